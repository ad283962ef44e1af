import pytest

pytest.importorskip("lightning", reason="needs the extra 'train'")
pytest.importorskip("h5py", reason="needs the extra 'io'")

import csv
import json
import math
import statistics
import sys
from pathlib import Path

import torch
import yaml

from torch_geometric_tactile.cli import main
from torch_geometric_tactile.data import Trials
from torch_geometric_tactile.experiments._run_experiment import run_experiment
from torch_geometric_tactile.experiments.plan import Settings, make_plan
from torch_geometric_tactile.experiments.predictions import Predictions
from torch_geometric_tactile.experiments.run_plan import run_plan
from torch_geometric_tactile.experiments.tables import Ordering
from torch_geometric_tactile.papers import load_table
from torch_geometric_tactile.papers._table_notes import compare_orderings
from torch_geometric_tactile.papers._table_numbers import run_rows, table_numbers
from torch_geometric_tactile.papers.write_table import markdown, write_table
from torch_geometric_tactile.predictor import Predictor

sys.path.insert(0, str(Path(__file__).parent))
from grasp_files import write_grasps

DATA = load_table("p3").data
ROOT = "--data.dataset.init_args.dataset.init_args.root"


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    return write_grasps(tmp_path_factory.mktemp("grasps") / "one")


def test_root_reaches_the_data_set_that_a_view_shows(root, tmp_path):
    source = DATA.with_arguments({"root": str(root), "ragged": "pad"})
    assert source.frames.arguments == {"root": str(root)}
    assert DATA.frames.arguments == {}  # as it was
    resolved, facts = source.resolve()
    assert (facts.num_samples, facts.num_trials, facts.num_groups) == (24, 24, 3)
    assert (resolved.kind, facts.class_names) == ("simulated", ("failure", "success"))
    assert resolved.caption.startswith("**Simulated**, not a result of a real sensor: 24 trials")
    dataset = resolved.load()
    assert isinstance(dataset, Trials)
    assert (dataset.column("num_frames"), dataset.column("x").shape) == (60, (24, 19, 180))

    elsewhere, _ = DATA.with_arguments({"root": str(write_grasps(tmp_path / "two"))}).resolve()
    assert elsewhere.identity() == resolved.identity()  # wherever the files lie
    (tmp_path / "two" / "raw" / "ball_0002.h5").unlink()
    fewer, _ = DATA.with_arguments({"root": str(tmp_path / "two")}).resolve()
    assert fewer.fingerprint != resolved.fingerprint


def test_caption_tells_the_success_rates_of_a_simulation(tmp_path):
    root = write_grasps(tmp_path / "one", 6)
    summary = {"seed": 3, "mujoco": "3.3.0", "objects": {"box": {"grasps": 8, "successes": 2}}}
    (root / "raw" / "simulation.json").write_text(json.dumps(summary))
    source, _ = DATA.with_arguments({"root": str(root)}).resolve()
    assert "(box 8, of which 25.0 % are successful; seed 3, MuJoCo 3.3.0)" in source.caption
    summary["objects"]["box"]["grasps"] = 0
    (root / "raw" / "simulation.json").write_text(json.dumps(summary))
    with pytest.raises(ValueError, match="must be a summary of 'tactile simulate'"):
        DATA.with_arguments({"root": str(root)}).resolve()


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ({"colour": 3}, "'colour' must be an argument of BiGS: root, fields"),
        ({"dataset": {"class_path": "nowhere.BiGS"}}, "'class_path' must be the import path"),
    ],
)
def test_arguments_of_the_inner_data_set_are_checked(arguments, match):
    with pytest.raises(ValueError, match=match):
        DATA.with_arguments(arguments).resolve()


def planned(root, only, protocols=("random",), seeds=1):
    settings = Settings(seeds=seeds, epochs=1, protocols=protocols, folds=2)
    table = load_table("p3")
    cells = tuple(cell for cell in table.cells if cell.experiment in only)
    has_both = {"svm_f", "majority"} <= only
    orderings = (Ordering("SVM above the majority", (("svm_f", "majority"),)),) if has_both else ()
    table = type(table)(**{**vars(table), "cells": cells, "orderings": orderings})
    return make_plan(table, settings, data={"root": str(root)})


def test_threshold_is_chosen_on_a_part_of_the_training(root):
    plan = planned(root, {"svm_f", "svm_f_threshold", "gcn_df_threshold"})
    results = {e.name: (e, run_experiment(e)) for e in plan.experiments}
    experiment, result = results["gcn_df_threshold"]
    assert experiment.threshold == "balanced_accuracy"
    assert "threshold" not in experiment.model
    assert 0 <= result["threshold"] <= 1
    predicted = Predictions.from_dict(result["predictions"])
    assert ((predicted.score[:, 1] > result["threshold"]) == predicted.prediction).all()
    assert set(predicted.trial) <= set(range(24))
    plain = results["svm_f"][1]
    chosen = results["svm_f_threshold"][1]
    assert "threshold" not in plain
    assert chosen["num_train"] < plain["num_train"]
    predicted = Predictions.from_dict(chosen["predictions"])
    assert ((predicted.score > chosen["threshold"]) == predicted.prediction).all()
    assert results["svm_f"][0].code != results["svm_f_threshold"][0].code
    assert "threshold" not in results["svm_f"][0].identity()


def test_page_of_the_table(root, tmp_path):
    plan = planned(root, {"svm_f", "majority", "gcn_df"}, ("random", "by object"), seeds=2)
    run = run_plan(plan, tmp_path)
    assert not run.failed
    page = markdown(run)
    assert "positive class, *success* (class 1). Its share of the test samples: " in page
    for heading in ("Precision of success in %", "Recall of success in %", "F1 score of success"):
        assert f"## {heading}" in page
    assert "90.08" in page.partition("## F1 score of success")[2].partition("## Area")[0]
    assert "## Which orderings hold" in page
    compared = compare_orderings(run)
    assert [(c.protocol, c.difference.num_splits) for c in compared] == [
        ("random", 2),
        ("by object", 3),  # objects, whatever the seeds
    ]
    for path in write_table(run, tmp_path):
        assert path.is_file()
    pairs = list(csv.DictReader((tmp_path / "p3-orderings.csv").read_text().splitlines()))
    assert len(pairs) == len(compared)
    assert [pairs[1][name] for name in ("protocol", "first", "second", "splits", "holds")] == [
        "by object",
        *compared[1].pair,
        "3",
        compared[1].verdict,
    ]
    assert pairs[1]["difference"] == f"{100 * compared[1].difference.mean:.6g}"
    assert pairs[1]["error"] == f"{100 * compared[1].difference.error:.6g}"


def test_spread_of_one_seed_is_over_its_folds(root, tmp_path):
    run = run_plan(planned(root, {"svm_f", "majority"}, ("random", "by object")), tmp_path)
    number = {(n.experiment, n.source): n for n in table_numbers(run) if n.metric == "accuracy"}
    of_runs = [
        row["accuracy"]
        for row in run_rows(run)
        if (row["experiment"], row["protocol"]) == ("svm_f", "by object")
    ]
    assert len(of_runs) == 3
    assert number["svm_f", "by object"].spread == pytest.approx(statistics.stdev(of_runs))
    assert math.isnan(number["svm_f", "random"].spread)
    assert "standard deviation over the folds." in markdown(run)


def test_picture_along_an_axis(root, tmp_path):
    settings = Settings(seeds=1, epochs=1)
    table = load_table("p3-k")
    cells = tuple(cell for cell in table.cells if cell.experiment in ("df_k1", "df_k18", "ff_k2"))
    table = type(table)(**{**vars(table), "cells": cells, "orderings": ()})
    run = run_plan(make_plan(table, settings, data={"root": str(root)}), tmp_path)
    assert not run.failed
    assert len(run.results) == 3
    paths = write_table(run, tmp_path)
    assert paths[2].read_bytes().startswith(b"\x89PNG")
    accuracies = paths[0].read_text().partition("## Accuracy in %\n\n")[2].splitlines()
    header, _, *rows = [line.split(" | ") for line in accuracies[:5]]
    assert header == [
        "| nearest neighbours k of each electrode",
        "GCN-DF, simulated, random",
        "GCN-FF, published, real hand, unavailable data",
        "GCN-FF, simulated, random |",
    ]
    assert [row[0] for row in rows] == ["| 1", "| 18", "| 2"]
    assert [bool(row[1]) for row in rows] == [True, True, False]  # GCN-DF has k = 1 and 18
    assert rows[2][2] == "89.13"


@pytest.mark.full
@pytest.mark.parametrize(
    "name", ["grasp_time_gcn_df", "grasp_time_lstm", "grasp_time_temporal", "p3_k/ff_k3"]
)
def test_configuration_trains_and_predicts(name, root, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    short = ["--trainer.max_epochs=1", "--trainer.accelerator=cpu"]
    short += ["--trainer.enable_progress_bar=false", "--trainer.enable_model_summary=false"]
    short += ["--model.class_weights=balanced", "--model.threshold=balanced_accuracy"]
    assert main(["fit", "--config", name, f"{ROOT}={root}", *short]) == 0
    (checkpoint,) = tmp_path.glob("runs/*/version_0/checkpoints/last.ckpt")
    predictor = Predictor.from_checkpoint(checkpoint)
    assert predictor.window.is_trial
    assert predictor.threshold is not None
    assert predictor.class_names == ("failure", "success")

    files = sorted((root / "raw").glob("*.h5"))
    capsys.readouterr()
    assert main(["predict", str(checkpoint), *map(str, files), "--out", "all.csv"]) == 0
    assert capsys.readouterr().out.startswith(f"all.csv: {len(files)} windows: ")
    with open("all.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["recording"] for row in rows] == list(map(str, files))
    said = torch.tensor([float(row["p_success"]) for row in rows])
    config = yaml.safe_load((checkpoint.parents[1] / "config.yaml").read_text())
    source = config["data"]["dataset"]["init_args"]
    assert source["dataset"]["init_args"]["root"] == str(root)
    dataset = DATA.with_arguments({"root": str(root), **_of_view(source)}).resolve()[0].load()
    data = predictor.prepare_samples(dataset.batch(torch.arange(len(dataset))))
    expected = predictor.probability(predictor.logits(data))[:, 1].detach()
    names = [dataset._names["trial"][i] for i in dataset.column("trial").tolist()]
    order = [names.index(f.stem) for f in files] if files[0].stem in names else None
    if order is not None:
        torch.testing.assert_close(said, expected[order], atol=1e-4, rtol=0)
    torch.testing.assert_close(said.sort().values, expected.sort().values, atol=1e-4, rtol=0)
    above = said > predictor.threshold
    assert [row["prediction"] == "success" for row in rows] == above.tolist()


def _of_view(source):
    return {"pre_transform": source["pre_transform"]}
