import numpy as np
import pytest

from torch_geometric_tactile.sensors import biotac, biotac_sp, grid
from torch_geometric_tactile.sim._biotac_grasp import SimulatedGrasps, simulate_grasps


def test_simulate_shapes_and_numbering_by_hand():
    grasps = simulate_grasps(biotac(), objects=2, grasps_per_object=4, sessions=3, num_fingers=2)
    assert isinstance(grasps, SimulatedGrasps)
    assert grasps.reading.shape == (8, 19, 2)
    assert grasps.force.shape == (8, 2)
    assert grasps.group.tolist() == [0, 0, 0, 0, 1, 1, 1, 1]
    assert grasps.session.tolist() == [0, 1, 2, 0, 1, 2, 0, 1]
    assert set(grasps.slipped.tolist()) <= {0, 1}


def test_simulate_is_deterministic_by_seed():
    first, again, other = (simulate_grasps(biotac_sp(), 3, 10, seed=seed) for seed in (1, 1, 2))
    for name in SimulatedGrasps._fields:
        assert np.array_equal(getattr(first, name), getattr(again, name))
    assert not np.array_equal(first.reading, other.reading)
    assert not np.array_equal(first.slipped, other.slipped)


def test_simulate_readings_are_counts_of_12_bits():
    reading = simulate_grasps(biotac_sp(), 50, 20, num_fingers=1).reading  # heavy for one finger
    assert reading.min() == 0
    assert reading.max() == 4095
    assert np.array_equal(reading, reading.round())
    assert reading.dtype == np.float32


@pytest.mark.parametrize("seed", range(5))
def test_simulate_about_half_of_the_grasps_slip(seed):
    slipped = simulate_grasps(biotac_sp(), objects=10, grasps_per_object=100, seed=seed).slipped
    assert 0.3 < slipped.mean() < 0.7


def test_simulate_pressing_harder_lowers_the_slip_rate():
    grasps = simulate_grasps(biotac_sp(), objects=1, grasps_per_object=600)
    rate = [part.mean() for part in np.split(grasps.slipped[grasps.force.sum(1).argsort()], 3)]
    assert rate[0] > 0.9
    assert rate[0] > rate[1] > rate[2]
    assert rate[2] < 0.1


def test_simulate_pressing_harder_lowers_the_lowest_reading():
    grasps = simulate_grasps(biotac_sp(), 1, 300, sessions=1, num_fingers=1)
    reading = grasps.reading[grasps.force[:, 0].argsort(), :, 0]
    soft, medium, hard = (part.mean() for part in np.split(reading.min(axis=1), 3))
    assert soft > medium > hard
    assert 3000 - hard > 1.5 * (reading[200:].max(axis=1).mean() - 3000)  # the contact is a fall


def test_simulate_sessions_have_offsets_of_their_own():
    reading = simulate_grasps(biotac_sp(), 1, 400, sessions=2, num_fingers=1).reading[:, :, 0]
    within = np.abs(reading[0::4].mean(0) - reading[2::4].mean(0)).mean()
    between = np.abs(reading[0::2].mean(0) - reading[1::2].mean(0)).mean()
    assert between > 4 * within


def test_simulate_pose_seed_moves_the_contacts_only():
    first, same, other = (
        simulate_grasps(biotac_sp(), 2, 20, seed=1, pose_seed=pose) for pose in (None, 1, 2)
    )
    assert np.array_equal(first.reading, same.reading)
    assert not np.array_equal(first.reading, other.reading)
    assert np.array_equal(first.force, other.force)
    assert np.array_equal(first.slipped, other.slipped)


def test_simulate_single_taxel_grasp_and_more_sessions_than_grasps():
    grasps = simulate_grasps(grid(1, 1, pitch=0.01), 1, 1, sessions=5, num_fingers=1)
    assert grasps.reading.shape == (1, 1, 1)
    assert grasps.session.tolist() == [0]


@pytest.mark.parametrize("name", ["objects", "grasps_per_object", "sessions", "num_fingers"])
def test_simulate_rejects(name):
    arguments = {"objects": 1, "grasps_per_object": 1, name: 0}
    with pytest.raises(ValueError, match=rf"'{name}' must be at least 1 \(got 0\)"):
        simulate_grasps(biotac_sp(), **arguments)
