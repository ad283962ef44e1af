import numpy as np
import pytest
import torch
from sklearn.metrics import accuracy_score, balanced_accuracy_score, f1_score

pytest.importorskip("lightning", reason="needs the extra 'train'")


from training_fixtures import quiet_trainer

from torch_geometric_tactile.datasets import FakeTactileDataset
from torch_geometric_tactile.nn.models import GraspGCN
from torch_geometric_tactile.predictor import Predictor
from torch_geometric_tactile.training import TactileDataModule, TactileModule
from torch_geometric_tactile.training._threshold import (
    THRESHOLD_METRICS,
    BestThreshold,
    choose_threshold,
)
from torch_geometric_tactile.training.metrics import classification_metrics
from torch_geometric_tactile.transforms import KNNGraph

_SCORES = {
    "accuracy": accuracy_score,
    "balanced_accuracy": balanced_accuracy_score,
    "f1": lambda y, said: f1_score(y, said, average="macro"),
    "f1_positive": f1_score,
}


def test_threshold_by_hand():
    score, y = np.array([0.1, 0.2, 0.3, 0.6]), np.array([0, 1, 1, 1])
    assert choose_threshold(score, y, "accuracy") == pytest.approx(0.15)
    assert choose_threshold(score, y[::-1].copy(), "f1_positive") < 0.1


@pytest.mark.full
@pytest.mark.parametrize("metric", THRESHOLD_METRICS)
@pytest.mark.parametrize("seed", range(5))
def test_no_other_threshold_is_better(metric, seed):
    rng = np.random.default_rng(seed)
    y = rng.integers(2, size=40)
    y[:2] = 0, 1
    score = np.round(np.clip(0.3 * y + rng.normal(0.3, 0.2, 40), 0, 1), 2)  # some are equal
    chosen = choose_threshold(score, y, metric)
    measure = _SCORES[metric]
    best = max(measure(y, score > t) for t in np.linspace(-0.005, 1.005, 203))
    assert measure(y, score > chosen) == pytest.approx(best)


def test_threshold_stays_where_nothing_is_better():
    score = np.array([0.1, 0.4, 0.6, 0.9])
    assert choose_threshold(score, np.array([0, 0, 1, 1]), "accuracy") == 0.5
    assert choose_threshold(score, np.ones(4), "accuracy") == 0.5  # one class: nothing to choose by
    decision = choose_threshold(score - 0.5, np.array([0, 0, 1, 1]), "accuracy", default=0.0)
    assert decision == 0.0


@pytest.mark.parametrize(
    ("score", "y"),
    [
        ([0.1, 0.2, 0.3], [1, 0, 0]),  # best is class 0 for all
        ([0.6, 0.7, 0.8], [1, 1, 0]),  # class 1 for all
        ([0.5, 0.6], [0, 1]),  # which is not above itself
    ],
)
def test_threshold_stays_outside_of_the_scores_and_on_one_of_them(score, y):
    assert choose_threshold(np.array(score), np.array(y), "accuracy") == 0.5
    assert choose_threshold(np.array([0.5, 0.6, 0.7]), np.array([1, 1, 0]), "accuracy") < 0.5


def test_batches_give_the_threshold_of_all():
    score = torch.tensor([[0.9, 0.1], [0.8, 0.2], [0.7, 0.3], [0.6, 0.4]])
    y = torch.tensor([0, 0, 1, 1])
    metric = BestThreshold("accuracy")
    metric.update(score[:1], y[:1])
    metric.update(score[1:], y[1:])
    assert float(metric.compute()) == pytest.approx(0.25)


@pytest.mark.parametrize(
    ("score", "metric", "match"),
    [
        ([0.5], "recall", r"'metric' must be one of \['accuracy', .* \(got 'recall'\)"),
        ([float("nan")], "f1", "'score' must hold numbers, none of them NaN"),
        ([], "f1", "'score' must hold numbers"),
    ],
)
def test_bad_scores(score, metric, match):
    with pytest.raises(ValueError, match=match):
        choose_threshold(np.array(score), np.ones(len(score)), metric)


def test_metrics_with_threshold():
    score, y = torch.tensor([[0.9, 0.1], [0.7, 0.3]]), torch.tensor([0, 1])
    assert classification_metrics(score, y)["accuracy"] == 0.5
    values = classification_metrics(score, y, threshold=0.2)
    assert values["accuracy"] == values["recall_positive"] == values["precision_positive"] == 1.0
    with pytest.raises(
        ValueError, match=r"'threshold' must be None unless there are 2 classes \(got 3"
    ):
        classification_metrics(torch.rand(2, 3), y, threshold=0.2)


class _Shifted(torch.nn.Module):
    # Ranks the samples rightly, but far from one half.
    def __init__(self):
        super().__init__()
        self.weight = torch.nn.Parameter(torch.ones(1))

    def forward(self, x, edge_index=None):
        score = self.weight * x.mean(dim=(1, 2)) - 5
        return torch.stack([-score, score], dim=1)


def _data(num_samples=80, **arguments):
    dataset = FakeTactileDataset(num_samples, pre_transform=KNNGraph(2))
    dataset.data.x = dataset.data.y.view(-1, 1, 1).expand_as(dataset.data.x).float().clone()
    return TactileDataModule(dataset, split="frame", val=0.3, test=0.3, batch_size=20, **arguments)


def test_threshold_of_training_counts_in_test_checkpoint_and_predictor(tmp_path):
    data = _data()
    module = TactileModule(
        _Shifted(), lambda p: torch.optim.SGD(p, lr=0.0), threshold="balanced_accuracy"
    )
    trainer = quiet_trainer()
    trainer.fit(module, data)
    assert float(trainer.callback_metrics["val/accuracy"]) < 1  # without the threshold
    logged = float(trainer.callback_metrics["val/threshold"])
    assert module.decision_threshold == pytest.approx(logged)
    assert module.decision_threshold < 0.01
    (tested,) = trainer.test(module, data, verbose=False)
    assert tested["test/accuracy"] == tested["test/recall_positive"] == 1.0

    path = tmp_path / "last.ckpt"
    trainer.save_checkpoint(path)
    again = TactileModule(_Shifted(), threshold="balanced_accuracy")
    again.on_load_checkpoint(torch.load(path, weights_only=True))
    assert again.decision_threshold == module.decision_threshold
    predictor = Predictor.from_checkpoint(path, _Shifted())
    assert predictor.threshold == module.decision_threshold
    said = predictor.labels(predictor(torch.ones(2, 24, 3)))
    assert said == [[data.class_names[1]]] * 2
    predictor.save(tmp_path / "grasp.predictor")
    assert Predictor.load(tmp_path / "grasp.predictor", _Shifted()).threshold == predictor.threshold


def test_validation_alone_changes_no_threshold():
    data = _data()
    module = TactileModule(_Shifted(), threshold="accuracy")
    module.decision_threshold = 0.7
    quiet_trainer().validate(module, data, verbose=False)
    assert module.decision_threshold == 0.7


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ({"threshold": "recall"}, "'threshold' must be a probability, or the metric that"),
        ({"threshold": 1.5}, r"'threshold' must be a probability, .* \(got 1.5\)"),
        ({"threshold": 0.5, "task": "multilabel"}, "'threshold' must be left out for task='multil"),
    ],
)
def test_bad_thresholds(arguments, match):
    for probability in (0, 1.0):
        TactileModule(_Shifted(), threshold=probability)
    with pytest.raises(ValueError, match=match):
        TactileModule(_Shifted(), **arguments)


def test_threshold_needs_a_validation_part_and_two_classes():
    dataset = FakeTactileDataset(40, pre_transform=KNNGraph(2))
    data = TactileDataModule(dataset, split="frame", val=0.0)
    module = TactileModule(GraspGCN(), threshold="accuracy")
    with pytest.raises(ValueError, match="'threshold' must be a number without a validation part"):
        quiet_trainer().fit(module, data)
    module = TactileModule(GraspGCN(out_channels=3), num_classes=3, threshold=0.4)
    with pytest.raises(ValueError, match=r"'threshold' must be left out unless .* \(got 3\)"):
        quiet_trainer().fit(module, data)


@pytest.mark.parametrize(("threshold", "task"), [(1.5, "multiclass"), (0.5, "multilabel")])
def test_predictor_refuses_other_thresholds(threshold, task):
    layout = FakeTactileDataset(5).layout
    with pytest.raises(ValueError, match="'threshold' must be a probability, with task='multicl"):
        Predictor(GraspGCN(), layout, task=task, threshold=threshold)
