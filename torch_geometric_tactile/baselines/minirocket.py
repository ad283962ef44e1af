r"""MiniRocket for windows of frames."""

from importlib import import_module
from typing import Any, Literal, Self

import numpy as np
from sklearn.linear_model import RidgeClassifierCV, RidgeCV
from sklearn.pipeline import Pipeline, make_pipeline
from sklearn.preprocessing import StandardScaler

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.baselines._readings import readings
from torch_geometric_tactile.baselines.flat_readings import FlatReadings

_MIN_FRAMES = 9  # length of MiniRocket's kernels
_MODULE = "sktime.transformations.panel.rocket"
_PENALTIES = np.logspace(-3, 3, 7)


def minirocket(
    task: Literal["multiclass", "regression"] = "multiclass",
    *,
    num_channels: int = 1,
    num_kernels: int = 10_000,
    class_weight: Literal["balanced"] | None = None,
) -> Pipeline:
    r"""Returns a MiniRocket pipeline for windows of frames, from the "MiniRocket: A Very Fast
    (Almost) Deterministic Transform for Time Series Classification" paper. Ridge classification or
    regression is applied to features of random convolutions of all signals in a window. The
    features are computed by sktime, which requires the extra ``series``. The first use on a machine
    takes about a minute longer, since the code is compiled.

    Args:
        task (str): :obj:`"multiclass"` or :obj:`"regression"`.
        num_channels (int): Number of channels per taxel. Their frames are concatenated.
        num_kernels (int): Number of features.
        class_weight (str, optional): :obj:`"balanced"` gives rare classes the same total weight as
            common ones.

    Raises:
        ImportError: If sktime is missing. Raised by :meth:`fit`.
        ValueError: If :obj:`task` is unknown. Also raised by :meth:`fit` if windows have fewer than
            nine frames.

    Examples:
        >>> minirocket(num_kernels=84).steps[-1][0]
        'ridgeclassifiercv'
    """
    need(task in ("multiclass", "regression"), "'task' must be multiclass or regression", task)
    if task == "multiclass":
        ridge = RidgeClassifierCV(alphas=_PENALTIES, class_weight=class_weight)
    else:
        ridge = RidgeCV(alphas=_PENALTIES)
    features = _RandomConvolutions(num_channels, num_kernels)
    return make_pipeline(features, StandardScaler(with_mean=False), ridge)


class _RandomConvolutions(FlatReadings):
    # Wraps sktime's transform. sktime is imported in `fit`, since it is an optional dependency.
    def __init__(
        self, num_channels: int = 1, num_kernels: int = 10_000, random_state: Any = None
    ) -> None:
        self.num_channels = num_channels
        self.num_kernels = num_kernels
        self.random_state = random_state

    def fit(self, x: Any, y: Any = None) -> Self:
        try:
            module = import_module(_MODULE)
        except ImportError as error:
            raise ImportError(
                "MiniRocket needs sktime: pip install 'torch-geometric-tactile[series]'"
            ) from error
        rocket = module.MiniRocketMultivariate(self.num_kernels, random_state=self.random_state)
        self.rocket_ = rocket.fit(self._signals(x))
        return self

    def transform(self, x: Any) -> np.ndarray:
        return np.asarray(self.rocket_.transform(self._signals(x)), dtype=np.float32)

    def _signals(self, x: Any) -> np.ndarray:
        values = np.nan_to_num(readings(x), nan=0.0)
        num_frames = values.shape[2] // self.num_channels
        need(
            num_frames >= _MIN_FRAMES,
            f"'x' must hold windows of at least {_MIN_FRAMES} frames",
            num_frames,
        )
        return values.reshape(len(values), -1, num_frames).astype(np.float32)
