import numpy as np
import pytest

pytest.importorskip("mujoco", reason="needs the extra 'sim'")

from torch_geometric_tactile.sim._bigs_physics import BigsPhysics
from torch_geometric_tactile.sim._bigs_slip import slip_onset

PICKUP, LOSS = 100, 400


def physics(slide, loss=LOSS):
    """A grasp of which only the sliding along x of each fingertip is told."""
    velocity = np.zeros((500, 3, 3))
    velocity[..., 0] = slide
    empty = np.zeros((500, 3))
    rest = [empty, empty, np.zeros((500, 3, 3)), velocity, np.zeros((500, 6))]
    poses = [empty, np.zeros((500, 6)), np.zeros((500, 7)), np.zeros(500, dtype=int)]
    return BigsPhysics(np.zeros((500, 3, 3)), *rest, *poses, pickup=PICKUP, loss=loss)


def sliding(*spans, fingers=3, speed=0.03):
    slide = np.zeros((500, 3))
    for start, end in spans:
        slide[start:end, :fingers] = speed
    return slide


def test_onset_is_the_beginning_of_the_slide_that_goes_far():
    # 30 mm/s for 3 mm takes 30 ticks of 1/300 s; the first slide is too short.
    assert slip_onset(physics(sliding((150, 160), (300, 400)))) == 300
    assert slip_onset(physics(sliding((150, 170), (300, 400)))) == 300
    assert slip_onset(physics(sliding((150, 190), (300, 400)))) == 150


def test_object_that_is_held_never_slips():
    assert slip_onset(physics(sliding((150, 400)), loss=None)) is None


def test_settling_before_pickup_and_one_finger_do_not_count():
    assert slip_onset(physics(sliding((0, 100)))) == LOSS
    assert slip_onset(physics(sliding((150, 400), fingers=1))) == LOSS
    assert slip_onset(physics(sliding((150, 400), fingers=2))) == 150


def test_slide_that_goes_on_since_before_pickup_begins_there():
    assert slip_onset(physics(sliding((50, 400)))) == PICKUP


def test_creep_is_slow():
    slide = sliding((100, 250), speed=0.004) + sliding((250, 400))
    assert slip_onset(physics(slide)) == 250
