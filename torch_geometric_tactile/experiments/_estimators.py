r"""Experiments with scikit-learn estimators."""

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
    r"""Fits an estimator on one part and predicts another part.

    Args:
        experiment (Experiment): The estimator and its settings.
        train (StaticDataset): The samples to fit on.
        test (StaticDataset): The samples to predict.
        val (StaticDataset, optional): The samples on which a decision threshold is selected.
    """
    transform = build_object(experiment.transform)
    train_samples = fitted_samples(transform, train)
    test_samples = fitted_samples(transform, test, adapt=True)
    estimator = seeded_estimator(experiment.model, train.layout, experiment.seed)
    x, x_test = (estimator_input(estimator, part) for part in (train_samples, test_samples))
    start = time.perf_counter()
    estimator.fit(x, train_samples.y.numpy())
    seconds = time.perf_counter() - start
    start = time.perf_counter()
    prediction = np.asarray(estimator.predict(x_test))
    predict_seconds = time.perf_counter() - start
    has_choice, threshold = experiment.choice is not None, None
    # A comparison scores predictions only; class scores would take time, and regressors have none.
    score = prediction if has_choice else class_scores(estimator, x_test, train.num_classes)
    if val is not None and experiment.threshold is not None:
        val_samples = fitted_samples(transform, val, adapt=True)
        val_score = class_scores(
            estimator, estimator_input(estimator, val_samples), train.num_classes
        )
        threshold = choose_threshold(
            _positive_score(val_score),
            val_samples.y.numpy(),
            experiment.threshold,
            default=0.0 if score.ndim == 1 else 0.5,
        )
        prediction = (_positive_score(score) > threshold).astype(np.int64)
    return Fitted(
        score=score,
        prediction=prediction,
        y=test_samples.y.numpy(),
        num_parameters=count_parameters(estimator) if has_choice else None,
        seconds=seconds,
        predict_seconds=predict_seconds,
        threshold=threshold,
        trained=None
        if train.layout is None
        else Trained(
            estimator,
            train_samples,
            test_samples,
            train.class_names,
            train.layout,
            experiment.seed,
        ),
    )


def seeded_estimator(model: Mapping[str, Any], layout: TaxelLayout | None, seed: int) -> Any:
    r"""Returns an estimator built from plain data. If they are left out, an argument
    :obj:`layout` is the layout of the data, and a random state is the seed.

    Args:
        model (Mapping): The :obj:`class_path` and :obj:`init_args` of the estimator.
        layout (TaxelLayout, optional): The layout of the data.
        seed (int): The seed.

    Raises:
        ValueError: If an argument other than :obj:`layout` has no default, or the object is not an
            estimator of scikit-learn.
    """
    arguments = dict(model.get("init_args") or {})
    path = model["class_path"]
    parameters = inspect.signature(find_class(path)).parameters
    if "layout" in parameters:
        arguments.setdefault("layout", layout)
    missing = [
        name
        for name, parameter in parameters.items()
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
    arguments_with_steps = estimator.get_params()
    unseeded = [
        name
        for name, value in arguments_with_steps.items()
        if name.rpartition("__")[2] == "random_state" and value is None
    ]
    return estimator.set_params(**dict.fromkeys(unseeded, seed))


def fitted_samples(
    transform: BaseTransform | None, part: SampleSet, *, adapt: bool = False
) -> StaticData:
    r"""Returns all samples of a part after two transforms: the transform of their data set, as for
    networks, and a transform that is fitted on the samples.

    Args:
        transform (BaseTransform, optional): The transform to fit.
        part (StaticDataset): The samples.
        adapt (bool): If :obj:`True`, only adapts the fitted transform to new sessions or trials.
    """
    if isinstance(part, GraphSamples):  # only for the constant answer, which ignores readings
        return StaticData(x=torch.zeros(len(part), 1, 1), y=part.column("y"))
    data: StaticData = part.data
    data = data if part.transform is None else apply_transform(part.transform, data)
    return fit_transform(transform, data, adapt=adapt)


def estimator_input(estimator: Any, samples: StaticData) -> StaticData | np.ndarray:
    r"""Returns the input of an estimator: the samples if its first step has :obj:`takes_samples`;
    readings :math:`(S, N, F)` if its tags allow three-dimensional arrays; otherwise rows
    :math:`(S, N \cdot F)`.
    """
    first = estimator.steps[0][1] if hasattr(estimator, "steps") else estimator
    if getattr(first, "takes_samples", False):
        return samples
    x: np.ndarray = samples.x.numpy()
    return x if get_tags(estimator).input_tags.three_d_array else x.reshape(len(x), -1)


def class_scores(estimator: Any, x: Any, num_classes: int) -> np.ndarray:
    r"""Returns the scores of the classes :math:`(S, C)`, or for two classes the scores of class 1
    :math:`(S,)`. A class that is missing from the training part gets the lowest score.
    """
    method = "decision_function" if hasattr(estimator, "decision_function") else "predict_proba"
    scores: np.ndarray = getattr(estimator, method)(x)
    if scores.ndim == 1 or scores.shape[1] == num_classes:
        return scores
    complete = np.full((len(scores), num_classes), scores.min())
    complete[:, estimator.classes_] = scores
    return complete


def _positive_score(score: np.ndarray) -> np.ndarray:
    # Returns one score per sample (S,), which is higher if class 1 of two is expected.
    if score.ndim == 2 and score.shape[1] != 2:
        raise ValueError(
            f"'threshold' must be None unless there are two classes (got {score.shape[1]})"
        )
    return score if score.ndim == 1 else np.asarray(score[:, 1])


def count_parameters(estimator: Any) -> int | None:
    r"""Returns how many numbers an estimator has fitted: weights and biases of linear models,
    support vectors with their weights, nodes of trees, and visual words. Returns :obj:`None` for
    other estimators.
    """
    last = estimator.steps[-1][1] if hasattr(estimator, "steps") else estimator
    last = getattr(last, "regressor_", last)
    parts = getattr(last, "estimators_", [last])
    parts = parts.ravel().tolist() if isinstance(parts, np.ndarray) else list(parts)
    sizes = [_count_part_parameters(part) for part in parts]
    return None if None in sizes else sum(sizes)  # type: ignore[arg-type]


def _count_part_parameters(part: Any) -> int | None:
    if hasattr(part, "words_"):
        num_svm = _count_part_parameters(part.svm_)
        return None if num_svm is None else int(part.words_.size) + num_svm
    if hasattr(part, "tree_"):
        return int(part.tree_.node_count)
    if hasattr(part, "support_vectors_"):
        return int(part.support_vectors_.size + part.dual_coef_.size + np.size(part.intercept_))
    if hasattr(part, "coef_"):
        return int(np.size(part.coef_) + np.size(part.intercept_))
    if hasattr(part, "constant_") or hasattr(part, "class_prior_"):
        return int(np.size(getattr(part, "constant_", part.__dict__.get("class_prior_"))))
    return None
