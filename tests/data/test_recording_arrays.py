import datetime
import warnings

import numpy as np
import pytest
import torch

from torch_geometric_tactile.data import Recording, StaticDataset
from torch_geometric_tactile.sensors import grid

TACTILE = np.zeros((2, 1, 2))


def time_of(time):
    recording = Recording(time, TACTILE)
    assert recording.time.dtype == np.float64
    return recording.time.tolist()


@pytest.mark.parametrize("unit", ["s", "ms", "us", "ns"])
def test_dates_become_seconds_since_1970(unit):
    dates = np.array(["1970-01-02T00:00:00", "2026-01-14T13:40:06"], dtype=f"datetime64[{unit}]")
    assert time_of(dates) == [86400.0, 1768398006.0]


def test_dates_keep_what_float64_can_hold():
    dates = np.array(["2026-01-14T13:40:06.957662101", "2026-01-14T13:40:06.957663"], "M8[ns]")
    assert time_of(dates) == [1768398006.957662101, 1768398006.957663]
    assert time_of(np.array(["1969-12-31T23:59:59.500", "1970-01-01"], "M8[ms]")) == [-0.5, 0.0]


@pytest.mark.parametrize(
    ("ticks", "unit", "seconds"),
    [
        ([1, 2], "h", [3600.0, 7200.0]),
        ([-3, 4], "ms", [-0.003, 0.004]),
        ([1, 3], "25ms", [0.025, 0.075]),
        ([9, 10**10], "ns", [9e-9, 10.0]),
        ([0, 10**16], "as", [0.0, 0.01]),
    ],
)
def test_time_differences_become_seconds(ticks, unit, seconds):
    assert time_of(np.array(ticks, dtype=f"m8[{unit}]")) == seconds


def test_years_and_months_begin_on_a_day():
    assert time_of(np.array(["1970", "1971"], "M8[Y]")) == [0.0, 365 * 86400.0]
    assert time_of(np.array(["1970-01", "1970-02"], "M8[M]")) == [0.0, 31 * 86400.0]


@pytest.mark.parametrize(
    ("time", "message"),
    [
        (np.arange(2), r"'time' must be .* \(floats in seconds, got int64\): pass seconds as fl"),
        (np.arange(2, dtype=np.uint8), r"got uint8\): .* nanoseconds as time / 1e9"),
        (np.array([False, True]), r"got bool"),
        (["0.0", "0.1"], r"got <U3"),
        ([0.0, None], r"got object"),
        (
            [datetime.datetime(2026, 1, 14), datetime.datetime(2026, 1, 15)],
            r"got object\): .* dates as numpy.datetime64",
        ),
        (np.array(["2026-01-14", "NaT"], "M8[ns]"), r"must be finite \(got NaT in frame 1\)"),
        (np.array([1, 2], "m8[M]"), r"unit of a fixed number of seconds \(got timedelta64\[M\]\)"),
        (np.ma.array([0.0, 1.0], mask=[0, 1]), r"'time' must not be masked .* in frame 1\)"),
        (torch.zeros(2, requires_grad=True), r"'time' must be an array of numbers \(.*grad"),
    ],
)
def test_time_refused(time, message):
    with pytest.raises(ValueError, match=message):
        Recording(time, TACTILE)


def test_masked_readings_and_angles_are_missing():
    tactile = np.ma.array([[[1, 2]], [[3, 4]]], mask=[[[0, 1]], [[0, 0]]])
    joint = np.ma.array([[0.5], [0.25]], mask=[[1], [0]])
    recording = Recording(np.ma.array([0.0, 1.0]), tactile, joint)
    assert np.array_equal(recording.tactile, [[[1, np.nan]], [[3, 4]]], equal_nan=True)
    assert np.array_equal(recording.joint, [[np.nan], [0.25]], equal_nan=True)
    assert (recording.tactile.dtype, recording.joint.dtype) == (np.float32, np.float32)
    assert type(recording.tactile) is np.ndarray
    assert type(recording.time) is np.ndarray


def test_what_lies_under_a_mask_is_not_looked_at():
    tactile = np.ma.array([[[np.inf]], [[3.0]]], mask=[[[1]], [[0]]])
    assert np.isnan(Recording([0.0, 1.0], tactile).tactile[0, 0, 0])


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"tactile": TACTILE + 1j}, r"'tactile' must be an array of numbers \(got complex128\)"),
        ({"tactile": TACTILE.astype(object)}, r"'tactile' must be .* \(got object\)"),
        ({"tactile": [[[0.0]], [[0.0, 1.0]]]}, r"'tactile' must be an array of numbers \(.*shape"),
        ({"extra": {"p": np.ma.masked}}, r"'p' must not be masked \(got a masked .* in frame 0\)"),
        ({"privileged": {"p": [[1], [2, 3]]}}, r"privileged 'p' must be an array \("),
        ({"privileged": [1]}, r"'privileged' must be a mapping \(got list\)"),
        ({"label": np.ma.masked}, r"'label' must be a text, an integer or None"),
    ],
)
def test_arrays_refused(changed, message):
    with pytest.raises(ValueError, match=message):
        Recording(**{"time": [0.0, 1.0], "tactile": TACTILE, **changed})


def test_signals_up_to_the_limits_of_files_are_taken():
    name, signal = 255 * "a", np.zeros((2,) + 8 * (1,))
    assert Recording([0.0, 1.0], TACTILE, extra={name: signal}).extra[name] is signal


def test_deep_metadata_is_refused():
    meta = []
    for _ in range(100_000):
        meta = [meta]
    with pytest.raises(ValueError, match=r"'meta' must hold JSON values \(.*for 'a'\)"):
        Recording([0.0, 1.0], TACTILE, meta={"a": meta})
    while meta:  # which Python would take apart by recursion
        meta = meta.pop()


def test_masked_samples_are_missing_and_masked_labels_refused():
    x = np.ma.array([[[1, 2]], [[3, 4]]], mask=[[[0, 1]], [[0, 0]]])
    layout = grid(1, 1, pitch=0.01)
    dataset = StaticDataset.from_arrays(x, [0, 1], layout=layout)
    assert np.array_equal(dataset[0].x, [[1, np.nan]], equal_nan=True)
    with pytest.raises(ValueError, match=r"'y' must not be masked .* in frame 1"):
        StaticDataset.from_arrays(x, np.ma.array([0, 1], mask=[0, 1]), layout=layout)


WIDE = 1_700_000_000 + np.arange(8).reshape(4, 1, 2)
ROUNDED = "holds readings of up to 1700000007, which single precision rounds.*such as x - x.0."


@pytest.mark.parametrize("dtype", [np.int32, np.uint32, np.int64, np.uint64, np.float64])
def test_readings_that_single_precision_rounds_are_said_once(dtype):
    x = WIDE.astype(dtype)
    with pytest.warns(UserWarning, match=f"'tactile' {ROUNDED}") as caught:
        recording = Recording(np.arange(4.0), x)
    assert [one.filename for one in caught] == [__file__]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        recording.select(slice(2))
        Recording(np.arange(4.0), x - x[0])
    layout = grid(1, 1, pitch=0.01)
    for values in (x, torch.from_numpy(x)):
        with pytest.warns(UserWarning, match=f"'x' {ROUNDED}") as caught:
            StaticDataset.from_arrays(values, layout=layout)
        assert [one.filename for one in caught] == [__file__]


@pytest.mark.parametrize(
    "x",
    [
        np.array([2**24, -(2**24), 3]),
        np.array([2**30, 2**25, -(2**40)]),  # are held exactly
        np.array([1e9 + 0.25, 0.1, 1e9 + 0.5]),  # are no integers
        np.array([1.2345678e17, 3.3333333e20, np.nan]),  # nor known to one
        np.float32([1_700_000_001, 1_700_000_002, 0]),
        np.array([60_000, 1, 2], np.uint16),
        np.array([True, False, True]),
    ],
)
def test_readings_that_lose_nothing_are_no_reason_to_warn(x):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Recording(np.arange(3.0), x[:, None, None])
        StaticDataset.from_arrays(x[:, None, None], layout=grid(1, 1, pitch=0.01))


def test_readings_beyond_single_precision_are_an_error_only():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(ValueError, match="finite readings"):
            Recording([0.0], [[[1e39]]])
