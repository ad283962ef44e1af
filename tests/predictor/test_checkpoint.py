import sys

import pytest
import torch
from torch.nn import Linear, Module

pytest.importorskip("lightning", reason="needs the extra 'train'")

import lightning as L
from torch_geometric.transforms import Compose

from torch_geometric_tactile import Predictor
from torch_geometric_tactile.data import apply_transform
from torch_geometric_tactile.nn import TactileGCN
from torch_geometric_tactile.training import TactileDataModule, TactileModule
from torch_geometric_tactile.transforms import DropTaxels, KNNGraph, ZScore


class Own(Module):
    modalities = ("joint",)

    def __init__(self, width=3):
        super().__init__()
        self.lin = Linear(3, width)

    def forward(self, x, edge_index, joint):
        return self.lin(joint) + x.mean()


def trained(labelled, model, tmp_path, **kwargs):
    data = TactileDataModule(
        labelled("multiclass", **kwargs), transform=Compose([ZScore(), ZScore(attr="joint")])
    )
    classifier = TactileModule(model, num_classes=3)
    trainer = L.Trainer(
        max_epochs=1,
        accelerator="cpu",
        logger=False,
        default_root_dir=tmp_path,
        enable_progress_bar=False,
        enable_model_summary=False,
    )
    trainer.fit(classifier, data)
    path = tmp_path / "last.ckpt"
    trainer.save_checkpoint(path)
    return classifier.eval(), data, path


@pytest.mark.filterwarnings("ignore")
def test_a_checkpoint_is_a_predictor(labelled, tmp_path):
    torch.manual_seed(0)
    small = {"head_widths": (8,), "head_pools": (2,)}
    model = TactileGCN(4, 3, inputs=("tactile",), num_joints=3, channels={"tactile": 2}, **small)
    classifier, data, path = trained(labelled, model, tmp_path)
    predictor = Predictor.from_checkpoint(path)
    stored = data.dataset.data
    ready = apply_transform(data.transform, stored)
    with torch.no_grad():
        expected = classifier(ready).softmax(dim=1)
    torch.testing.assert_close(predictor(stored.x, stored.joint), expected)
    assert predictor.class_names == ("hard", "heavy", "slippery")
    assert predictor.task == "multiclass"
    with pytest.raises(ValueError, match="'joint' must be given: 3 joint angles"):
        predictor(stored.x)
    predictor.save(tmp_path / "a.predictor")
    assert Predictor.load(tmp_path / "a.predictor")(stored.x, stored.joint).equal(
        predictor(stored.x, stored.joint)
    )


@pytest.mark.filterwarnings("ignore")
def test_a_checkpoint_needs_no_lightning(labelled, tmp_path, monkeypatch):
    _, data, path = trained(labelled, Own(), tmp_path)
    monkeypatch.setitem(sys.modules, "lightning", None)
    with pytest.raises(ValueError, match=r"'model' must be given.*Own"):
        Predictor.from_checkpoint(path)
    predictor = Predictor.from_checkpoint(path, model=Own())
    stored = data.dataset.data
    assert predictor(stored.x[0], stored.joint[0]).shape == (3,)
    with pytest.raises(ValueError, match=r"'lin.weight' of shape \(3, 3\).*\(got \(4, 3\)\)"):
        Predictor.from_checkpoint(path, model=Own(4))


@pytest.mark.filterwarnings("ignore")
def test_the_transforms_of_the_data_set_come_first(labelled, tmp_path):
    pre, own = KNNGraph(k=1), DropTaxels(taxels=[0])

    class Posed(labelled):
        def read(self):
            data, names = super().read()
            data.pos = self.layout.pos
            del data.edge_attr
            return data, names

    _, data, path = trained(Posed, Own(), tmp_path, pre_transform=pre, transform=own)
    predictor = Predictor.from_checkpoint(path, model=Own())
    stored = data.dataset.data
    prepared = predictor.prepare(stored.x, stored.joint)
    expected = apply_transform(Compose([own, data.transform]), stored)
    assert prepared.x.equal(expected.x)
    assert prepared.joint.equal(expected.joint)
    assert prepared.edge_index.equal(stored.edge_index)
