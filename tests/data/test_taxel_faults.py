import numpy as np
import pytest

from torch_geometric_tactile.data._taxel_faults import TaxelFaults, find_taxel_faults

TIME = np.arange(60)


def waves(num_taxels=4, low=0.0, high=1023.0):
    """Taxels that move over the range at different times, each at a limit for one frame."""
    phase = TIME[:, None] / 10 + np.arange(num_taxels)
    middle, size = (low + high) / 2, (high - low) / 2
    return np.round(middle + size * np.sin(phase))[:, :, None]


def test_moving_taxels_have_no_faults():
    assert find_taxel_faults(waves()) == TaxelFaults()


def test_dead_taxels_are_not_constant_or_equal():
    tactile = waves()
    tactile[:, :2] = np.nan
    assert find_taxel_faults(tactile) == TaxelFaults(dead=(0, 1))
    assert find_taxel_faults(np.full((60, 2, 1), np.nan)) == TaxelFaults(dead=(0, 1))


def test_constant_taxels_are_not_equal_to_another():
    tactile = waves()
    tactile[:, 1] = tactile[:, 3] = 1023  # also not saturated
    tactile[5, 3] = np.nan
    assert find_taxel_faults(tactile) == TaxelFaults(constant=(1, 3))


def test_a_taxel_is_constant_only_in_all_channels():
    tactile = np.concatenate([waves(), np.zeros((60, 4, 1))], axis=2)
    assert find_taxel_faults(tactile) == TaxelFaults()


@pytest.mark.parametrize(("frames", "saturated"), [(9, ()), (10, (2,))])
@pytest.mark.parametrize("limit", [4095.0, -4095.0])
def test_ten_frames_at_the_limit_are_saturated(frames, saturated, limit):
    tactile = waves()
    tactile[20 : 20 + frames, 2] = limit
    assert find_taxel_faults(tactile) == TaxelFaults(saturated=saturated)
    tactile[25, 2] = np.nan  # the run ends at a missing reading
    assert find_taxel_faults(tactile) == TaxelFaults()


def test_each_channel_has_its_limits():
    tactile = np.concatenate([waves(), waves(high=10_000)], axis=2)
    tactile[20:40, 1, 0] = 2000  # not the limit of the other channel
    assert find_taxel_faults(tactile).saturated == (1,)
    tactile[:, 3, 1] = np.where(TIME < 30, 0, 1)  # a switch is none in its channel only
    assert find_taxel_faults(tactile).saturated == (1,)


def test_a_resting_zero_is_not_saturated():
    tactile = np.maximum(waves(low=-1000), 0.0)
    assert (tactile == 0).sum() > 60
    assert find_taxel_faults(tactile) == TaxelFaults()


def test_rest_is_not_saturated_where_it_is_not_zero():
    tactile = np.maximum(waves(low=-3000), 3.0)  # counts of a resistive sensor
    assert np.median(tactile) == 3
    assert find_taxel_faults(tactile) == TaxelFaults()
    grasped = np.where(TIME[:, None, None] < 20, 3.0, waves(low=500))
    assert np.median(grasped) > 500
    assert find_taxel_faults(grasped) == TaxelFaults()
    inverted = 255.0 - np.maximum(waves(low=-600, high=200), 0.0)  # such as iCub's fingertips
    assert find_taxel_faults(inverted) == TaxelFaults()


def test_quiet_integers_are_not_saturated():
    tactile = 240.0 + np.arange(16)[None, :, None] + np.zeros((60, 16, 1))
    tactile[::12] += 1  # steps of one count
    assert find_taxel_faults(tactile) == TaxelFaults()


def test_switches_are_not_saturated():
    tactile = (waves() > 700).astype(float)
    assert find_taxel_faults(tactile) == TaxelFaults()


def test_equal_taxels_are_grouped():
    tactile = np.concatenate([waves(3), -waves(3)], axis=2)
    tactile = tactile[:, [0, 1, 0, 2, 1, 0]]
    tactile[7, [0, 2, 5]] = np.nan
    tactile[9, 5] = -0.0
    tactile[9, [0, 2]] = 0.0
    assert find_taxel_faults(tactile) == TaxelFaults(equal=((0, 2, 5), (1, 4)))
    tactile[3, 2, 1] += 1
    tactile[4, 4] = np.nan
    assert find_taxel_faults(tactile) == TaxelFaults(equal=((0, 5),))


def test_taxels_that_change_in_few_frames_are_not_equal():
    tactile = waves()
    tactile[:, 1] = tactile[:, 2] = np.where(TIME % 20 == 5, 3, 0)[:, None]  # three touches
    assert find_taxel_faults(tactile) == TaxelFaults()


def test_short_recordings_have_dead_taxels_only():
    assert find_taxel_faults(np.zeros((0, 3, 1))) == TaxelFaults()
    tactile = np.full((9, 3, 1), 5.0)
    tactile[:, 1] = np.nan
    assert find_taxel_faults(tactile) == TaxelFaults(dead=(1,))


def test_readings_are_not_changed():
    tactile = waves()
    tactile[0] = -0.0
    copy = tactile.copy()
    find_taxel_faults(tactile)
    assert tactile.tobytes() == copy.tobytes()
