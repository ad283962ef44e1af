import math

import numpy as np
import pytest

from torch_geometric_tactile.data import Recording, measure_rate
from torch_geometric_tactile.data._gaps import gaps_of, part_numbers

RATES = (10.0, 37.5, 100.0, 1000.0)


def recording(time):
    return Recording(time=time, tactile=np.zeros((len(time), 1, 1)))


def test_rate_by_hand():
    assert measure_rate(np.array([0.0, 0.5, 1.0])) == (2.0, 0.5)
    assert measure_rate(np.array([0.0, 0.5, 1.0])).max_gap == 2.5


@pytest.mark.parametrize("time", [[], [3.0]])
def test_too_few_frames_have_no_rate(time):
    assert math.isnan(measure_rate(np.array(time)).rate)
    assert recording(np.array(time)).info.rate is None
    assert recording(np.array(time)).gaps.shape == (0, 2)


def test_of_two_distances_the_longer_one_is_the_gap():
    time = np.array([0.0, 0.01, 5.0])
    assert measure_rate(time).rate == pytest.approx(100.0)
    assert recording(time).gaps.tolist() == [[0.01, 5.0]]


@pytest.mark.parametrize("since", [0.0, 1.7e9])
@pytest.mark.parametrize("rate", RATES)
@pytest.mark.parametrize("seed", range(4))
def test_gaps_losses_and_jitter_do_not_change_the_rate(rate, seed, since):
    draw = np.random.default_rng(seed)
    time = np.arange(400) / rate
    starts = np.sort(draw.choice(np.arange(20, 380, 20), 3, replace=False))
    for start in starts:
        time[start:] += draw.uniform(7, 1000) / rate
    jitter = time + draw.uniform(-0.2, 0.2, 400) / rate
    assert measure_rate(since + jitter).rate == pytest.approx(rate, rel=0.02)
    assert len(recording(since + jitter).gaps) == 3
    kept = np.sort(draw.choice(400, 330, replace=False))
    assert measure_rate(since + time[kept]).rate == pytest.approx(rate, rel=0.01)


@pytest.mark.parametrize("rate", RATES)
@pytest.mark.parametrize("size", [2, 3, 5, 16])
def test_frames_of_one_read_are_one_arrival(rate, size):
    read, place = np.divmod(np.arange(320), size)
    time = read * size / rate + place * 1e-6
    found = measure_rate(time)
    assert found.rate == pytest.approx(rate, rel=0.01)
    assert found.arrival == pytest.approx(size / rate, rel=0.02)
    assert len(recording(time).gaps) == 0
    time[160:] += 6 * size / rate
    assert recording(time).gaps.shape == (1, 2)


def test_a_fast_clock_is_no_burst():
    assert measure_rate(np.arange(100) / 22_000).rate == pytest.approx(22_000)


def test_parts_and_gaps_by_hand():
    time = np.array([0.0, 1.0, 6.0, 7.0, 12.1])
    assert part_numbers(time, 5.0).tolist() == [0, 0, 0, 0, 1]  # five frames are no gap
    assert part_numbers(time, math.inf).tolist() == [0] * 5
    assert part_numbers(time[:0], 1.0).tolist() == []
    assert gaps_of(time, 2.0).tolist() == [1, 3]
