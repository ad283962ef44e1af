import pytest
import torch

from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.transforms import Tare

TIME = [5.0, 5.1, 5.2, 5.3, 0.0, 0.5, 1.0]


def trials(time=TIME):
    x = torch.tensor([10.0, 12.0, 20.0, 30.0, 1.0, 2.0, 3.0]).view(7, 1, 1)
    data = StaticData(x=x, trial=torch.tensor([4, 4, 4, 4, 9, 9, 9]))
    data.time = torch.tensor(time, dtype=torch.double)
    return data


def tared(seconds, data):
    return Tare("trial", seconds=seconds).fit(data)(data).x.view(-1).tolist()


def test_tare_seconds_by_hand():
    # Trial 4 rests for two samples, at 11; trial 9, sampled more slowly, for one.
    assert tared(0.15, trials()) == [-1, 1, 9, 19, 0, 1, 2]
    assert tared(0.05, trials()) == [0, 2, 10, 20, 0, 1, 2]
    assert tared(0.5, trials())[4:] == [0, 1, 2]  # the sample at half a second is past it
    everything = Tare("trial").fit(trials())(trials()).x.view(-1)
    assert tared(100.0, trials()) == everything.tolist()


def test_tare_seconds_not_in_order():
    order = torch.tensor([3, 5, 0, 6, 1, 4, 2])
    shuffled = trials().index_select(order)
    expected = torch.tensor(tared(0.15, trials()))[order]
    assert tared(0.15, shuffled) == expected.tolist()


def test_tare_seconds_counts_from_the_start_of_each_trial():
    # Seconds since 1970, as a clock gives them, one trial an hour after the other.
    late = [1.7e9 + t + 3600 * (i > 3) for i, t in enumerate(TIME)]
    assert tared(0.15, trials(late)) == tared(0.15, trials())


def test_tare_seconds_needs_the_time_only_to_fit():
    transform = Tare("trial", seconds=0.15).fit(trials())
    later = trials()
    del later.time  # what was fitted needs no time
    assert torch.equal(transform(later).x, transform(trials()).x)
    column = trials()
    column.time = column.time.view(-1, 1)
    assert tared(0.15, column) == tared(0.15, trials())


def test_tare_seconds_adapt():
    data = trials()
    transform = Tare("trial", seconds=0.15).fit(data.index_select(slice(0, 4)))
    assert transform.adapt(data)(data).x.view(-1).tolist() == tared(0.15, data)


def test_tare_seconds_single_sample():
    data = trials().index_select(slice(2, 3))
    assert tared(0.01, data) == [0]


def test_tare_seconds_bad_input():
    with pytest.raises(ValueError, match=r"only one of 'first' and 'seconds' .* \(got 1 and 0.5\)"):
        Tare("trial", first=1, seconds=0.5)
    for wrong in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(ValueError, match=r"'seconds' must be positive and finite \(got"):
            Tare("trial", seconds=wrong)
    without = trials()
    del without.time
    with pytest.raises(ValueError, match=r"Tare needs samples with 'time' \(got none\)"):
        tared(0.1, without)
    one_for_all = trials()
    del one_for_all.time
    one_for_all.declare(shared=["time"]).time = torch.zeros(3)
    with pytest.raises(
        ValueError, match=r"'time' must have 7 values, one for each sample \(got 3\)"
    ):
        tared(0.1, one_for_all)
    with pytest.raises(ValueError, match="'time' must be finite seconds"):
        tared(0.1, trials([float("nan"), *TIME[1:]]))
