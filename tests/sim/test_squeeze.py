from dataclasses import replace

import numpy as np
import pytest
import torch

pytest.importorskip("mujoco", reason="needs the extra 'sim'")

from torch_geometric_tactile.sensors import HandKinematics, TaxelLayout, allegro_uskin_240
from torch_geometric_tactile.sim import (
    ContactParameters,
    GraspSpread,
    twenty,
)
from torch_geometric_tactile.sim._grasp import GraspSimulator
from torch_geometric_tactile.sim._squeeze import SQUEEZE_PHASES, plan_squeeze

LAYOUT = allegro_uskin_240()
SQUEEZE = SQUEEZE_PHASES.index("squeeze")
CARTON, BALL = twenty()[17], twenty()[9]


def plan(seed=0, size=(0.07, 0.18, 0.07), **kwargs):
    return plan_squeeze(size, np.random.default_rng(seed), **kwargs)


def run(item, one, layout=LAYOUT):
    simulator = GraspSimulator(
        layout, HandKinematics.allegro(), item, ContactParameters(timestep=0.004)
    )
    return simulator.run(one, rate=50.0)


@pytest.mark.parametrize("seed", range(8))
def test_250_steps_at_30_hz_are_squeezes(seed):
    one = plan(seed)
    assert one.phase_names == SQUEEZE_PHASES == ("hover", "reach", "close", "squeeze")
    assert set(np.diff(one.phase).tolist()) == {0, 1}
    assert len(one.phase) == 1000
    assert (one.phase == SQUEEZE).sum() * one.step >= 250 / 30
    assert one.gantry.shape == (1000, 4)
    assert one.joint.shape == (1000, 16)


def test_short_trials_have_every_phase():
    share = np.bincount(plan(duration=1.0, step=0.01).phase) / 100
    assert share == pytest.approx(np.bincount(plan().phase) / 1000, abs=0.02)


def test_palm_stays_down():
    one = plan(3)
    height = one.gantry[one.phase == SQUEEZE, 2]
    assert np.ptp(height) < 0.01
    assert one.gantry[0, 2] - height.mean() == pytest.approx(0.101, abs=0.01)


@pytest.mark.parametrize("seed", range(8))
def test_hand_closes_three_to_five_times(seed):
    one = plan(seed, spread=GraspSpread())
    # Joint 9 is the middle of the ring finger; the tremor is below a tenth of a squeeze.
    angle = one.joint[one.phase == SQUEEZE, 9]
    smooth = np.convolve(angle, np.full(25, 1 / 25), mode="valid")
    middle = (smooth.max() + smooth.min()) / 2
    inner = smooth[(smooth > middle).argmax() :] > middle
    assert 2 <= 1 + (np.diff(inner.astype(int)) == 1).sum() <= 5
    level = (smooth - 0.30) / (1.25 - 0.30)  # from open to closed
    assert 0.5 < level.min() < 0.95
    assert 0.9 < level.max() < 1.45


def test_fingers_have_times_of_their_own():
    one = plan(1, spread=GraspSpread(posture=0.0))
    index, middle = one.joint[one.phase == SQUEEZE][:, [1, 5]].T
    assert np.abs(index - middle).max() > 0.05


def test_squeezes_differ_by_seed_and_are_the_same_again():
    assert not np.array_equal(plan(0).joint, plan(1).joint)
    assert np.array_equal(plan(0).joint, plan(0).joint)


def test_lazy_finger_hardly_closes():
    spread = GraspSpread(posture=0.0, lazy_finger=1.0)
    closing = [np.ptp(plan(seed, spread=spread).joint[:, 1:12:4], axis=0) for seed in range(6)]
    assert all(finger.min() < 0.75 * finger.max() for finger in closing)


def test_carton_is_pressed_again_and_again_and_not_lifted():
    result = run(CARTON, plan(0, CARTON.size, step=0.02))
    assert result.success
    assert len(result.time) == 500
    rise = result.object_pose[:, 2] - result.object_pose[0, 2]
    assert np.abs(rise).max() < 0.02
    squeezed = result.phase == SQUEEZE
    pressure = result.force[squeezed, :, 2].clip(0).sum(axis=1)
    assert pressure.min() < 0.5 * pressure.max()
    digits = LAYOUT.digit[torch.from_numpy(result.force[squeezed, :, 2].max(axis=0)) > 0.05]
    assert len(digits.unique()) >= 2


def test_object_that_slips_off_its_stand_ends_the_attempt():
    lost = [run(BALL, plan(seed, BALL.size, step=0.02)) for seed in range(3)]
    ended = [result for result in lost if len(result.time) < 500]
    assert ended
    for result in ended:
        moved = result.object_pose[-1, :3] - result.object_pose[0, :3]
        assert moved[2] < -0.02 or np.hypot(*moved[:2]) > 0.06
        assert not result.success


def test_digits_are_counted_at_one_time_in_the_squeeze():
    one = plan()
    layout = TaxelLayout(
        "hand",
        pos=torch.zeros(3, 3),
        digit=torch.tensor([0, 1, 2]),
        digit_names=("index", "thumb", "palm"),
    )
    phase = np.array([2, 3, 3])
    force = np.zeros((3, 3, 3))

    def pressed(*cells):
        out = force.copy()
        for frame, taxel in cells:
            out[frame, taxel, 2] = 1.0
        return one.is_done(phase, out, layout)

    assert pressed((1, 0), (1, 1))
    assert not pressed((1, 0), (2, 1))  # one after the other
    assert not pressed((0, 0), (0, 1))  # before
    assert not pressed((1, 0), (1, 2))  # the palm is no digit


def test_hand_that_touches_nothing_fails():
    far = replace(CARTON, name="far", size=(0.062, 0.13, 0.066))
    away = plan(0, far.size, step=0.02)
    away.gantry[:, 2] += 0.3
    assert not run(far, away).success
