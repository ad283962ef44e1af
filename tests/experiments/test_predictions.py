import pytest

pytest.importorskip("lightning", reason="needs the extra 'train'")

import json
import math

import numpy as np

from torch_geometric_tactile.experiments.predictions import Predictions
from torch_geometric_tactile.training import classification_metrics

JUDGED = Predictions(
    score=np.array([0.9, 0.8, 0.2, 0.1]),
    prediction=np.array([1, 1, 0, 0]),
    y=np.array([1, 0, 0, 0]),
    session=np.array([3, 3, 4, 4]),
)


def test_metrics_by_hand():
    metrics = JUDGED.metrics()
    assert metrics["accuracy"] == 0.75
    assert metrics["f1_positive"] == pytest.approx(2 / 3)
    assert metrics["f1"] == pytest.approx((2 / 3 + 4 / 5) / 2)
    assert metrics["auroc"] == 1.0


@pytest.mark.parametrize("num_classes", [2, 4])
def test_metrics_are_those_of_training(num_classes):
    draw = np.random.default_rng(0)
    score = draw.dirichlet(np.ones(num_classes), 200)
    y = draw.integers(0, num_classes, 200)
    metrics = Predictions(score, score.argmax(1), y).metrics()
    expected = classification_metrics(score, y)
    for name in ("accuracy", "f1", "auroc"):
        assert metrics[name] == pytest.approx(expected[name], abs=1e-6)
    assert ("f1_positive" in metrics) == (num_classes == 2)


def test_metrics_of_labels_are_those_of_training():
    draw = np.random.default_rng(1)
    score, y = draw.random((50, 3)), draw.integers(0, 2, (50, 3))
    metrics = Predictions(score, (score > 0.5).astype(int), y).metrics()
    expected = classification_metrics(score, y, "multilabel")
    assert metrics.keys() >= {"label_accuracy", "label_accuracy_2"}
    for name in ("accuracy", "label_accuracy", "label_accuracy_2", "f1", "auroc"):
        assert metrics[name] == pytest.approx(expected[name], abs=1e-6)


def test_class_that_is_neither_there_nor_expected():
    nothing = Predictions(np.zeros(3), np.zeros(3, dtype=int), np.zeros(3, dtype=int))
    metrics = nothing.metrics()
    assert (metrics["f1"], metrics["f1_positive"]) == (1.0, 0.0)
    assert math.isnan(metrics["auroc"])


def test_some_samples_and_all_again():
    first, second = (JUDGED.select(JUDGED.session == session) for session in (3, 4))
    assert first.y.tolist() == [1, 0]
    assert Predictions.join([first, second]).to_dict() == JUDGED.to_dict()


def test_bits_are_kept_as_json():
    draw = np.random.default_rng(0)
    score = draw.random((5, 2)).astype(np.float32)
    predicted = Predictions(score, score.argmax(1), np.arange(5) % 2)
    again = Predictions.from_dict(json.loads(json.dumps(predicted.to_dict())))
    assert again.score.dtype == np.float32
    assert np.array_equal(again.score, score)
    assert again.prediction.dtype == np.int64
    assert again.session is None
