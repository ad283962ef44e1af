import json
import shutil

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="needs the extra 'sim'")
pytest.importorskip("h5py", reason="needs the extra 'sim'")

from torch_geometric_tactile.io import read_recording, write_recording
from torch_geometric_tactile.sim import BioTacModel, simulate_bigs
from torch_geometric_tactile.sim import _trial_files as trial_files
from torch_geometric_tactile.sim._bigs_physics import BIGS_PHASES, BigsSimulator
from torch_geometric_tactile.sim._bigs_plan import draw_grasp
from torch_geometric_tactile.sim._bigs_slip import slip_onset

GRASPS = 8


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A folder of eight grasps, and their reports."""
    out = tmp_path_factory.mktemp("bigs")
    return out, list(simulate_bigs(out, GRASPS))


@pytest.fixture(scope="module")
def recordings(made):
    return [read_recording(report.path) for report in made[1]]


def same(*paths):
    first, second = map(read_recording, paths)
    pairs = [(first.time, second.time), (first.tactile, second.tactile)]
    pairs += [(value, second.privileged[name]) for name, value in first.privileged.items()]
    pairs += [(value, second.extra[name]) for name, value in first.extra.items()]
    return first.meta == second.meta and all(np.array_equal(a, b) for a, b in pairs)


def changed(shape, seed=0, **values):
    return draw_grasp(shape, np.random.default_rng(seed))._replace(**values)


def test_objects_are_in_the_proportions_of_the_set(made):
    out, reports = made
    names = [report.object_name for report in reports]
    assert names == ["cylinder", "box", "cylinder", "ball"] * 2
    assert [report.trial for report in reports] == list(range(GRASPS))
    assert {path.name for path in out.iterdir()} == {
        "simulation.json",
        *(f"{name}_{i:04d}.h5" for i, name in enumerate(names)),
    }


def test_files_hold_what_is_promised(recordings):
    for recording in recordings:
        frames = recording.num_frames
        assert recording.tactile.shape == (frames, 19, 3)
        shapes = {name: value.shape[1:] for name, value in recording.extra.items()}
        assert shapes == {
            "pressure": (3,),
            "pac": (3, 22),
            "robot_joint": (3, 7),
            "finger_joint": (3, 4),
            "wrench": (6,),
        }
        assert recording.privileged["force"].shape == (frames, 3, 3)
        assert recording.privileged["object_pose"].shape == (frames, 7)
        assert recording.rate == pytest.approx(100)
        meta = recording.meta
        assert (meta["sensor"], meta["unit"], meta["rate"]) == ("biotac", "count", 100)
        assert meta["synthetic"] is True
        assert meta["phase_names"] == list(BIGS_PHASES)


def test_a_lifted_object_pulls_at_the_wrist_by_its_weight(recordings):
    held = [recording for recording in recordings if recording.label == "success"]
    assert held
    for recording in held:
        meta, time = recording.meta, recording.time
        still = (time > meta["pickup_time"] + 1.5) & (time < meta["shake_time"])
        force, torque = recording.extra["wrench"][still].mean(axis=0).reshape(2, 3)
        weight = 9.81 * meta["grasp"]["mass"]
        assert np.linalg.norm(force) == pytest.approx(weight, rel=0.05)
        assert force[2] < -0.9 * weight  # down, in a hand that is hardly tilted
        # A weight that hangs below the hand: its torque is across it, with a short arm.
        assert abs(torque @ force) / weight < 0.005
        assert np.linalg.norm(torque) / weight < 0.05
        before = recording.privileged["phase"] == 0
        assert np.abs(recording.extra["wrench"][before]).max() < 1


def test_shake_begins_after_the_input_ends(recordings):
    for recording in recordings:
        phase, meta = recording.privileged["phase"], recording.meta
        assert np.all(np.diff(phase) >= 0)
        assert set(phase[:1]) == {0}
        lift = recording.time[phase == 2]
        assert lift[0] - meta["pickup_time"] == pytest.approx(0, abs=0.011)
        assert recording.time[-1] >= meta["pickup_time"] + 2
        if (phase == 3).any():
            assert recording.time[phase == 3][0] > meta["pickup_time"] + 2
            assert recording.time[phase == 3][0] == pytest.approx(meta["shake_time"], abs=0.011)
        if recording.label == "success":
            assert (phase == 3).any()


def test_nothing_is_touched_while_fingers_close(recordings):
    for recording in recordings:
        closing = recording.privileged["phase"] == 0
        assert recording.privileged["normal_force"][closing].max() < 0.6
        assert recording.privileged["normal_force"][~closing].max() > 1.0


def test_slip_begins_in_the_air_and_before_the_loss(recordings):
    labels = [recording.label for recording in recordings]
    assert set(labels) == {"success", "failure"}
    for recording in recordings:
        slip, meta = recording.privileged["slip"], recording.meta
        assert np.all(np.diff(slip) >= 0)
        assert not slip[recording.time < meta["pickup_time"]].any()
        if recording.label == "success":
            assert not slip.any()
            assert meta["slip_time"] is None
            assert meta["lost"] is None
        else:
            assert slip[-1] == 1
            assert meta["slip_time"] <= meta["pickup_time"] + meta["lost"] + 1e-6
            first = recording.time[slip == 1][0]
            assert first - meta["slip_time"] == pytest.approx(0.005, abs=0.006)
            after = recording.time[-1] - meta["pickup_time"] - meta["lost"]
            assert after == pytest.approx(0.3, abs=0.011)  # seconds that are recorded after it


def test_without_friction_all_fall_and_with_much_all_hold():
    for shape in ("cylinder", "box", "ball"):
        slippery = BigsSimulator(changed(shape, friction=0.02)).run()
        assert not slippery.success
        assert slip_onset(slippery) <= slippery.loss
        firm = changed(shape, friction=1.5, grip=8.0, offset=(0.0, 0.0), turn=(0.0, 0.0, 0.0))
        held = BigsSimulator(firm).run()
        assert held.success
        assert slip_onset(held) is None


def test_forces_balance_the_weight_and_keep_within_friction():
    grasp = changed("ball", seed=3, friction=1.2, grip=5.0, turn=(0.0, 0.0, 0.0))
    physics = BigsSimulator(grasp).run()
    waits = slice(physics.pickup + 480, physics.pickup + 590)
    # Across the pads nothing is held up: fingers hang, so that x of a fingertip points down.
    down = physics.force[waits, :, 0].sum(axis=1).mean()
    assert physics.shear[waits].sum(axis=1).mean() > 0.9 * grasp.mass * 9.81
    assert down > 0.6 * grasp.mass * 9.81
    touched = physics.normal > 0.05
    assert np.all(physics.shear[touched] <= 1.01 * grasp.friction * physics.normal[touched])
    total = np.linalg.norm(physics.force, axis=2)
    assert np.allclose(total[touched], np.hypot(physics.normal, physics.shear)[touched], rtol=1e-6)


def test_vibration_is_louder_while_sliding(recordings):
    quiet, loud = [], []
    for recording in recordings:
        speed = recording.privileged["slide_speed"]
        normal = recording.privileged["normal_force"]
        spread = recording.extra["pac"].astype(float).std(axis=2)
        lifted = (recording.privileged["phase"] >= 2)[:, None] & (normal > 0.5)
        quiet.append(spread[lifted & (speed < 0.002)])
        loud.append(spread[lifted & (speed > 0.03)])
    assert np.median(np.concatenate(loud)) > 5 * np.median(np.concatenate(quiet))


def test_sessions_have_offsets_of_their_own(made, recordings):
    def rest(recording):
        return recording.tactile[recording.privileged["phase"] == 0][:20].mean(axis=0)

    first, second = ([rest(r) for r in recordings if r.meta["session"] == s] for s in (0, 1))
    assert len(first) == len(second) == 4
    assert max(np.abs(a - first[0]).max() for a in first) < 30
    assert np.abs(first[0] - second[0]).mean() > 60


@pytest.mark.parametrize("jobs", [1, 2])
def test_grasps_do_not_depend_on_jobs_or_number(made, tmp_path, jobs):
    out, _ = made
    reports = list(simulate_bigs(tmp_path, 2, jobs=jobs))
    assert all(same(report.path, out / report.path.name) for report in reports)


def test_another_seed_gives_other_grasps(made, tmp_path):
    (report,) = simulate_bigs(tmp_path, 1, seed=1)
    assert not same(report.path, made[0] / report.path.name)


def test_finished_grasps_are_kept_and_summed_up(made, tmp_path):
    out, reports = made
    before = {path: path.stat().st_mtime_ns for path in out.glob("*.h5")}
    again = list(simulate_bigs(out, GRASPS))
    assert [report._replace(kept=False) for report in again] == reports
    assert {path: path.stat().st_mtime_ns for path in out.glob("*.h5")} == before
    summary = json.loads((out / "simulation.json").read_text())
    assert summary["grasps"] == GRASPS
    assert summary["successes"] == sum(report.success for report in reports)
    assert summary["objects"]["cylinder"]["grasps"] == 4
    early = [report.lost is not None and report.lost < 2 for report in reports]
    assert summary["lost_before_input_ends"] == sum(early)


@pytest.mark.parametrize(
    ("change", "key"), [({"seed": 1}, "seed"), ({"model": BioTacModel(noise=0)}, "fingertip")]
)
def test_folder_of_another_run_is_refused(made, change, key):
    with pytest.raises(ValueError, match=rf"cylinder_0000\.h5' was written with another '{key}'"):
        list(simulate_bigs(made[0], GRASPS, **change))


@pytest.mark.parametrize("lost", ["1.0", True, -1.0])
def test_finished_grasp_that_does_not_tell_its_loss_is_named(tmp_path, made, lost):
    recording = read_recording(made[1][0].path)
    path = tmp_path / made[1][0].path.name
    object.__setattr__(recording, "meta", {**recording.meta, "lost": lost})
    write_recording(recording, path)
    with pytest.raises(
        ValueError, match=r"must have the time 'lost' of its object in its metadata"
    ):
        list(simulate_bigs(tmp_path, 1))


def test_bad_arguments_are_named(tmp_path):
    for arguments, message in [
        ({"grasps": 0}, r"'grasps' must be at least 1 \(got 0\)"),
        ({"jobs": 0}, r"'jobs' must be at least 1 \(got 0\)"),
        ({"seed": -1}, r"'seed' must not be negative \(got -1\)"),
        ({"model": "wet"}, r"'model' must be a BioTacModel \(got 'wet'\)"),
    ]:
        with pytest.raises(ValueError, match=message):
            simulate_bigs(tmp_path, **arguments)
    with pytest.raises(ValueError, match=r"'shape' must be one of \['cylinder', .* \(got 'cube'\)"):
        draw_grasp("cube", np.random.default_rng(0))


def test_missing_package_names_the_extra(tmp_path, monkeypatch):
    monkeypatch.setattr(trial_files, "find_spec", lambda name: None)
    with pytest.raises(ImportError, match=r"simulated grasps needs? mujoco: pip install"):
        simulate_bigs(tmp_path)


def test_data_set_reads_the_folder(made, tmp_path):
    datasets = pytest.importorskip("torch_geometric_tactile.datasets")
    if not hasattr(datasets, "BiGS"):
        pytest.skip("needs BiGS")
    root = shutil.copytree(made[0], tmp_path / "grasps")  # other tests list the files of `made`
    dataset = datasets.BiGS(root)
    assert set(dataset.y.tolist()) == {0, 1}
    assert dataset.x.shape[1:] == (19, 3)
    assert len(set(dataset.trial.tolist())) == GRASPS
