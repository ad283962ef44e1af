import logging

import pytest
import torch

from torch_geometric_tactile.data import StaticDataset, Trials, split_frames
from torch_geometric_tactile.sensors import grid


def frames_of(lengths=(3, 2, 4), **attributes):
    trial = torch.arange(len(lengths)).repeat_interleave(torch.tensor(lengths))
    x = torch.arange(8.0 * len(trial)).view(-1, 4, 2)
    values = {"y": trial % 2} | attributes
    return StaticDataset.from_arrays(x, trial=trial, layout=grid(2, 2, 0.002), **values)


def test_trials_of_one_length():
    frames = frames_of((3, 3))
    trials = Trials(frames)
    assert repr(trials) == "Trials(2)"
    assert trials.y.tolist() == [0, 1]
    assert split_frames(trials[1].x, 3).transpose(0, 1).equal(frames.x[3:])
    assert "valid_frames" not in trials[0]


def test_padded_trials_have_nan_after_their_end():
    frames = frames_of(time=torch.arange(9) * 0.1, step=torch.arange(9))
    trials = Trials(frames, ragged="pad", series=["time", "step"])
    assert trials.valid_frames.tolist() == [3, 2, 4]
    batch = trials.batch([1, 2])
    found = split_frames(batch.x, 4)
    assert found[0, :, :2].transpose(0, 1).equal(frames.x[3:5])
    assert found[0, :, 2:].isnan().all()
    assert found[1].transpose(0, 1).equal(frames.x[5:])
    assert batch.time[0, 2:].isnan().all()
    assert batch.step.tolist() == [[3, 4, 4, 4], [5, 6, 7, 8]]
    assert batch.valid_frames.tolist() == [2, 4]
    assert trials[0].valid_frames.tolist() == [3]
    assert Trials(frames, ragged="pad", length=6).x.shape == (3, 4, 12)
    copied = trials[[1, 0]].copy()
    assert copied.valid_frames.tolist() == [2, 3]
    assert copied.x.nan_to_num(-1).equal(trials.x[[1, 0]].nan_to_num(-1))


@pytest.mark.parametrize(("ragged", "first"), [("crop_end", [0, 3, 5]), ("crop_start", [1, 3, 7])])
def test_cropped_trials(ragged, first):
    frames = frames_of()
    trials = Trials(frames, ragged=ragged)
    for sample, start in zip(trials, first, strict=True):
        assert split_frames(sample.x, 2).transpose(0, 1).equal(frames.x[start : start + 2])


def test_cropped_trials_that_are_too_short(caplog):
    with caplog.at_level(logging.WARNING):
        trials = Trials(frames_of(), ragged="crop_end", length=3)
    assert trials.trial.tolist() == [0, 2]
    assert trials.too_short == ["trial 1"]
    assert "1 of 3 trials are left out" in caplog.text


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ({}, r"different numbers of frames \(got 2 in trial 1 and 4 in trial 2\)"),
        ({"ragged": "crop"}, "'ragged' must be one of"),
        ({"length": 2}, "'length' must be left out with ragged='error'"),
        ({"ragged": "crop_end", "length": 0}, "'length' must be at least 1"),
        ({"ragged": "crop_end", "length": 5}, "at most 4 frames, the length of the longest trial"),
        (
            {"ragged": "pad", "length": 3},
            "at least 4 with ragged='pad', the length of the longest trial, trial 2",
        ),
    ],
)
def test_trials_with_bad_arguments(arguments, match):
    with pytest.raises(ValueError, match=match):
        Trials(frames_of(), **arguments)


def test_trials_with_other_bad_data():
    with pytest.raises(ValueError, match=r"'y' must be the same.*frame 1 of trial 0"):
        Trials(frames_of(y=torch.arange(9)), ragged="pad")
    frames = frames_of()
    frames._data.x = frames._data.x.int()
    with pytest.raises(ValueError, match="integers, which have no NaN"):
        Trials(frames, ragged="pad")
