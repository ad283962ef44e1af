r"""Experiments that choose settings on a validation part, and look at the test once."""

import copy
import math
import time
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor
from torch_geometric.data import Data
from torch_geometric.transforms import BaseTransform, Compose

from torch_geometric_tactile.data import StaticDataset
from torch_geometric_tactile.experiments._building import build
from torch_geometric_tactile.experiments._estimators import (
    estimator_input,
    fitted_samples,
    num_numbers,
    seeded_estimator,
)
from torch_geometric_tactile.experiments._experiment import Experiment
from torch_geometric_tactile.experiments._fitting import Clock, fit_classifier, warm_up
from torch_geometric_tactile.experiments._held_out import Parts, choice_parts, column_of
from torch_geometric_tactile.experiments._scores import prediction_scores
from torch_geometric_tactile.experiments.judgement import Judgement
from torch_geometric_tactile.sensors import TaxelLayout
from torch_geometric_tactile.training._config_files import merged
from torch_geometric_tactile.training._predictions import Predictions, collect_predictions
from torch_geometric_tactile.training.data_module import TactileDataModule
from torch_geometric_tactile.training.one_cycle import OneCycle
from torch_geometric_tactile.transforms import KNNGraph

_NEIGHBOURS = 6
_NEXT_SEED = 1000  # of the next network, beyond the seeds of experiments


class Scored(NamedTuple):
    r"""A score, the higher the better, and the loss that decides between equals."""

    value: float
    loss: float = 0.0


_NO_SCORE = Scored(-math.inf, math.inf)


class Fitted(NamedTuple):
    r"""What a model that was trained says of samples: its predictions, their score if it was asked
    for, how many numbers it holds, and for how many seconds it was trained and predicted.
    """

    prediction: np.ndarray
    score: Scored | None
    num_parameters: int | None
    seconds: float
    predict_seconds: float


def run_choosing(experiment: Experiment) -> dict[str, Any]:
    r"""Tries the settings of :obj:`experiment.choice` on a validation part, trains the best of them
    on the whole training part, and predicts the test part once.
    """
    assert experiment.choice is not None
    parts = choice_parts(experiment)
    start = time.perf_counter()
    count = len(experiment.choice.settings)
    scores = [_tried(experiment, parts, i) for i in range(count)] if count > 1 else []
    best = max(range(len(scores)), key=lambda i: (scores[i].value, -scores[i].loss, -i), default=0)
    choosing = time.perf_counter() - start
    model = _model(experiment, best)
    fitted = fit_and_predict(experiment, model, parts.train, parts.test)
    y = _labels(parts.test).numpy()
    return {
        "metrics": _finite(prediction_scores(y, fitted.prediction, experiment.choice.of_numbers)),
        "label_names": None,
        "frames_per_second": len(parts.train) * max(1, experiment.epochs) / fitted.seconds,
        "peak_memory_mb": None,
        "measures": None,
        "num_parameters": fitted.num_parameters,
        "choose_seconds": choosing,
        "train_seconds": fitted.seconds,
        "predict_seconds": fitted.predict_seconds,
        "chosen": {
            "setting": dict(experiment.choice.settings[best]),
            "number": best,
            "validation": [score.value if math.isfinite(score.value) else None for score in scores],
        },
        "predictions": Judgement(
            score=fitted.prediction,
            prediction=fitted.prediction,
            y=y,
            trial=column_of(parts.test, "trial"),
            index=np.asarray(parts.test.indices()),
        ).to_dict(),
        "num_train": len(parts.train),
        "num_test": len(parts.test),
    }


def _tried(experiment: Experiment, parts: Parts, number: int) -> Scored:
    # A setting with which a training fails, such as a learning rate that makes it diverge, is not
    # chosen.
    try:
        model = _model(experiment, number)
        score = fit_and_predict(experiment, model, parts.fit, parts.val, is_scored=True).score
    except ValueError:
        return _NO_SCORE
    assert score is not None
    return score


def _model(experiment: Experiment, number: int) -> dict[str, Any]:
    assert experiment.choice is not None
    return merged(experiment.model, experiment.choice.settings[number])


def fit_and_predict(
    experiment: Experiment,
    model: Mapping[str, Any],
    train: StaticDataset,
    other: StaticDataset,
    *,
    is_scored: bool = False,
) -> Fitted:
    r"""Trains a model on one part and returns what it says of another."""
    fit = _fit_estimator if experiment.is_estimator else _fit_network
    return fit(experiment, model, train, other, is_scored)


def _fit_estimator(
    experiment: Experiment,
    model: Mapping[str, Any],
    train: StaticDataset,
    other: StaticDataset,
    is_scored: bool,
) -> Fitted:
    assert experiment.choice is not None
    transform = build(experiment.transform)
    seen = fitted_samples(transform, train)
    held_out = fitted_samples(transform, other, adapt=True)
    estimator = seeded_estimator(model, train.layout, experiment.seed)
    start = time.perf_counter()
    estimator.fit(estimator_input(estimator, seen), seen.y.numpy())
    seconds = time.perf_counter() - start
    start = time.perf_counter()
    prediction = np.asarray(estimator.predict(estimator_input(estimator, held_out)))
    predicting = time.perf_counter() - start
    score = None
    if is_scored:
        score = Scored(_value(experiment, held_out.y.numpy(), prediction))
    return Fitted(prediction, score, num_numbers(estimator), seconds, predicting)


def _fit_network(
    experiment: Experiment,
    model: Mapping[str, Any],
    train: StaticDataset,
    other: StaticDataset,
    is_scored: bool,
) -> Fitted:
    assert experiment.choice is not None
    numbers = experiment.choice.of_numbers
    scale = TargetScale.of(train) if numbers else None
    train, other = (_prepared(part, scale) for part in (train, other))
    data = TactileDataModule(
        train,
        test_dataset=other,  # its sessions, if anything is scaled by session, are measured too
        split="frame",
        val=0.0,
        transform=build(experiment.transform),
        batch_size=experiment.batch_size,
    )
    data.setup()
    warm_up(experiment.accelerator)
    section = dict(model)
    if not numbers:
        section.setdefault("num_classes", experiment.data.load().num_classes)
    settings = {"accelerator": experiment.accelerator, "limit_val_batches": 0}
    settings |= experiment.trainer
    members = 1 if is_scored else experiment.choice.members
    said, seconds, predicting, size = [], 0.0, 0.0, 0
    for member in range(members):
        clock, seed = Clock(), experiment.seed + _NEXT_SEED * member
        classifier = fit_classifier(
            section, data, seed, settings, experiment.epochs, OneCycle(), clock
        )
        seconds += clock.seconds
        size += sum(weight.numel() for weight in classifier.model.parameters())
        start = time.perf_counter()
        said.append(collect_predictions(classifier, data.test_dataloader()))
        predicting += time.perf_counter() - start
    score = _score(experiment, said[0], scale) if is_scored else None
    return Fitted(_predicted(said, scale), score, size, seconds, predicting)


def _score(experiment: Experiment, said: Predictions, scale: "TargetScale | None") -> Scored:
    prediction = _predicted([said], scale)
    if scale is not None:
        return Scored(_value(experiment, scale.back(said.y).numpy(), prediction))
    loss = float(F.cross_entropy(said.logits, said.y))
    return Scored(_value(experiment, said.y.numpy(), prediction), loss)


def _predicted(said: Sequence[Predictions], scale: "TargetScale | None") -> np.ndarray:
    # What several networks say on average.
    if scale is None:
        return torch.stack([one.probability for one in said]).mean(dim=0).argmax(dim=-1).numpy()
    logits = torch.stack([one.logits for one in said]).mean(dim=0)
    return scale.back(logits.view(said[0].y.shape)).numpy()


def _value(experiment: Experiment, y: np.ndarray, prediction: np.ndarray) -> float:
    assert experiment.choice is not None
    metric = experiment.choice.metric
    value = prediction_scores(y, prediction, experiment.choice.of_numbers)[metric]
    return -value if metric == "mae" else value


def _labels(part: StaticDataset) -> Tensor:
    y = part.column("y")  # of `data`, all windows would be cut for them
    assert y is not None
    return y


class TargetScale(BaseTransform):
    r"""Shifts and scales the numbers to be predicted to mean zero and standard deviation one over
    the training part.
    """

    supports_static = True

    def __init__(self, center: Tensor, scale: Tensor) -> None:
        self.center = center
        self.scale = scale

    @classmethod
    def of(cls, train: StaticDataset) -> "TargetScale":
        r"""Measures a training part."""
        y = _labels(train).double()
        scale = y.std(dim=0, correction=0)
        return cls(y.mean(dim=0), torch.where(scale > 0, scale, 1.0))

    def forward(self, data: Data) -> Data:
        r"""Sets :obj:`y`."""
        data.y = ((data.y.double() - self.center) / self.scale).float()
        return data

    def back(self, y: Tensor) -> Tensor:
        r"""Returns numbers in their own unit."""
        return y.double() * self.scale + self.center


class _Edges(BaseTransform):
    supports_static = True

    def __init__(self, edge_index: Tensor) -> None:
        self.edge_index = edge_index

    def forward(self, data: Data) -> Data:
        data.edge_index = self.edge_index
        return data


def layout_edges(layout: TaxelLayout) -> Tensor:
    r"""Returns the edges of samples that have none: the layout's :obj:`"original"` or first
    adjacency, or else the six nearest neighbours of each taxel.
    """
    if layout.adjacency:
        names = list(layout.adjacency)
        return layout.edge_index("original" if "original" in names else names[0])
    if layout.num_taxels == 1:
        return torch.zeros(2, 0, dtype=torch.long)
    k = min(_NEIGHBOURS, layout.num_taxels - 1)
    edges: Tensor = KNNGraph(k)(Data(pos=layout.pos)).edge_index
    return edges


def _prepared(part: StaticDataset, scale: TargetScale | None) -> StaticDataset:
    steps: list[BaseTransform] = [] if part.transform is None else [part.transform]
    if part[:1].batch([0]).edge_index is None:
        steps.append(_Edges(layout_edges(part.layout)))
    if scale is not None:
        steps.append(scale)
    out = copy.copy(part)
    out.transform = Compose(steps) if steps else None
    return out


def _finite(metrics: Mapping[str, float]) -> dict[str, float | None]:
    return {name: value if math.isfinite(value) else None for name, value in metrics.items()}
