from dataclasses import replace

import numpy as np
import pytest
import torch

pytest.importorskip("mujoco", reason="needs the extra 'sim'")

from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.sensors import HandKinematics, TaxelLayout, allegro_uskin
from torch_geometric_tactile.sim import paper8
from torch_geometric_tactile.sim._grasp import PHASES, GraspSimulator, plan_grasp
from torch_geometric_tactile.transforms import TaxelForce, TaxelPose

pytestmark = pytest.mark.full

LAYOUT, HAND = allegro_uskin(), HandKinematics.allegro()
# A palm of one taxel: quick to build.
SMALL = TaxelLayout(
    "small",
    pos=torch.tensor([[0.012, 0.0, -0.03]]),
    normal=torch.tensor([[1.0, 0.0, 0.0]]),
    link_names=("palm_link",),
)


def plan(seed=0, size=(0.07, 0.18, 0.07), **kwargs):
    return plan_grasp(size, np.random.default_rng(seed), **{"duration": 5.0, "step": 0.02} | kwargs)


def rotation(quaternion):
    w, x, y, z = np.moveaxis(quaternion, -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), -1, 0)


def on_the_taxels(result):
    """Sum of the forces of the object on the skin, in the world's frame."""
    data = StaticData(x=torch.from_numpy(result.force), joint=torch.from_numpy(result.joint))
    data = TaxelForce("force")(TaxelPose(LAYOUT, HAND, tangent=True)(data))
    palm = rotation(result.palm_pose[:, 3:])
    return np.einsum("tij,tj->ti", palm, data.force.double().sum(dim=1).numpy())


def test_at_least_four_of_five_attempts_lift_and_hold(paper8_grasps):
    assert len(paper8_grasps) == 16
    assert sum(grasp.result.success for grasp in paper8_grasps) >= 13


def test_hand_carries_the_weight_of_what_it_holds(paper8_grasps):
    held = [grasp for grasp in paper8_grasps if grasp.result.success]
    for grasp in held:
        support = grasp.result.support[grasp.hold].mean(axis=0)
        weight = 9.81 * grasp.item.mass
        assert support[2] == pytest.approx(weight, rel=0.05), grasp.item.name
        assert np.abs(support[:2]).max() < 0.1 * weight, grasp.item.name
    assert held


def test_taxels_and_bones_together_support_the_object(paper8_grasps):
    alone = 0
    for grasp in paper8_grasps:
        result = grasp.result
        pressure = result.force[..., 2].clip(0).sum(axis=1)
        rest = np.linalg.norm(result.support + on_the_taxels(result), axis=1)
        # What the taxels do not give, bones do; of them the normal forces are known.
        bones = np.hypot(1, grasp.item.friction) * result.bone_force
        # Forces are those at the begin of the last time step and joints those at its end, which
        # shows while the hand moves.
        assert (rest <= bones + 0.06 * pressure + 0.02).all()
        hold = result.phase == PHASES.index("hold") if result.success else []  # not while it falls
        assert (rest <= bones + 0.003 * pressure + 0.01)[hold].all()
        alone += int(((result.bone_force == 0) & (pressure > 1)).sum())
    assert alone > 50  # frames in which taxels alone are the balance


def test_handedness_of_readings_is_that_of_the_support(paper8_grasps):
    """TaxelForce turns clean readings into the force on the skin, where no bone helps; with
    pressure along the normal, or with axes the other way round, it would not."""
    mirrors = ([1, 1, 1], [1, 1, -1], [-1, 1, 1], [1, -1, 1])
    errors, size = np.zeros(len(mirrors)), 0.0
    for grasp in paper8_grasps:
        result = grasp.result
        alone = (result.bone_force == 0) & (result.force[..., 2].clip(0).sum(axis=1) > 1)
        size += np.linalg.norm(result.support[alone], axis=1).sum()
        for i, mirror in enumerate(mirrors):
            force = on_the_taxels(result._replace(force=result.force * np.float32(mirror)))
            errors[i] += np.linalg.norm(force + result.support, axis=1)[alone].sum()
    assert errors[0] < 0.05 * size
    assert errors[1:].min() > 0.2 * size


def test_taxels_are_pressed_and_hardly_ever_pulled(paper8_grasps):
    # The edge of a box can meet the side of a taxel that looks away from it.
    pressure = np.concatenate([grasp.result.force[..., 2].ravel() for grasp in paper8_grasps])
    assert -pressure.clip(max=0).sum() < 0.01 * np.abs(pressure).sum()


def test_nothing_touches_before_the_hand_closes(paper8_grasps):
    for grasp in paper8_grasps:
        hover = grasp.result.phase == PHASES.index("hover")
        assert hover.sum() > 5
        assert not grasp.result.force[hover].any()
        assert not grasp.result.support[hover].any()


def test_held_objects_are_lifted(paper8_grasps):
    for grasp in paper8_grasps:
        rise = grasp.result.object_pose[-1, 2] - grasp.result.object_pose[0, 2]
        assert (rise > 0.05) == grasp.result.success


def test_frames_have_one_length_each(paper8_grasps):
    result = next(grasp.result for grasp in paper8_grasps if grasp.result.success)
    assert result.time == pytest.approx(np.arange(1, 251) / 50)
    assert result.joint.shape == (250, 16)
    assert result.force.shape == (250, 384, 3)
    assert result.support.shape == (250, 3)
    assert result.object_pose.shape == result.palm_pose.shape == (250, 7)
    assert sorted(set(result.phase.tolist())) == list(range(6))


@pytest.mark.parametrize("seed", range(5))
def test_phases_are_in_order_and_as_long_as_they_may_be(seed):
    phase = plan(seed, duration=17.0, step=0.01).phase
    assert set(np.diff(phase).tolist()) == {0, 1}
    seconds = np.bincount(phase) * 0.01
    shortest, longest = (1.2, 2.0, 2.2, 0.6, 1.8), (2.2, 3.0, 3.2, 1.4, 2.6)
    assert (seconds[:5] >= np.array(shortest) - 0.011).all()
    assert (seconds[:5] <= np.array(longest) + 0.011).all()
    assert seconds.sum() == pytest.approx(17)


def test_short_trials_have_every_phase():
    full, short = plan(duration=17.0, step=0.01).phase, plan().phase
    assert sorted(set(short.tolist())) == list(range(len(PHASES)))
    share = np.bincount(full) / len(full)
    assert np.bincount(short) / len(short) == pytest.approx(share, abs=0.01)


def test_plan_knows_the_size_only():
    light = paper8()[0]
    heavy = replace(light, mass=0.3, friction=1.0, soft=False)
    for first, second in zip(plan(size=light.size)[:3], plan(size=heavy.size)[:3], strict=True):
        assert np.array_equal(first, second)
    assert not np.array_equal(plan(size=(0.05, 0.1, 0.05)).gantry, plan().gantry)
    assert not np.array_equal(plan(0).joint, plan(1).joint)


def test_tremor_is_never_still():
    one = plan()
    for target in (*one.gantry[:, :3].T, *one.joint.T):
        assert (np.diff(target) != 0).all()
    hover = one.joint[one.phase == 0]
    assert 0.002 < (hover - hover.mean(axis=0)).std() < 0.02


def test_run_begins_anew_each_time():
    simulator = GraspSimulator(SMALL, HAND, paper8()[1])
    first, _, again = (simulator.run(plan(seed, duration=1.0), rate=50.0) for seed in (0, 1, 0))
    for name in first._fields:
        assert np.array_equal(getattr(first, name), getattr(again, name)), name


def test_object_that_stays_on_its_stand_is_given_up_early():
    lead = replace(paper8()[1], mass=50.0)
    result = GraspSimulator(SMALL, HAND, lead).run(plan(), rate=50.0)
    assert not result.success
    assert len(result.time) < 250
    assert result.phase[-1] == PHASES.index("hold")
    assert len(result.force) == len(result.phase) == len(result.time)


def test_bad_rates_and_steps_are_named():
    with pytest.raises(ValueError, match=r"'step' must be positive and below .* \(got 0, 5.0\)"):
        plan(step=0)
    with pytest.raises(ValueError, match=r"'step' must be positive and below .* \(got 6, 5.0\)"):
        plan(step=6)
    simulator = GraspSimulator(SMALL, HAND, paper8()[1])
    with pytest.raises(ValueError, match=r"'rate' must make 0.0142857 s .* \(got 0.714286\)"):
        simulator.run(plan(), rate=70.0)
    with pytest.raises(ValueError, match=r"'plan.step' must make 0.005 s .* \(got 2.5\)"):
        simulator.run(plan(step=0.005, duration=1.0), rate=50.0)
