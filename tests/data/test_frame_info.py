import math

import numpy as np
import pytest

from torch_geometric_tactile.data import FrameInfo, Recording


def test_repr_and_equality():
    info = FrameInfo(rate=100.0, stride=2, unit="count")
    assert repr(info).startswith("FrameInfo(rate=100.0, tolerance=0.05, max_gap=None,")
    assert info == FrameInfo(rate=100.0, stride=2, unit="count")
    assert info.changed(stride=1) != info


def test_rate_of_the_frames_that_are_used():
    assert FrameInfo().frame_rate is None
    assert FrameInfo(rate=100.0, stride=4).frame_rate == 25.0
    assert FrameInfo(rate=100.0, selected_rate=30.0, stride=3).frame_rate == 10.0


@pytest.mark.parametrize(
    ("argument", "value", "message"),
    [
        ("rate", 0.0, "'rate' must be a positive number"),
        ("rate", math.inf, "'rate' must be a positive number"),
        ("max_gap", math.nan, "'max_gap' must be a positive number"),
        ("rest", -1.0, "'rest' must be a positive number"),
        ("tolerance", None, "'tolerance' must be a positive number"),
        ("stride", 0, "'stride' must be at least 1"),
        ("unit", 1, "'unit' must be a text or None"),
        ("columns", {"tactile": "ab"}, "'columns' must be names"),
        ("columns", {"x": ["a"]}, "'columns' must be names"),
        ("resampled", True, "'resampled' must be true or false, and requires a rate"),
    ],
)
def test_wrong_values_are_refused(argument, value, message):
    with pytest.raises(ValueError, match=message):
        FrameInfo(**{argument: value})


def test_round_trip_as_json():
    info = FrameInfo(
        rate=99.5, max_gap=math.inf, stride=3, unit="count", columns={"tactile": ["a", "b"]}
    )
    assert info.to_dict()["max_gap"] == "inf"
    assert FrameInfo.from_dict(info.to_dict()) == info
    for content in ([], {"speed": 1}, {"max_gap": "wide"}):
        with pytest.raises(ValueError, match=r"'(frames|max_gap)' must"):
            FrameInfo.from_dict(content)


def test_what_is_known_is_compared():
    known = FrameInfo(rate=100.0, unit="count")
    for other in (FrameInfo(), FrameInfo(rate=104.0), FrameInfo(rate=100.0, unit="count")):
        known.require(other, "a recording")
    with pytest.raises(ValueError, match=r"mug\.h5 must have readings in count.*got newton"):
        known.require(FrameInfo(unit="newton"), "mug.h5")
    with pytest.raises(ValueError, match=r"mug\.h5 must have 100 frames per second.*got 106"):
        known.require(FrameInfo(rate=106.0), "mug.h5")
    known.require(FrameInfo(rate=106.0), "mug.h5", with_rate=False)
    FrameInfo(rate=100.0, tolerance=0.1).require(FrameInfo(rate=106.0), "mug.h5")
    FrameInfo(rate=100.0, selected_rate=50.0).require(FrameInfo(rate=200.0), "mug.h5")


def test_selected_frames_by_hand():
    time = 7.0 + np.arange(10) / 100
    assert FrameInfo(stride=4).selected_frames(None, 10).tolist() == [0, 4, 8]
    half = FrameInfo(rate=100.0, selected_rate=50.0)
    assert half.selected_frames(time, 10).tolist() == [0, 2, 4, 6, 8]
    assert half.changed(stride=2).selected_frames(time, 10).tolist() == [0, 4, 8]
    third = FrameInfo(rate=100.0, selected_rate=30.0)
    assert third.selected_frames(time, 10).tolist() == [0, 3, 7]  # of ticks at 0, 33 and 67 ms
    assert half.selected_frames(time[:0], 0).tolist() == []


def test_info_of_a_recording():
    columns = {"tactile": ["b", "a"]}
    recording = Recording(
        time=np.arange(50) / 20,
        tactile=np.zeros((50, 2, 1)),
        meta={"unit": "newton", "column_names": columns},
    )
    info = recording.info
    assert (info.rate, info.unit, info.columns) == (pytest.approx(20.0), "newton", columns)
    assert info.max_gap == pytest.approx(0.25)
