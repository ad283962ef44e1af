from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="needs the extra 'sim'")

from torch_geometric_tactile.sensors import allegro_uskin, grid
from torch_geometric_tactile.sim import (
    GripperLift,
    LiftLimits,
    LiftObject,
    LiftOutcome,
    PadSensor,
    constant_squeeze,
    draw_lift_object,
    lift_expert,
    lift_inputs,
    needed_squeeze,
)

ITEM = LiftObject(mass=0.2, friction=0.6, offset=0.006)
EXACT = PadSensor(gain_spread=0, offset=0, noise=0)


def run(env, seed, policy, item=None):
    env.reset(seed, item)
    finished = False
    while not finished:
        _, finished = env.step(policy(env))
    return env.outcome


@pytest.fixture(scope="module")
def held():
    """An episode of the expert, at its end."""
    env = GripperLift(sensor=EXACT)
    assert run(env, 0, lift_expert, ITEM).success
    return env


def test_pads_carry_the_weight(held):
    force = held.taxel_force.reshape(2, 16, 3)
    assert force[:, :, 1].sum() == pytest.approx(-0.2 * 9.81, rel=0.01)
    assert held.load == pytest.approx(0.2 * 9.81, rel=0.01)
    assert force[:, :, 2].sum(axis=1) == pytest.approx(held.command[0], rel=0.02)
    assert held.squeeze == pytest.approx(held.command[0], rel=0.02)
    assert held.observation.readings == pytest.approx(held.taxel_force, abs=1e-6)


def test_pads_carry_the_moment_of_the_weight(held):
    wrench = lift_inputs(held.observation, "wrench")[8:].reshape(2, 6)
    # Both pads face each other, so a moment about the closing axis has opposite signs.
    assert wrench[0, 5] - wrench[1, 5] == pytest.approx(-0.2 * 9.81 * 0.006, rel=0.05)


def test_friction_bounds_the_shear(held):
    force = held.taxel_force
    shear, normal = np.hypot(force[:, 0], force[:, 1]), force[:, 2]
    assert (shear <= 1.05 * 0.6 * normal + 0.005).all()
    assert (shear > 0.9 * 0.6 * normal).any()  # outer taxels slip before the object does


def test_pressure_falls_to_the_edge_of_the_crowned_pad(held):
    normal = held.taxel_force[:, 2].reshape(2, 4, 4)
    middle, corners = normal[:, 1:3, 1:3].mean(), normal[:, ::3, ::3].mean()
    assert middle > 1.2 * corners


@pytest.mark.parametrize("side", [1, -1])
def test_narrow_object_touches_the_columns_at_its_place(side):
    env = GripperLift()
    item = replace(ITEM, breadth=0.01, place=side * 0.005, offset=side * 0.005)
    assert run(env, 0, lift_expert, item).success
    touched = (env.taxel_force[:, 2] > 0.01).reshape(2, 4, 4).any(axis=1)
    right, left = [False, False, True, True], [True, True, False, False]
    # Columns count along y on the left pad, and against it on the right pad, which faces it.
    assert touched.tolist() == ([right, left] if side == 1 else [left, right])


def test_motors_measure_opening_height_and_forces(held):
    position, force = held.observation.position, held.observation.force
    assert position[0] == pytest.approx(ITEM.width, abs=0.003)
    assert position[1] > 0.03
    assert force[0] == pytest.approx(held.command[0], abs=0.6)
    assert force[1] == pytest.approx(0.2 * 9.81, abs=2.5)


def test_episode_starts_without_contact():
    env = GripperLift(sensor=EXACT)
    for seed in range(5):
        observation = env.reset(seed)
        assert not observation.readings.any()
        assert not env.is_touching
        gap = observation.position[0] - env.item.width
        assert 0.0075 < gap < 0.0165
        assert observation.command == pytest.approx([0.3, 0.0])


@pytest.mark.parametrize(
    ("item", "squeeze", "label"),
    [
        (replace(ITEM, offset=0.0), 0.4, "slipped"),
        (replace(ITEM, offset=0.012), 2.4, "turned"),
        (ITEM, 8.0, "crushed"),
    ],
)
def test_failures_are_told_apart(item, squeeze, label):
    env = GripperLift()
    outcome = run(env, 0, constant_squeeze(squeeze), item)
    assert outcome.label == label
    assert not outcome.success
    limits = env.limits
    exceeded = {
        "slipped": outcome.slide > limits.slide,
        "turned": outcome.tilt > limits.tilt,
        "crushed": outcome.peak > 1.6 * outcome.need + 0.5,
    }
    assert exceeded[label]


def test_gripper_that_does_not_lift_is_unfinished():
    env = GripperLift()
    outcome = run(env, 0, lambda env: [0.0, 0.0], ITEM)
    assert outcome[:1] + outcome[-1:] == ("unfinished", needed_squeeze(ITEM))
    assert outcome.slide < 0.001


def test_gripper_that_lifts_without_touching_is_unfinished():
    env = GripperLift()
    env.reset(0, ITEM)
    env.data.qpos[env._motors[0]] = -0.2  # wide open
    finished = False
    while not finished:
        _, finished = env.step([0.0, 0.05])
    assert env.outcome.label == "unfinished"


def test_same_seed_gives_the_same_bytes():
    def episode():
        env = GripperLift()
        parts = [np.concatenate([part.ravel() for part in env.reset(5)])]
        finished = False
        while not finished:
            observation, finished = env.step(lift_expert(env))
            parts.append(np.concatenate([part.ravel() for part in observation]))
        return np.concatenate(parts).tobytes(), env.outcome

    first, again = episode(), episode()
    assert first == again


def test_sensor_is_paired_by_seed_and_not_by_the_policy():
    env = GripperLift(sensor=PadSensor(gain_spread=0, offset=0.002, noise=0.001))
    noise = []
    for action in ([0.0, 0.0], [0.3, 0.0]):
        env.reset(0, ITEM)
        for _ in range(3):  # no contact yet
            observation, _ = env.step(action)
        noise.append(observation.readings - env.taxel_force)
    assert noise[0] == pytest.approx(noise[1], abs=1e-8)
    env.reset(1, ITEM)
    for _ in range(3):
        observation, _ = env.step([0.0, 0.0])
    assert not np.allclose(observation.readings, noise[0], atol=1e-4)


def test_actions_are_clipped():
    env = GripperLift()
    env.reset(0, ITEM)
    env.step([5.0, 1.0])
    assert env.command == pytest.approx([0.3 * np.exp(0.3), 0.05])
    env.step([-5.0, -1.0])
    env.step([-5.0, -1.0])
    assert env.command == pytest.approx([0.3, 0.0])


@pytest.mark.parametrize(
    "item",
    [
        LiftObject(0.05, 1.0),
        LiftObject(0.05, 0.3, offset=0.012),
        LiftObject(0.4, 0.3),
        LiftObject(0.4, 0.3, offset=-0.012),
        LiftObject(0.4, 1.0, offset=0.012),
    ],
)
def test_object_held_at_twice_the_need_does_not_creep(item):
    env = GripperLift(limits=LiftLimits(squeeze_ratio=10))
    observation, squeeze = env.reset(0, item), 2 * needed_squeeze(item)
    place = []
    for step in range(118):
        # Up to 20 mm, below the height that ends the episode.
        speed = 0.02 if step > 25 and observation.position[1] < 0.02 else 0.0
        change = np.log(squeeze / env.command[0]) if env.is_touching else 0.0
        observation, finished = env.step([change, speed])
        assert not finished
        place.append(env.data.qpos[env._object][1:3] - [0.0, env.data.qpos[env._motors[1]]])
    creep = np.hypot(*(place[-1] - place[-61]))  # in 3 s
    print(f"{item}: {1e3 * creep:.4f} mm in 3 s, {1e3 * env.slide:.2f} mm in all")  # noqa: T201
    assert env.load == pytest.approx(item.mass * 9.81, rel=0.02)
    assert creep < 1e-4
    assert env.slide < 0.001


def test_other_pads():
    env = GripperLift(pad=grid(3, 5, 0.004))
    assert env.layout.num_taxels == 30
    assert env.reset(0).readings.shape == (30, 3)
    assert run(env, 0, lift_expert, ITEM).success
    with pytest.raises(ValueError, match="'pad' must be flat"):
        GripperLift(pad=allegro_uskin())


def test_expert_lifts_objects_of_both_splits():
    env = GripperLift()
    labels = [
        run(env, seed, lift_expert, draw_lift_object(seed, held_out=held_out)).label
        for held_out in (False, True)
        for seed in range(6)
    ]
    assert labels == ["success"] * 12


@pytest.mark.full
def test_expert_lifts_all_of_200_objects_and_no_constant_squeeze_does():
    env = GripperLift()
    assert all(run(env, seed, lift_expert).success for seed in range(200))
    rate = np.mean([run(env, seed, constant_squeeze(2.5)).success for seed in range(100)])
    assert rate < 0.5


def test_misuse_is_named():
    env = GripperLift()
    for call in (lambda: env.step([0, 0]), lambda: env.outcome):
        with pytest.raises(RuntimeError, match="call 'reset'"):
            call()
    env.reset(0, ITEM)
    with pytest.raises(RuntimeError, match="no episode is finished"):
        _ = env.outcome
    for action in ([0.0], [0.0, float("nan")], [[0.0, 0.0]]):
        with pytest.raises(ValueError, match="'action' must have two finite numbers"):
            env.step(action)
    with pytest.raises(ValueError, match="'seed' must not be negative"):
        env.reset(-1)
    with pytest.raises(ValueError, match=r"'tilt' must be positive \(got 0\)"):
        LiftLimits(tilt=0)


def test_repr():
    assert repr(GripperLift()) == (
        "GripperLift(TaxelLayout('gripper_pads', num_taxels=32, patches=2, digits=2), "
        "PadSensor(gain_spread=0.05, offset=0.002, noise=0.001, dead=0.0))"
    )
    assert LiftOutcome("turned", 0.0, 0.2, 1.0, 1.0).success is False
