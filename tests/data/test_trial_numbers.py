import numpy as np
import pytest
import torch

from torch_geometric_tactile.data import Protocol, StaticDataset, Windows
from torch_geometric_tactile.sensors import grid

LAYOUT = grid(1, 2, pitch=0.004)


def frames(trial, **columns):
    x = np.zeros((len(trial), 2, 1))
    y = columns.pop("y", np.zeros(len(trial), int))
    return StaticDataset.from_arrays(x, y, layout=LAYOUT, trial=trial, **columns)


def test_a_trial_lies_in_one_session():
    dataset = frames([0] * 4 + [1] * 3 + [0] * 2, session=[0] * 4 + [0] * 3 + [1] * 2)
    assert dataset.trial.tolist() == [0] * 4 + [2] * 3 + [1] * 2
    assert len(Windows(dataset, 2)) == 3 + 2 + 1


def test_numbers_that_begin_anew_in_each_group():
    dataset = frames([0, 0, 1, 1, 0, 0, 1, 1], group=["a"] * 4 + ["b"] * 4)
    assert len(dataset.trial.unique()) == 4
    assert len(Windows(dataset, 2)) == 4


def test_a_trial_may_touch_two_objects():
    dataset = frames([5, 5, 5, 7, 7], group=[0, 0, 1, 1, 1])
    assert dataset.trial.tolist() == [5, 5, 5, 7, 7]


@pytest.mark.parametrize("columns", [{}, {"session": [0] * 4}, {"group": [0, 0, 1, 1]}])
def test_other_numbers_stay(columns):
    assert frames([3, 3, 9, 9], **columns).trial.tolist() == [3, 3, 9, 9]


def test_names_of_trials_follow():
    class Named(StaticDataset):
        def __init__(self):
            self.layout = LAYOUT
            super().__init__()

        def read(self):
            data = frames([0, 0, 1]).data
            data.session = torch.tensor([0, 1, 1])
            return data, {"trial": ["first", "second"]}

    dataset = Named()
    assert dataset.trial.tolist() == [0, 1, 2]
    assert dataset._names["trial"] == ["first", "first", "second"]


def test_windows_that_overlap_are_not_split_by_frame():
    dataset = frames(np.arange(40) // 20, y=np.arange(40) // 20)
    windows = Windows(dataset, 5, 2)
    assert windows.overlap
    with pytest.raises(ValueError, match="must be split by trial, group or session"):
        Protocol("frame").split(windows)
    for apart in (Windows(dataset, 5, 5), windows[::3]):
        assert not apart.overlap
        assert len(Protocol("frame", val=0.0, test=0.5).split(apart).test) > 0
    assert len(Protocol("trial", val=0.0, test=0.5).split(windows).test) > 0
