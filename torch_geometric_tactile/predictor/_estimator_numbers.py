r"""Conversion of fitted scikit-learn pipelines to steps of plain data and tensors."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from sklearn.compose import TransformedTargetRegressor
from sklearn.dummy import DummyClassifier, DummyRegressor
from sklearn.ensemble import (
    ExtraTreesClassifier,
    ExtraTreesRegressor,
    RandomForestClassifier,
    RandomForestRegressor,
)
from sklearn.linear_model import LinearRegression, LogisticRegression, Ridge, RidgeClassifier
from sklearn.multioutput import MultiOutputRegressor
from sklearn.pipeline import Pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.svm import SVC, SVR, LinearSVC, LinearSVR
from sklearn.utils.validation import check_is_fitted
from torch import Tensor

from torch_geometric_tactile.baselines import (
    DescriptorFeatures,
    FlatReadings,
    PosedSummary,
    TemperatureScaling,
)
from torch_geometric_tactile.baselines._window_features import WindowFeatures
from torch_geometric_tactile.sensors import as_layout

_Step = dict[str, Any]
_FORESTS = (
    RandomForestClassifier,
    RandomForestRegressor,
    ExtraTreesClassifier,
    ExtraTreesRegressor,
)
_LINEAR = (LinearSVC, LinearSVR, LogisticRegression, LinearRegression, Ridge, RidgeClassifier)
_SUPPORTED_MODELS = "a forest, a support vector machine, a linear model, ridge or a constant"
_FEATURE_STEPS = "FlatReadings, DescriptorFeatures, PosedSummary or the features of signal_svm"


def fitted_steps(
    estimator: Any, num_classes: int | None, normal: bool = False, tangent: bool = False
) -> list[_Step]:
    r"""Returns the steps of a fitted pipeline as plain data and tensors.

    Args:
        estimator (estimator): The pipeline.
        num_classes (int, optional): Number of classes; :obj:`None` for a regression.
        normal (bool): Whether samples have normals.
        tangent (bool): Whether samples have tangents.

    Raises:
        ValueError: If a part of the pipeline is not supported.
    """
    if not isinstance(estimator, Pipeline) or len(estimator.steps) < 2:
        raise ValueError(
            f"an estimator must be a pipeline that begins with {_FEATURE_STEPS} (got "
            f"{type(estimator).__name__})"
        )
    check_is_fitted(estimator)
    parts = [part for _, part in estimator.steps]
    steps = [_feature_step(parts[0], normal, tangent)]
    for part in parts[1:-1]:
        if type(part) is not StandardScaler:
            raise ValueError(
                "steps between the features and the model must be StandardScaler (got "
                f"{part!r:.80})"
            )
        steps.append(_scaler_step(part))
    if num_classes is None:
        return [*steps, *_regression_steps(parts[-1])]
    classes = [int(number) for number in parts[-1].classes_]
    logits = {"step": "Logits", "classes": classes, "num_classes": num_classes}
    return [*steps, *_probability_steps(parts[-1]), logits]


def _feature_step(part: Any, has_normal: bool, has_tangent: bool) -> _Step:
    if type(part) is FlatReadings:
        return {"step": "Readings"}
    if type(part) is DescriptorFeatures:
        flags = {name: bool(getattr(part, name)) for name in ("with_readings", "balanced")}
        return {"step": "Descriptors", **flags}
    if type(part) is WindowFeatures:
        return {"step": "Signals", "num_channels": int(part.num_channels)}
    if type(part) is PosedSummary:
        rest = _double_tensor(part.rest_)
        return {
            "step": "PatchSums",
            "rest": rest,
            "patch": torch.as_tensor(as_layout(part.layout).patch).long(),
            "threshold": float(part.threshold_),
            "has_normal": has_normal,
            "has_tangent": has_tangent and has_normal and rest.size(1) == 3,
        }
    raise ValueError(f"a pipeline must begin with {_FEATURE_STEPS} to be saved (got {part!r:.80})")


def _scaler_step(scaler: StandardScaler) -> _Step:
    center = scaler.mean_ if scaler.with_mean else np.zeros(scaler.n_features_in_)
    scale = scaler.scale_ if scaler.with_std else np.ones(scaler.n_features_in_)
    return {
        "step": "Affine",
        "weight": _double_tensor(1 / scale),
        "bias": _double_tensor(-center / scale),
    }


def _probability_steps(model: Any) -> list[_Step]:
    if isinstance(model, TemperatureScaling):
        return [*_score_steps(model.estimator_), _softmax_step(model, float(model.factor_))]
    if isinstance(model, _FORESTS):
        return [_forest_step(model)]
    if isinstance(model, DummyClassifier) and model.strategy in ("most_frequent", "prior"):
        return [
            {"step": "Constant", "values": _double_tensor(model.predict_proba(np.zeros((1, 1)))[0])}
        ]
    if isinstance(model, LogisticRegression):
        if (
            model.solver == "liblinear"
        ):  # in older versions of scikit-learn, it fits one model per class
            raise ValueError("'solver' must not be 'liblinear' for a regression to be saved")
        return [*_score_steps(model), _softmax_step(model, 1.0)]
    if hasattr(model, "decision_function"):
        raise ValueError(
            "a classifier must have probabilities to be saved (got "
            f"{type(model).__name__}, which has only scores): wrap it in TemperatureScaling, and "
            "fit it"
        )
    raise _unsupported_error(model)


def _softmax_step(model: Any, factor: float) -> _Step:
    return {"step": "Probability", "factor": factor, "of_two": len(model.classes_) == 2}


def _score_steps(model: Any) -> list[_Step]:
    if isinstance(model, SVC):
        return _kernel_score_steps(model)
    if isinstance(model, _LINEAR):
        return [_linear_step([model])]
    raise _unsupported_error(model)


def _regression_steps(model: Any) -> list[_Step]:
    if isinstance(model, TransformedTargetRegressor):
        scaler = model.transformer_
        if model.func is not None or type(scaler) is not StandardScaler:
            raise ValueError(f"targets must be scaled by StandardScaler (got {scaler!r:.80})")
        unscale = {
            "step": "Affine",
            "weight": _double_tensor(scaler.scale_),
            "bias": _double_tensor(scaler.mean_),
        }
        return [*_regression_steps(model.regressor_), unscale]
    if isinstance(model, MultiOutputRegressor):
        return [
            {
                "step": "Beside",
                "models": [_regression_steps(member) for member in model.estimators_],
            }
        ]
    if isinstance(model, SVR):
        _check_radial(model)
        kernel = _kernel_step(model, [len(model.support_vectors_)])
        return [kernel, _shift_step(model.intercept_)]
    if isinstance(model, _LINEAR):
        return [_linear_step([model])]
    if isinstance(model, _FORESTS):
        return [_forest_step(model)]
    if isinstance(model, DummyRegressor):
        return [{"step": "Constant", "values": _double_tensor(np.ravel(model.constant_))}]
    raise _unsupported_error(model)


def _linear_step(models: Sequence[Any]) -> _Step:
    (model,) = models
    weight = np.atleast_2d(model.coef_)
    bias = np.broadcast_to(np.ravel(model.intercept_), len(weight))
    return {"step": "Linear", "weight": _double_tensor(weight.T), "bias": _double_tensor(bias)}


def _shift_step(bias: Any) -> _Step:
    return {
        "step": "Affine",
        "weight": torch.ones(len(bias)).double(),
        "bias": _double_tensor(bias),
    }


def _kernel_score_steps(model: SVC) -> list[_Step]:
    _check_radial(model)
    if len(model.classes_) == 2:
        return [_kernel_step(model, [len(model.support_vectors_)]), _shift_step(model.intercept_)]
    if model.decision_function_shape != "ovr":
        raise ValueError("'decision_function_shape' of an SVC must be 'ovr' (got 'ovo')")
    counts = [int(count) for count in model.n_support_]
    return [
        _kernel_step(model, counts),
        {"step": "Votes", "bias": _double_tensor(model.intercept_)},
    ]


def _check_radial(model: Any) -> None:
    if model.kernel != "rbf":
        raise ValueError(
            "the kernel of a support vector machine must be 'rbf' to be saved (got "
            f"'{model.kernel}')"
        )


def _kernel_step(model: Any, counts: list[int]) -> _Step:
    return {
        "step": "Kernel",
        "vectors": _double_tensor(model.support_vectors_),
        "weight": _double_tensor(model.dual_coef_.T),
        "counts": counts,
        "gamma": float(model._gamma),  # private, because `gamma` may be the text "scale"
    }


def _forest_step(model: Any) -> _Step:
    trees = [tree.tree_ for tree in model.estimators_]
    starts = np.cumsum([0, *(tree.node_count for tree in trees)])
    children_by_side: dict[str, list[np.ndarray]] = {"left": [], "right": []}
    for start, tree in zip(starts, trees, strict=False):
        node = np.arange(tree.node_count)
        is_leaf = tree.children_left < 0
        for name, children in (("left", tree.children_left), ("right", tree.children_right)):
            children_by_side[name].append(start + np.where(is_leaf, node, children))
    feature = np.concatenate([tree.feature for tree in trees]).clip(min=0)
    is_classifier = hasattr(model, "classes_")
    values = np.concatenate(
        [tree.value[:, 0] if is_classifier else tree.value[..., 0] for tree in trees]
    )
    if is_classifier:  # older versions of scikit-learn store counts
        values = values / values.sum(axis=1, keepdims=True)
    return {
        "step": "Forest",
        "feature": _index_tensor(feature),
        "threshold": _double_tensor(np.concatenate([tree.threshold for tree in trees])),
        **{
            name: _index_tensor(np.concatenate(indices))
            for name, indices in children_by_side.items()
        },
        "roots": _index_tensor(starts[:-1]),
        "values": _double_tensor(values),
        "num_features": int(model.n_features_in_),
    }


def _double_tensor(values: Any) -> Tensor:
    return torch.from_numpy(np.array(values, dtype=np.float64))


def _index_tensor(values: np.ndarray) -> Tensor:
    return torch.from_numpy(values.astype(np.int32))


def _unsupported_error(model: Any) -> ValueError:
    return ValueError(
        f"only {_SUPPORTED_MODELS} can be saved in a predictor (got {type(model).__name__})"
    )
