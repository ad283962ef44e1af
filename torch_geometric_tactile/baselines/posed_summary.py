r"""A summary of each patch in the frame of the palm."""

from typing import Any, Self

import numpy as np
from sklearn.base import TransformerMixin
from sklearn.utils.validation import check_is_fitted

from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.baselines._readings import ReadingsEstimator, readings
from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.sensors import TaxelLayout, as_layout

_PRESSED_SHARE = 0.05  # threshold for pressed taxels, as a share of the strongest reading
_STRONGEST_PERCENTILE = 99.9  # the maximum may be an outlier


class PosedSummary(TransformerMixin, ReadingsEstimator):
    r"""Summarises each patch in the frame of the palm by its force, its centre of pressure, the
    mean normal of its pressed taxels, and their number. The number of features depends on the
    number of patches, but not on the number of taxels. A forest on these features is a strong
    baseline.

    The signal of a taxel is its reading minus its median over the training samples. The strength
    :math:`w_i` of the taxel is the norm of its signal. The taxel is pressed if :math:`w_i` is above
    a twentieth of the 99.9th percentile of all strengths in the training samples. With the
    positions :math:`\mathbf{p}_i` in metres, the normals :math:`\mathbf{n}_i` and the signals
    :math:`\mathbf{f}_i` of the pressed taxels :math:`P` of a patch, the features are

    .. math::
        \sum_{i \in P} \mathbf{f}_i, \quad
        \frac{\sum_P w_i \mathbf{p}_i}{\sum_P w_i}, \quad
        \frac{\sum_P w_i \mathbf{n}_i}{\sum_P w_i}, \quad |P|

    Positions and normals are taken from the attributes :obj:`pos` and :obj:`normal` of the samples
    (see :class:`~torch_geometric_tactile.transforms.TaxelPose`) or, if the samples have none, from
    the layout. If samples have three channels and :obj:`tangent` axes, :math:`\mathbf{f}_i` is
    rotated into the frame of the palm (see
    :class:`~torch_geometric_tactile.transforms.TaxelForce`). For a patch without pressed taxels,
    the centre of pressure is the centre of the patch, and all other features are zero. Taxels with
    missing readings (NaN) count as not pressed.

    Args:
        layout (TaxelLayout or str or PathLike): The layout, the name of a stock layout, or the path
            of a layout file.

    Shapes:
        - **input:** samples, or readings :math:`(S, N, F)`
        - **output:** features :math:`(S, K \cdot (F + 7))` for :math:`K` patches

    Raises:
        ValueError: If the samples do not have as many taxels as the layout.

    Examples:
        >>> from torch_geometric_tactile.sensors import grid
        >>> x = np.array([[0.0, 0.0], [0.0, 2.0], [0.0, 0.0]])[:, :, None]
        >>> PosedSummary(grid(1, 2, pitch=0.01)).fit(x).transform(x)[1].round(3)
        array([2.  , 0.01, 0.  , 0.  , 0.  , 0.  , 1.  , 1.  ])
    """

    takes_samples = True
    _allows_nan = True

    def __init__(self, layout: TaxelLayout | PathLike) -> None:
        self.layout = layout

    def fit(self, x: Any, y: Any = None) -> Self:
        r"""Computes the median reading of each taxel and the threshold for pressed taxels.

        Args:
            x (StaticData or array-like): Samples, or readings :math:`(S, N, F)`.
            y (array-like, optional): Not used.
        """
        values = self._checked_readings(x)
        self.rest_ = np.nan_to_num(_nanmedian(values), nan=0.0)
        strength = np.linalg.norm(np.nan_to_num(values - self.rest_), axis=2)
        self.threshold_ = _PRESSED_SHARE * float(np.percentile(strength, _STRONGEST_PERCENTILE))
        return self

    def transform(self, x: Any) -> np.ndarray:
        r"""Returns the features.

        Args:
            x (StaticData or array-like): Samples, or readings :math:`(S, N, F)`.
        """
        check_is_fitted(self)
        layout = as_layout(self.layout)
        signal = np.nan_to_num(self._checked_readings(x) - self.rest_)
        strength = np.linalg.norm(signal, axis=2)
        is_pressed = strength > self.threshold_
        pos, normal = _positions_and_normals(x, layout)
        if signal.shape[2] == 3 and isinstance(x, StaticData) and x.get("tangent") is not None:
            signal = _rotate_to_palm(signal, x["tangent"].numpy(force=True), normal)
        patch = np.asarray(layout.patch)
        features = [
            _patch_features(
                *(array[:, patch == i] for array in (signal, strength, is_pressed, pos, normal))
            )
            for i in np.unique(patch)
        ]
        return np.concatenate(features, axis=1)

    def _checked_readings(self, x: Any) -> np.ndarray:
        values = readings(x).astype(np.float64)
        layout = as_layout(self.layout)
        if values.shape[1] != layout.num_taxels:
            raise ValueError(
                f"'x' must have {layout.num_taxels} taxels, like layout '{layout.name}' (got shape "
                f"{values.shape})"
            )
        return values


def posed_summary(x: Any, layout: TaxelLayout | PathLike) -> np.ndarray:
    r"""Returns the features from a :class:`PosedSummary` that is fitted on the same samples.

    Args:
        x (StaticData or array-like): Samples, or readings :math:`(S, N, F)`.
        layout (TaxelLayout or str or PathLike): The layout.

    Examples:
        >>> from torch_geometric_tactile.sensors import grid
        >>> x = np.array([[0.0, 0.0], [0.0, 2.0], [0.0, 0.0]])[:, :, None]
        >>> posed_summary(x, grid(1, 2, pitch=0.01)).shape
        (3, 8)
    """
    features: np.ndarray = PosedSummary(layout).fit(x).transform(x)
    return features


def _patch_features(
    signal: np.ndarray,
    strength: np.ndarray,
    is_pressed: np.ndarray,
    pos: np.ndarray,
    normal: np.ndarray,
) -> np.ndarray:
    # Returns the features (S, F + 7) of one patch.
    weight = strength * is_pressed
    total = weight.sum(axis=1)
    is_touched = total > 0
    share = weight / np.where(is_touched, total, 1.0)[:, None]
    centre = np.einsum("sn,snd->sd", share, np.broadcast_to(pos, (len(signal), *pos.shape[1:])))
    direction = np.einsum(
        "sn,snd->sd", share, np.broadcast_to(normal, (len(signal), *pos.shape[1:]))
    )
    centre = np.where(is_touched[:, None], centre, pos.mean(axis=1))
    force = (signal * is_pressed[:, :, None]).sum(axis=1)
    return np.concatenate([force, centre, direction, is_pressed.sum(axis=1)[:, None]], axis=1)


def _positions_and_normals(x: Any, layout: TaxelLayout) -> tuple[np.ndarray, np.ndarray]:
    # Returns arrays of shape (S, N, 3), or (1, N, 3) if they are the same for all samples. Missing
    # normals are zero.
    arrays = []
    for key in ("pos", "normal"):
        tensor = x[key] if isinstance(x, StaticData) and key in x else None
        tensor = getattr(layout, key) if tensor is None else tensor
        array = np.zeros(layout.pos.shape) if tensor is None else tensor.numpy(force=True)
        arrays.append(np.asarray(array, dtype=np.float64).reshape(-1, layout.num_taxels, 3))
    return arrays[0], arrays[1]


def _rotate_to_palm(signal: np.ndarray, tangent: np.ndarray, normal: np.ndarray) -> np.ndarray:
    # As in TaxelForce, the third channel is positive into the skin, which is against the normal.
    x_axis, y_axis = tangent[..., 0, :], tangent[..., 1, :]
    return signal[..., :1] * x_axis + signal[..., 1:2] * y_axis - signal[..., 2:] * normal


def _nanmedian(values: np.ndarray) -> np.ndarray:
    # NumPy warns about taxels without any reading. Here, their median is zero, without a warning.
    is_empty = np.isnan(values).all(axis=0)
    filled = np.where(is_empty, 0.0, values)
    median: np.ndarray = np.nanmedian(filled, axis=0)
    return median
