import math

import pytest

pytest.importorskip("lightning", reason="needs the extra 'train'")

import numpy as np
import torch

from torch_geometric_tactile.predictor import PretrainedEncoder
from torch_geometric_tactile.sensors import grid
from torch_geometric_tactile.training import PretrainSettings, pretrain
from torch_geometric_tactile.training.pretraining import _contrast

LAYOUT = grid(4, 4, pitch=0.004)
QUICK = PretrainSettings(steps=4, batch_size=6, embedding_channels=8)


def trials(count=6, frames=10, seed=0):
    """Frames that are alike within a trial, and rise from side to side."""
    draw = torch.Generator().manual_seed(seed)
    slope = 500.0 * torch.randn(count, 3, 2, generator=draw)
    touch = (LAYOUT.pos @ slope).unsqueeze(1)
    x = touch + 0.3 * torch.randn(count, frames, 16, 2, generator=draw)
    return x.flatten(0, 1), torch.arange(count).repeat_interleave(frames)


def weights(encoder):
    return torch.cat([value.flatten() for value in encoder.model.state_dict().values()])


def test_pretrain_learns_to_tell_trials_apart():
    x, trial = trials()
    losses = []
    settings = PretrainSettings(steps=60, batch_size=6)
    encoder = pretrain(x, trial, LAYOUT, settings, on_step=losses.append)
    first, last = losses[0], losses[-1]
    assert [step.step for step in losses] == list(range(1, 61))
    assert {step.steps for step in losses} == {60}
    assert last.trial_loss < 0.5 * first.trial_loss
    assert last.view_loss < 0.5 * first.view_loss
    assert last.mask_loss < first.mask_loss
    unseen, their_trial = trials(seed=0)  # of the same touches, in another order
    found = torch.nn.functional.normalize(encoder.embed(unseen + 0.1), dim=1)
    near = (found @ found.t()).fill_diagonal_(-1).argmax(dim=1)
    assert (their_trial[near] == their_trial).float().mean() > 0.9


def test_contrast_by_hand():
    one, other = torch.eye(3), torch.eye(3)[[0, 1, 1]]
    trial = torch.tensor([0, 1, 1])  # the second and the third are no negatives of each other
    found = _contrast(one, other, trial, 1.0)
    first = math.log(1 + 2 * math.exp(-1))
    second, third = math.log(1 + math.exp(-1)), math.log(2)
    back = (math.log(1 + 2 * math.exp(-1)) + math.log(1 + math.exp(-1)) + math.log(2)) / 3
    assert float(found) == pytest.approx(((first + second + third) / 3 + back) / 2)


def test_pretrain_is_the_same_for_one_seed_and_number_of_steps():
    x, trial = trials()
    state = torch.random.get_rng_state()
    one = pretrain(x, trial, LAYOUT, QUICK)
    assert torch.random.get_rng_state().equal(state)  # that of the user
    assert weights(one).equal(weights(pretrain(x.numpy(), trial.numpy() + 7, LAYOUT, QUICK)))
    other = PretrainSettings(steps=4, batch_size=6, embedding_channels=8, seed=1)
    assert not weights(one).equal(weights(pretrain(x, trial, LAYOUT, other)))
    assert not one.model.training
    assert one.trained_on["num_trials"] == 6
    assert one.trained_on["num_frames"] == 60
    assert one.trained_on["steps"] == 4


class _StoppedError(Exception):
    pass


def test_pretrain_goes_on_where_it_was_stopped(tmp_path, monkeypatch):
    monkeypatch.setattr("torch_geometric_tactile.training.pretraining._SECONDS_BETWEEN_FILES", 0.0)
    x, trial = trials()
    whole = pretrain(x, trial, LAYOUT, QUICK)
    path = tmp_path / "a.checkpoint"

    def stop(step):
        if step.step == 3:
            raise _StoppedError

    with pytest.raises(_StoppedError):
        pretrain(x, trial, LAYOUT, QUICK, checkpoint=path, on_step=stop)
    assert [p.name for p in tmp_path.iterdir()] == ["a.checkpoint"]
    steps = []
    resumed = pretrain(x, trial, LAYOUT, QUICK, checkpoint=path, on_step=steps.append)
    assert [step.step for step in steps] == [3, 4]
    assert weights(resumed).equal(weights(whole))
    assert not path.exists()


def test_pretrain_refuses_the_checkpoint_of_others(tmp_path, monkeypatch):
    monkeypatch.setattr("torch_geometric_tactile.training.pretraining._SECONDS_BETWEEN_FILES", 0.0)
    x, trial = trials()
    path = tmp_path / "a.checkpoint"

    def stop(step):
        if step.step == 3:
            raise _StoppedError

    with pytest.raises(_StoppedError):
        pretrain(x, trial, LAYOUT, QUICK, checkpoint=path, on_step=stop)
    with pytest.raises(ValueError, match="other data or settings"):
        pretrain(x + 1, trial, LAYOUT, QUICK, checkpoint=path)
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(ValueError, match=r"no checkpoint .* can be read .*delete it"):
        pretrain(x, trial, LAYOUT, QUICK, checkpoint=path)


def test_pretrain_reckons_the_steps_from_the_time():
    x, trial = trials()
    steps = []
    settings = PretrainSettings(minutes=0.02, batch_size=4, embedding_channels=8)
    encoder = pretrain(x, trial, LAYOUT, settings, on_step=steps.append)
    assert steps[0].steps is None
    assert steps[-1].step == steps[-1].steps == encoder.trained_on["steps"]
    assert len({step.steps for step in steps}) == 2


def test_pretrain_of_missing_readings_and_single_frames():
    x, trial = trials()
    x[:, 3] = math.nan
    x[5:9] = math.nan
    trial[-1] = 99  # a trial of one frame
    encoder = pretrain(x, trial, LAYOUT, QUICK)
    assert weights(encoder).isfinite().all()
    assert encoder.embed(x).isfinite().all()


def test_pretrain_of_taxels_of_which_none_is_hidden():
    x, trial = trials()
    settings = PretrainSettings(steps=2, batch_size=2, drop=1e-9, embedding_channels=8)
    assert weights(pretrain(x, trial, LAYOUT, settings)).isfinite().all()


def test_pretrain_warns_of_too_little(caplog):
    x, trial = trials()
    pretrain(x, trial, LAYOUT, QUICK)
    assert "6 trials and 60 frames" in caplog.text
    caplog.clear()
    pretrain(*trials(20, 30), LAYOUT, QUICK)
    assert not caplog.text


def test_pretrain_bad():
    x, trial = trials()
    with pytest.raises(ValueError, match=r"at least 2 trials.*nothing to contrast \(got 1 trial"):
        pretrain(x, torch.zeros(60), LAYOUT)
    with pytest.raises(ValueError, match=r"nothing to contrast \(got 0 trials of 0 frames"):
        pretrain(x[:0], trial[:0], LAYOUT)
    with pytest.raises(ValueError, match=r"'x' must have shape \(num_frames, 16, num_channels\)"):
        pretrain(x[:, :4], trial, LAYOUT)
    with pytest.raises(ValueError, match="'trial' must have one number for each of 60 frames"):
        pretrain(x, trial[:4], LAYOUT)
    with pytest.raises(ValueError, match="'x' must hold finite readings, or NaN"):
        pretrain(torch.where(x > 1, math.inf, x), trial, LAYOUT)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("minutes", 0.0),
        ("minutes", math.nan),
        ("steps", 0),
        ("batch_size", 1),
        ("lr", -1.0),
        ("temperature", 0.0),
        ("drop", 1.0),
        ("embedding_channels", 0),
    ],
)
def test_settings_bad(name, value):
    with pytest.raises(ValueError, match=f"'{name}' must be"):
        PretrainSettings(**{name: value})


def test_an_encoder_is_the_same_in_its_file(tmp_path):
    x, trial = trials()
    encoder = pretrain(x, trial, LAYOUT, QUICK, trained_on={"source": "a", "rest": None})
    path = tmp_path / "skin.encoder"
    encoder.save(path)
    loaded = PretrainedEncoder.load(path)
    assert loaded.embed(x).equal(encoder.embed(x))
    assert loaded.trained_on == encoder.trained_on
    assert loaded.layout.matches(LAYOUT)
    assert np.array_equal(weights(loaded), weights(encoder))
