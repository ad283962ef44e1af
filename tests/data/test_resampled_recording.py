import numpy as np
import pytest

from torch_geometric_tactile.data import Recording


def recording(time, values, **more):
    tactile = np.asarray(values, np.float32).reshape(len(time), -1, 1)
    return Recording(time=np.asarray(time, float), tactile=tactile, **more)


def test_averages_over_each_new_frame_by_hand():
    given = recording([0, 1, 2, 3, 4], [0.0, 2.0, 0.0, 2.0, 0.0])
    found = given.resample(0.5)
    assert found.time.tolist() == [0.0, 2.0, 4.0]
    # Means of the lines over 0 to 1, 1 to 3 and 3 to 4 seconds.
    assert found.tactile.ravel().tolist() == [1.0, 1.0, 1.0]
    assert found.meta["rate"] == 0.5


def test_lines_between_frames_by_hand():
    found = recording([0, 1, 2], [0.0, 2.0, 0.0]).resample(2.0)
    assert found.tactile.ravel().tolist() == [0.0, 1.0, 2.0, 1.0, 0.0]


@pytest.mark.parametrize("rate", [7.0, 40.0, 100.0, 333.0])
def test_constants_and_ramps_stay(rate):
    draw = np.random.default_rng(0)
    time = 1.7e9 + np.cumsum(draw.uniform(0.005, 0.015, 300))
    ramp = time - time[0]
    found = recording(time, np.stack([np.full(300, 3.0), ramp], axis=1)).resample(rate)
    assert np.diff(found.time) == pytest.approx(1 / rate, abs=1e-6)
    assert found.tactile[:, 0] == pytest.approx(3.0)
    inner = slice(10, -10) if rate < 100 else slice(None)  # at its ends an average is of one side
    assert found.tactile[inner, 1, 0] == pytest.approx(
        found.time[inner] - time[0], abs=2 / max(rate, 100)
    )


def test_what_is_too_fast_for_the_new_rate_does_not_come_back_slow():
    time = np.arange(1000) / 100
    fast = np.sin(2 * np.pi * 21 * time)
    found = recording(time, fast).resample(10.0).tactile
    assert np.abs(found[2:-2]).max() < 0.2
    assert np.abs(recording(time[::10], fast[::10]).tactile).max() > 0.9


def test_gaps_stay_and_missing_readings_stay_missing():
    time = np.r_[np.arange(50), 500 + np.arange(50)] / 100
    values = np.ones((100, 2))
    values[:, 1] = np.nan
    values[10:20, 0] = np.nan
    found = recording(time, values).resample(50.0)
    assert found.gaps.round(2).tolist() == [[0.48, 5.0]]
    assert np.isnan(found.tactile[:, 1]).all()
    assert np.flatnonzero(np.isnan(found.tactile[:, 0, 0])).tolist() == [5, 6, 7, 8, 9]
    assert np.nanmin(found.tactile[:, 0]) == np.nanmax(found.tactile[:, 0]) == 1.0


def test_all_signals_go_along():
    time = np.arange(11) / 10
    given = recording(
        time,
        np.arange(11.0),
        joint=np.arange(11.0)[:, None],
        privileged={"phase": np.arange(11)},
        extra={"temp": np.arange(22.0).reshape(11, 2), "name": np.array(["a"] * 5 + ["b"] * 6)},
        annotations=[(0.2, 0.4, "slip")],
        label="cup",
    )
    found = given.resample(20.0)
    assert found.num_frames == 21
    assert found.joint[:, 0] == pytest.approx(np.arange(21) / 2)
    assert found.extra["temp"][:, 1] == pytest.approx(np.arange(21) + 1)
    assert found.privileged["phase"].dtype.kind == "i"
    assert found.extra["name"].tolist().count("a") in (9, 10)
    assert (found.label, list(found.annotations)) == ("cup", [(0.2, 0.4, "slip")])


@pytest.mark.parametrize(
    ("rate", "expected"), [(20.0, [0, 0, 1, 1, 2]), (5.0, [0, 2]), (10.0, [0, 1, 2])]
)
def test_a_command_stays_in_force_until_the_next_one(rate, expected):
    # Times since 1970 are rounded, which must not select an earlier command.
    time = 1.7e9 + np.r_[np.arange(3), 100 + np.arange(3)] / 10
    commands = np.r_[np.arange(3.0), 10 + np.arange(3.0)][:, None]
    found = recording(time, np.zeros(6), action=commands).resample(rate).action
    assert found.ravel().tolist() == [*expected, *(10 + command for command in expected)]


@pytest.mark.parametrize("rate", [0.0, -1.0, np.nan, np.inf, "fast", 1e12])
def test_wrong_rates_are_refused(rate):
    with pytest.raises(ValueError, match="'rate' must"):
        recording([0.0, 1.0, 2.0], [0.0, 1.0, 2.0]).resample(rate)


@pytest.mark.parametrize("size", [0, 1])
def test_too_few_frames_stay(size):
    given = recording([5.0], [1.0]).select(slice(size))
    assert given.resample(10.0).num_frames == size


@pytest.mark.parametrize("rate", [7.0, 33.3, 40.0, 100.0, 250.0])
def test_a_resampled_recording_stays_as_it_is(rate):
    draw = np.random.default_rng(0)
    time = 1.7e9 + np.r_[np.arange(300), 700 + np.arange(200)] / 100
    once = recording(time, draw.normal(size=(500, 2))).resample(rate)
    twice = once.resample(rate)
    assert twice.time == pytest.approx(once.time, abs=1e-6)
    np.testing.assert_allclose(twice.tactile, once.tactile, rtol=0, atol=1e-4)
