import warnings

import pytest
import torch

from torch_geometric_tactile.data import Protocol, StaticData, StaticDataset, Windows
from torch_geometric_tactile.data.splits import (
    SharedDataWarning,
    num_shared,
    shared_recordings,
    shared_units,
)
from torch_geometric_tactile.sensors import grid

LAYOUT = grid(2, 3, pitch=0.01)


def readings(num_trials=6, frames=4, seed=0):
    return torch.randn(num_trials, frames, 6, 1, generator=torch.Generator().manual_seed(seed))


def dataset(x, **columns):
    trial = torch.arange(len(x)).repeat_interleave(x.shape[1])
    columns = {"trial": trial, **columns}
    y = torch.zeros(len(trial), dtype=torch.long)
    return StaticDataset.from_arrays(x.flatten(0, 1), y, layout=LAYOUT, **columns)


def halves(data):
    size = len(data) // 2
    return torch.arange(size), torch.tensor([], dtype=torch.long), torch.arange(size, 2 * size)


def test_num_shared_counts_members_in_both():
    values = torch.tensor([3, 3, 5, 7, 5])
    assert num_shared(values, torch.tensor([0, 2]), torch.tensor([1, 3, 4])) == 2
    assert num_shared(values, torch.tensor([0]), torch.tensor([3])) == 0
    assert num_shared(values, torch.tensor([], dtype=torch.long), torch.tensor([3])) == 0


def test_units_of_all_pairs_of_parts():
    group = torch.tensor([0, 1, 2, 2, 0, 1, 3, 4])
    data = dataset(readings(4, 2), group=group)
    parts = [torch.tensor(part) for part in ([0, 2], [3, 5], [4, 1, 6, 7])]
    assert shared_units(data, parts) == {"trial": [0, 1, 2], "group": [0, 1, 2]}
    apart = [torch.tensor(part) for part in ([0, 1], [2, 3], [4, 5, 6, 7])]
    assert shared_units(data, apart) == {"trial": [], "group": [0, 1]}


@pytest.mark.parametrize("of_windows", [False, True])
def test_copies_of_trials(of_windows):
    once = readings(3)
    data = dataset(torch.cat([once, once]))
    data = Windows(data, 2) if of_windows else data
    copies = shared_recordings(data, halves(data))
    assert [tuple(copy) for copy in copies] == [(3, 0), (4, 1), (5, 2)]


def test_copies_in_one_part_are_no_leak():
    once = readings(3)
    data = dataset(torch.cat([once[:1], once[:1], once]))
    parts = (torch.arange(8), torch.arange(0), torch.arange(8, 20))
    assert [tuple(copy) for copy in shared_recordings(data, parts)] == [(2, 0)]
    parts = (torch.arange(12), torch.arange(12, 20), torch.arange(0))
    assert shared_recordings(data, parts) == []


def test_copies_of_samples_without_trials():
    x = torch.randn(10, 6, 2)
    data = StaticData(x=torch.cat([x, x[:4]]), y=torch.zeros(14, dtype=torch.long))
    parts = (torch.arange(10), torch.arange(0), torch.arange(10, 14))
    assert [tuple(copy) for copy in shared_recordings(data, parts)] == [
        (10, 0), (11, 1), (12, 2), (13, 3)
    ]  # fmt: skip


def test_one_other_reading_is_no_copy():
    once = readings(1, frames=100)
    for frame in range(100):  # also where the first comparison does not look
        other = once.clone()
        other[0, frame, 3] += 1e-6
        data = dataset(torch.cat([once, other]))
        assert shared_recordings(data, halves(data)) == []


def test_readings_at_rest_are_no_copies():
    data = dataset(torch.zeros(6, 50, 6, 1))
    assert shared_recordings(data, halves(data)) == []
    steps = torch.arange(7.0).repeat(6, 6, 1).transpose(1, 2)[..., None].contiguous()
    data = dataset(steps)  # seven values in each trial
    assert shared_recordings(data, halves(data)) == []


def test_missing_readings_and_zeros_of_both_signs_are_equal():
    first = readings(1)
    first[0, 0, :2, 0] = torch.tensor([torch.nan, 0.0])
    second = first.clone()
    second[0, 0, :2, 0] = torch.tensor([-torch.nan, -0.0])
    data = dataset(torch.cat([first, second]))
    assert len(shared_recordings(data, halves(data))) == 1


def test_trials_of_other_lengths_are_no_copies():
    x = readings(1, frames=6).flatten(0, 1)
    trial = torch.tensor([0] * 6 + [1] * 5)
    data = StaticData(x=torch.cat([x, x[:5]]), trial=trial)
    assert shared_recordings(data, (torch.arange(6), torch.arange(6, 11))) == []


def test_given_parts_that_share_a_trial_are_told():
    data = dataset(readings(4), part=torch.arange(16) % 2 * 2)
    with pytest.warns(SharedDataWarning, match=r"^4 trials are in more than one part \(trial 0, "):
        Protocol("given").split(data)


def test_copies_on_both_sides_are_told():
    once = readings(6)
    data = dataset(torch.cat([once, once]))
    text = r"^\d trials have the same readings as a trial in another part \(trial \d+ is trial \d+,"
    with pytest.warns(SharedDataWarning, match=text):
        Protocol("trial", test=0.5, val=0.0).split(data)


@pytest.mark.parametrize("by", ["trial", "frame", "given", "group"])
def test_clean_splits_are_silent(by):
    trial = torch.arange(6).repeat_interleave(4)
    data = dataset(readings(6), group=trial // 2, part=(trial >= 4) * 2)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Protocol(by, **({} if by == "given" else {"test": 0.4, "val": 0.0})).split(data)
