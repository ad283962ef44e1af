import math
from itertools import pairwise

import numpy as np
import pytest

from torch_geometric_tactile.live._frame_clock import FrameClock


def simulated(rate, burst, *, jitter=0.0, loss=0.0, drift=0.0, seconds=20.0):
    """Distances of mapped times in periods, and mapped minus true times of frames in seconds."""
    draw = np.random.default_rng(0)
    number = max(round(seconds * rate), 40 * burst)
    true = 1000 + np.arange(number) / rate
    true += 0.5 * drift * (true - 1000) ** 2 / seconds
    clock, times, numbers, before = FrameClock(), [], [], 0.0
    for place in range(0, number - burst + 1, burst):
        read = np.arange(place, place + burst)
        read = read[draw.random(burst) >= loss]
        if not len(read):
            continue
        late = 0.0005 + (draw.exponential(jitter) if jitter else 0.0)
        arrival = max(true[place + burst - 1] + late, before + 1e-4)
        mapped = clock.times((7 + read).tolist(), arrival, waited=arrival - before)
        assert max(mapped) <= arrival
        times += mapped
        numbers += read.tolist()
        before = arrival
    assert all(earlier < later for earlier, later in pairwise(times))
    spacing = np.diff(times) / np.diff(numbers) * rate
    return spacing, np.array(times) - true[numbers], clock


@pytest.mark.parametrize("rate", [10, 100, 187.5, 1000])
@pytest.mark.parametrize("burst", [1, 2, 3, 7, 16])
@pytest.mark.parametrize("loss", [0.0, 0.05])
def test_frames_of_any_burst_are_a_period_apart(rate, burst, loss):
    jitter = 0.002
    spacing, error, clock = simulated(rate, burst, jitter=jitter, loss=loss)
    settled = spacing[len(spacing) // 3 :]
    assert np.abs(settled - 1).max() < 0.06
    assert np.abs(np.percentile(settled, [5, 95]) - 1).max() < 0.01
    assert np.abs(error[len(error) // 3 :]).max() < 0.003
    assert clock.rate == pytest.approx(rate, rel=0.002)


@pytest.mark.parametrize("drift", [1e-3, -1e-3])
def test_slow_drift_of_the_rate_is_followed(drift):
    _, error, _ = simulated(100, 3, jitter=0.002, drift=drift, seconds=60)
    assert np.abs(error[600:]).max() < 0.005


def test_first_read_is_spread_from_the_opening():
    assert FrameClock().times([0, 1, 2, 3], 10.4, since=10.0) == pytest.approx(
        [10.1, 10.2, 10.3, 10.4]
    )
    first = FrameClock().times([0, 1], 10.4)
    assert first == pytest.approx([10.4, 10.4], abs=1e-5)
    assert first[0] < first[1] <= 10.4


def fed(clock, count, rate=100.0, first=0, start=100.0):
    """Frames one by one without jitter; the last time."""
    for number in range(first, first + count):
        arrival = start + (number - first) / rate
        assert clock.times([number], arrival, waited=1 / rate)[0] <= arrival
    return start + (count - 1) / rate


def test_lost_numbers_keep_their_time():
    clock = FrameClock()
    last = fed(clock, 300)
    assert clock.times([349], last + 0.5, waited=0.5) == pytest.approx([last + 0.5])
    # 20 ms late, after 100 that are lost.
    assert clock.times([450], last + 1.53, waited=1) == pytest.approx([last + 1.51], abs=0.005)


def test_late_read_of_a_stopped_process_is_no_outage():
    clock = FrameClock()
    last = fed(clock, 300)
    backlog = list(range(300, 380))
    times = clock.times(backlog[:50], last + 0.9, waited=0.001)
    times += clock.times(backlog[50:], last + 0.9001, waited=0.0)
    assert np.diff(times) == pytest.approx(0.01, rel=0.06)
    assert times[0] == pytest.approx(last + 0.01, abs=1e-3)


def test_long_pause_of_a_device_without_numbers_is_seen_at_once():
    clock = FrameClock()
    last = fed(clock, 300)
    assert clock.times([300], last + 3.0, waited=3.0) == pytest.approx([last + 3.0])
    assert clock.times([301], last + 3.01, waited=0.01) == pytest.approx([last + 3.01])
    assert clock.rate == pytest.approx(100, rel=1e-3)


def test_short_pause_is_seen_after_a_few_frames():
    clock = FrameClock()
    last = fed(clock, 300)
    start = last + 0.3
    times = []
    for i in range(40):
        times += clock.times([300 + i], start + i / 100, waited=0.3 if i == 0 else 0.01)
    assert max(np.diff([last, *times])) == pytest.approx(0.3, abs=0.06)
    assert times[-1] == pytest.approx(start + 0.39)


def test_sender_that_makes_up_for_a_delay_is_no_outage():
    clock = FrameClock()
    last = fed(clock, 300)
    late, arrival, times = 0.2, last + 0.21, []
    for number in range(300, 350):  # 20 ms of the 200 ms are made up for in 27 ms each
        times += clock.times([number], arrival, waited=0.008)
        late = max(0.0, late - 0.0045)
        arrival = last + (number - 298) / 100 + late
    assert np.diff([last, *times]) == pytest.approx(0.01, rel=0.06)


def test_pause_among_the_first_frames_is_seen():
    clock = FrameClock()
    last = fed(clock, 5)
    assert clock.times([5, 6, 7], last + 3.0, waited=3.0) == pytest.approx(
        [last + 2.98, last + 2.99, last + 3.0]
    )


def test_numbers_that_jump_without_reason_make_no_frame_early():
    clock = FrameClock()
    last = fed(clock, 300)
    assert clock.times([5000], last + 0.01, waited=0.01)[0] <= last + 0.01
    end = fed(clock, 300, first=5001, start=last + 0.02)
    assert clock.times([5301], end + 0.01, waited=0.01) == pytest.approx([end + 0.01])
    assert clock.rate == pytest.approx(100, rel=0.01)


def test_numbers_that_begin_again_go_on():
    clock = FrameClock()
    last = fed(clock, 300)
    assert clock.times([0], last + 0.01, waited=0.01) == pytest.approx([last + 0.01])
    assert clock.times([1, 2], last + 0.03, waited=0.02) == pytest.approx(
        [last + 0.02, last + 0.03]
    )


def test_another_rate_is_found():
    clock = FrameClock()
    last = fed(clock, 600, rate=100.0)
    fed(clock, 2000, rate=200.0, first=600, start=last + 0.005)
    assert clock.rate == pytest.approx(200, rel=0.001)
    last = fed(clock, 600, rate=50.0, first=2600, start=last + 10.02)
    assert clock.rate == pytest.approx(50, rel=0.001)


def test_after_a_reset_it_begins_anew_at_the_present():
    clock = FrameClock()
    last = fed(clock, 300)
    clock.reset()
    assert clock.times([300, 301], last + 7.0, waited=0.0) == pytest.approx(
        [last + 6.99, last + 7.0]
    )


def test_rate_is_known_after_a_second():
    clock = FrameClock()
    fed(clock, 100)
    assert clock.rate is None
    clock = FrameClock()
    fed(clock, 120)
    assert clock.rate == pytest.approx(100)
    assert clock.largest_gap == pytest.approx(0.05)


def test_largest_gap_is_five_periods():
    clock = FrameClock()
    assert clock.largest_gap == 0.5
    fed(clock, 20, rate=10.0)
    assert clock.largest_gap == pytest.approx(0.5)
    clock = FrameClock()
    fed(clock, 20, rate=2.0)
    assert clock.largest_gap == pytest.approx(2.5)


def test_observed_times_are_kept_and_increase():
    clock = FrameClock()
    assert clock.observe(0, 5.0) == 5.0
    assert 5.0 < clock.observe(1, 5.0) < 5.00001
    assert clock.times([2], 5.5) == [5.5]


def test_frame_clock_repr():
    assert repr(FrameClock(2.0)) == "FrameClock(rate=None, window=2.0)"
    assert not math.isnan(FrameClock().largest_gap)
