from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="needs the extra 'sim'")

from torch_geometric_tactile.io import read_recording, write_recording
from torch_geometric_tactile.sim import (
    GripperLift,
    LiftLimits,
    LiftObject,
    constant_squeeze,
    lift_expert,
    lift_observations,
    record_lift,
)

ITEM = LiftObject(mass=0.2, friction=0.6, offset=0.006)


@pytest.fixture(scope="module")
def recording():
    return record_lift(GripperLift(), 0, ITEM)


def test_recording_holds_the_episode(recording):
    assert recording.label == "success"
    assert recording.tactile.shape[1:] == (32, 3)
    assert recording.rate == pytest.approx(20)
    assert recording.joint.shape == (recording.num_frames, 2)
    assert set(recording.extra) == {"velocity", "command", "motor_force"}
    assert recording.meta["object_properties"]["mass"] == 0.2
    assert recording.meta["unit"] == "newton"
    # A frame is before its action: the command of a frame is that of the action before.
    command, action = recording.extra["command"], recording.action
    assert command[1:, 1] == pytest.approx(action[:-1, 1], abs=1e-6)
    change = np.diff(np.log(command[:, 0]))
    assert change == pytest.approx(action[:-1, 0], abs=1e-5)


def test_recording_survives_a_file(recording, tmp_path):
    write_recording(recording, tmp_path / "lift.npz")
    copy = read_recording(tmp_path / "lift.npz")
    assert np.array_equal(copy.tactile, recording.tactile)
    assert np.array_equal(copy.action, recording.action)


def test_expert_squeezes_in_proportion_to_the_load(recording):
    squeeze, load = recording.privileged["squeeze"], recording.privileged["load"]
    need, weight = recording.meta["need"], ITEM.mass * 9.81
    is_loading = (load > 0.2 * weight) & (load < 0.9 * weight)
    assert is_loading.sum() >= 4
    ratio = squeeze[is_loading] / (need * load[is_loading] / weight)
    assert ratio.min() > 0.8
    assert ratio.max() < 2
    assert squeeze[-1] == pytest.approx(1.3 * need, rel=0.03)
    assert recording.action[load < 0.5 * weight, 1].max() < 0.004


def test_noise_moves_the_episode_and_not_the_labels():
    env = GripperLift()
    first, again = (record_lift(env, 1, ITEM, noise=0.4) for _ in range(2))
    assert np.array_equal(first.tactile, again.tactile)
    assert first.label == "success"
    before_touch = first.privileged["squeeze"] < 0.02
    assert before_touch.any()
    assert not first.action[before_touch].any()
    assert first.extra["command"][before_touch][1:].std(axis=0).min() > 0
    with pytest.raises(ValueError, match=r"'noise' must not be negative \(got -1\)"):
        record_lift(env, 0, noise=-1)


def test_observations_of_a_recording_are_those_of_the_episode(recording):
    env, found = GripperLift(), []
    record_lift(env, 0, ITEM, policy=lambda env: found.append(env.observation) or lift_expert(env))
    observations = lift_observations(recording)
    assert len(observations) == len(found) == recording.num_frames
    for observation, expected in zip(observations, found, strict=True):
        for part, other in zip(observation, expected, strict=True):
            np.testing.assert_array_equal(part, other.astype(np.float32))
    for part in ({"extra": {}}, {"joint": None}):
        with pytest.raises(ValueError, match=r"must come from 'record_lift' \(got Rec"):
            lift_observations(replace(recording, **part))


def test_a_disturbance_lasts():
    env, changes = GripperLift(limits=LiftLimits(squeeze_ratio=100)), []
    for seed in range(8):
        recording = record_lift(env, seed, policy=lambda env: np.array([0.02, 0.0]), noise=0.4)
        changes.append(np.diff(np.log(recording.extra["command"][:, 0]))[20:])
    first, second = (np.concatenate([c[part] for c in changes]) for part in np.s_[:-1, 1:])
    assert np.corrcoef(first, second)[0, 1] == pytest.approx(0.9, abs=0.07)
    assert np.concatenate(changes).std() == pytest.approx(0.4 * 0.3, rel=0.3)


def test_constant_squeeze_waits_for_contact_and_then_lifts():
    recording = record_lift(GripperLift(), 0, ITEM, policy=constant_squeeze(4.0))
    squeeze, action = recording.privileged["squeeze"], recording.action
    assert recording.label == "success"
    assert squeeze[-1] == pytest.approx(4.0, rel=0.02)
    assert not action[squeeze < 0.05].any()
    assert action[squeeze < 2.5, 1].max() == 0
    with pytest.raises(ValueError, match=r"'squeeze' must be positive \(got 0\)"):
        constant_squeeze(0)


def test_expert_waits_without_contact():
    env = GripperLift()
    env.reset(0, ITEM)
    assert lift_expert(env).tolist() == [0.0, 0.0]
