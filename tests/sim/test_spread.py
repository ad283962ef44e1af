from dataclasses import FrozenInstanceError, fields, replace

import numpy as np
import pytest

from torch_geometric_tactile.sim import SPREADS, GraspSpread
from torch_geometric_tactile.sim._grasp import plan_grasp

SIZE = (0.07, 0.18, 0.07)
SUMS = (18859.181252675706, 6607781.945643889, 135027.0)


def plan(seed=0, spread=None):
    return plan_grasp(SIZE, np.random.default_rng(seed), 5.0, 0.02, spread)


def test_repr():
    assert repr(GraspSpread.wide()) == (
        "GraspSpread(yaw=0.35, lateral=0.02, forward=0.012, posture=0.12, lazy_finger=0.3)"
    )
    assert {"careful": GraspSpread(), "wide": GraspSpread.wide()} == SPREADS
    with pytest.raises(FrozenInstanceError):
        GraspSpread().yaw = 0.1


def test_the_default_is_the_plan_of_before():
    # The sums were taken before there was a spread (no digest: the last bits differ by processor).
    sums = [np.sum(part * np.arange(1, part.size + 1).reshape(part.shape)) for part in plan()[:3]]
    assert sums == pytest.approx(SUMS, rel=1e-9)
    for part, same in zip(plan(1)[:3], plan(1, GraspSpread())[:3], strict=True):
        assert np.array_equal(part, same)


@pytest.mark.parametrize(("name", "column"), [("forward", 0), ("lateral", 1), ("yaw", 3)])
def test_each_spread_moves_its_own_part(name, column):
    usual, other = plan(), plan(spread=replace(GraspSpread(), **{name: 0.5}))
    changed = np.abs(usual.gantry - other.gantry).max(axis=0) > 1e-9
    assert changed.tolist() == [i == column for i in range(4)]
    assert np.array_equal(usual.joint, other.joint)


def test_posture_moves_the_joints_only():
    usual, other = plan(), plan(spread=GraspSpread(posture=0.2))
    assert np.array_equal(usual.gantry, other.gantry)
    assert (np.abs(usual.joint - other.joint).max(axis=0) > 0.01).all()


@pytest.mark.parametrize(("name", "sd"), [("forward", 0.03), ("lateral", 0.03), ("yaw", 0.4)])
def test_spread_is_the_standard_deviation(name, sd):
    column = {"forward": 0, "lateral": 1, "yaw": 3}[name]
    spread = replace(GraspSpread(), **{name: sd})
    drawn = [
        plan_grasp(SIZE, np.random.default_rng(i), 1.0, 0.1, spread).gantry[:, column].mean()
        for i in range(600)
    ]
    assert np.std(drawn) == pytest.approx(sd, rel=0.1)


def test_no_spread_leaves_the_tremor():
    none = GraspSpread(0, 0, 0, 0)
    gantry = plan(spread=none).gantry
    assert (gantry[:, 3] == 0).all()
    assert 0 < np.abs(gantry[:, 1]).max() < 0.005


def test_lazy_finger_closes_less_and_the_thumb_never():
    closing = np.ones(16)
    always = GraspSpread(lazy_finger=1)
    lazy = np.array([always.close_less(closing, np.random.default_rng(i)) for i in range(200)])
    assert (closing == 1).all()
    assert (lazy[:, 12:] == 1).all()
    of_finger = lazy[:, :12].reshape(200, 3, 4)
    assert ((of_finger < 1).all(axis=2).sum(axis=1) == 1).all()
    assert (of_finger == of_finger[:, :, :1]).all()
    assert of_finger.min() >= 0
    least = of_finger.min(axis=(1, 2))
    assert 0.5 < least.max() <= 0.6
    assert (of_finger < 1).any(axis=2).sum(axis=0).min() > 40  # each finger


def test_lazy_fingers_are_as_frequent_as_told():
    some = GraspSpread(lazy_finger=0.3)
    lazy = [(some.close_less(np.ones(16), np.random.default_rng(i)) < 1).any() for i in range(600)]
    assert np.mean(lazy) == pytest.approx(0.3, abs=0.06)


@pytest.mark.parametrize(
    ("lateral", "yaw", "expected"),
    [(-0.01, -0.1, 0), (-0.01, 0.0, 1), (-0.01, 0.1, 2), (0.0, -0.1, 3), (0, 0, 4), (0.01, 0.1, 8)],
)
def test_placement_by_hand(lateral, yaw, expected):
    assert GraspSpread().placement(lateral, yaw) == expected


def test_placements_are_equally_frequent():
    spread = GraspSpread.wide()
    draw = np.random.default_rng(0).normal(size=(9000, 2)) * [spread.lateral, spread.yaw]
    count = np.bincount([spread.placement(*row) for row in draw.tolist()], minlength=9)
    assert len(count) == 9
    assert count == pytest.approx(np.full(9, 1000), rel=0.12)


def test_without_spread_there_is_one_placement():
    assert GraspSpread(yaw=0, lateral=0).placement(0.3, -0.2) == 4


@pytest.mark.parametrize("name", [field.name for field in fields(GraspSpread)])
@pytest.mark.parametrize("value", [-0.1, float("nan"), float("inf"), "wide", None, True])
def test_bad_numbers_are_named(name, value):
    with pytest.raises(ValueError, match=rf"'{name}' must be a number of at least 0 \(got "):
        GraspSpread(**{name: value})


def test_lazy_finger_is_a_probability():
    with pytest.raises(ValueError, match=r"'lazy_finger' must be a probability \(got 1.5\)"):
        GraspSpread(lazy_finger=1.5)
