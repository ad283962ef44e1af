import json
import signal
import sys
from dataclasses import asdict, replace
from math import comb

import numpy as np
import pytest
from sklearn.neighbors import KNeighborsClassifier

pytest.importorskip("mujoco", reason="needs the extra 'sim'")
pytest.importorskip("h5py", reason="needs the extra 'sim'")

import joblib

from torch_geometric_tactile._files import atomic_path
from torch_geometric_tactile.io import read_recording, write_recording
from torch_geometric_tactile.sensors import stock_layout
from torch_geometric_tactile.sim import (
    PRESETS,
    PROPERTIES,
    GraspObject,
    GraspSpread,
    SkinModel,
    TrialReport,
    drawn_objects,
    paper8,
    simulate,
    twenty,
)
from torch_geometric_tactile.sim import _trial_files as trial_files
from torch_geometric_tactile.sim._grasp import PHASES, GraspPlan, plan_grasp
from torch_geometric_tactile.sim._object_sets import OBJECT_SETS

module = sys.modules["torch_geometric_tactile.sim.simulate"]
SPONGE = paper8()[1]
PRIVILEGED = ("bone_force", "force", "object_pose", "palm_pose", "phase", "support")


@pytest.fixture
def objects(monkeypatch):
    """Another set of objects, for simulations in this process."""

    def choose(name, *items):
        monkeypatch.setitem(OBJECT_SETS, name, lambda: list(items))
        return name

    return choose


@pytest.fixture
def hovering(monkeypatch):
    """Trials end before the hand reaches for the object."""

    def plan(*args):
        gantry, joint, phase, step = plan_grasp(*args)
        hover = phase == PHASES.index("hover")
        return GraspPlan(gantry[hover], joint[hover], phase[hover], step)

    monkeypatch.setattr(module, "plan_grasp", plan)


def test_every_trial_has_a_file_and_a_report(undisturbed):
    out, reports = undisturbed
    names = [item.name for item in paper8()]
    assert [report.object_name for report in reports] == names
    for report in reports:
        assert isinstance(report, TrialReport)
        assert report.path == out / f"{report.object_name}_000.h5"
        assert report.trial == 0
        assert 1 <= report.attempts <= 5
        assert not report.kept
    files = sorted(path.name for path in out.iterdir())
    assert files == sorted([*(f"{name}_000.h5" for name in names), "simulation.json"])


def test_summary(undisturbed):
    out, reports = undisturbed
    summary = json.loads((out / "simulation.json").read_text())
    assert summary["synthetic"] is True
    assert "not measured" in summary["note"]
    assert summary["attempts"] == sum(report.attempts for report in reports)
    assert (summary["trials"], summary["successes"], summary["given_up"]) == (8, 8, [])
    assert (summary["object_set"], summary["seed"]) == ("paper8", 0)


def test_recording_tells_that_it_is_simulated_and_how(undisturbed):
    out, reports = undisturbed
    for item, report in zip(paper8(), reports, strict=True):
        recording = read_recording(out / f"{item.name}_000.h5")
        assert recording.label == item.name
        meta = recording.meta
        assert meta["synthetic"] is True
        assert (meta["seed"], meta["trial"], meta["attempt"]) == (0, 0, report.attempts - 1)
        assert meta["labels"] == list(item.labels)
        assert meta["label_names"] == list(PROPERTIES)
        assert meta["phase_names"] == list(PHASES)
        assert (meta["unit"], meta["rate"], meta["sensor"]) == ("count", 50.0, "allegro_uskin")
        assert set(meta["versions"]) == {"torch-geometric-tactile", "mujoco", "numpy"}


def test_truth_is_kept_apart(undisturbed):
    out, _ = undisturbed
    recording = read_recording(out / "sponge_000.h5")
    assert recording.tactile.shape == (250, 384, 3)
    assert recording.joint.shape == (250, 16)
    assert recording.rate == pytest.approx(50)
    assert tuple(sorted(recording.privileged)) == PRIVILEGED
    assert all(len(values) == 250 for values in recording.privileged.values())
    assert np.array_equal(recording.tactile, recording.tactile.round())
    # Pressure raises the count of z; nothing of it is seen before contact.
    change = recording.tactile[..., 2] - recording.tactile[:10, :, 2].mean(axis=0)
    pressed = recording.privileged["force"][..., 2] > 1.0
    assert (change[pressed] > 300).mean() > 0.99
    assert np.abs(change[recording.privileged["phase"] == 0]).max() < 100


def test_order_of_work_does_not_matter(undisturbed, tmp_path, same_arrays):
    out, _ = undisturbed
    # Alone, and after another trial of the same model, in place of second of eight.
    module._simulator.cache_clear()
    tasks = [
        module._Trial(
            out=str(tmp_path),
            hand="allegro_uskin",
            object_set="paper8",
            item=SPONGE,
            index=1,
            trial=trial,
            seed=0,
            max_attempts=5,
            preset=PRESETS["ci"],
            skin=SkinModel(),
            spread=GraspSpread(),
            motion="lift",
        )
        for trial in (1, 0)
    ]
    for task in tasks:
        task.simulate()
    assert same_arrays(tmp_path / "sponge_000.h5", out / "sponge_000.h5")
    assert not same_arrays(tmp_path / "sponge_001.h5", out / "sponge_000.h5")


def test_another_seed_gives_other_trials(tmp_path, objects, hovering):
    name = objects("one", SPONGE)
    for seed in (0, 1):
        list(simulate(tmp_path / str(seed), name, trials=1, seed=seed, preset="ci"))
    first, second = (read_recording(tmp_path / f"{seed}/sponge_000.h5") for seed in (0, 1))
    shortest = min(first.num_frames, second.num_frames)
    assert not np.allclose(first.joint[:shortest], second.joint[:shortest], atol=1e-3)


@pytest.mark.full
def test_finished_trials_are_kept(undisturbed):
    out, reports = undisturbed
    before = {path: path.stat().st_mtime_ns for path in out.glob("*.h5")}
    again = list(simulate(out, trials=1, preset="ci"))
    assert all(report.kept for report in again)
    assert [report._replace(kept=False) for report in again] == reports
    assert {path: path.stat().st_mtime_ns for path in out.glob("*.h5")} == before


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ({"seed": 1}, "seed"),
        ({"preset": "full"}, "preset"),
        ({"skin": SkinModel(noise=0)}, "skin"),
        ({"plan": GraspSpread.wide()}, "spread"),
        ({"seconds": 4}, "preset"),
        ({"motion": "squeeze"}, "motion"),
        ({"objects": "renamed"}, "object_set"),
    ],
)
def test_folder_of_another_run_is_refused(undisturbed, objects, change, key):
    out, _ = undisturbed
    objects("renamed", *paper8())
    arguments = {"trials": 1, "preset": "ci"} | change
    with pytest.raises(
        ValueError, match=rf"plastic_tube_000\.h5' was written with another '{key}'"
    ):
        list(simulate(out, **arguments))
    assert len(list(out.glob("*.h5"))) == 8


def test_object_that_cannot_be_lifted_is_given_up(tmp_path, objects, caplog):
    anvil = replace(SPONGE, name="anvil", mass=50.0)
    (report,) = simulate(tmp_path, objects("anvils", anvil), 1, preset="ci", max_attempts=2)
    assert report == TrialReport("anvil", 0, 2, None, kept=False)
    assert "anvil, trial 0: not lifted in 2 attempts" in caplog.text
    assert [path.name for path in tmp_path.iterdir()] == ["simulation.json"]
    summary = json.loads((tmp_path / "simulation.json").read_text())
    assert (summary["trials"], summary["attempts"], summary["successes"]) == (1, 2, 0)
    assert summary["given_up"] == ["anvil_000"]


def test_second_attempt_is_another_grasp(tmp_path, objects, hovering, monkeypatch):
    run, seen = module.GraspSimulator.run, []

    def fails_once(self, plan, rate):
        seen.append(plan)
        return run(self, plan, rate)._replace(success=len(seen) > 1)

    monkeypatch.setattr(module.GraspSimulator, "run", fails_once)
    (report,) = simulate(tmp_path, objects("two", SPONGE), 1, preset="ci")
    assert report.attempts == 2
    assert read_recording(report.path).meta["attempt"] == 1
    assert not np.array_equal(seen[0].joint[:10], seen[1].joint[:10])


@pytest.mark.parametrize("attempt", [None, "0", 1.5, True, -1])
def test_finished_trial_without_its_attempt_is_named(tmp_path, objects, hovering, attempt):
    name = objects("one", SPONGE)
    (report,) = simulate(tmp_path, name, trials=1, preset="ci")
    recording = read_recording(report.path)
    meta = {**recording.meta, "attempt": attempt}
    write_recording(replace(recording, meta=meta), report.path)
    with pytest.raises(ValueError, match=r"sponge_000\.h5' must have a whole number 'attempt'"):
        list(simulate(tmp_path, name, trials=1, preset="ci"))


def test_frames_before_contact_tell_the_trial_but_not_the_object(tmp_path, hovering):
    list(simulate(tmp_path, trials=3, preset="ci"))
    x, y, trial = [], [], []
    for path in sorted(tmp_path.glob("*.h5")):
        recording = read_recording(path)
        x += list(np.concatenate([recording.tactile.reshape(-1, 1152), recording.joint], axis=1))
        y += [recording.label] * recording.num_frames
        trial += [recording.meta["trial"]] * recording.num_frames
    x, y, trial = np.array(x), np.array(y), np.array(trial)
    x = (x - x.mean(axis=0)) / x.std(axis=0)

    # By trial: each of the 24 trials is one vote, right by chance with 1/8.
    votes = 0
    for held_out in range(3):
        test = trial == held_out
        guess = KNeighborsClassifier(5).fit(x[~test], y[~test]).predict(x[test])
        for name in set(y):
            names, counts = np.unique(guess[y[test] == name], return_counts=True)
            votes += names[counts.argmax()] == name
    bound = next(
        k
        for k in range(25)
        if sum(comb(24, i) * 7 ** (24 - i) / 8**24 for i in range(k + 1)) > 0.999
    )
    assert votes <= bound  # 9

    # By frame: neighbours in time are on both sides of the split.
    test = np.random.default_rng(0).random(len(y)) < 0.3
    assert KNeighborsClassifier(5).fit(x[~test], y[~test]).score(x[test], y[test]) > 0.9


def test_temporary_files_of_a_killed_run_are_removed_and_not_those_of_a_second(
    tmp_path, objects, hovering
):
    (tmp_path / ".sponge_000.h5.3.tmp").write_text("half a file")
    (tmp_path / ".other.tmp").write_text("another's")
    with atomic_path(tmp_path / "sponge_000.h5") as alive:
        alive.write_text("a second run's")
        list(simulate(tmp_path, objects("three", SPONGE), 1, preset="ci"))
        names = sorted(path.name for path in tmp_path.iterdir())
        assert names == [".other.tmp", alive.name, "simulation.json", "sponge_000.h5"]
    assert (tmp_path / "sponge_000.h5").read_text() == "a second run's"


def test_workers_start_with_interrupts_ignored(tmp_path, objects, hovering, monkeypatch):
    # What is ignored at the start of a process stays so: no traces from half-imported workers.
    at_start, call = [], joblib.Parallel.__call__

    def spied(self, tasks):
        at_start.append(signal.getsignal(signal.SIGINT))
        return call(self, tasks)

    monkeypatch.setattr(joblib.Parallel, "__call__", spied)
    before = signal.getsignal(signal.SIGINT)
    for _ in simulate(tmp_path, objects("four", SPONGE), 1, preset="ci"):
        assert signal.getsignal(signal.SIGINT) is before
    assert at_start == [signal.SIG_IGN]
    assert signal.getsignal(signal.SIGINT) is before


def test_hand_is_that_of_the_objects_paper_unless_told(tmp_path, objects, hovering):
    tube = twenty()[0]
    for name, hand, num_taxels in [
        ("twenty", None, 240),
        ("tubes", None, 384),
        ("tubes", "allegro_uskin_240", 240),
    ]:
        out = tmp_path / f"{name}_{hand}"
        (report,) = simulate(out, objects(name, tube), 1, preset="ci", hand=hand)
        recording = read_recording(report.path)
        assert recording.num_taxels == num_taxels
        assert stock_layout(recording.meta["sensor"]).num_taxels == num_taxels


def test_plan_and_length_are_recorded(tmp_path, hovering):
    wide = GraspSpread.wide()
    names = []
    for report in simulate(
        tmp_path, "shapes", 2, preset="ci", plan=wide, seconds=4, num_objects=3, seed=2
    ):
        names.append((report.object_name, report.trial))
        meta = read_recording(report.path).meta
        (item,) = (item for item in drawn_objects(3, 2) if item.name == report.object_name)
        assert meta["object_set"] == "shapes"
        assert meta["spread"] == asdict(wide)
        assert meta["preset"]["duration"] == 4.0
        assert (meta["shape"], meta["width"]) == (item.shape, item.size[0])
        assert (meta["mass"], meta["friction"]) == (item.mass, item.friction)
        assert meta["size"] == int(item.size[0] * 100 + 1e-9)
        lateral, yaw = meta["palm_lateral"], meta["palm_yaw"]
        assert meta["placement"] == wide.placement(lateral, yaw)
        assert meta["labels"] == list(item.labels)
    shapes = ["sphere_000", "cylinder_000", "box_000"]
    assert names == [(name, trial) for trial in range(2) for name in shapes]
    summary = json.loads((tmp_path / "simulation.json").read_text())
    assert summary["spread"] == asdict(wide)


@pytest.mark.full
def test_wide_trials_are_the_same_on_two_processes_and_after_a_stop(tmp_path, same_arrays):
    arguments = {"preset": "ci", "plan": GraspSpread.wide(), "seconds": 2.0, "num_objects": 2}
    for out, jobs in (("one", 1), ("two", 2)):
        list(simulate(tmp_path / out, "shapes", 1, jobs=jobs, max_attempts=20, **arguments))
    names = [path.name for path in sorted((tmp_path / "one").glob("*.h5"))]
    assert len(names) == 2
    assert all(same_arrays(tmp_path / "one" / name, tmp_path / "two" / name) for name in names)
    (tmp_path / "two" / names[0]).unlink()
    running = list(simulate(tmp_path / "two", "shapes", 1, max_attempts=20, **arguments))
    assert sorted(report.kept for report in running) == [False, True]
    assert all(same_arrays(tmp_path / "one" / name, tmp_path / "two" / name) for name in names)


def test_folder_of_before_spread_and_motion_had_names_is_kept(tmp_path, objects, hovering):
    name = objects("one", SPONGE)
    (report,) = simulate(tmp_path, name, trials=1, preset="ci")
    recording = read_recording(report.path)
    unnamed = ("spread", "motion")
    meta = {key: value for key, value in recording.meta.items() if key not in unnamed}
    write_recording(replace(recording, meta=meta), report.path)
    assert [r.kept for r in simulate(tmp_path, name, trials=1, preset="ci")] == [True]
    with pytest.raises(ValueError, match="was written with another 'spread'"):
        list(simulate(tmp_path, name, trials=1, preset="ci", plan=GraspSpread.wide()))
    with pytest.raises(
        ValueError, match=r"was written with another 'motion' \(lift, not squeeze\)"
    ):
        list(simulate(tmp_path, name, trials=1, preset="ci", motion="squeeze"))


def test_squeezed_trials_say_so_and_hold_no_lift(tmp_path, objects):
    tube = twenty()[17]
    given = {"preset": "ci", "motion": "squeeze", "hand": "allegro_uskin_240"}
    (report,) = simulate(tmp_path, objects("cartons", tube), 1, **given)
    recording = read_recording(report.path)
    assert recording.meta["motion"] == "squeeze"
    assert recording.meta["phase_names"] == ["hover", "reach", "close", "squeeze"]
    assert recording.num_frames == 250
    assert np.ptp(recording.privileged["object_pose"][:, 2]) < 0.03
    summary = json.loads((tmp_path / "simulation.json").read_text())
    assert summary["motion"] == "squeeze"
    (again,) = simulate(tmp_path, "cartons", 1, **given)
    assert again.kept


def test_object_that_slips_out_is_given_up(tmp_path, objects, caplog):
    ball = replace(twenty()[9], name="wet", friction=0.001)
    given = {"preset": "ci", "max_attempts": 1, "motion": "squeeze", "hand": "allegro_uskin_240"}
    (report,) = simulate(tmp_path, objects("balls", ball), 1, seed=1, **given)
    assert report == TrialReport("wet", 0, 1, None, kept=False)
    assert "wet, trial 0: not squeezed in 1 attempts" in caplog.text


def test_objects_of_ones_own(tmp_path, hovering):
    ball = GraspObject("ball", "sphere", (0.07, 0.07, 0.07), mass=0.1, friction=1.0, soft=False)
    (report,) = simulate(tmp_path, [ball], 1, preset="ci")
    meta = read_recording(report.path).meta
    assert (meta["object_set"], meta["object"], meta["shape"]) == ("own", "ball", "sphere")


def test_bad_arguments_are_named(tmp_path):
    for arguments, message in [
        ({"objects": "nine"}, r"'objects' must be one of \['paper8', .*\] \(got 'nine'\)"),
        ({"preset": "slow"}, r"'preset' must be one of \['full', 'ci'\] \(got 'slow'\)"),
        ({"trials": 0}, r"'trials' must be at least 1 \(got 0\)"),
        ({"jobs": 0}, r"'jobs' must be at least 1 \(got 0\)"),
        ({"max_attempts": 0}, r"'max_attempts' must be at least 1 \(got 0\)"),
        ({"motion": "drop"}, r"'motion' must be one of \['lift', 'squeeze'\] \(got 'drop'\)"),
        ({"hand": "glove"}, r"'hand' must be one of \['allegro_uskin', .*\] \(got 'glove'\)"),
        ({"seed": -1}, r"'seed' must not be negative \(got -1\)"),
        ({"seconds": 0.9}, r"'seconds' must be at least 1 \(got 0.9\)"),
        ({"seconds": float("inf")}, r"'seconds' must be at least 1 \(got inf\)"),
        ({"seconds": float("nan")}, r"'seconds' must be at least 1 \(got nan\)"),
        ({"objects": "shapes", "num_objects": 0}, r"'num_objects' must be at least 1 \(got 0\)"),
        ({"num_objects": 3}, r"'num_objects' must be left out for .* 'shapes' \(got 3\)"),
        ({"plan": "wide"}, r"'plan' must be a GraspSpread, such as .* \(got 'wide'\)"),
        ({"objects": ["sponge"]}, r"'objects' must be .* valid file names \(got 'sponge'\)"),
        ({"objects": [replace(SPONGE, name="a/b")]}, r"valid file names \(got .*name='a/b'"),
        ({"objects": []}, r"'objects' must be objects with different names \(got \[\]\)"),
        ({"objects": [SPONGE, SPONGE]}, r"different names \(got \['sponge', 'sponge'\]\)"),
    ]:
        with pytest.raises(ValueError, match=message):
            simulate(tmp_path, **arguments)


@pytest.mark.parametrize("package", ["mujoco", "h5py"])
def test_missing_package_names_the_extra(tmp_path, monkeypatch, package):
    find = trial_files.find_spec
    monkeypatch.setattr(
        trial_files, "find_spec", lambda name: None if name == package else find(name)
    )
    message = rf"needs {package}: pip install 'torch-geometric-tactile\[sim\]'"
    with pytest.raises(ImportError, match=message):
        simulate(tmp_path)
