import numpy as np
import pytest

from torch_geometric_tactile.sensors import grid
from torch_geometric_tactile.sim import LIFT_INPUTS, LiftObservation, lift_inputs

MOTORS = np.arange(8.0).reshape(4, 2)
PAD = grid(2, 2, 0.01)  # taxels at (-5, -5), (5, -5), (-5, 5), (5, 5) mm


def touch(readings, name):
    numbers = lift_inputs(LiftObservation(readings, *MOTORS), name, PAD)
    assert numbers.dtype == np.float32
    assert numbers[:8].tolist() == list(range(8))
    return numbers[8:]


def test_inputs_by_hand():
    readings = np.zeros((8, 3))
    readings[1] = 1.0, 2.0, 3.0  # on the first pad at (5, -5) mm
    readings[6] = 0.0, -1.0, 4.0  # on the second pad at (-5, 5) mm
    assert touch(readings, "none").tolist() == []
    assert touch(readings, "normal").tolist() == [0, 3, 0, 0, 0, 0, 4, 0]
    assert touch(readings, "total").tolist() == [1, 2, 3, 0, -1, 4]
    # r x f with f = (x, y, -z): (0.015, 0.015, 0.015) and (-0.02, -0.02, 0.005) N m.
    wrench = [1, 2, -3, 0.015, 0.015, 0.015, 0, -1, -4, -0.02, -0.02, 0.005]
    assert touch(readings, "wrench") == pytest.approx(wrench)
    assert np.array_equal(touch(readings, "taxels"), readings.ravel())


def test_force_in_the_middle_of_a_pad_has_no_torque():
    readings = np.tile([0.1, 0.2, 0.3], (8, 1))
    assert touch(readings, "wrench").reshape(2, 6)[:, 3:] == pytest.approx(0, abs=1e-9)


def test_names_and_numbers_of_inputs():
    readings = np.zeros((8, 3))
    assert [len(touch(readings, name)) for name in LIFT_INPUTS] == [0, 8, 6, 12, 24]


def test_bad_arguments_are_named():
    observation = LiftObservation(np.zeros((8, 3)), *MOTORS)
    with pytest.raises(ValueError, match=r"'name' must be one of .* \(got shear\)"):
        lift_inputs(observation, "shear", PAD)
    with pytest.raises(ValueError, match=r"must have readings \(32, 3\) \(got \(8, 3\)\)"):
        lift_inputs(observation, "total")
