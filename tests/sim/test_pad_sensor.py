import numpy as np
import pytest

from torch_geometric_tactile.sim import PadSensor

EXACT = {"gain_spread": 0.0, "offset": 0.0, "noise": 0.0}


def device(seed=0, num_taxels=2000, **changes):
    sensor = PadSensor(**EXACT | changes)
    return sensor.device(num_taxels, np.random.default_rng(seed))


def test_exact_sensor_reads_the_force():
    force = np.random.default_rng(0).normal(size=(5, 3))
    readings = device(num_taxels=5).readings(force)
    assert readings.dtype == np.float32
    assert readings == pytest.approx(force, abs=1e-6)


def test_spreads_are_standard_deviations():
    rest, press = np.zeros((2000, 3)), np.ones((2000, 3))
    assert device(gain_spread=0.05).readings(press).std() == pytest.approx(0.05, rel=0.05)
    assert not device(gain_spread=0.05).readings(rest).any()
    assert device(offset=0.002).readings(rest).std() == pytest.approx(0.002, rel=0.05)
    assert device(noise=0.001).readings(rest).std() == pytest.approx(0.001, rel=0.05)


def test_offset_stays_and_noise_changes_within_an_episode():
    rest = np.zeros((2000, 3))
    sensor = device(offset=0.002)
    assert np.array_equal(sensor.readings(rest), sensor.readings(rest))
    sensor = device(noise=0.001)
    first, second = sensor.readings(rest), sensor.readings(rest)
    assert abs(np.corrcoef(first.ravel(), second.ravel())[0, 1]) < 0.1


def test_devices_differ_by_seed():
    press = np.ones((2000, 3))
    first, again, second = (device(seed, gain_spread=0.1).readings(press) for seed in (0, 0, 1))
    assert np.array_equal(first, again)
    assert not np.allclose(first, second)


def test_dead_taxels_read_zero_on_all_axes():
    sensor = PadSensor(dead=0.25).device(2000, np.random.default_rng(0))
    is_zero = sensor.readings(np.ones((2000, 3))) == 0
    assert np.array_equal(is_zero.all(axis=1), is_zero.any(axis=1))
    assert is_zero.mean() == pytest.approx(0.25, abs=0.03)


def test_rough_sensor():
    assert PadSensor.rough() == PadSensor(gain_spread=0.15, offset=0.02, noise=0.001, dead=0.0)


def test_bad_values_are_named():
    for key in ("gain_spread", "offset", "noise", "dead"):
        for value in (-0.1, float("nan")):
            with pytest.raises(ValueError, match=f"'{key}' must be a number, not negative"):
                PadSensor(**{key: value})
    with pytest.raises(ValueError, match=r"'dead' must be a probability \(got 1.5\)"):
        PadSensor(dead=1.5)
