import pytest

pytest.importorskip("lightning", reason="needs the extra 'train'")

import lightning as L
import torch
from torch.utils.data import DataLoader

from torch_geometric_tactile.training import OneCycle


class Module(L.LightningModule):
    def __init__(self, rates=(0.1,)):
        super().__init__()
        self.lins = torch.nn.ModuleList(torch.nn.Linear(1, 1) for _ in rates)
        self.rates, self.seen = rates, []

    def training_step(self, batch):
        self.seen.append([group["lr"] for group in self.optimizers().param_groups])
        return sum(lin(batch).sum() for lin in self.lins)

    def configure_optimizers(self):
        groups = zip(self.lins, self.rates, strict=True)
        return torch.optim.AdamW([{"params": lin.parameters(), "lr": lr} for lin, lr in groups])


def fit(module, epochs=4, **arguments):
    trainer = L.Trainer(
        barebones=True, max_epochs=epochs, callbacks=[OneCycle(**arguments)], accelerator="cpu"
    )
    trainer.fit(module, DataLoader(torch.ones(10, 1), batch_size=2))
    return module


def test_one_cycle_rises_and_falls_once():
    rates = [seen[0] for seen in fit(Module()).seen]
    assert len(rates) == 20  # of four epochs
    top = rates.index(max(rates))
    assert top == 5  # three tenths of the steps, of which the first has a rate as well
    assert rates[top] == pytest.approx(0.1)
    assert rates[0] == pytest.approx(0.1 / 25)
    assert rates[-1] < 1e-5
    assert rates[: top + 1] == sorted(rates[: top + 1])
    assert rates[top:] == sorted(rates[top:], reverse=True)


def test_one_cycle_keeps_the_rates_of_groups_apart_and_momentum():
    module = fit(Module((0.1, 0.01)), part=0.5)
    for first, second in module.seen:
        assert first == pytest.approx(10 * second)
    assert module.optimizers().param_groups[0]["betas"] == (0.9, 0.999)


def test_one_cycle_of_a_single_step():
    trainer = L.Trainer(barebones=True, max_steps=1, callbacks=[OneCycle()], accelerator="cpu")
    module = Module()
    trainer.fit(module, DataLoader(torch.ones(2, 1), batch_size=2))
    assert len(module.seen) == 1


@pytest.mark.parametrize("part", [0, 1, -0.1])
def test_one_cycle_bad_part(part):
    with pytest.raises(ValueError, match=r"'part' must be between 0 and 1 \(got"):
        OneCycle(part)


def test_one_cycle_needs_an_end():
    with pytest.raises(ValueError, match="'max_epochs' must be given for OneCycle"):
        fit(Module(), epochs=-1)


def test_one_cycle_repr():
    assert str(OneCycle(0.2)) == "OneCycle(part=0.2)"
