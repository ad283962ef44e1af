import pytest

pytest.importorskip("lightning", reason="needs the extra 'train'")

import time

import numpy as np
import torch

from torch_geometric_tactile.data import Protocol
from torch_geometric_tactile.datasets import FakeTactileDataset
from torch_geometric_tactile.experiments._estimators import fit_estimator
from torch_geometric_tactile.experiments._experiment import Experiment
from torch_geometric_tactile.experiments._run_experiment import run_experiment
from torch_geometric_tactile.experiments.predictions import Predictions
from torch_geometric_tactile.experiments.source import DataSource
from torch_geometric_tactile.training._config import load_config

KNN = {"class_path": "torch_geometric_tactile.transforms.KNNGraph", "init_args": {"k": 2}}
SESSION = {"class_path": "torch_geometric_tactile.transforms.SessionZScore"}
SVM = {"class_path": "torch_geometric_tactile.baselines.GraspSVM"}
MAJORITY = {
    "class_path": "sklearn.dummy.DummyClassifier",
    "init_args": {"strategy": "most_frequent"},
}
FOREST = {
    "class_path": "sklearn.ensemble.RandomForestClassifier",
    "init_args": {"n_estimators": 5},
}


def generated(model, protocol=Protocol("given"), split=None, **changes):  # noqa: B008 - frozen
    arguments = {"num_samples": 120, "num_test": 60, "split": split, "pre_transform": KNN}
    source = DataSource("torch_geometric_tactile.datasets.FakeTactileDataset", arguments)
    return Experiment("m", source, protocol, "p", model, SESSION, **changes)


def judged(experiment):
    return Predictions.from_dict(run_experiment(experiment)["predictions"])


@pytest.mark.parametrize(
    ("model", "middle"),
    [({"class_path": "sklearn.svm.LinearSVC"}, 0.0), (FOREST, 0.5)],
    ids=["decisions", "probabilities"],
)
def test_threshold_is_the_middle_where_one_class_gives_no_choice(model, middle):
    train, test = FakeTactileDataset(60), FakeTactileDataset(30, "test")
    one_class = test[test.data.y == 0]
    experiment = generated(model, threshold="f1")
    fitted = fit_estimator(experiment, train, test, one_class)
    assert fitted.threshold == middle


def test_experiment_is_trained_and_tested(of_grasps):
    experiment = of_grasps(epochs=20, selection={"phases": ["hold"]}, measure_memory=True)
    began = time.perf_counter()
    result = run_experiment(experiment)
    seconds = time.perf_counter() - began
    assert 0 < result["train_seconds"] + result["predict_seconds"] < result["seconds"] < seconds
    # 3 objects with 4 trials of 4 frames, of which 1, 1 and 2 are to test, validate and train.
    assert (result["num_train"], result["num_test"]) == (24, 12)
    assert result["metrics"]["accuracy"] > 0.9  # chance is 0.33
    assert set(result["metrics"]) >= {"accuracy", "f1", "auroc"}
    assert result["label_names"] is None
    assert result["num_parameters"] == 4_463_987
    assert 40 < result["peak_memory_mb"] < 400  # parameters, gradients and Adam's state are 72
    assert result["frames_per_second"] == pytest.approx(24 * 20 / result["train_seconds"])
    predicted = Predictions.from_dict(result["predictions"])
    assert predicted.score.shape == (12, 3)
    assert predicted.metrics()["accuracy"] == result["metrics"]["accuracy"]
    again = run_experiment(experiment)
    assert again["metrics"] == result["metrics"]
    assert again["predictions"] == result["predictions"]


def test_properties_have_named_labels(of_grasps):
    result = run_experiment(
        of_grasps(
            "p1_table2/cnn_a_joint",
            task="property",
            selection={"stride": 2, "phases": ["hold"]},
            protocol=Protocol("frame"),
        )
    )
    assert result["label_names"] == ["light", "heavy", "hard", "soft", "non-slippery", "slippery"]
    assert "label_accuracy_5" in result["metrics"]
    assert result["num_train"] + result["num_test"] < 24
    assert result["peak_memory_mb"] is None  # it was not asked for
    predicted = Predictions.from_dict(result["predictions"])
    for name, value in result["metrics"].items():
        if value is not None:
            assert predicted.metrics()[name] == pytest.approx(value, abs=1e-6)


@pytest.mark.parametrize("model", [SVM, MAJORITY, FOREST])
def test_scikit_learn_is_judged_on_the_given_part(model):
    predicted = judged(generated(model))
    test = FakeTactileDataset(60, "test")
    assert np.array_equal(predicted.y, test.data.y.numpy())
    assert set(predicted.session) == {3, 4, 5}
    if model is MAJORITY:
        assert len(set(predicted.prediction)) == 1
    else:
        assert predicted.metrics()["accuracy"] > 0.5


def test_seed_is_that_of_scikit_learn():
    first, again, other = (judged(generated(FOREST, seed=seed)) for seed in (0, 0, 1))
    assert np.array_equal(first.score, again.score)
    assert not np.array_equal(first.score, other.score)


def test_left_out_objects_are_not_in_training():
    experiment = generated(SVM, Protocol("group", folds=2), split="train")
    train, test = experiment.data.parts(experiment.protocol, 0, 1)
    groups = [set(part.column("group").tolist()) for part in (train, test)]
    assert groups[0]
    assert groups[1]
    assert not groups[0] & groups[1]


def test_training_part_without_a_class_keeps_the_places_of_the_others():
    x = torch.zeros(3, 2).numpy()

    class Estimator:
        classes_ = np.array([0, 2])

        def predict_proba(self, x):
            return np.array([[0.9, 0.1], [0.2, 0.8], [0.5, 0.5]])

    from torch_geometric_tactile.experiments._estimators import class_scores

    assert class_scores(Estimator(), x, 3).tolist() == [
        [0.9, 0.1, 0.1],
        [0.2, 0.1, 0.8],
        [0.5, 0.1, 0.5],
    ]


def test_further_arguments_of_the_trainer_are_passed_on():
    model = load_config("grasp_gcn_df")["model"]
    arguments = {"epochs": 1, "batch_size": 64}
    plain = judged(generated(model, **arguments))
    clipped = judged(generated(model, trainer={"gradient_clip_val": 1e-3}, **arguments))
    assert not np.array_equal(plain.score, clipped.score)


def test_gpu_that_is_not_there(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(ValueError, match=r"'accelerator' must be 'cpu'.*\(got 'gpu'\)"):
        run_experiment(generated(SVM, accelerator="gpu"))
