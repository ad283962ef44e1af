import json
import pickle
from dataclasses import replace

import pytest

pytest.importorskip("lightning", reason="needs the extra 'train'")

import numpy as np
import torch
from compared import GIVEN, SCALED, SVM, experiment, touches
from torch_geometric.transforms import BaseTransform

from torch_geometric_tactile.data import Protocol
from torch_geometric_tactile.datasets import SamplesFile
from torch_geometric_tactile.experiments import _networks as networks
from torch_geometric_tactile.experiments import _run_experiment as run
from torch_geometric_tactile.experiments._experiment import Choice
from torch_geometric_tactile.experiments._held_out import choice_cuts
from torch_geometric_tactile.experiments._networks import TargetScale
from torch_geometric_tactile.experiments._run_experiment import run_experiment
from torch_geometric_tactile.experiments._worker import run_here
from torch_geometric_tactile.experiments.predictions import Predictions

FOREST = {
    "class_path": "torch_geometric_tactile.baselines.flat_forest",
    "init_args": {"num_trees": 5},
}
FNN = {
    "model": {
        "class_path": "torch_geometric_tactile.nn.models.TactileFNN",
        "init_args": {"widths": [8], "pools": [1]},
    },
    "optimizer": {"class_path": "torch.optim.Adam", "init_args": {"lr": 0.01}},
}


def told(result):
    return {key: result[key] for key in ("metrics", "chosen", "predictions")}


def test_best_setting_on_the_validation_part_is_taken(tmp_path):
    touches(tmp_path / "a.npz")
    settings = [
        {"class_path": "torch_geometric_tactile.baselines.constant"},
        {"init_args": {"C": 1.0}},
        {"init_args": {"C": 1.0}},
    ]
    result = run_experiment(experiment(tmp_path / "a.npz", settings=settings))
    chosen = result["chosen"]
    assert chosen["number"] == 1  # the first of equals
    assert chosen["setting"] == settings[1]
    assert chosen["validation"][0] < chosen["validation"][1]
    assert result["metrics"]["accuracy"] > 0.6
    assert (result["num_train"], result["num_test"]) == (32, 16)
    parts = sum(result[f"{what}_seconds"] for what in ("choose", "train", "predict"))
    assert 0 < parts < result["seconds"]
    json.dumps(result, allow_nan=False)


@pytest.mark.parametrize(("part", "cuts"), [(GIVEN, 1), (np.where(GIVEN == 1, 0, GIVEN), 3)])
def test_a_single_setting_is_validated_too_as_it_is_trained_for_the_test(tmp_path, part, cuts):
    touches(tmp_path / "a.npz", part=part)
    changes = {"protocol": Protocol("given"), "model": FNN, "epochs": 1}
    choice = Choice(members=2, num_validation_cuts=5, most_samples=8)
    one = experiment(tmp_path / "a.npz", choice=choice, **changes)
    validation = run_experiment(one)["validation"]
    said = [Predictions.from_dict(content) for content in validation["predictions"]]
    assert len(said) == cuts
    assert validation["score"] == pytest.approx(
        np.mean([(p.y == p.prediction).mean() for p in said])
    )
    (fit, val), *_ = choice_cuts(one, 5)[2]
    assert validation["overlap"] == len(val) / len(fit)
    alone = replace(one, choice=replace(choice, num_validation_cuts=0))
    trained = run.fit(alone, fit, val)  # both members, on all samples
    assert trained.prediction.tolist() == said[0].prediction.tolist()
    assert "validation" not in run_experiment(alone)
    assert alone.code != one.code
    assert "num_validation_cuts" not in alone.identity()["choice"]


def test_model_that_cannot_be_validated_has_no_score(tmp_path, monkeypatch):
    touches(tmp_path / "a.npz", part=GIVEN)
    one = experiment(
        tmp_path / "a.npz", protocol=Protocol("given"), choice=Choice(num_validation_cuts=5)
    )
    fit = run.fit

    def diverge(experiment, train, test, *more):
        if len(test) == 12 and test.trial.unique().tolist() == [6, 7, 8]:
            raise ValueError("it diverges")
        return fit(experiment, train, test, *more)

    monkeypatch.setattr(run, "fit", diverge)
    result = run_experiment(one)
    assert (result["validation"]["score"], result["validation"]["predictions"]) == (None, [])
    json.dumps(result, allow_nan=False)


def said_of(rights):
    """What a setting said of cuts of ten trials each, of which some are right."""
    y = np.ones(10, dtype=int)
    return [
        Predictions(
            score=y,
            prediction=(np.arange(10) < right).astype(int),
            y=y,
            session=None,
            trial=10 * cut + np.arange(10),
            index=10 * cut + np.arange(10),
        )
        for cut, right in enumerate(rights)
    ]


@pytest.mark.parametrize(
    ("rights", "number"),
    [
        ([[7, 7, 7], [8, 7, 7]], 0),  # one of thirty trials more
        ([[7, 7, 7], [9, 8, 9]], 1),
        ([[7, 7, 7], [10, 5, 8]], 0),  # not in each cut
        ([[7, 7, 7], [9, 8, 9], [10, 9, 10]], 2),
        ([[7, 7, 7], [5, 5, 5]], 0),
        ([[5], [9]], 1),
    ],
)
def test_default_stays_unless_another_setting_is_better_beyond_the_noise(
    rights, number, tmp_path, monkeypatch
):
    touches(tmp_path / "a.npz")
    settings = [{"init_args": {"C": float(i + 1)}} for i in range(len(rights))]
    one = experiment(tmp_path / "a.npz", settings=settings)
    said = {
        setting["init_args"]["C"]: right for setting, right in zip(settings, rights, strict=True)
    }

    def evaluate(candidate, choice, part, val):
        right = said[candidate.experiment.model["init_args"]["C"]]
        cut = len(candidate.predictions)
        candidate.predictions.append(said_of(right)[cut])
        candidate.scores.append(right[cut] / 10)
        candidate.losses.append(0.0)

    monkeypatch.setattr(run._Candidate, "evaluate", evaluate)
    chosen_one, chosen = run._select_setting(one, one.choice, choice_cuts(one, len(rights[0]))[2])
    assert chosen["chosen"]["number"] == number
    assert chosen_one.model["init_args"]["C"] == number + 1


def test_setting_that_is_behind_is_not_tried_again(tmp_path, monkeypatch):
    touches(tmp_path / "a.npz", num_trials=18)
    tried = []
    fit = run.fit

    def watched(experiment, part, *rest):
        tried.append((experiment.model["init_args"]["num_trees"], len(part)))
        return fit(experiment, part, *rest)

    monkeypatch.setattr(run, "fit", watched)
    one_leaf = {"init_args": {"num_trees": 1, "min_samples_leaf": 99}}  # one class for all
    settings = [{"init_args": {"num_trees": 9}}, one_leaf]
    one = experiment(tmp_path / "a.npz", FOREST, settings)
    run_experiment(replace(one, choice=Choice(settings, repeats=3, most_samples=20)))
    assert tried == [(9, 20), (1, 20), (9, 20), (9, 20), (9, 48)]


def test_draft_is_for_the_comparison_of_settings_alone(tmp_path, monkeypatch):
    touches(tmp_path / "a.npz")
    trained = []
    fit = run.fit

    def watched(experiment, *parts):
        arguments = experiment.model["init_args"]
        trained.append((arguments["num_trees"], arguments.get("min_samples_leaf")))
        return fit(experiment, *parts)

    monkeypatch.setattr(run, "fit", watched)
    settings = [{}, {"init_args": {"min_samples_leaf": 99}}]
    choice = Choice(settings, repeats=1, draft={"init_args": {"num_trees": 2}})
    one = experiment(tmp_path / "a.npz", FOREST, choice=choice)
    result = run_experiment(pickle.loads(pickle.dumps(one)))
    assert trained == [(2, None), (2, 99), (5, None)]
    assert result["chosen"]["setting"] == {}
    assert one.code != replace(one, choice=Choice(settings, repeats=1)).code


def test_transform_is_a_setting(tmp_path):
    touches(tmp_path / "a.npz")
    no_readings = {
        "class_path": "torch_geometric_tactile.transforms.DropTaxels",
        "init_args": {"taxels": list(range(12))},
    }
    settings = [{"transform": no_readings}, {}]
    result = run_experiment(experiment(tmp_path / "a.npz", SVM, settings))
    assert result["chosen"]["number"] == 1
    settings = [{}, {"transform": no_readings}]
    result = run_experiment(experiment(tmp_path / "a.npz", SVM, settings))
    assert result["chosen"]["number"] == 0
    alone = experiment(tmp_path / "a.npz", SVM, settings[1:])
    assert run_experiment(alone)["metrics"]["accuracy"] < 0.5 < result["metrics"]["accuracy"]


def test_network_gives_the_same_numbers_again(tmp_path):
    touches(tmp_path / "a.npz")
    one = experiment(tmp_path / "a.npz", FNN, epochs=30)
    result = run_experiment(one)
    assert result["chosen"] == {"setting": {}, "number": 0, "validation": []}
    assert result["metrics"]["accuracy"] > 0.5
    assert result["num_parameters"] == 12 * 8 + 8 + 8 * 3 + 3
    again = run_experiment(pickle.loads(pickle.dumps(one)))
    assert told(again) == told(result)


def test_networks_are_averaged(tmp_path, monkeypatch):
    touches(tmp_path / "a.npz")
    seeds, said = [], []
    fit, collect = networks.fit_classifier, networks.collect_predictions

    def watched(model, data, seed, *rest):
        seeds.append(seed)
        return fit(model, data, seed, *rest)

    def collected(*arguments):
        said.append(collect(*arguments))
        return said[-1]

    monkeypatch.setattr(networks, "fit_classifier", watched)
    monkeypatch.setattr(networks, "collect_predictions", collected)
    one = experiment(tmp_path / "a.npz", FNN, epochs=2)
    result = run_experiment(replace(one, choice=Choice(members=3), seed=1))
    assert seeds == [1, 1001, 2001]
    mean = sum(part.probability for part in said) / 3
    found = Predictions.from_dict(result["predictions"]).prediction
    assert found.tolist() == mean.argmax(dim=1).tolist()
    assert not torch.equal(said[0].probability, said[1].probability)
    assert result["num_parameters"] == 3 * (12 * 8 + 8 + 8 * 3 + 3)


@pytest.mark.parametrize("model", [FOREST, FNN], ids=["forest", "fnn"])
@pytest.mark.parametrize("what", ["y", "x"])
def test_garbage_in_the_test_part_changes_no_choice(tmp_path, model, what):
    few = {"model": {"init_args": {"widths": [2]}}}
    settings = [{"init_args": {"min_samples_leaf": 3}} if model is FOREST else few, {}]
    content = touches(tmp_path / "a.npz", part=GIVEN)
    garbage = content[what].copy()
    is_test = GIVEN == 2
    garbage[is_test] = (content["y"][is_test] + 1) % 3 if what == "y" else 1e3
    touches(tmp_path / "b.npz", part=GIVEN, **{what: garbage})
    given = {"protocol": Protocol("given"), "choice": Choice(settings, num_validation_cuts=5)}
    found = [
        run_experiment(experiment(tmp_path / name, model, **given)) for name in ("a.npz", "b.npz")
    ]
    assert found[0]["chosen"] == found[1]["chosen"]
    assert found[0]["validation"] == found[1]["validation"]
    if what == "y":  # nor what is predicted
        said = [result["predictions"]["prediction"] for result in found]
        assert said[0] == said[1]
        assert found[1]["metrics"] != found[0]["metrics"]


def test_labels_that_are_chosen_on_do_change_the_choice(tmp_path):
    content = touches(tmp_path / "a.npz", part=GIVEN)
    garbage = np.where(GIVEN == 1, (content["y"] + 1) % 3, content["y"])
    touches(tmp_path / "b.npz", part=GIVEN, y=garbage)
    settings = [{"init_args": {"C": c}} for c in (1.0, 10.0)]
    found = [
        run_experiment(experiment(tmp_path / name, settings=settings, protocol=Protocol("given")))
        for name in ("a.npz", "b.npz")
    ]
    assert found[0]["chosen"] != found[1]["chosen"]


def test_numbers_of_any_unit_are_predicted(tmp_path):
    x = np.random.default_rng(0).normal(size=(48, 3, 4))
    y = 1e-6 * x[:, 0, 0] + 5e-5
    touches(tmp_path / "a.npz", x=x, y=y)
    network = {**FNN, "task": "regression"}
    result = run_experiment(experiment(tmp_path / "a.npz", network, metric="mae", epochs=60))
    assert result["metrics"]["mae"] < 0.5e-6
    assert result["metrics"]["r2"] > 0.5
    settings = [{"optimizer": {"init_args": {"lr": lr}}} for lr in (1e-6, 0.01)]
    chosen = run_experiment(
        experiment(tmp_path / "a.npz", network, settings, metric="mae", epochs=60)
    )["chosen"]
    assert chosen["number"] == 1
    assert chosen["validation"][0] < chosen["validation"][1] < 0


def test_setting_that_diverges_is_not_chosen(tmp_path):
    touches(tmp_path / "a.npz")
    wild = {"optimizer": {"class_path": "torch.optim.SGD", "init_args": {"lr": 1e38}}}
    one = experiment(tmp_path / "a.npz", FNN, [wild, {}])
    chosen = run_experiment(one)["chosen"]
    assert chosen["number"] == 1
    assert chosen["validation"][0] is None
    alone = replace(one, choice=Choice([wild]))
    assert "finite" in run_here(alone)["error"]


def test_missing_readings_are_filled(tmp_path):
    x = touches(tmp_path / "a.npz")["x"].copy()
    x[::7, 0, 1] = np.nan
    x[:, 2, 3] = np.nan
    touches(tmp_path / "a.npz", x=x)
    fill = {"class_path": "torch_geometric_tactile.transforms.FillMissing"}
    both = {
        "class_path": "torch_geometric.transforms.Compose",
        "init_args": {"transforms": [SCALED, fill]},
    }
    for model in (FNN, SVM, FOREST):
        result = run_experiment(experiment(tmp_path / "a.npz", model, transform=both, epochs=10))
        assert result["metrics"]["accuracy"] > 0.5


def test_choice_is_part_of_the_identity(tmp_path):
    touches(tmp_path / "a.npz")
    one = experiment(tmp_path / "a.npz")
    assert one.code != replace(one, choice=Choice(metric="balanced_accuracy")).code
    assert "choice" not in replace(one, choice=None).identity()


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ({"metric": "f1"}, r"'metric' must be one of \['accuracy'"),
        ({"settings": ()}, "'settings' must hold at least one setting"),
        ({"members": 0}, r"'members' must be at least 1 \(got 0\)"),
        ({"repeats": 0}, r"'repeats' must be at least 1 \(got 0\)"),
    ],
)
def test_wrong_choice_is_refused(arguments, match):
    with pytest.raises(ValueError, match=match):
        Choice(**arguments)


def test_scaled_targets_come_back(tmp_path):
    y = np.array([[1.0, 7.0], [3.0, 7.0]] * 24)
    touches(tmp_path / "a.npz", y=y)
    dataset = SamplesFile(tmp_path / "a.npz", grid="3x4")
    scale = TargetScale.from_samples(dataset)
    data = scale(dataset.data)
    assert data.y[:2].tolist() == [[-1.0, 0.0], [1.0, 0.0]]
    assert scale.unscale(data.y).tolist() == y.tolist()


class Zeros(BaseTransform):
    supports_static = True

    def forward(self, data):
        data.x = torch.zeros_like(data.x)
        return data


@pytest.mark.parametrize("chosen", [True, False])
def test_estimators_see_the_transform_of_the_data_set(tmp_path, chosen):
    touches(tmp_path / "a.npz")
    changes = {"transform": {"class_path": f"{__name__}.Zeros"}}
    source = experiment(tmp_path / "a.npz").data.with_arguments(changes)
    choice = {} if chosen else {"choice": None}
    result = run_experiment(experiment(tmp_path / "a.npz", data=source.resolve()[0], **choice))
    prediction = Predictions.from_dict(result["predictions"]).prediction
    assert len(set(prediction.tolist())) == 1  # nothing is left to tell samples apart
