r"""The numbers that were fitted, out of scikit-learn's estimators."""

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
_KNOWN = "a forest, a support vector machine, a linear model, ridge or a constant"
_FIRST = "FlatReadings, DescriptorFeatures, PosedSummary or the features of signal_svm"


def fitted_steps(
    estimator: Any, num_classes: int | None, normal: bool = False, tangent: bool = False
) -> list[_Step]:
    r"""Returns the steps of a fitted pipeline, plain data and tensors."""
    if not isinstance(estimator, Pipeline) or len(estimator.steps) < 2:
        raise ValueError(
            f"an estimator must be a pipeline that begins with {_FIRST} (got "
            f"{type(estimator).__name__})"
        )
    check_is_fitted(estimator)
    parts = [part for _, part in estimator.steps]
    steps = [_features(parts[0], normal, tangent)]
    for part in parts[1:-1]:
        if type(part) is not StandardScaler:
            raise ValueError(
                f"between features and model there may be StandardScaler only (got {part!r:.80})"
            )
        steps.append(_scaled(part))
    if num_classes is None:
        return [*steps, *_numbers(parts[-1])]
    classes = [int(number) for number in parts[-1].classes_]
    last = {"step": "Logits", "classes": classes, "num_classes": num_classes}
    return [*steps, *_probability(parts[-1]), last]


def _features(part: Any, has_normal: bool, has_tangent: bool) -> _Step:
    if type(part) is FlatReadings:
        return {"step": "Readings"}
    if type(part) is DescriptorFeatures:
        flags = {name: bool(getattr(part, name)) for name in ("with_readings", "balanced")}
        return {"step": "Descriptors", **flags}
    if type(part) is WindowFeatures:
        return {"step": "Signals", "num_channels": int(part.num_channels)}
    if type(part) is PosedSummary:
        rest = _tensor(part.rest_)
        return {
            "step": "PatchSums",
            "rest": rest,
            "patch": torch.as_tensor(as_layout(part.layout).patch).long(),
            "threshold": float(part.threshold_),
            "has_normal": has_normal,
            "has_tangent": has_tangent and has_normal and rest.size(1) == 3,
        }
    raise ValueError(f"a pipeline must begin with {_FIRST} to be saved (got {part!r:.80})")


def _scaled(scaler: StandardScaler) -> _Step:
    center = scaler.mean_ if scaler.with_mean else np.zeros(scaler.n_features_in_)
    scale = scaler.scale_ if scaler.with_std else np.ones(scaler.n_features_in_)
    return {"step": "Affine", "weight": _tensor(1 / scale), "bias": _tensor(-center / scale)}


def _probability(model: Any) -> list[_Step]:
    if isinstance(model, TemperatureScaling):
        return [*_scores(model.estimator_), _softmax(model, float(model.factor_))]
    if isinstance(model, _FORESTS):
        return [_forest(model)]
    if isinstance(model, DummyClassifier) and model.strategy in ("most_frequent", "prior"):
        return [{"step": "Constant", "values": _tensor(model.predict_proba(np.zeros((1, 1)))[0])}]
    if isinstance(model, LogisticRegression):
        if model.solver == "liblinear":  # each class by itself, in older versions of scikit-learn
            raise ValueError("'solver' must not be 'liblinear' for a regression to be saved")
        return [*_scores(model), _softmax(model, 1.0)]
    if hasattr(model, "decision_function"):
        raise ValueError(
            f"a classifier must tell probabilities to be saved: put TemperatureScaling around "
            f"{type(model).__name__} and fit it (got scores only)"
        )
    raise _unknown(model)


def _softmax(model: Any, factor: float) -> _Step:
    return {"step": "Probability", "factor": factor, "of_two": len(model.classes_) == 2}


def _scores(model: Any) -> list[_Step]:
    if isinstance(model, SVC):
        return _kernel_scores(model)
    if isinstance(model, _LINEAR):
        return [_linear([model])]
    raise _unknown(model)


def _numbers(model: Any) -> list[_Step]:
    if isinstance(model, TransformedTargetRegressor):
        scaler = model.transformer_
        if model.func is not None or type(scaler) is not StandardScaler:
            raise ValueError(f"targets may be scaled by StandardScaler only (got {scaler!r:.80})")
        back = {"step": "Affine", "weight": _tensor(scaler.scale_), "bias": _tensor(scaler.mean_)}
        return [*_numbers(model.regressor_), back]
    if isinstance(model, MultiOutputRegressor):
        return [{"step": "Beside", "models": [_numbers(one) for one in model.estimators_]}]
    if isinstance(model, SVR):
        _check_radial(model)
        kernel = _kernel(model, [len(model.support_vectors_)])
        return [kernel, _shift(model.intercept_)]
    if isinstance(model, _LINEAR):
        return [_linear([model])]
    if isinstance(model, _FORESTS):
        return [_forest(model)]
    if isinstance(model, DummyRegressor):
        return [{"step": "Constant", "values": _tensor(np.ravel(model.constant_))}]
    raise _unknown(model)


def _linear(models: Sequence[Any]) -> _Step:
    (model,) = models
    weight = np.atleast_2d(model.coef_)
    bias = np.broadcast_to(np.ravel(model.intercept_), len(weight))
    return {"step": "Linear", "weight": _tensor(weight.T), "bias": _tensor(bias)}


def _shift(bias: Any) -> _Step:
    return {"step": "Affine", "weight": torch.ones(len(bias)).double(), "bias": _tensor(bias)}


def _kernel_scores(model: SVC) -> list[_Step]:
    _check_radial(model)
    if len(model.classes_) == 2:
        return [_kernel(model, [len(model.support_vectors_)]), _shift(model.intercept_)]
    if model.decision_function_shape != "ovr":
        raise ValueError("'decision_function_shape' of a machine must be 'ovr' (got 'ovo')")
    counts = [int(count) for count in model.n_support_]
    return [_kernel(model, counts), {"step": "Votes", "bias": _tensor(model.intercept_)}]


def _check_radial(model: Any) -> None:
    if model.kernel != "rbf":
        raise ValueError(
            f"the kernel of a machine must be 'rbf' to be saved (got '{model.kernel}')"
        )


def _kernel(model: Any, counts: list[int]) -> _Step:
    return {
        "step": "Kernel",
        "vectors": _tensor(model.support_vectors_),
        "weight": _tensor(model.dual_coef_.T),
        "counts": counts,
        "gamma": float(model._gamma),  # `gamma` may be "scale"
    }


def _forest(model: Any) -> _Step:
    trees = [tree.tree_ for tree in model.estimators_]
    starts = np.cumsum([0, *(tree.node_count for tree in trees)])
    sides: dict[str, list[np.ndarray]] = {"left": [], "right": []}
    for start, tree in zip(starts, trees, strict=False):
        node = np.arange(tree.node_count)
        is_leaf = tree.children_left < 0
        for name, children in (("left", tree.children_left), ("right", tree.children_right)):
            sides[name].append(start + np.where(is_leaf, node, children))
    feature = np.concatenate([tree.feature for tree in trees]).clip(min=0)
    of_classes = hasattr(model, "classes_")
    values = np.concatenate(
        [tree.value[:, 0] if of_classes else tree.value[..., 0] for tree in trees]
    )
    if of_classes:  # counts in older versions of scikit-learn
        values = values / values.sum(axis=1, keepdims=True)
    return {
        "step": "Forest",
        "feature": _whole(feature),
        "threshold": _tensor(np.concatenate([tree.threshold for tree in trees])),
        **{name: _whole(np.concatenate(side)) for name, side in sides.items()},
        "roots": _whole(starts[:-1]),
        "values": _tensor(values),
        "num_features": int(model.n_features_in_),
    }


def _tensor(values: Any) -> Tensor:
    return torch.from_numpy(np.array(values, dtype=np.float64))


def _whole(values: np.ndarray) -> Tensor:
    return torch.from_numpy(values.astype(np.int32))


def _unknown(model: Any) -> ValueError:
    return ValueError(f"only {_KNOWN} can be saved in a predictor (got {type(model).__name__})")
