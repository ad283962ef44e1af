r"""What each patch feels, in the frame of the palm."""

from typing import Any, Self

import numpy as np
from sklearn.base import TransformerMixin
from sklearn.utils.validation import check_is_fitted

from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.baselines._readings import TakesReadings, readings
from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.sensors import TaxelLayout, as_layout

_PRESSED = 0.05  # of the strongest reading
_STRONGEST = 99.9  # percent


class PosedSummary(TransformerMixin, TakesReadings):
    r"""Summarises each patch in the frame of the palm: its force, the centre of its pressure, its
    mean normal there, and how many of its taxels are pressed. This is a few numbers per patch,
    whatever the number of taxels; a forest on them is a strong baseline.

    What a taxel feels is its reading less its median over the samples that this was fitted on; its
    strength :math:`w_i` is the length of that, and it is pressed if :math:`w_i` is above a
    twentieth of the strongest. With the places :math:`\mathbf{p}_i` and the normals
    :math:`\mathbf{n}_i` of the pressed taxels :math:`P` of a patch, the features are

    .. math::
        \sum_{i \in P} \mathbf{f}_i, \quad
        \frac{\sum_P w_i \mathbf{p}_i}{\sum_P w_i}, \quad
        \frac{\sum_P w_i \mathbf{n}_i}{\sum_P w_i}, \quad |P|

    Samples with :obj:`pos` and :obj:`normal` of their own (see
    :class:`~torch_geometric_tactile.transforms.TaxelPose`) are summed up where their taxels are;
    others on the layout. The force :math:`\mathbf{f}_i` is in the frame of the palm where samples
    have three channels and :obj:`tangent` axes (see
    :class:`~torch_geometric_tactile.transforms.TaxelForce`); otherwise it is what the channels
    feel. A patch that nothing presses has its own centre and zeros. Missing readings (NaN) are not
    pressed.

    Args:
        layout (TaxelLayout or str or PathLike): The taxels: a layout, the name of one that comes
            with the package, or a layout file.

    Shapes:
        - **input:** samples, or readings :math:`(S, N, F)`
        - **output:** features :math:`(S, K \cdot (F + 7))` of :math:`K` patches

    Raises:
        ValueError: If the readings are not of the layout's taxels.

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
        r"""Measures the rest reading of each taxel, and the strongest reading.

        Args:
            x (StaticData or array-like): Samples, or readings :math:`(S, N, F)`.
            y (array-like, optional): Not used.
        """
        values = self._values(x)
        self.rest_ = np.nan_to_num(_nanmedian(values), nan=0.0)
        strength = np.linalg.norm(np.nan_to_num(values - self.rest_), axis=2)
        self.threshold_ = _PRESSED * float(np.percentile(strength, _STRONGEST))
        return self

    def transform(self, x: Any) -> np.ndarray:
        r"""Returns the features.

        Args:
            x (StaticData or array-like): Samples, or readings :math:`(S, N, F)`.
        """
        check_is_fitted(self)
        layout = as_layout(self.layout)
        felt = np.nan_to_num(self._values(x) - self.rest_)
        weight = np.linalg.norm(felt, axis=2)
        pressed = weight > self.threshold_
        pos, normal = _places(x, layout)
        if felt.shape[2] == 3 and isinstance(x, StaticData) and x.get("tangent") is not None:
            felt = _turned(felt, x["tangent"].numpy(force=True), normal)
        patch = np.asarray(layout.patch)
        rows = [
            _patch(*(values[:, patch == i] for values in (felt, weight, pressed, pos, normal)))
            for i in np.unique(patch)
        ]
        return np.concatenate(rows, axis=1)

    def _values(self, x: Any) -> np.ndarray:
        values = readings(x).astype(np.float64)
        layout = as_layout(self.layout)
        if values.shape[1] != layout.num_taxels:
            raise ValueError(
                f"'x' must have {layout.num_taxels} taxels, as layout '{layout.name}' (got shape "
                f"{values.shape})"
            )
        return values


def posed_summary(x: Any, layout: TaxelLayout | PathLike) -> np.ndarray:
    r"""Returns the features of :class:`PosedSummary`, fitted on the same samples.

    Args:
        x (StaticData or array-like): Samples, or readings :math:`(S, N, F)`.
        layout (TaxelLayout or str or PathLike): The taxels.

    Examples:
        >>> from torch_geometric_tactile.sensors import grid
        >>> x = np.array([[0.0, 0.0], [0.0, 2.0], [0.0, 0.0]])[:, :, None]
        >>> posed_summary(x, grid(1, 2, pitch=0.01)).shape
        (3, 8)
    """
    features: np.ndarray = PosedSummary(layout).fit(x).transform(x)
    return features


def _patch(
    felt: np.ndarray, weight: np.ndarray, pressed: np.ndarray, pos: np.ndarray, normal: np.ndarray
) -> np.ndarray:
    weight = weight * pressed
    total = weight.sum(axis=1)
    is_touched = total > 0
    share = weight / np.where(is_touched, total, 1.0)[:, None]
    centre = np.einsum("sn,snd->sd", share, np.broadcast_to(pos, (len(felt), *pos.shape[1:])))
    direction = np.einsum("sn,snd->sd", share, np.broadcast_to(normal, (len(felt), *pos.shape[1:])))
    centre = np.where(is_touched[:, None], centre, pos.mean(axis=1))
    force = (felt * pressed[:, :, None]).sum(axis=1)
    return np.concatenate([force, centre, direction, pressed.sum(axis=1)[:, None]], axis=1)


def _places(x: Any, layout: TaxelLayout) -> tuple[np.ndarray, np.ndarray]:
    # Positions and normals (S, N, 3), or (1, N, 3) where all samples share them.
    found = []
    for key in ("pos", "normal"):
        value = x[key] if isinstance(x, StaticData) and key in x else None
        value = getattr(layout, key) if value is None else value
        array = np.zeros(layout.pos.shape) if value is None else value.numpy(force=True)
        found.append(np.asarray(array, dtype=np.float64).reshape(-1, layout.num_taxels, 3))
    return found[0], found[1]


def _turned(felt: np.ndarray, tangent: np.ndarray, normal: np.ndarray) -> np.ndarray:
    # As TaxelForce: pressure is positive into the skin.
    along_x, along_y = tangent[..., 0, :], tangent[..., 1, :]
    return felt[..., :1] * along_x + felt[..., 1:2] * along_y - felt[..., 2:] * normal


def _nanmedian(values: np.ndarray) -> np.ndarray:
    # Without a warning for taxels that have no reading at all.
    empty = np.isnan(values).all(axis=0)
    filled = np.where(empty, 0.0, values)
    median: np.ndarray = np.nanmedian(filled, axis=0)
    return median
