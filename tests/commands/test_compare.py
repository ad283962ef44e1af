"""The verb, on tiny files: whole runs, stops and kills, and what it says of bad input."""

# ruff: noqa: E402
import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

for extra in ("lightning", "sklearn", "matplotlib"):
    pytest.importorskip(extra, reason="needs the extras 'train' and 'viz'")

from compared import touches
from listed_outputs import check_listed
from moving import motions

from torch_geometric_tactile import Predictor
from torch_geometric_tactile.cli import build_parser, main
from torch_geometric_tactile.commands import compare
from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.experiments import _compared_models as compared_models
from torch_geometric_tactile.experiments import run_plan
from torch_geometric_tactile.io._recording_npz import write_npz

QUICK = ["--grid", "3x4", "--epochs", "2", "--folds", "3", "--members", "1"]
THREE = ["--models", "fnn,svm_linear,constant"]
OF_FRAMES = {"temporal", "grasp_gcn", "lstm", "temporal_cnn", "svm_signal", "minirocket"}
LONG = [*THREE, "--epochs", "100"]  # seconds from the first finished run to the last


def run(folder, *options):
    return main(["compare", str(folder / "a.npz"), *QUICK, "--out", str(folder / "out"), *options])


def results(folder):
    """What was found in each run, without the times that it took."""
    found = {}
    for path in sorted((folder / "out" / "runs").glob("*.json")):
        result = json.loads(path.read_text())["result"]
        found[path.name] = [result[key] for key in ("metrics", "chosen", "predictions")]
    return found


def test_names_are_those_of_the_models():
    assert list(compare.MODELS) == [model.name for model in compared_models.MODELS]


def test_table_ends_with_a_sentence(tmp_path, capsys):
    touches(tmp_path / "a.npz")
    assert run(tmp_path, *THREE) == 0
    out = capsys.readouterr().out.splitlines()
    assert out[0].startswith(
        "48 samples, 12 trials; 3 folds by trial, stratified by y; 3 models x "
    )
    assert "; about " in out[0]
    done = [line.split()[:2] for line in out[1:4]]  # as they finish
    assert sorted(done) == [
        ["constant", "accuracy"],
        ["fnn", "accuracy"],
        ["svm_linear", "accuracy"],
    ]
    assert out[4].split()[:2] == ["model", "kind"]
    assert "a: 9 of 9 runs finished" in out
    assert out[-1].startswith("Use ")
    for suffix in (".md", ".csv", ".json", "_predictions.csv", ".png"):
        assert (tmp_path / "out" / f"a{suffix}").stat().st_size > 100
        assert f"wrote {tmp_path / 'out' / f'a{suffix}'}" in out
    out = tmp_path / "out"
    check_listed(["compare", tmp_path / "a.npz", "--out", out], out)
    before = results(tmp_path)
    assert run(tmp_path, *THREE) == 0
    assert "all runs are finished" in capsys.readouterr().out
    assert results(tmp_path) == before


def test_quick_models_are_done_first(tmp_path, capsys, monkeypatch):
    touches(tmp_path / "a.npz")
    seconds = {"svm_rbf": 3.0, "constant": 9.0, "svm_linear": 1.0}
    monkeypatch.setattr(sys.modules[run_plan.__module__], "_estimate_seconds", lambda todo: seconds)
    assert run(tmp_path, "--models", "svm_linear,constant,svm_rbf", "--seeds", "2") == 0
    out = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in out[1:4]] == ["svm_linear", "svm_rbf", "constant"]


def test_every_other_sample_of_a_trial_of_a_file(tmp_path, capsys):
    touches(tmp_path / "a.npz", num_trials=12, frames=5)
    assert run(tmp_path, "--models", "constant", "--stride", "2", "--window", "3") == 0
    assert "12 samples of 3 frames, 12 trials" in capsys.readouterr().out


def test_groups_are_called_groups(tmp_path, capsys):
    touches(tmp_path / "a.npz", group=np.repeat(["ann", "bo", "cy", "di"], 12))
    assert run(tmp_path, "--models", "constant", "--by", "group") == 0
    out = capsys.readouterr().out
    assert "folds by group" in out
    assert "object" not in out
    page = (tmp_path / "out" / "a.md").read_text()
    assert "| group | test samples | constant |" in page
    assert "| ann | 12 | " in page


def test_several_test_sets_after_one_training(tmp_path, capsys):
    sets = np.repeat(["lab", "lab", "kitchen", "garden"], 12)
    touches(tmp_path / "a.npz", part=np.repeat([0, 0, 2, 2], 12), set=sets)
    assert run(tmp_path, *THREE, "--by", "given", "--seeds", "3") == 0
    page = (tmp_path / "out" / "a.md").read_text()
    assert "## Accuracy by set" in page
    assert "| garden | 12 |" in page  # with any number of seeds
    assert "the given parts, 1 split. Mean ± standard deviation over 3 training seeds" in page
    content = json.loads((tmp_path / "out" / "a.json").read_text())
    assert (content["num_splits"], content["num_seeds"], content["chosen_by"]) == (
        *(1, 3),
        "validation",
    )
    constant = next(m for m in content["models"] if m["name"] == "constant")
    assert constant["difference"]["num_splits"] == 1
    assert constant["scores"]["accuracy"]["sd"] == 0.0
    assert "| lab |" not in page
    rows = (tmp_path / "out" / "a_predictions.csv").read_text().splitlines()
    assert rows[0] == "model,seed,fold,index,set,trial,y,prediction"
    assert len(rows) == 1 + 3 * 3 * 24
    assert any(row.startswith("constant,2,0,24,kitchen,6,0,") for row in rows)


@pytest.mark.full
def test_windows_that_are_already_cut(tmp_path, capsys):
    x = np.random.default_rng(0).normal(size=(24, 10, 12, 2))
    touches(tmp_path / "a.npz", x=x, y=np.arange(24) % 2, trial=np.arange(24))
    options = [
        "--models",
        "lstm,temporal_cnn,svm_signal,constant",
        "--time-axis",
        "1",
        "--epochs",
        "1",
    ]
    assert run(tmp_path, *options) == 0
    assert "24 samples of 10 frames, 24 trials" in capsys.readouterr().out


def test_json_is_all_that_is_printed(tmp_path, capsys):
    touches(tmp_path / "a.npz")
    assert run(tmp_path, "--models", "svm_linear,constant", "--json") == 0
    said = capsys.readouterr()
    content = json.loads(said.out)
    assert content == json.loads((tmp_path / "out" / "a.json").read_text())
    assert (content["format"], content["version"]) == ("tactile comparison", 4)
    assert [model["name"] for model in content["models"]] == ["svm_linear", "constant"]
    assert content["num_splits"] == 3
    assert "48 samples" in said.err


def test_nothing_is_trained_if_not_wanted(tmp_path, capsys):
    touches(tmp_path / "a.npz")
    assert run(tmp_path, *THREE, "--no-train") == 0
    out = capsys.readouterr().out
    assert "0 of 9 runs finished, 9 missing" in out
    assert "No model has a result for every split yet" in out
    assert not (tmp_path / "out" / "a.png").exists()


def test_numbers_are_predicted(tmp_path, capsys):
    x = np.random.default_rng(0).normal(size=(48, 3, 4))
    touches(tmp_path / "a.npz", x=x, y=0.01 * x[:, 0, 0])
    assert run(tmp_path, "--models", "svm_linear,constant") == 0
    out = capsys.readouterr().out
    assert "MAE" in out
    assert "Use svm_linear (MAE " in out


@pytest.mark.full
def test_all_models_run_on_missing_readings_and_names(tmp_path, capsys):
    content = touches(tmp_path / "a.npz")
    x = content["x"].copy()
    x[::5, 1, 1] = np.nan
    names = np.array(["mug", "ball", "box"])[content["y"]]
    touches(tmp_path / "a.npz", x=x, y=names)
    options = ["--folds", "2", "--epochs", "1", "--rest", "1", "--members", "1"]
    assert run(tmp_path, *options) == 0
    found = json.loads((tmp_path / "out" / "a.json").read_text())
    assert found["data"]["class_names"] == ["ball", "box", "mug"]
    without = {"posed_taxel_net", "bmf_cnn", *OF_FRAMES}
    expected = [name for name in compare.MODELS if name not in without]
    assert [model["name"] for model in found["models"]] == expected


@pytest.mark.full
def test_hand_is_posed_by_its_joints(grasps, tmp_path, capsys):
    options = ["--init", f"root={grasps}", "split=null", "--init", "task=object", "--stride", "20"]
    options += ["--models", "posed_taxel_net,posed_forest,posed_ridge", "--by", "frame"]
    options += ["--folds", "2", "--epochs", "1", "--members", "1", "--out", str(tmp_path)]
    assert main(["compare", "AllegroUSkin", *options]) == 0
    found = json.loads((tmp_path / "AllegroUSkin.json").read_text())
    models = [model["name"] for model in found["models"]]
    assert models == ["posed_taxel_net", "posed_forest", "posed_ridge"]
    assert found["data"]["num_trials"] > 1


@pytest.mark.full
def test_all_models_run_on_windows(tmp_path, capsys):
    content = motions(tmp_path / "a.npz", num_trials=18)
    x = content["x"].copy()
    x[::7, 1, 1] = np.nan
    motions(tmp_path / "a.npz", num_trials=18, x=x)
    cut = ["--window", "10", "--hop", "5", "--rest", "3", "--folds", "2"]
    assert run(tmp_path, *cut, "--epochs", "9") == 0
    said = capsys.readouterr()
    assert said.out.startswith("126 samples of 10 frames, 18 trials; 2 folds by trial")
    assert not said.err
    found = json.loads((tmp_path / "out" / "a.json").read_text())
    scores = {model["name"]: model["scores"]["accuracy"]["mean"] for model in found["models"]}
    without = {"posed_taxel_net", "posed_forest", "posed_ridge", "bmf_cnn"}
    assert list(scores) == [name for name in compare.MODELS if name not in without]
    assert scores["temporal"] > scores["constant"] + 0.2
    assert scores["temporal_cnn"] > scores["constant"] + 0.2
    assert found["data"]["num_frames"] == 10
    page = (tmp_path / "out" / "a.md").read_text()
    assert "A sample is a window of 10 frames, one every 5 frames, with the label" in page
    assert run(tmp_path, *cut, "--epochs", "9") == 0
    assert "all runs are finished" in capsys.readouterr().out


@pytest.mark.full
def test_windows_of_a_hand_are_strided_before_they_are_cut(grasps, tmp_path, capsys):
    options = ["--init", f"root={grasps}", "split=null", "task=object", "--stride", "5"]
    options += ["--window", "2", "--models", "temporal,svm_signal,constant", "--by", "trial"]
    options += ["--folds", "2", "--epochs", "1", "--members", "1", "--out", str(tmp_path)]
    assert main(["compare", "AllegroUSkin", *options]) == 0
    found = json.loads((tmp_path / "AllegroUSkin.json").read_text())
    assert [model["name"] for model in found["models"]] == ["temporal", "svm_signal", "constant"]
    assert found["data"]["num_frames"] == 2
    assert found["data"]["class_names"]


@pytest.mark.full
def test_numbers_are_predicted_from_whole_trials(tmp_path, capsys):
    y = np.linspace(0.1, 1.0, 12).repeat(40)
    motions(tmp_path / "a.npz", y=y)
    names = "temporal,grasp_gcn,lstm,temporal_cnn,svm_signal,constant"
    assert run(tmp_path, "--trials", "8", "--models", names) == 0
    found = json.loads((tmp_path / "out" / "a.json").read_text())
    assert found["metric"] == "mae"
    assert [model["name"] for model in found["models"]] == names.split(",")
    assert "12 samples of 8 frames, 12 trials" in capsys.readouterr().out


def command(folder):
    options = [*QUICK, *LONG, "--out", str(folder / "out")]
    # What a shell runs in the background ignores Ctrl-C, and what that starts does as well.
    code = (
        "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); "
        "from torch_geometric_tactile.cli import main; raise SystemExit(main())"
    )
    return [sys.executable, "-c", code, "compare", str(folder / "a.npz"), *options]


@pytest.mark.full
@pytest.mark.parametrize("stop", [signal.SIGINT, signal.SIGKILL])
def test_stopped_run_goes_on_to_the_same_numbers(tmp_path, stop):
    whole, halved = tmp_path / "whole", tmp_path / "halved"
    for folder in (whole, halved):
        folder.mkdir()
        touches(folder / "a.npz")
    assert run(whole, *LONG) == 0
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    process = subprocess.Popen(
        command(halved), stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, env=environment
    )
    runs = halved / "out" / "runs"
    deadline = time.monotonic() + 120
    while not list(runs.glob("*.json")) and time.monotonic() < deadline:
        assert process.poll() is None
        time.sleep(0.02)
    process.send_signal(stop)
    said = process.communicate(timeout=60)[1].decode()
    if stop == signal.SIGINT:
        assert process.returncode == 130, said
        assert "of 9 runs are finished and kept" in said
    kept = {path: path.stat().st_mtime_ns for path in runs.glob("*.json")}
    assert 1 <= len(kept) < 9
    assert run(halved, *LONG) == 0
    assert results(halved) == results(whole)
    assert all(path.stat().st_mtime_ns == written for path, written in kept.items())
    assert not list(runs.glob(".*"))


@pytest.mark.parametrize(
    ("options", "match"),
    [
        (
            ["--models", "svm"],
            "'--models' must be some of taxel_net, posed_taxel_net, temporal, gcn",
        ),
        (["--models", ","], "'--models' must be some of"),
        (
            ["--by", "person"],
            "'--by' must be a unit that all samples have: 'trial' (got 'person'): add an array or "
            "attribute 'person'",
        ),
        (
            ["--pattern", "{person}_{trial}"],
            "'--pattern' must be left out unless DATA is a folder of recordings (got '",
        ),
        (["--metric", "mae"], "'--metric' must be 'accuracy' or 'balanced_accuracy' for classes"),
        (["--init", "stride"], "'--init' must be KEY=VALUE, such as root=DIR (got 'stride')"),
        (["--init", "stride=[1"], "'--init stride' must be a plain value"),
        (["--init", "no=1"], "'no' must be an argument of SamplesFile"),
        (["--init", "models=1"], "'models' must be an argument of SamplesFile"),  # no '--models'
        (["--layout", "biotac"], "only one of '--layout' and '--grid'"),
        (["--grid", "8x8"], "'x' must have shape (num_samples, 64, ...)"),
        (["--time-axis", "9"], "'--time-axis' must be a dimension of 'x' of at least 2 frames"),
        (["--time-axis", "1", "--window", "2"], "'--time-axis' must be left out if windows"),
        (["--time-axis", "2", "--rest", "1"], "'--rest' must be left out for samples of several"),
        (
            ["--window", "5"],
            "'--window' must be at most 4 frames, the length of the longest trial",
        ),
        (
            ["--window", "3", "--horizon", "2"],
            "'--horizon' must be within the trial of at least one window",
        ),
        (["--window", "3", "--trials", "9"], "only one of '--window' and '--trials' may be given"),
        (["--hop", "3"], "'--hop' must come with '--window'"),
        (["--window", "2", "--hop", "1", "--by", "frame"], "'--by' must be 'trial' or 'group'"),
        (["--window", "2", "--init", "no=1"], "'no' must be an argument of SamplesFile"),
        (["--models", "lstm"], "got 'lstm', but the samples are single frames: cut windows"),
        (["--window", "2", "--models", "posed_ridge"], "got 'posed_ridge', but it is for single"),
        (["--task", "regression", "--metric", "accuracy"], "'--metric' must be 'mae' for numbers"),
    ],
)
def test_bad_options_are_one_line(tmp_path, capsys, options, match):
    touches(tmp_path / "a.npz")
    assert run(tmp_path, *options) == 1
    said = capsys.readouterr().err
    assert match in said
    assert len([line for line in said.splitlines() if line.startswith("tactile: error:")]) == 1
    assert not (tmp_path / "out").exists()


def test_help_has_examples(capsys):
    with pytest.raises(SystemExit) as end:
        main(["compare", "--help"])
    assert end.value.code == 0
    out = capsys.readouterr().out
    assert "tactile compare touches.npz --grid 28x50" in out
    assert "tactile compare BiGS --init root=DIR --trials 60" in out
    assert all(name in out for name in compare.MODELS)


def test_the_recommended_model_is_saved_and_predicts(tmp_path, capsys):
    touches(tmp_path / "a.npz")
    save = ["--save", str(tmp_path / "best.predictor")]
    assert run(tmp_path, "--models", "svm_linear,constant", *save) == 0
    out = capsys.readouterr().out.splitlines()
    assert out[-3].startswith("Use svm_linear")
    told = "Predictor(EstimatorModel, 'grid_3x4', classes=['0', '1', '2'], task='multiclass')"
    assert out[-2] == f"wrote {tmp_path / 'best.predictor'}: {told}"
    assert out[-1].startswith("  svm_linear: accuracy ")
    assert out[-1].endswith("(3 folds by trial, stratified by y); trained on all 48 samples")
    before = results(tmp_path)
    other = ["--no-train", "--model", "constant", "--save", str(tmp_path / "constant.predictor")]
    assert run(tmp_path, "--models", "svm_linear,constant", *other) == 0
    assert "  constant: accuracy" in capsys.readouterr().out
    assert results(tmp_path) == before
    tactile = np.load(tmp_path / "a.npz")["x"].reshape(48, 12, 1)
    write_npz(Recording(time=np.arange(48) / 100, tactile=tactile), tmp_path / "recording.npz")
    csv = str(tmp_path / "a.csv")
    predict = ["predict", save[1], str(tmp_path / "recording.npz"), "--out", csv]
    assert main(predict) == 0
    assert "was selected for svm_linear: accuracy" in capsys.readouterr().out
    rows = (tmp_path / "a.csv").read_text().splitlines()
    found = [int(row.split(",")[3]) for row in rows[1:]]
    assert np.mean(found == np.load(tmp_path / "a.npz")["y"]) > 0.9


@pytest.mark.full
def test_a_network_over_time_is_chosen_and_predicts_windows_of_recordings(tmp_path, capsys):
    content = motions(tmp_path / "a.npz", num_trials=18)
    path, cut = tmp_path / "best.predictor", ["--window", "10", "--hop", "5"]
    options = ["--models", "temporal_cnn,constant", "--epochs", "12", "--save", str(path)]
    assert run(tmp_path, *cut, *options) == 0
    said = capsys.readouterr().out
    assert "Use temporal_cnn" in said
    assert f"wrote {path}: Predictor(TemporalCNN, 'grid_3x4', classes=['0', '1']" in said
    predictor = Predictor.load(path)
    assert (predictor.window.length, predictor.window.hop) == (10, 5)
    assert predictor.info.rate == pytest.approx(100)
    assert predictor.score.model == "temporal_cnn"
    names = []
    for i in range(2):
        frames = content["trial"] == i
        tactile = content["x"][frames].reshape(40, 12, 2)
        names.append(str(tmp_path / f"trial_{i}.npz"))
        write_npz(Recording(time=content["time"][frames], tactile=tactile), names[i])
    assert main(["predict", str(path), *names, "--out", str(tmp_path / "a.csv")]) == 0
    rows = [row.split(",") for row in (tmp_path / "a.csv").read_text().splitlines()[1:]]
    assert [int(row[1]) for row in rows] == 2 * [9, 14, 19, 24, 29, 34, 39]
    assert np.mean([row[3] for row in rows] == np.repeat(["0", "1"], 7)) > 0.8


@pytest.mark.full
@pytest.mark.slow
def test_a_network_over_time_is_exported_as_it_is_saved(tmp_path, capsys):
    for extra in ("onnx", "onnxscript", "onnxruntime"):
        pytest.importorskip(extra, reason="needs the extra 'export'")
    motions(tmp_path / "a.npz")
    path, graph = tmp_path / "best.predictor", tmp_path / "a.onnx"
    options = ["--models", "temporal_cnn,constant", "--members", "2"]
    save = ["--model", "temporal_cnn", "--save", str(path)]
    assert run(tmp_path, "--window", "10", *options, *save) == 0
    assert main(["export", str(path), str(graph)]) == 0
    assert "largest difference from PyTorch: " in capsys.readouterr().out
    assert graph.stat().st_size > 10_000


def test_json_is_all_that_is_printed_where_a_model_is_saved(tmp_path, capsys):
    touches(tmp_path / "a.npz")
    save = ["--save", str(tmp_path / "best.predictor"), "--json"]
    assert run(tmp_path, "--models", "svm_linear", *save) == 0
    said = capsys.readouterr()
    assert json.loads(said.out)["advice"].startswith("Use svm_linear")
    assert "best.predictor: Predictor(EstimatorModel" in said.err


def test_what_cannot_be_saved_is_told_before_the_runs(tmp_path, capsys):
    touches(tmp_path / "a.npz")
    for options, text in (
        (["--model", "forest"], "'--model' must come with '--save' (got 'forest' alone)"),
        (
            ["--model", "forest", "--save", str(tmp_path / "a")],
            "'--model' must be a compared model: svm_linear, constant (got 'forest')",
        ),
        (["--save", str(tmp_path / "none" / "a")], "does not exist: create it"),
    ):
        assert run(tmp_path, "--models", "svm_linear,constant", *options) == 1
        assert text in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_score_for_a_new_person(tmp_path, capsys):
    draw = np.random.default_rng(0)
    folder = tmp_path / "glove"
    folder.mkdir()
    for person in ("p1", "p2", "p3"):
        for i, thing in enumerate(("cup", "pen", "cup", "pen")):
            rows = draw.normal(size=(4, 2)) + 9 * (thing == "cup")
            lines = ["time,s0,s1", *(f"{t / 10},{a},{b}" for t, (a, b) in enumerate(rows))]
            (folder / f"{person}_{thing}_{i:03d}.csv").write_text("\n".join(lines) + "\n")
    command = ["compare", str(folder), "--grid", "1x2", "--models", "svm_linear,constant"]
    command += ["--folds", "3", "--out", str(tmp_path / "out"), "--pattern"]
    assert main([*command, "{person}_{object}_{trial}", "--by", "person"]) == 0
    out = capsys.readouterr().out
    assert "48 samples, 12 trials; 3 folds by person" in out
    assert (
        "On persons that the model has never seen, svm_linear has an accuracy of 100.0 % (3 persons"
        in out
    )
    assert main([*command, "{object}_{trial}", "--by", "person"]) == 1
    assert (
        "'--by' must be a unit that all samples have: 'trial', 'group', 'object' (got 'person'): "
        "name it in the '--pattern' of the file names, such as '{person}_{object}_{trial}', or add "
        "a column 'person' to labels.csv"
    ) in capsys.readouterr().err
    assert main([*command, "{person", "--init", "pattern=x"]) == 1
    assert "'--pattern' and '--init pattern=' must not both" in capsys.readouterr().err


def test_options_of_csv_files_become_arguments_of_the_data_set(tmp_path, capsys):
    options = ["--label", "grip", "--unit", "count", "--joint", "bend.*", "--missing", "NA"]
    arguments = build_parser().parse_args(["compare", str(tmp_path), *options, "--missing", "-1"])
    assert compare._dataset_arguments(arguments) == {
        "target": "grip",
        "unit": "count",
        "read_options": {"joint": "bend.*", "label": "grip", "missing": ["NA", "-1"]},
    }
    arguments.init = ["target=object"]
    assert compare._dataset_arguments(arguments)["target"] == "object"
    arguments.init = ["read_options={joint: a}"]
    with pytest.raises(ValueError, match="'--joint' and '--init read_options=' must not both"):
        compare._dataset_arguments(arguments)
