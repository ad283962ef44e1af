import json
import signal
import sys
from contextlib import suppress

import pytest

pytest.importorskip("lightning", reason="needs the extra 'train'")

from torch_geometric_tactile.experiments.plan import Settings, make_plan
from torch_geometric_tactile.experiments.run_plan import run_plan
from torch_geometric_tactile.papers import load_table

QUICK = Settings(seeds=1, epochs=1, protocols=("trial",))


def run_table(name, root, out, settings=QUICK, only=None, **arguments):
    plan = make_plan(load_table(name), settings, data={"root": str(root)}, selection={"stride": 2})
    return run_plan(plan, out, only=only, **arguments)


def files(out):
    return sorted(path.name for path in (out / "runs").iterdir())


def test_finished_runs_are_kept(grasps, tmp_path, trained):
    only = ["ii_tac", "ii_pos"]
    run = run_table("p2-table2", grasps, tmp_path, QUICK, only)
    assert trained == ["ii_tac by trial 0", "ii_pos by trial 0"]
    assert (len(run.results), run.kept, run.missing) == (2, 0, 16)
    kept = files(tmp_path)
    assert len(kept) == 2
    content = json.loads((tmp_path / "runs" / kept[1]).read_text())
    assert content["experiment"] == "ii_tac"
    assert content["identity"]["epochs"] == 1
    run = run_table("p2-table2", grasps, tmp_path, QUICK, ["ii_*"])
    assert trained[2:] == [
        f"ii_{name} by trial 0" for name in ("tac_pos", "tac_joint", "pos_joint", "tac_pos_joint")
    ]
    assert (len(run.results), run.kept, run.missing) == (6, 2, 12)
    assert run.describe() == "p2-table2: 6 of 18 runs finished (2 kept from before), 12 missing"
    run_table("p2-table4", grasps, tmp_path, QUICK, ["ii_*"])  # the same experiments
    assert len(trained) == 6


def test_only_runs_with_a_choice_are_estimated(grasps, tmp_path, trained):
    told = []
    run_table("p2-table2", grasps, tmp_path, QUICK, ["ii_tac"], on_estimate=told.append)
    assert (told, trained) == ([{}], ["ii_tac by trial 0"])


def test_all_seeds_and_splits_are_run(grasps, tmp_path, trained):
    settings = Settings(seeds=2, epochs=1)
    run = run_table("p1-table3", grasps, tmp_path, settings, ["dense"])
    assert sorted(trained) == [
        f"dense by {by} {seed}" for by in ("frame", "trial") for seed in (0, 1)
    ]
    assert run.missing == 12
    run_table("p1-table3", grasps, tmp_path, Settings(seeds=2, epochs=2), ["dense"])
    assert len(trained) == 8  # other epochs are other runs
    assert len(files(tmp_path)) == 8
    again = run_table("p1-table3", grasps, tmp_path, settings, train=False)
    assert (len(trained), again.kept) == (8, 4)


def test_one_configuration_of_two_tables_is_trained_once(grasps, tmp_path, trained):
    run_table("p1-table2", grasps, tmp_path, QUICK, ["mt_gcn_te_joint"])
    run = run_table("p1-table3", grasps, tmp_path, QUICK, ["original"])
    assert trained == ["mt_gcn_te_joint by trial 0"]
    assert [experiment.name for experiment, _ in run.results] == ["original"]


def test_other_recordings_are_other_runs(grasps, tmp_path, trained):
    run_table("p2-table2", grasps, tmp_path, QUICK, ["ii_tac"])
    other = tmp_path / "other" / "raw"
    other.mkdir(parents=True)
    for path in sorted((grasps / "raw").iterdir())[:8]:
        (other / path.name).symlink_to(path)
    assert run_table("p2-table2", other.parent, tmp_path, QUICK, ["ii_tac"]).kept == 0
    copied = tmp_path / "copy" / "raw"
    copied.mkdir(parents=True)
    for path in (grasps / "raw").iterdir():
        (copied / path.name).symlink_to(path)
    assert run_table("p2-table2", copied.parent, tmp_path, QUICK, ["ii_tac"]).kept == 1


def test_failed_run_is_no_result(grasps, tmp_path, trained):
    run = run_table("p2-table2", grasps, tmp_path, QUICK, ["x_*"])
    assert run.failed == {"x_pos, by trial, seed 0": "ValueError: it must not"}
    assert (len(run.results), run.missing) == (5, 13)
    assert not [name for name in files(tmp_path) if name.startswith("x_pos_by-trial")]
    run_table("p2-table2", grasps, tmp_path, QUICK, ["x_*"])
    assert trained[6:] == ["x_pos by trial 0"]  # tried again


def test_ctrl_c_tells_what_is_kept(grasps, tmp_path, trained, monkeypatch):
    def stop(experiment, ended, count):
        if ended == 2:
            raise KeyboardInterrupt

    message = "stopped; 2 of 18 runs are finished and kept: run the same command again to continue"
    with pytest.raises(KeyboardInterrupt, match=message):
        run_table("p2-table2", grasps, tmp_path, QUICK, ["ii_*"], on_progress=stop)
    assert len(files(tmp_path)) == 2


def test_ctrl_c_that_a_library_answers_with_an_error_stops(grasps, tmp_path, monkeypatch):
    module = sys.modules[run_plan.__module__]

    def compare(experiment):  # as NumPy does when it compares structured arrays
        with suppress(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        return {"error": "TypeError: Cannot compare structured arrays"}

    monkeypatch.setattr(module, "run_safely", compare)
    # A job that a shell put into the background ignores Ctrl-C.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt, match="0 of 18 runs are finished and kept"):
            run_table("p2-table2", grasps, tmp_path, QUICK, ["ii_*"])
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, before)


@pytest.fixture
def changed_run(grasps, tmp_path, trained):
    """Runs a table again, the file of whose only run has another text; how many runs were kept."""
    run_table("p2-table2", grasps, tmp_path, QUICK, ["ii_tac"])
    (path,) = (tmp_path / "runs").iterdir()
    before = path.read_text()

    def run_again(change):
        path.write_text(change(before))
        return run_table("p2-table2", grasps, tmp_path, QUICK, ["ii_tac"]).kept

    return run_again


def edited(text, place, change):
    content = json.loads(text)
    change(content[place] if place else content)
    return json.dumps(content)


def test_run_with_other_spaces_or_of_an_earlier_version_is_kept(changed_run):
    assert changed_run(lambda text: json.dumps(json.loads(text))) == 1
    assert changed_run(lambda text: edited(text, "", lambda run: run.pop("sha256"))) == 1


@pytest.mark.parametrize("content", ["", "{", "[]", '{"identity": 1}', "[" * 100_000])
def test_damaged_run_is_named(changed_run, content):
    with pytest.raises(ValueError, match=r"/runs/ii_.*' is damaged: delete it to run it again"):
        changed_run(lambda text: content)


@pytest.mark.parametrize(
    ("place", "change", "message"),
    [
        ("result", lambda result: result.update(num_train=2), "its result differs from its check"),
        ("result", lambda result: result.pop("machine"), "its result differs from its checksum"),
        ("result", lambda result: result.clear(), "its result differs from its checksum"),
        ("", lambda run: run.update(sha255=run.pop("sha256")), "is damaged"),
        (
            "identity",
            lambda identity: identity.update(epochs=2),
            "belongs to another",
        ),
    ],
)
def test_run_with_another_content_is_named(changed_run, place, change, message):
    with pytest.raises(ValueError, match=message):
        changed_run(lambda text: edited(text, place, change))


def test_killed_worker_is_an_error_that_says_what_to_do(grasps, tmp_path, trained, monkeypatch):
    from concurrent.futures.process import BrokenProcessPool

    module = sys.modules[run_plan.__module__]

    def broken(*args):
        raise BrokenProcessPool
        yield

    monkeypatch.setattr(module, "run_parallel", broken)
    with pytest.raises(OSError, match=r"killed.*fewer jobs \(finished runs are kept\)"):
        run_table("p2-table2", grasps, tmp_path, only=["ii_tac"])


def test_fewer_jobs_than_one(grasps, tmp_path):
    with pytest.raises(ValueError, match=r"'jobs' must be at least 1 \(got 0\)"):
        run_table("p2-table2", grasps, tmp_path, only=["ii_tac"], jobs=0)


def test_pattern_that_fits_nothing_is_found_before_training(grasps, tmp_path, trained):
    with pytest.raises(
        ValueError, match="'only' must match the name of an experiment of p2-table2"
    ):
        run_table("p2-table2", grasps, tmp_path, only=["gcn_t"])
    assert not trained
