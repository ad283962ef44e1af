import numpy as np
import pytest

from torch_geometric_tactile.live.onnx_judge import _session_statistics

RULE = {"per": "taxel", "has_scale": True}
NAN = float("nan")


def statistics(samples, num_frames=1, **rule):
    samples = np.array(samples, dtype=np.float32)
    return [
        out.round(6).tolist() for out in _session_statistics(samples, {**RULE, **rule}, num_frames)
    ]


# Three frames of two taxels and two channels.
FRAMES = [[[0, 1], [NAN, 5]], [[2, 1], [4, 5]], [[4, 1], [NAN, 8]]]


@pytest.mark.parametrize(
    ("rule", "center", "scale"),
    [
        ({}, [[2, 1], [4, 6]], [[1.632993, 1], [1, 1.414214]]),
        ({"has_scale": False}, [[2, 1], [4, 6]], [[1, 1], [1, 1]]),
        ({"per": "channel"}, [[2.5, 3.5]], [[1.658312, 2.692582]]),
        ({"per": "signal"}, [[2, 1], [4, 6]], [[1.632993, 1], [1, 1.414214]]),
    ],
)
def test_statistics_of_a_session_by_hand(rule, center, scale):
    found = statistics(FRAMES, **rule)
    np.testing.assert_array_equal(found[0], center)
    np.testing.assert_array_equal(found[1], scale)


def test_statistics_of_signals_are_over_all_frames_of_windows():
    # Two windows of two frames: a taxel whose first channel goes from 0 to 2, and from 2 to 4.
    windows = [[[0, 2, 10, 10]], [[2, 4, 10, 10]]]
    center, scale = statistics(windows, num_frames=2, per="signal")
    assert center == [[2, 10]]
    assert scale == [[1.414214, 1]]
