import math

import numpy as np
import pytest

from torch_geometric_tactile.live._clock_map import ClockMap


def ns(seconds):
    return round(seconds * 1e9)


def simulated(drift, period=None, rate=100, seconds=60, start=0.0):
    """Mapped minus true times of frames with jitter, of which some arrive together."""
    generator = np.random.default_rng(0)
    clock = ClockMap(period)
    errors = []
    true = 1000 + np.arange(seconds * rate) / rate
    late = 0.001 + generator.exponential(0.002, len(true))
    received = np.maximum.accumulate(true + late)
    received[5::50] = received[9::50][: len(received[5::50])]
    received = np.maximum.accumulate(received)
    for one, host in zip(true, received, strict=True):
        device = start + (one - 1000) * (1 + drift)
        device = device if period is None else device % period
        mapped = clock.map(device, ns(host))
        assert mapped <= host + 1e-9
        errors.append(mapped - one)
    return np.array(errors)


@pytest.mark.parametrize("drift", [0.0, 1e-4, -1e-4])
def test_clock_map_follows_drift_within_five_milliseconds_a_minute(drift):
    errors = simulated(drift)
    settled = errors[500:]
    assert np.abs(settled).max() < 0.005
    assert abs(settled[-500:].mean() - settled[:500].mean()) < 0.001


@pytest.mark.parametrize("period", [2**32 / 1e6, 7.3])
def test_clock_map_unwraps_a_clock_that_starts_over(period):
    errors = simulated(0.0, period, start=period - 3.0)
    assert np.abs(errors[500:]).max() < 0.005
    steps = np.diff(errors)
    assert np.abs(steps).max() < 0.03


def test_clock_map_keeps_what_it_knows_where_the_clock_starts_over():
    clock = ClockMap(period=10.0)
    clock.map(9.0, ns(99.0))
    assert clock.map(9.9, ns(99.94)) == pytest.approx(99.9)  # 40 ms late
    assert clock.map(0.1, ns(100.12)) == pytest.approx(100.1)  # 20 ms late


def test_clock_map_by_hand():
    clock = ClockMap()
    assert clock.map(5.0, ns(1.0)) == 1.0
    assert clock.map(6.0, ns(2.003)) == pytest.approx(2.0)
    assert clock.map(7.0, ns(2.999)) == pytest.approx(2.999)
    assert clock.map(8.0, ns(4.2)) == pytest.approx(3.999)


def test_clock_map_forgets_after_its_window():
    clock = ClockMap(window=5.0)
    clock.map(0.0, ns(0.0))
    assert clock.map(4.0, ns(4.03)) == pytest.approx(4.0)
    assert clock.map(9.0, ns(9.03)) == pytest.approx(9.03)


@pytest.mark.parametrize("device", [None, math.nan, math.inf])
def test_clock_map_without_a_device_time_is_the_host(device):
    clock = ClockMap()
    clock.map(100.0, ns(1.0))
    assert clock.map(device, ns(2.5)) == 2.5
    assert clock.map(101.0, ns(2.1)) == pytest.approx(2.0)


def test_clock_map_recognises_a_restarted_device():
    clock = ClockMap()
    for step in range(100):
        clock.map(50 + step / 100, ns(10 + step / 100))
    assert clock.map(0.0, ns(12.0)) == 12.0
    assert clock.map(0.01, ns(12.015)) == pytest.approx(12.01)
    assert clock.map(0.02, ns(12.021)) == pytest.approx(12.02)


def test_clock_map_leaves_out_a_damaged_time():
    clock = ClockMap()
    clock.map(1.0, ns(11.0))
    for damaged in (1e30, -5.0, 3.0):
        assert clock.map(damaged, ns(12.0)) == 12.0
    assert clock.map(2.0, ns(12.02)) == pytest.approx(12.0)


def test_clock_map_reset_begins_anew():
    clock = ClockMap()
    clock.map(1.0, ns(11.0))
    clock.reset()
    assert clock.map(1.5, ns(20.0)) == 20.0


@pytest.mark.parametrize("name", ["period", "window"])
@pytest.mark.parametrize("value", [0, -1.0, math.nan, math.inf])
def test_clock_map_bad_input_raises(name, value):
    with pytest.raises(ValueError, match=f"'{name}' must be a positive number of seconds"):
        ClockMap(**{name: value})


def test_clock_map_repr():
    assert repr(ClockMap(2.5)) == "ClockMap(period=2.5, window=5.0)"
