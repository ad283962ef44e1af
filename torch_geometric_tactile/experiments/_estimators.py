r"""Estimators of scikit-learn as models of experiments."""

import inspect
import time
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from sklearn.utils import get_tags
from torch_geometric.transforms import BaseTransform

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.data import StaticData, apply_transform
from torch_geometric_tactile.data._graph_samples import GraphSamples, SampleSet
from torch_geometric_tactile.experiments._building import build_object, find_class
from torch_geometric_tactile.experiments._experiment import Experiment, Fitted
from torch_geometric_tactile.experiments.studies import Trained
from torch_geometric_tactile.sensors import TaxelLayout
from torch_geometric_tactile.training._threshold import choose_threshold
from torch_geometric_tactile.transforms import fit_transform


def fit_estimator(
    experiment: Experiment,
    train: SampleSet,
    test: SampleSet,
    val: SampleSet | None = None,
) -> Fitted:
    r"""Fits an estimator and returns what it says of other samples."""
    transform = build_object(experiment.transform)
    seen = fitted_samples(transform, train)
    held_out = fitted_samples(transform, test, adapt=True)
    estimator = seeded_estimator(experiment.model, train.layout, experiment.seed)
    x, x_test = (estimator_input(estimator, part) for part in (seen, held_out))
    start = time.perf_counter()
    estimator.fit(x, seen.y.numpy())
    seconds = time.perf_counter() - start
    start = time.perf_counter()
    prediction = np.asarray(estimator.predict(x_test))
    predicting = time.perf_counter() - start
    is_chosen, threshold = experiment.choice is not None, None
    score = prediction if is_chosen else class_scores(estimator, x_test, train.num_classes)
    if val is not None and experiment.threshold is not None:
        other = fitted_samples(transform, val, adapt=True)
        seen_score = class_scores(estimator, estimator_input(estimator, other), train.num_classes)
        threshold = choose_threshold(
            _positive_score(seen_score),
            other.y.numpy(),
            experiment.threshold,
            default=0.0 if score.ndim == 1 else 0.5,
        )
        prediction = (_positive_score(score) > threshold).astype(np.int64)
    return Fitted(
        score=score,
        prediction=prediction,
        y=held_out.y.numpy(),
        num_parameters=num_numbers(estimator) if is_chosen else None,
        seconds=seconds,
        predict_seconds=predicting,
        threshold=threshold,
        trained=None
        if train.layout is None
        else Trained(estimator, seen, held_out, train.class_names, train.layout, experiment.seed),
    )


def seeded_estimator(model: Mapping[str, Any], layout: TaxelLayout | None, seed: int) -> Any:
    # Its `layout`, if it has such an argument, is that of the data; its random state, if it is left
    # open, is the seed.
    arguments = dict(model.get("init_args") or {})
    path = model["class_path"]
    known = inspect.signature(find_class(path)).parameters
    if "layout" in known:
        arguments.setdefault("layout", layout)
    missing = [
        name
        for name, parameter in known.items()
        if parameter.default is parameter.empty
        and parameter.kind not in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD)
        and name not in arguments
    ]
    need(
        not missing,
        f"'{path}' must not need arguments other than 'layout', the only one that it is called "
        f"with if it has it (it needs {', '.join(missing)}); give the others a default",
    )
    estimator = build_object({**model, "init_args": arguments})
    need(
        all(hasattr(estimator, name) for name in ("get_params", "set_params", "fit", "predict")),
        f"'{path}' must return an estimator of scikit-learn; of a network, give the class itself",
        type(estimator).__name__,
    )
    parameters = estimator.get_params()
    open_states = [
        name
        for name, value in parameters.items()
        if name.rpartition("__")[2] == "random_state" and value is None
    ]
    return estimator.set_params(**dict.fromkeys(open_states, seed))


def fitted_samples(
    transform: BaseTransform | None, part: SampleSet, *, adapt: bool = False
) -> StaticData:
    r"""Returns all samples of a part in memory, behind the transform of their data set, as networks
    see them, and behind another, which is fitted on them.
    """
    if isinstance(part, GraphSamples):  # for the constant answer, which reads labels only
        return StaticData(x=torch.zeros(len(part), 1, 1), y=part.column("y"))
    data: StaticData = part.data
    data = data if part.transform is None else apply_transform(part.transform, data)
    return fit_transform(transform, data, adapt=adapt)


def estimator_input(estimator: Any, samples: StaticData) -> StaticData | np.ndarray:
    r"""Returns what an estimator is fitted on: samples if its first step takes them, readings
    :math:`(S, N, F)` if its tags tell that it knows taxels, and otherwise rows of numbers.
    """
    first = estimator.steps[0][1] if hasattr(estimator, "steps") else estimator
    if getattr(first, "takes_samples", False):
        return samples
    x: np.ndarray = samples.x.numpy()
    return x if get_tags(estimator).input_tags.three_d_array else x.reshape(len(x), -1)


def class_scores(estimator: Any, x: Any, num_classes: int) -> np.ndarray:
    r"""Returns scores of the classes :math:`(S, C)`, or of class 1 of two :math:`(S,)`."""
    method = "decision_function" if hasattr(estimator, "decision_function") else "predict_proba"
    scores: np.ndarray = getattr(estimator, method)(x)
    if scores.ndim == 1 or scores.shape[1] == num_classes:
        return scores
    # The training part lacks classes.
    complete = np.full((len(scores), num_classes), scores.min())
    complete[:, estimator.classes_] = scores
    return complete


def _positive_score(score: np.ndarray) -> np.ndarray:
    # One number a sample (S,), higher where class 1 of two is expected.
    if score.ndim == 2 and score.shape[1] != 2:
        raise ValueError(f"'threshold' must be None unless of two classes (got {score.shape[1]})")
    return score if score.ndim == 1 else np.asarray(score[:, 1])


def num_numbers(estimator: Any) -> int | None:
    # How many fitted numbers it holds: weights and biases of a linear one, support vectors
    # with their weights, nodes of trees, visual words; None for other estimators.
    last = estimator.steps[-1][1] if hasattr(estimator, "steps") else estimator
    last = getattr(last, "regressor_", last)
    parts = getattr(last, "estimators_", [last])
    parts = parts.ravel().tolist() if isinstance(parts, np.ndarray) else list(parts)
    found = [_of_one(part) for part in parts]
    return None if None in found else sum(found)  # type: ignore[arg-type]


def _of_one(part: Any) -> int | None:
    if hasattr(part, "words_"):
        machine = _of_one(part.svm_)
        return None if machine is None else int(part.words_.size) + machine
    if hasattr(part, "tree_"):
        return int(part.tree_.node_count)
    if hasattr(part, "support_vectors_"):
        return int(part.support_vectors_.size + part.dual_coef_.size + np.size(part.intercept_))
    if hasattr(part, "coef_"):
        return int(np.size(part.coef_) + np.size(part.intercept_))
    if hasattr(part, "constant_") or hasattr(part, "class_prior_"):
        return int(np.size(getattr(part, "constant_", part.__dict__.get("class_prior_"))))
    return None
