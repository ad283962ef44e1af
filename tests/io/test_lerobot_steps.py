import numpy as np
import pytest

from torch_geometric_tactile.io._lerobot_steps import frames_since, regular_steps, steps_to_frames


@pytest.mark.parametrize(
    ("nearest", "expected"), [(False, [0, 1, 2, 4, 5]), (True, [0, 1, 3, 4, 5])]
)
def test_each_step_has_the_last_or_the_nearest_frame(nearest, expected):
    time = np.array([0.0, 0.095, 0.11, 0.22, 0.3, 0.4])
    assert steps_to_frames(time, regular_steps(time, 10), 10, nearest).tolist() == expected


def test_steps_that_lie_on_frames_but_for_rounding():
    time = 1.7e9 + np.arange(3001) / 30
    since = time - time[0]
    for whole in (False, True):
        assert steps_to_frames(since, regular_steps(since, 30, whole), 30).tolist() == [
            *range(3001)
        ]
    assert regular_steps(time[:1], 30, cover_last=True).tolist() == [0]


def test_each_frame_belongs_to_one_step():
    time = np.random.default_rng(0).uniform(0.001, 0.02, 500).cumsum()
    time -= time[0]
    found = frames_since(time, regular_steps(time, 30, cover_last=True), 30)
    assert np.concatenate(found).tolist() == [*range(500)]
    assert len(regular_steps(time, 30)) == len(found) - 1


def test_frames_long_before_the_first_step_are_left_out():
    time = np.arange(10) / 10
    found = frames_since(time, np.array([0.5, 0.7]), 5)
    assert [frames.tolist() for frames in found] == [[4, 5], [6, 7]]
    assert steps_to_frames(time, np.array([-1.0, 0.0]), 5).tolist() == [-1, 0]
