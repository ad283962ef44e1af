import importlib
import json
import logging
import re
import sys
import types
from dataclasses import replace

import pytest

pytest.importorskip("lightning", reason="needs the extra 'train'")

import numpy as np
import torch
from compared import GIVEN, touches
from own_models import neighbours

from torch_geometric_tactile.data import StaticDataset
from torch_geometric_tactile.experiments import _networks as networks
from torch_geometric_tactile.experiments._compared_models import MODELS, find_model, select_models
from torch_geometric_tactile.experiments._compared_task import ComparedTask
from torch_geometric_tactile.experiments._held_out import choice_cuts, mean_training_size
from torch_geometric_tactile.experiments._score_units import ScoreUnits, comparison_splits
from torch_geometric_tactile.experiments.advice import advice, recommended, to_dict
from torch_geometric_tactile.experiments.compared_windows import data_source
from torch_geometric_tactile.experiments.comparison import (
    ComparisonSettings,
    _is_regression,
    comparison_plan,
    summarize,
)
from torch_geometric_tactile.experiments.deploy import deploy
from torch_geometric_tactile.experiments.plan import PlanRun
from torch_geometric_tactile.experiments.predictions import Predictions
from torch_geometric_tactile.experiments.run_plan import _estimate_seconds, run_plan
from torch_geometric_tactile.experiments.source import DataSource
from torch_geometric_tactile.reports._compare import (
    comparison_csv,
    comparison_markdown,
    prediction_rows,
)
from torch_geometric_tactile.sensors import biotac_sp, grid
from torch_geometric_tactile.training import training_recipe


def plan(folder, settings=None, grid="3x4", **changes):
    touches(folder / "a.npz", **changes)
    return comparison_plan(data_source(folder / "a.npz", grid=grid), settings)


def predicted(samples, right):
    """Predictions that are right on a part of the samples."""
    y, index = samples.data.y.numpy(), np.asarray(samples.indices())
    prediction = np.where(np.arange(len(y)) < round(right * len(y)), y, (y + 1) % 3)
    return Predictions(prediction, prediction, y, None, samples.data.trial.numpy(), index)


def validated(experiment, right):
    """A validation part in a run, of which a model is right on a part."""
    ((fit, val),) = choice_cuts(experiment, 1)[2]
    said = predicted(val, right)
    return {
        "score": float((said.prediction == said.y).mean()),
        "overlap": len(val) / len(fit),
        "predictions": [said.to_dict()],
    }


def made_up(plan, parts, failed=(), sizes={}, validation=None):  # noqa: B006
    """A run whose models are right on given parts of the samples of each split."""
    results = []
    for experiment in plan.experiments:
        if experiment.name not in parts or experiment.label in failed:
            continue
        train, test = experiment.data.parts(experiment.protocol, experiment.seed, experiment.fold)
        said = predicted(test, parts[experiment.name][experiment.fold])
        accuracy = float((said.prediction == said.y).mean())
        results.append(
            (
                experiment,
                {
                    "metrics": {"accuracy": accuracy, "balanced_accuracy": accuracy, "f1": 0.5},
                    "predictions": said.to_dict(),
                    "num_parameters": sizes.get(experiment.name, 10),
                    "choose_seconds": 2.0,
                    "train_seconds": 1.0,
                    "predict_seconds": 1e-5 * (sizes.get(experiment.name) or 10) * len(said.y),
                    "num_train": len(train),
                    "num_test": len(test),
                    "chosen": {"setting": {}, "number": 0, "epochs": 3, "validation": [0.5]},
                },
            )
        )
        if validation is not None:
            right = validation[experiment.name]
            results[-1][1]["validation"] = validated(experiment, right)
    missing = len(plan.experiments) - len(results)
    return summarize(PlanRun(plan, results, 0, dict.fromkeys(failed, "it must not"), missing))


THREE = ComparisonSettings(models=("gcn", "fnn", "forest", "constant"), folds=3)


def test_all_models_that_fit_the_data_are_planned(tmp_path):
    found = plan(tmp_path)
    names = [cell.experiment for cell in found.table.cells]
    assert "cnn" in names
    assert "posed_taxel_net" not in names
    assert len(found.experiments) == 4 * len(names)
    assert found.protocols[0].protocol.describe() == "4 folds by trial, stratified by y"


def test_data_set_is_built_once(tmp_path, monkeypatch):
    built, build = [], DataSource._build
    monkeypatch.setattr(DataSource, "_build", lambda *a: built.append(a) or build(*a))
    found = plan(tmp_path, THREE)
    for experiment in found.experiments[:3]:
        experiment.data.parts(experiment.protocol, experiment.seed, experiment.fold)
    assert len(built) == 1


def test_models_without_a_place_are_told():
    task = ComparedTask(biotac_sp(), "accuracy", 100)
    assert "cnn" not in [model.name for model in select_models(None, task)]
    with pytest.raises(ValueError, match=r"got 'cnn', but the layout has no image_map"):
        select_models(["cnn"], task)
    with pytest.raises(ValueError, match=r"'models' must be some of taxel_net, .* \(got 'cnnn'\)"):
        select_models(["cnnn"], task)


def test_large_maps_have_bmf_cnn():
    for size, has_it in (((20, 25), True), ((19, 25), False), ((25, 19), False)):
        task = ComparedTask(grid(*size, 0.01), "accuracy", 100)
        assert ("bmf_cnn" in [model.name for model in select_models(None, task)]) == has_it
    with pytest.raises(ValueError, match=r"the layout has fewer than 20 x 20 cells"):
        select_models(["bmf_cnn"], task)
    with pytest.raises(ValueError, match=r"got 'bmf_cnn', but the layout has no image_map"):
        select_models(["bmf_cnn"], ComparedTask(biotac_sp(), "accuracy", 100))


def test_map_has_as_many_convolutions_as_it_carries():
    for size, widths in (((28, 50), [16, 32, 64, 64]), ((8, 8), [32, 64]), ((16, 9), [32, 64])):
        task = ComparedTask(grid(*size, 0.01), "accuracy", 100)
        (cnn,) = (model.to_cell(task) for model in select_models(["cnn"], task))
        assert cnn.config["model"]["model"]["init_args"]["widths"] == widths


@pytest.mark.parametrize("name", ["gcn", "bmf_cnn"])
def test_slow_models_are_left_out_on_many_taxels_unless_named(name):
    for size, has_it in (((20, 25), True), ((20, 26), False)):
        task = ComparedTask(grid(*size, 0.01), "accuracy", 100)
        assert (name in [model.name for model in select_models(None, task)]) == has_it
        assert [model.name for model in select_models([name], task)] == [name]


@pytest.mark.parametrize(
    ("size", "samples", "settings", "members"),
    [((20, 25), 900, 3, 3), ((3, 167), 900, 3, 3), ((3, 400), 900, 1, 1), ((3, 167), 2000, 1, 1)],
)
def test_one_network_is_trained_on_many_readings_of_many_taxels(size, samples, settings, members):
    task = ComparedTask(grid(*size, 0.01), "accuracy", samples, members=None)
    fnn, forest = (model.to_cell(task) for model in select_models(["fnn", "forest"], task))
    assert (len(fnn.choice.settings), fnn.choice.members) == (settings, members)
    assert (len(forest.choice.settings), forest.choice.repeats) == (3, 3 if members == 3 else 2)
    assert forest.choice.most_samples == 1000


def test_taxels_are_placed_where_joints_and_links_are_known(grasps):
    source = data_source("AllegroUSkin", arguments={"root": str(grasps), "split": None})
    dataset = source.resolve()[0].load()
    assert ComparedTask.from_dataset(dataset, "accuracy", 60).has_pose
    arrays = {"x": torch.zeros(6, 12, 1), "y": torch.tensor([0, 1] * 3), "layout": grid(3, 4, 0.01)}
    from torch_geometric_tactile.data import StaticDataset

    other = StaticDataset.from_arrays(joint=torch.zeros(6, 16), **arrays)
    assert not ComparedTask.from_dataset(other, "accuracy", 60).has_pose


def test_networks_are_trained_by_the_recipe():
    task = ComparedTask(grid(3, 4, 0.01), "accuracy", 4000)
    assert task.recipe == training_recipe(4000)
    few = ComparedTask(grid(3, 4, 0.01), "accuracy", 4000, epochs=7)
    assert few.recipe == training_recipe(4000)._replace(max_epochs=7)


@pytest.mark.parametrize("metric", ["balanced_accuracy", "mae"])
def test_every_model_is_told_what_counts(metric):
    task = ComparedTask(grid(3, 4, 0.01), metric, 100, has_pose=True)
    for model in MODELS:
        cell = model.to_cell(task)
        assert cell.choice.metric == metric
        section = cell.config["model"] if cell.config else cell.estimator["init_args"]
        if metric == "mae":
            assert section["task"] == "regression"
        elif model.name != "constant":
            assert "balanced" in (section.get("class_weights"), section.get("class_weight"))


def test_samples_without_trials_are_split_by_frame_with_a_word(tmp_path, caplog):
    with caplog.at_level(logging.WARNING):
        found = plan(tmp_path, trial=None)
    assert found.protocols[0].name == "by frame"
    assert "the samples have no 'trial' and are split one by one" in caplog.text


def test_given_parts_are_one_split(tmp_path):
    found = plan(tmp_path, replace(THREE, by="given"), part=GIVEN)
    assert len(found.experiments) == 4
    assert found.protocols[0].name == "given"


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ({"models": ("svm",)}, "'models' must be some of taxel_net"),
        ({"models": ()}, r"'models' must be some of .* \(got none\)"),
        ({"metric": "f1"}, "'metric' must be 'accuracy', 'balanced_accuracy' or 'mae'"),
        ({"folds": 1}, "'folds' must be at least 2"),
        ({"epochs": 0}, "'epochs' must be at least 1"),
    ],
)
def test_wrong_settings_are_refused(arguments, match):
    with pytest.raises(ValueError, match=match):
        ComparisonSettings(**arguments)


def test_persons_are_the_units_of_a_comparison_by_person(tmp_path, caplog):
    person = np.array(["Ann", "Eva", "Ida"]).repeat(16)
    session = np.arange(3).repeat(16)  # as many as persons
    settings = ComparisonSettings(models=("svm_linear", "constant"), by="person", folds=3)
    found = plan(tmp_path, settings, person=person, session=session)
    assert "person" not in caplog.text
    comparison = summarize(run_plan(found, tmp_path / "out"))
    assert (comparison.units.name, found.protocols[0].name) == ("person", "by person")
    assert to_dict(comparison)["unit"] == "person"
    assert "On persons that the model has never seen, svm_linear" in advice(comparison)
    assert "## Accuracy by person" in comparison_markdown(comparison)
    header, *rows = prediction_rows(comparison)
    assert {row[header.index("person")] for row in rows} == {"Ann", "Eva", "Ida"}
    assert "3 folds by person" in str(deploy(comparison, "svm_linear").score)
    for train, test in comparison_splits(found):
        assert not {*person[train]} & {*person[test]}
    by_trial = plan(tmp_path, replace(settings, by="trial"), person=person, session=session)
    keys = [
        {json.dumps(e.identity(), sort_keys=True) for e in p.experiments} for p in (found, by_trial)
    ]
    assert not keys[0] & keys[1]


def test_named_units_in_both_parts_are_told_if_no_unit_is_chosen(tmp_path, caplog):
    person = np.arange(3).repeat(16)
    plan(tmp_path, ComparisonSettings(models=("constant",)), person=person)
    assert "split by trial: the 3 values of 'person' are in both the training and" in caplog.text
    caplog.clear()
    changes = {"person": np.arange(48) // 16, "group": np.arange(48) // 4}
    plan(tmp_path, ComparisonSettings(models=("constant",), by="trial"), **changes)
    assert caplog.text == ""


@pytest.mark.parametrize(
    ("settings", "changes", "match"),
    [
        ({"metric": "mae"}, {}, "'metric' must be 'accuracy' or 'balanced_accuracy' for classes"),
        ({"metric": "accuracy"}, {"y": np.arange(48) / 7 + 0.1}, "'metric' must be 'mae' for num"),
        ({"by": "group"}, {}, r"'by' must be a unit that all samples have: 'trial' \(got 'group'"),
        ({"by": "given"}, {}, "'dataset' must have a 'part' for each sample with by='given'"),
        ({}, {"trial": np.arange(48) % 2}, "at least 3 trials, to train, to select and to test on"),
        ({}, {"y": np.zeros(48, int)}, "'y' must have at least 2 classes"),
    ],
)
def test_data_that_cannot_be_compared_on_is_refused(tmp_path, settings, changes, match):
    with pytest.raises(ValueError, match=match):
        plan(tmp_path, ComparisonSettings(**settings), **changes)


@pytest.mark.parametrize(
    ("given", "kind", "match"),
    [
        ({"data": "none.npz"}, FileNotFoundError, "'none.npz' does not exist"),
        ({"data": "none/of/these"}, FileNotFoundError, "give an npz file of samples, a folder of"),
        (
            {"data": "Gloves"},
            FileNotFoundError,
            "a folder or a data set of this package: AllegroUSkin",
        ),
        (
            {"data": "Gloves", "layout": "x.json"},
            FileNotFoundError,
            "or a data set of this package: .*USkinPick$",
        ),
        ({"data": "my.Gloves"}, ValueError, "'class_path' must be the import path of a class"),
        ({"data": __file__}, ValueError, "'data' must be an npz file, a folder or a class"),
        ({"data": "BioTacSP", "grid": "3x4"}, ValueError, "'grid' must be left out for a class"),
        ({"data": ".", "task": "regression"}, ValueError, "'task' must be left out for anything"),
        ({"data": ".", "grid": "3by4"}, ValueError, "'grid' must be rows and columns"),
    ],
)
def test_what_is_no_data_is_told(given, kind, match):
    with pytest.raises(kind, match=match):
        data_source(**given).resolve()


def test_folder_of_recordings_is_a_data_source(tmp_path):
    from torch_geometric_tactile.data import Recording
    from torch_geometric_tactile.io._recording_npz import write_npz

    for name in ("mug_001", "mug_002", "cup_001", "cup_002"):
        recording = Recording(time=[0.0, 0.1], tactile=np.zeros((2, 6, 1)))
        write_npz(recording, tmp_path / f"{name}.npz")
    source, facts = data_source(tmp_path, grid="2x3").resolve()
    assert facts.class_names == ("cup", "mug")
    assert facts.num_trials == 4
    assert source.load().layout.matches(grid(2, 3, 0.005))


def test_place_of_the_file_is_no_part_of_a_result(tmp_path):
    codes = []
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        codes.append([e.code for e in plan(tmp_path / name, THREE).experiments])
    assert codes[0] == codes[1]
    other = plan(tmp_path / "one", THREE, seed=1).experiments
    assert not {e.code for e in other} & set(codes[0])


GOOD, FAIR, POOR = [1.0, 1.0, 1.0], [0.75, 0.75, 0.75], [0.25, 0.25, 0.25]


@pytest.mark.parametrize(
    ("parts", "sentence"),
    [
        (
            {"gcn": GOOD, "fnn": POOR, "forest": [0.5] * 3, "constant": [0.3] * 3},
            "Use gcn (accuracy 100.0 %). The best plain model, forest, is 50.0 points worse, "
            "which is beyond the noise of ± ",
        ),
        (
            {"gcn": FAIR, "fnn": [0.75, 0.8, 0.69], "forest": POOR, "constant": [0.1] * 3},
            "Use gcn (accuracy 75.0 %). The best plain model, fnn, has the same score. On trials",
        ),
        (
            {"gcn": POOR, "fnn": GOOD, "forest": FAIR, "constant": POOR},
            "Use fnn (accuracy 100.0 %). The best graph model, gcn, is 75.0 points worse, which "
            "is beyond the noise of ± ",
        ),
        (
            {"forest": FAIR, "fnn": GOOD, "constant": POOR},
            "Use fnn (accuracy 100.0 %). The next best model, forest, is 25.0 points worse",
        ),
        ({"fnn": GOOD, "constant": POOR}, "Use fnn (accuracy 100.0 %). No other model has a sc"),
        ({"gcn": GOOD}, "Use gcn (accuracy 100.0 %). No other model has a score."),
        (
            {"gcn": POOR, "fnn": POOR, "constant": FAIR},
            "No model is recommended: none is better than always answering '0' (25.0 %).",
        ),
        (
            {"gcn": POOR, "fnn": [0.3, 0.6, 0.1], "constant": [0.25] * 3},
            "No model is recommended yet: the best model, fnn (accuracy 35.4 %), is within one "
            "standard error of always answering '0' (25.0 %) (standard error 23.1 over 3 splits "
            "and 10.4 over 12 trials). More trials are needed.",
        ),
        ({}, "No model has a result for every split yet"),
    ],
)
def test_sentence_says_which_model_to_take(tmp_path, parts, sentence):
    comparison = made_up(plan(tmp_path, THREE), parts)
    assert advice(comparison).startswith(sentence)
    content = to_dict(comparison)
    assert content["advice"] == advice(comparison)
    json.dumps(content, allow_nan=False)


def test_the_model_that_is_ahead_is_taken_though_splits_are_few(tmp_path):
    # The model with more weights is ahead in 3 of 3 splits, which three splits cannot prove.
    parts = {"gcn": [1.0, 0.94, 0.75], "fnn": [0.75, 0.56, 0.63], "constant": [0.2] * 3}
    found = plan(tmp_path, THREE, num_trials=48)
    comparison = made_up(found, parts, sizes={"gcn": 1100})
    assert comparison.difference("gcn", "fnn").verdict == "within the noise"
    assert recommended(comparison).model.name == "gcn"
    text = advice(comparison)
    assert text.startswith(
        "Use gcn (accuracy 89.6 %). The best plain model, fnn, is 25.0 points worse. gcn is better "
        "in 3 of 3 splits and in 12 trials, and worse in 0. 3 splits cannot prove a difference "
        "beyond the noise of ± "
    )
    assert "'--folds 10' could." in text
    more = made_up(plan(tmp_path, replace(THREE, folds=10), num_trials=48), parts_of_folds(parts))
    assert "'--folds" not in advice(more)


def parts_of_folds(parts, folds=10):
    return {name: [values[i % len(values)] for i in range(folds)] for name, values in parts.items()}


NEAR = {"gcn": [1.0, 0.5, 0.75], "fnn": [0.5, 0.75, 0.75]}  # 8.3 points, standard error 34.9


@pytest.mark.parametrize(
    ("sizes", "tolerance", "name"),
    [
        ({"gcn": 20}, 0.09, "fnn"),
        ({"gcn": 20}, 0.08, "gcn"),  # not within the tolerance
        ({"gcn": 19}, 0.09, "gcn"),  # not at most half the weights
        ({"gcn": None}, 0.09, "gcn"),  # of which nobody knows the weights
    ],
)
def test_a_simpler_model_is_taken_if_it_is_about_as_good(tmp_path, sizes, tolerance, name):
    comparison = made_up(plan(tmp_path, THREE), NEAR, sizes=sizes)
    assert comparison.tolerance == 0.01
    comparison = replace(comparison, tolerance=tolerance)
    assert recommended(comparison).model.name == name
    text = (
        "Use fnn (accuracy 66.7 %). It is simpler than gcn, the best model, and about as good "
        "(10 instead of 20 weights, 0.1 instead of 0.2 ms per sample). The best graph model, gcn, "
        "is 8.3 points better. gcn is better in 1 of 3 splits and in 2 trials, and worse in 1. The "
        "difference is within the noise of ± 150.0 (standard error 34.9 over 3 splits and "
    )
    assert advice(comparison).startswith(text) is (name == "fnn")


def test_a_simpler_model_beyond_one_standard_error_is_not_taken(tmp_path):
    # Ahead by the same in every split: the error is that over trials, 4.0 points.
    parts = {"gcn": [0.94] * 3, "fnn": [0.81] * 3}
    comparison = made_up(plan(tmp_path, THREE), parts, sizes={"gcn": 1000})
    difference = comparison.difference("gcn", "fnn")
    assert difference.mean > difference.error
    assert recommended(replace(comparison, tolerance=0.5)).model.name == "gcn"


def test_of_equal_models_the_smallest_is_taken(tmp_path):
    parts = {"gcn": FAIR, "fnn": FAIR, "forest": FAIR}
    sizes = {"gcn": 12, "fnn": 11, "forest": 13}
    comparison = made_up(plan(tmp_path, THREE), parts, sizes=sizes)
    assert recommended(comparison).model.name == "fnn"


def test_persons_are_the_units_where_they_are_new(tmp_path):
    group = np.repeat(["ann", "bo", "cy", "di"], 12)
    found = plan(tmp_path, replace(THREE, by="group", folds=4), group=group)
    parts = {"gcn": [1.0, 0.5, 0.75, 0.75], "fnn": [*POOR, 0.25], "constant": [*POOR, 0.25]}
    found.data.load().group_kind = "person"
    comparison = made_up(found, parts)
    assert comparison.difference("gcn", "fnn").num_units == 4
    text = advice(comparison)
    assert "gcn is not clearly better than" not in text
    assert text.endswith(
        "There are only 4 persons: with other persons, another model may be the best. On persons "
        "that the model has never seen, gcn has an accuracy of 75.0 % (4 persons with 50.0 to "
        "100.0 % each; always answering '0' scores 33.3 %; best of 2 models, selected by these "
        "scores)."
    )


@pytest.mark.parametrize(
    ("right", "low", "high"),
    [([1.0] * 3, "71.", "100.0"), ([0.75, 0.75, 0.75], "4", "9")],
)
def test_interval_of_a_score_is_between_0_and_100(tmp_path, right, low, high):
    text = advice(made_up(plan(tmp_path, THREE), {"gcn": right}))
    found = re.search(r"\(12 trials; 95 % confidence interval ([\d.]+) to ([\d.]+) %", text)
    assert found[1].startswith(low)
    assert found[2].startswith(high)


def test_one_given_part_has_a_verdict_by_its_units(tmp_path):
    found = plan(tmp_path, replace(THREE, by="given"), part=GIVEN)
    comparison = made_up(found, {"gcn": GOOD, "fnn": POOR, "constant": POOR})
    assert "Use gcn (accuracy 100.0 %). The best plain model, fnn, is 75.0 points worse" in advice(
        comparison
    )
    assert "There are only 3 trials" in advice(comparison)
    page = comparison_markdown(comparison)
    assert "| +75.0 | ± " in page
    assert "no verdict with fewer than 3 splits (unless all share one given test part)" in page


def with_test_part(folder, num_train, num_test):
    """The plan of a file of touches, of which the first are to train on."""
    part = np.repeat([0, 2], [4 * num_train, 4 * num_test])
    settings = ComparisonSettings(models=("fnn", "svm_linear"), by="given")
    return plan(folder, settings, num_trials=num_train + num_test, part=part)


def identities(plan):
    return [{**experiment.identity(), "data": None} for experiment in plan.experiments]


@pytest.mark.parametrize("num_train", [6, 300, 1200])  # trials of four samples
def test_training_does_not_follow_from_the_number_of_test_samples(tmp_path, num_train):
    once, twice = (with_test_part(tmp_path, num_train, num_test) for num_test in (300, 600))
    assert identities(once) == identities(twice)
    recipe = training_recipe(round(0.8 * 4 * num_train))
    assert (once.experiments[0].batch_size, once.experiments[0].epochs) == recipe[:2]
    assert once.experiments[0].choice.members == (3 if num_train < 310 else 1)
    assert identities(once) != identities(with_test_part(tmp_path, 600, 300))


@pytest.mark.full
def test_more_test_samples_change_no_answer(tmp_path):
    content = touches(tmp_path / "a.npz", num_trials=24) | {"part": np.repeat([0, 2], [24, 72])}
    settings = ComparisonSettings(models=("fnn", "svm_linear"), by="given")
    answers = []
    for num_samples in (48, 96):
        np.savez(tmp_path / "a.npz", **{key: v[:num_samples] for key, v in content.items()})
        found = comparison_plan(data_source(tmp_path / "a.npz", grid="3x4"), settings)
        run = run_plan(found, tmp_path / "out")
        said = [Predictions.from_dict(result["predictions"]) for _, result in run.results]
        answers.append([p.prediction[p.index < 48].tolist() for p in said])
    assert [len(values) for values in answers[0]] == [24, 24]
    assert answers[0] == answers[1]


@pytest.mark.parametrize(("folds", "num_train"), [(3, 64), (4, 72)])
def test_training_follows_from_the_mean_over_unequal_folds(tmp_path, folds, num_train):
    group = np.repeat([0, 1, 2, 3], [60, 12, 12, 12])
    settings = ComparisonSettings(models=("fnn",), by="group", folds=folds)
    found = plan(tmp_path, settings, num_trials=24, group=group)
    protocol = found.protocols[0].protocol
    assert len({len(e.data.split(protocol, 0, e.fold).train) for e in found.experiments}) > 1
    assert mean_training_size(found.data, protocol) == pytest.approx(num_train)


@pytest.mark.parametrize(
    ("by", "part"), [("trial", GIVEN), ("given", GIVEN), ("given", np.where(GIVEN == 1, 0, GIVEN))]
)
def test_only_selected_samples_count_and_are_trained_on(tmp_path, by, part):
    touches(tmp_path / "a.npz", part=part)
    settings = ComparisonSettings(models=("svm_linear",), by=by)
    source = DataSource("compared.SelectedTouches", {"path": str(tmp_path / "a.npz")})
    found = comparison_plan(source, settings, selection={"stride": 2})
    assert found.facts.num_samples == 24
    assert mean_training_size(found.data, found.protocols[0].protocol) == 18
    train, test, cuts = choice_cuts(found.experiments[0], 1)
    assert (len(train), len(test), sum(map(len, cuts[0]))) == (18, 6, 18)
    is_selected = found.data.is_selected(found.data.load())
    for samples in (train, test, *cuts[0]):
        assert is_selected[torch.as_tensor(list(samples.indices()))].all()


def test_nothing_is_recommended_where_given_parts_share_trials(tmp_path):
    part = np.where(np.arange(48) % 2, 2, 0)
    found = plan(tmp_path, replace(THREE, by="given"), part=part)
    comparison = made_up(found, {"gcn": GOOD, "fnn": POOR, "constant": POOR})
    assert recommended(comparison) is None
    assert advice(comparison) == (
        "No model is recommended: 12 trials of the test part are also in the training part, so the "
        "scores say nothing about new trials. Put each trial into one part, or split by trial."
    )
    by_frame = made_up(plan(tmp_path, replace(THREE, by="frame")), {"gcn": GOOD, "fnn": POOR})
    assert recommended(by_frame).model.name == "gcn"
    assert "12 trials are in both the training and the test part of a split" in advice(by_frame)
    assert "On samples from trials that the model has seen, gcn has an acc" in advice(by_frame)


MANY_GIVEN = np.repeat([0, 1, 2], [48, 48, 96])  # 48 trials
POOR_FLOOR = {"constant": [0.25] * 3}


def given(folder, parts, validation, seeds=1, **more):
    settings = replace(THREE, by="given", seeds=seeds)
    found = plan(folder, settings, num_trials=48, part=MANY_GIVEN)
    validation = {**validation, "constant": 0.25}
    return made_up(found, {**parts, **POOR_FLOOR}, validation=validation, **more)


def test_the_model_of_given_parts_is_chosen_by_validation_scores(tmp_path):
    parts = {"gcn": [0.8], "fnn": [0.85], "forest": [0.5]}
    comparison = given(tmp_path, parts, {"gcn": 0.9, "fnn": 0.7, "forest": 0.5})
    assert comparison.is_validated
    assert recommended(comparison).model.name == "gcn"
    text = advice(comparison)
    assert text.startswith(
        "Use gcn (accuracy 80.2 %, 89.6 % on validation parts). The best plain model, fnn, is 5.2 "
        "points better. fnn is better in 2 trials, and worse in 0. The difference is within the "
        "noise of ± "
    )
    assert "split" not in text
    assert "disagree" not in text
    assert "best of 3 models, selected by validation scores; one training run; another" in text
    content = to_dict(comparison)
    assert (content["chosen_by"], content["num_splits"]) == ("validation", 1)
    assert content["models"][0]["validation"] == pytest.approx(43 / 48)
    page = comparison_markdown(comparison)
    assert "| model | kind | accuracy (%) |" in page
    assert "| validation accuracy (%) |" in page
    assert "| gcn | graph | 80.2 | 80.2 | 50.0 | 89.6 |" in page
    assert "over the splits" not in page.partition("## Sel")[0].partition("A difference is")[0]
    assert comparison_csv(comparison).splitlines()[1].endswith(",0.8958333333333334,")
    assert deploy(comparison, "forest").score.sd is None


def test_test_part_that_proves_the_opposite_of_validation_parts_is_told(tmp_path):
    parts = {"gcn": [0.95], "fnn": [0.6], "forest": [0.28]}
    comparison = given(tmp_path, parts, {"gcn": 0.5, "fnn": 0.8, "forest": 0.5})
    assert recommended(comparison).model.name == "fnn"
    assert (
        "Validation and test scores disagree: on the test part, gcn is 34.4 points better than "
        "fnn, beyond the noise. Test both on new trials."
    ) in advice(comparison)


def test_model_that_is_worse_than_the_constant_answer_on_the_test_part_is_not_taken(tmp_path):
    parts = {"gcn": [0.05], "fnn": [0.05], "forest": [0.0]}
    comparison = given(tmp_path, parts, {"gcn": 0.9, "fnn": 0.8, "forest": 0.5})
    assert recommended(comparison) is None
    assert "model, gcn (accuracy 5.2 %, 89.6 % on validation parts), is worse on the test" in (
        advice(comparison)
    )


@pytest.mark.parametrize(("sizes", "name"), [({"gcn": 9}, "gcn"), ({"gcn": 11}, "fnn")])
def test_of_equal_validation_scores_the_smallest_model_is_taken(tmp_path, sizes, name):
    parts = {"gcn": [0.6], "fnn": [0.6], "forest": [0.9]}
    validation = {"gcn": 1.0, "fnn": 1.0, "forest": 0.9}
    assert recommended(given(tmp_path, parts, validation, sizes=sizes)).model.name == name


def test_a_simpler_model_is_taken_by_its_validation_score(tmp_path):
    parts = {"gcn": [0.9], "fnn": [0.6], "forest": [0.5]}
    validation = {"gcn": 0.81, "fnn": 0.79, "forest": 0.5}
    comparison = given(tmp_path, parts, validation, sizes={"gcn": 20})
    near = replace(comparison, tolerance=0.03)
    assert [recommended(one).model.name for one in (comparison, near)] == ["gcn", "fnn"]
    assert comparison.validation_difference("gcn", "fnn").num_units == 12


def test_runs_without_validation_scores_are_chosen_by_test_scores(tmp_path):
    found = plan(tmp_path, replace(THREE, by="given"), num_trials=48, part=MANY_GIVEN)
    comparison = made_up(found, {"gcn": [0.8], "fnn": [0.85], **POOR_FLOOR})
    assert not comparison.is_validated
    assert recommended(comparison).model.name == "fnn"
    assert "selected by these scores" in advice(comparison)
    with pytest.raises(ValueError, match=r"'gcn' must have a validation score \(got none\)"):
        comparison.validation_difference("gcn", "fnn")


def test_seeds_of_given_parts_are_one_split(tmp_path):
    parts = {"gcn": [0.9], "fnn": [0.6], "forest": [0.5]}
    validation = {"gcn": 0.9, "fnn": 0.6, "forest": 0.5}
    one, three = (given(tmp_path, parts, validation, seeds) for seeds in (1, 3))
    first, second = (comparison.difference("gcn", "fnn") for comparison in (one, three))
    assert (second.num_splits, second.num_seeds, second.over_seeds) == (1, 3, 0.0)
    assert second.margin == pytest.approx(first.margin)
    assert (three.num_splits, three.num_seeds) == (1, 3)
    text = advice(three)
    assert "over 24 trials and 0.0 over 3 seeds)" in text
    assert "mean of 3 training runs" in text
    page = comparison_markdown(three)
    assert "1 split. Mean ± standard deviation over 3 training seeds." in page
    assert "| vs fnn (points) | over seeds | over trials |" in page
    assert "| vs fnn (points) | over trials | parameters |" in comparison_markdown(one)
    assert ",accuracy,0.8958333333333334,0.0,1," in comparison_csv(three)


@pytest.mark.parametrize("num_seen", [0, 1])
def test_steps_of_a_few_new_persons_are_no_units(tmp_path, num_seen):
    # 180 steps of three persons, of whom one may have a step among those to train on.
    person = np.repeat(np.arange(6), 60)
    person[:num_seen] = 5
    changes = {"group": person, "trial": None, "part": np.repeat([0, 2], 180)}
    found = plan(tmp_path, replace(THREE, by="given"), num_trials=360, frames=1, **changes)
    units = ScoreUnits.from_splits(found.data.load(), comparison_splits(found))
    assert (units.name, units.num_seen) == ("group", num_seen)
    assert len(np.unique(units.numbers[180:])) == 3
    held_out = [set(part.group.tolist()) for part in choice_cuts(found.experiments[0], 1)[2][0]]
    assert not set.intersection(*held_out)


def test_trials_in_both_parts_are_told_though_most_persons_are_new(tmp_path):
    person, trial = np.repeat(np.arange(6), 8), np.arange(48)
    person[0], trial[0] = 5, 47
    found = plan(
        tmp_path, replace(THREE, by="given"), group=person, trial=trial, part=np.repeat([0, 2], 24)
    )
    units = ScoreUnits.from_splits(found.data.load(), comparison_splits(found))
    assert (units.num_seen, units.num_leaked) == (1, 1)
    comparison = made_up(found, {"gcn": [1.0], "fnn": [0.2], "constant": [0.2]})
    assert advice(comparison).startswith("No model is recommended: 1 trial of the test part is")


def test_page_without_a_plain_model_compares_with_none(tmp_path):
    found = plan(tmp_path, THREE)
    for parts in ({}, {"gcn": GOOD}):
        assert "None" not in comparison_markdown(made_up(found, parts))


def test_scores_by_group_and_predictions_of_each_sample(tmp_path):
    groups = np.repeat(["ann", "-1"], 24)
    found = plan(tmp_path, THREE, group=groups, y=np.repeat(["a", "b", "c", "a"], 12))
    comparison = made_up(found, {"gcn": GOOD, "fnn": POOR})
    page = comparison_markdown(comparison)
    assert "## Accuracy by group" in page
    assert "| group | test samples | gcn | fnn |" in page
    assert "| ann | 24 | 100.0 | " in page
    header, *rows = prediction_rows(comparison)
    assert header == ["model", "seed", "fold", "index", "group", "trial", "y", "prediction"]
    of_gcn = {row[3]: row[4:] for row in rows if row[0] == "gcn"}
    assert sorted(of_gcn) == list(range(48))
    assert of_gcn[13] == ["ann", "3", "b", "b"]
    assert of_gcn[47] == ["-1", "11", "a", "a"]


def test_model_that_lacks_a_split_is_left_out(tmp_path):
    found = plan(tmp_path, THREE)
    parts = {"gcn": GOOD, "fnn": FAIR}
    comparison = made_up(found, parts, failed=["gcn, by trial, seed 0, fold 1"])
    assert [result.model.name for result in comparison.results] == ["fnn"]
    assert to_dict(comparison)["failed"] == {"gcn, by trial, seed 0, fold 1": "it must not"}
    assert "it must not" in comparison_markdown(comparison)
    with pytest.raises(ValueError, match=r"'name' must be one of \['fnn'\] \(got 'gcn'\)"):
        comparison.of("gcn")


def test_pages_hold_the_numbers(tmp_path):
    comparison = made_up(plan(tmp_path, THREE), {"gcn": GOOD, "fnn": POOR})
    page = comparison_markdown(comparison)
    assert "| gcn | graph | 100.0 ± 0.0 | 100.0 ± 0.0 | 50.0 ± 0.0 | +75.0 * |" in page
    assert "48 samples, 12 trials; 3 folds by trial, stratified by y, 3 splits" in page
    lines = comparison_csv(comparison).splitlines()
    assert lines[0].startswith("model,kind,metric,mean,sd,splits,difference,over_splits")
    assert lines[1].startswith("gcn,graph,accuracy,1.0,0.0,3,0.75,0.0,")
    assert len(lines) == 1 + 2 * 3


def test_json_has_one_form(tmp_path):
    content = to_dict(made_up(plan(tmp_path, THREE), {"gcn": GOOD, "fnn": POOR}))
    assert list(content) == [
        *("format", "version", "data", "protocol", "num_splits", "num_seeds", "chosen_by"),
        *("task", "metric", "unit"),
        *("constant", "tolerance", "recommended", "best_plain"),
        *("models", "failed", "missing", "advice"),
    ]
    assert content["unit"] == "trial"
    assert content["constant"] == {"name": "'0'", "score": 0.25}
    assert content["recommended"] == "gcn"
    gcn, fnn = content["models"]
    assert list(gcn) == [
        *("name", "title", "kind", "scores", "validation", "difference", "num_parameters"),
        *("seconds", "milliseconds", "chosen"),
    ]
    assert (content["num_splits"], content["num_seeds"], content["chosen_by"]) == (3, 1, "test")
    assert gcn["validation"] is None
    assert gcn["scores"]["accuracy"] == {"mean": 1.0, "sd": 0.0}
    assert gcn["difference"]["mean"] == 0.75
    assert gcn["difference"]["verdict"] == "beyond the noise"
    assert fnn["difference"] is None
    assert content["missing"] == 6


def test_estimate_is_of_each_model_and_trains_one_network_at_a_time(tmp_path, monkeypatch):
    trained, fit = [], networks.fit_classifier
    monkeypatch.setattr(networks, "fit_classifier", lambda *a: trained.append(a) or fit(*a))
    settings = ComparisonSettings(models=("fnn", "svm_linear"), folds=3, epochs=2)
    found = plan(tmp_path, settings)
    seconds = _estimate_seconds(found.experiments)
    assert set(seconds) == {"fnn", "svm_linear"}
    assert all(value > 0 for value in seconds.values())
    assert len(trained) == 2  # the first of a kind twice, whose imports do not count
    assert _estimate_seconds([]) == {}


def test_estimate_of_a_forest_compares_settings_with_fewer_trees(tmp_path, monkeypatch):
    trees, module = [], sys.modules[run_plan.__module__]
    fit = module.fit

    def counted(experiment, *parts):
        trees.append(experiment.model["init_args"].get("num_trees", 300))
        return fit(experiment, *parts)

    monkeypatch.setattr(module, "fit", counted)
    found = plan(tmp_path, ComparisonSettings(models=("forest",), folds=3))
    _estimate_seconds(found.experiments)
    assert trees[-3:] == [300, 100, 100]  # trained once, then the first and the last setting tried


def test_run_of_a_table_is_no_comparison(tmp_path):
    found = plan(tmp_path, THREE)
    plain = replace(found, experiments=tuple(replace(e, choice=None) for e in found.experiments))
    with pytest.raises(ValueError, match="'run' must be the run of a comparison"):
        summarize(PlanRun(plain, [], 0, {}, 0))


def test_models_of_ones_own_stand_behind_ours(tmp_path):
    own = ("own_models.neighbours", "own_models.OfEdges", "own_models.OneLayer")
    found = plan(tmp_path, ComparisonSettings(models=(*own, "constant"), folds=3))
    cells = {cell.experiment: cell for cell in found.table.cells}
    assert list(cells) == ["constant", *own]
    assert cells[own[0]].estimator == {"class_path": own[0], "init_args": {}}
    assert cells[own[1]].config["model"]["model"]["class_path"] == own[1]
    assert [find_model(name).is_graph for name in own] == [False, True, False]


def test_import_path_of_no_model(tmp_path):
    with pytest.raises(
        ValueError, match=r"import paths of your own models \(got 'own_models\.Not'"
    ):
        plan(tmp_path, ComparisonSettings(models=("own_models.Not",), folds=3))


def test_models_of_ones_own_are_trained(tmp_path):
    names = ("own_models.neighbours", "own_models.OneLayer")
    settings = ComparisonSettings(models=names, folds=2, epochs=1, members=1)
    run = run_plan(plan(tmp_path, settings), tmp_path / "out")
    assert not run.failed
    assert {result.model.name for result in summarize(run).results} == {*names}


ESTIMATOR = """
from sklearn.neighbors import KNeighborsClassifier
def nearest(): return KNeighborsClassifier({k})
"""


def own_run(tmp_path, name="edited_nets.nearest"):
    settings = ComparisonSettings(models=(name,), folds=2)
    return run_plan(plan(tmp_path, settings), tmp_path / "out")


@pytest.fixture
def edited_nets(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    file = tmp_path / "edited_nets.py"
    file.write_text(ESTIMATOR.format(k=1))
    yield file
    sys.modules.pop("edited_nets", None)


def test_edited_model_of_ones_own_is_trained_again(tmp_path, edited_nets):
    assert own_run(tmp_path).kept == 0
    assert own_run(tmp_path).kept == 2
    edited_nets.write_text(ESTIMATOR.format(k=24))
    importlib.reload(sys.modules["edited_nets"])
    again = own_run(tmp_path)
    assert again.kept == 0
    accuracy = summarize(again).results[0].scores["accuracy"].mean
    assert accuracy < 0.5  # the votes of all are those of the most frequent class
    edited_nets.write_text(ESTIMATOR.format(k=1))
    importlib.reload(sys.modules["edited_nets"])
    assert own_run(tmp_path).kept == 2  # as it was


def test_model_without_source_is_not_kept(tmp_path, caplog):
    made = types.ModuleType("made_nets")
    made.nearest = neighbours
    sys.modules["made_nets"] = made
    try:
        for _ in range(2):
            run = own_run(tmp_path, "made_nets.nearest")
            assert (run.kept, len(run.results), run.missing) == (0, 2, 0)
    finally:
        del sys.modules["made_nets"]
    assert not (tmp_path / "out" / "runs").exists()
    assert "runs with 'made_nets' are not stored" in caplog.text


def test_model_that_is_edited_during_its_run_is_not_kept(tmp_path, edited_nets, caplog):
    found = plan(tmp_path, ComparisonSettings(models=("edited_nets.nearest",), folds=2))
    assert found.experiments[0].code  # read before the training
    edited_nets.write_text(ESTIMATOR.format(k=3))
    run = run_plan(found, tmp_path / "out")
    assert len(run.results) == 2
    assert not (tmp_path / "out" / "runs").exists()
    assert "edited_nets) was edited during the run" in caplog.text
    importlib.reload(sys.modules["edited_nets"])
    with pytest.raises(ValueError, match="edited after the comparison"):
        deploy(summarize(run), "edited_nets.nearest")


def test_given_parts_that_share_trials_are_told(tmp_path, caplog):
    settings = ComparisonSettings(models=("svm_linear", "constant"), by="given")
    found = plan(tmp_path, settings, part=np.arange(48) % 2 * 2)
    (sentence,) = found.shared
    assert sentence.startswith("12 trials are in more than one part (trial 0, trial 1, trial 2 and")
    page = comparison_markdown(summarize(run_plan(found, tmp_path / "out")))
    assert [r.getMessage() for r in caplog.records].count(sentence) == 1
    assert "**Scores are too high:** 12 trials are in more than one part" in page
    assert plan(tmp_path, settings, part=GIVEN).shared == ()


def test_recordings_that_are_there_twice_are_told(tmp_path):
    content = touches(tmp_path / "b.npz")
    x = np.concatenate([content["x"][:24]] * 2)
    settings = ComparisonSettings(models=("constant",), folds=3)
    (sentence,) = plan(tmp_path, settings, x=x).shared
    assert "trials have the same readings as a trial in another part" in sentence
    assert plan(tmp_path, settings).shared == ()


def test_negative_class_is_refused():
    y = torch.arange(-1, 2).repeat(8)
    data = StaticDataset.from_arrays(torch.randn(24, 6, 1), y, layout=grid(2, 3, pitch=0.01))
    with pytest.raises(ValueError, match=r"'y' must be classes from 0; leave .* \(got -1\)"):
        _is_regression(data)
