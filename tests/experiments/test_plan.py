import json

import pytest

pytest.importorskip("lightning", reason="needs the extra 'train'")

from torch_geometric_tactile.experiments import plan as experiments
from torch_geometric_tactile.experiments.experiment import Experiment, run_experiment
from torch_geometric_tactile.experiments.plan import Settings, run_table
from torch_geometric_tactile.experiments.worker import close_process, run_in_process
from torch_geometric_tactile.training.config import expand_template

QUICK = Settings(seeds=1, epochs=1, stride=2, split_by=("trial",))
CONFIG = expand_template("p2_table2")["ii_tac"]


@pytest.fixture
def trained(monkeypatch):
    """Puts made-up results in the place of training; the names of what was trained."""
    names = []

    def run(experiment, parent=None):
        names.append(f"{experiment.name} {experiment.split_by} {experiment.seed}")
        if experiment.name == "x_pos":
            return {"error": "ValueError: it must not"}
        metrics = {"accuracy": 0.5, "f1": 0.5, "auroc": None}
        return {"metrics": metrics, "num_train": 1, "machine": "m"}

    monkeypatch.setattr(experiments, "run_in_process", run)
    return names


def files(out):
    return sorted(path.name for path in (out / "runs").iterdir())


def test_experiment_is_trained_and_tested(grasps):
    settings = {"root": str(grasps), "data": "f", "split_by": "trial"}
    experiment = Experiment("ii_tac", CONFIG, seed=0, epochs=20, **settings)
    result = run_experiment(experiment)
    # 3 objects with 4 trials of 8 frames, of which 1, 1 and 2 are to test, validate and train.
    assert (result["num_train"], result["num_test"]) == (48, 24)
    assert result["metrics"]["accuracy"] > 0.9  # chance is 0.33
    assert set(result["metrics"]) == {"accuracy", "f1", "auroc"}
    assert result["label_names"] is None
    assert result["num_parameters"] == 4_464_232
    assert 40 < result["peak_memory_mb"] < 400  # parameters, gradients and Adam's state are 72
    assert result["frames_per_second"] == pytest.approx(48 * 20 / result["train_seconds"])
    again = run_experiment(experiment)
    assert again["metrics"] == result["metrics"]


def test_properties_have_named_labels(grasps):
    config = expand_template("p1_table2")["cnn_a_joint"]
    result = run_experiment(
        Experiment("cnn", config, str(grasps), "f", 0, "frame", 1, 2, ("hold",))
    )
    assert result["label_names"] == ["light", "heavy", "hard", "soft", "non-slippery", "slippery"]
    assert "label_accuracy_5" in result["metrics"]
    assert result["num_train"] + result["num_test"] < 24


def test_process_measures_is_used_again_and_says_what_failed(grasps):
    experiment = Experiment("ii_tac", CONFIG, str(grasps), "f", 0, "trial", 1)
    first = run_in_process(experiment)
    assert first["num_test"] == 24
    assert run_in_process(experiment)["metrics"] == first["metrics"]
    wrong = Experiment("ii_tac", CONFIG, str(grasps), "f", 0, "trial", 1, phases=("fly",))
    error = run_in_process(wrong)["error"]
    assert "'phases' must be some of ['reach', 'hold']" in error
    assert run_in_process(experiment)["metrics"] == first["metrics"]
    close_process()
    close_process()


def test_killed_process_is_explained(grasps, monkeypatch):
    from torch_geometric_tactile.experiments import worker as experiment_process

    start = experiment_process._Process

    def killed(threads):
        process = start(threads)
        process._popen.kill()
        return process

    monkeypatch.setattr(experiment_process, "_Process", killed)
    experiment = Experiment("ii_tac", CONFIG, str(grasps), "f", 0, "trial", 1)
    assert run_in_process(experiment) == {
        "error": "its process was killed, for want of memory perhaps"
    }
    close_process()


def test_identity_is_all_that_the_result_follows_from():
    def experiment(**changes):
        arguments = {"name": "a", "config": {"x": 1}, "root": "r", "data": "d", "seed": 0}
        arguments |= {"split_by": "trial", "epochs": 2}
        return Experiment(**arguments | changes)

    same = [experiment(), experiment(name="b"), experiment(root="s"), experiment(threads=2)]
    assert len({e.code for e in same}) == 1
    others = [
        {"config": {"x": 2}},
        {"data": "e"},
        {"seed": 1},
        {"split_by": "frame"},
        {"epochs": 3},
    ]
    others += [{"stride": 2}, {"phases": ("hold",)}, {"accelerator": "gpu"}]
    assert len({experiment(**change).code for change in [{}, *others]}) == 1 + len(others)
    assert experiment().file_name == f"a_trial_seed0_{experiment().code}.json"


def test_settings_stand_above_the_configuration(grasps):
    experiment = Experiment("a", CONFIG, "r", "d", 3, "frame", 7, 5, ("hold",), "cpu")
    config = experiment.full_config()
    for key in ("dataset", "test_dataset"):
        arguments = config["data"][key]["init_args"]
        assert (arguments["root"], arguments["split_by"], arguments["split_seed"]) == (
            "r",
            "frame",
            3,
        )
        assert (arguments["stride"], arguments["phases"]) == (5, ["hold"])
        assert arguments["task"] == "object"
    assert config["data"]["val_dataset"] is None
    assert config["trainer"] == {"max_epochs": 7, "accelerator": "cpu"}
    assert "root" in CONFIG["data"]["dataset"]["init_args"]


def test_finished_runs_are_kept(grasps, tmp_path, trained):
    only = ["ii_tac", "ii_pos"]
    run = run_table("p2-table2", grasps, tmp_path, QUICK, only)
    assert trained == ["ii_tac trial 0", "ii_pos trial 0"]
    assert (len(run.results), run.kept, run.missing) == (2, 0, 16)
    kept = files(tmp_path)
    assert len(kept) == 2
    content = json.loads((tmp_path / "runs" / kept[1]).read_text())
    assert content["experiment"] == "ii_tac"
    assert content["identity"]["epochs"] == 1
    run = run_table("p2-table2", grasps, tmp_path, QUICK, ["ii_*"])
    assert trained[2:] == [
        f"ii_{name} trial 0" for name in ("tac_pos", "tac_joint", "pos_joint", "tac_pos_joint")
    ]
    assert (len(run.results), run.kept, run.missing) == (6, 2, 12)
    assert run.describe() == "p2-table2: 6 of 18 runs finished (2 kept from before), 12 missing"
    run_table("p2-table4", grasps, tmp_path, QUICK, ["ii_*"])  # the same experiments
    assert len(trained) == 6


def test_all_seeds_and_splits_are_run(grasps, tmp_path, trained):
    settings = Settings(seeds=2, epochs=1)
    run = run_table("p1-table3", grasps, tmp_path, settings, ["dense"])
    assert sorted(trained) == [f"dense {by} {seed}" for by in ("frame", "trial") for seed in (0, 1)]
    assert run.missing == 12
    run_table("p1-table3", grasps, tmp_path, Settings(seeds=2, epochs=2), ["dense"])
    assert len(trained) == 8  # other epochs are other runs
    assert len(files(tmp_path)) == 8
    again = run_table("p1-table3", grasps, tmp_path, settings, train=False)
    assert (len(trained), again.kept) == (8, 4)


def test_one_configuration_of_two_tables_is_trained_once(grasps, tmp_path, trained):
    run_table("p1-table2", grasps, tmp_path, QUICK, ["mt_gcn_te_joint"])
    run = run_table("p1-table3", grasps, tmp_path, QUICK, ["original"])
    assert trained == ["mt_gcn_te_joint trial 0"]
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
    assert not [name for name in files(tmp_path) if name.startswith("x_pos_trial")]
    run_table("p2-table2", grasps, tmp_path, QUICK, ["x_*"])
    assert trained[6:] == ["x_pos trial 0"]  # tried again


def test_ctrl_c_tells_what_is_kept(grasps, tmp_path, trained, monkeypatch):
    def stop(experiment, ended, count):
        if ended == 2:
            raise KeyboardInterrupt

    message = r"stopped; 2 of 18 runs are finished and kept: the same command goes on"
    with pytest.raises(KeyboardInterrupt, match=message):
        run_table("p2-table2", grasps, tmp_path, QUICK, ["ii_*"], on_progress=stop)
    assert len(files(tmp_path)) == 2


@pytest.mark.parametrize("content", ["", "{", "[]", '{"identity": 1}'])
def test_damaged_run_is_named(grasps, tmp_path, trained, content):
    run_table("p2-table2", grasps, tmp_path, QUICK, ["ii_tac"])
    (path,) = (tmp_path / "runs").iterdir()
    path.write_text(content)
    with pytest.raises(ValueError, match=rf"'{path}' is damaged: delete it to run it again"):
        run_table("p2-table2", grasps, tmp_path, QUICK, ["ii_tac"])


def test_renamed_run_is_not_taken_for_another(grasps, tmp_path, trained):
    run_table("p2-table2", grasps, tmp_path, QUICK, ["ii_tac"])
    (path,) = (tmp_path / "runs").iterdir()
    content = json.loads(path.read_text())
    content["identity"]["epochs"] = 2
    path.write_text(json.dumps(content))
    with pytest.raises(ValueError, match="is not what its name says"):
        run_table("p2-table2", grasps, tmp_path, QUICK, ["ii_tac"])


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"seeds": 0}, r"'seeds' must be at least 1 \(got 0\)"),
        ({"epochs": 0}, r"'epochs' must be at least 1 \(got 0\)"),
        ({"stride": -1}, r"'stride' must be at least 1 \(got -1\)"),
        ({"threads": 0}, r"'threads' must be at least 1 \(got 0\)"),
        ({"split_by": ()}, r"'split_by' must be some of \['trial', 'frame'\] \(got \[\]\)"),
        ({"split_by": ["object"]}, r"'split_by' must be some of .*got \['object'\]"),
        ({"accelerator": "tpu"}, r"'accelerator' must be one of \['cpu', 'gpu'\] \(got 'tpu'\)"),
    ],
)
def test_wrong_settings(settings, message):
    with pytest.raises(ValueError, match=message):
        Settings(**settings)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"name": "p1-table9"}, r"'name' must be one of .*got 'p1-table9'"),
        ({"only": ["gcn_t"]}, r"'only' must fit the name of an experiment of p2-table2: x_tac"),
        ({"jobs": 0}, r"'jobs' must be at least 1 \(got 0\)"),
        ({"backend": "mpi"}, r"'backend' must be one of \['loky', 'dask', 'ray'\] \(got 'mpi'\)"),
        ({"scheduler": "tcp://a"}, r"'scheduler' must come with the backend dask or ray"),
        ({"settings": Settings(phases=["fly"])}, r"'phases' must be some of \['reach', 'hold'\]"),
    ],
)
def test_wrong_arguments_are_found_before_training(grasps, tmp_path, trained, arguments, message):
    with pytest.raises(ValueError, match=message):
        run_table(**{"name": "p2-table2", "root": grasps, "out": tmp_path, **arguments})
    assert not trained


def test_missing_recordings_name_the_next_step(tmp_path):
    with pytest.raises(FileNotFoundError, match=rf"tactile simulate --out '{tmp_path}/none'"):
        run_table("p2-table2", tmp_path / "none", tmp_path)
