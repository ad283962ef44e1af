r"""Descriptors of a layout as the features of estimators."""

from typing import Any

import numpy as np
import torch

from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.baselines._readings import num_repeats, readings
from torch_geometric_tactile.baselines.flat_readings import FlatReadings
from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.sensors import TaxelLayout, as_layout
from torch_geometric_tactile.transforms import TaxelDescriptors

_AT_ONCE = 1 << 18  # readings


class DescriptorFeatures(FlatReadings):
    r"""Describes samples by :func:`~torch_geometric_tactile.sensors.taxel_descriptors`, as the
    first step of a scikit-learn pipeline; windows as
    :class:`~torch_geometric_tactile.transforms.TaxelDescriptors` does. Readings should be scaled
    before, by one scale a channel. Missing readings (NaN) count as the mean of their neighbours.

    Args:
        layout (TaxelLayout or str or PathLike): The taxels: a layout, the name of one that comes
            with the package, or a layout file.
        with_readings (bool): Whether the readings follow the descriptors, missing ones as zero.
        balanced (bool): Whether the descriptors are then repeated until they are about as many as
            the readings: a forest draws features by their number.

    Shapes:
        - **input:** readings :math:`(S, N, F)`, or samples, which may be windows
        - **output:** rows :math:`(S, K)`

    Raises:
        ValueError: If the readings are not of the layout's taxels.

    Examples:
        >>> DescriptorFeatures("biotac_sp").fit_transform(np.zeros((5, 24, 3))).shape
        (5, 450)
    """

    def __init__(
        self, layout: TaxelLayout | PathLike, with_readings: bool = False, balanced: bool = False
    ) -> None:
        self.layout = layout
        self.with_readings = with_readings
        self.balanced = balanced

    def transform(self, x: Any) -> np.ndarray:
        r"""Returns the rows.

        Args:
            x (StaticData or array-like): Samples, or readings :math:`(S, N, F)`.
        """
        rows = self._rows(x)
        if not self.with_readings:
            return rows
        flat = super().transform(x)
        times = num_repeats(flat.shape[1], rows.shape[1]) if self.balanced else 1
        return np.concatenate([*[rows] * times, flat], axis=1)

    def _rows(self, x: Any) -> np.ndarray:
        values = readings(x)
        data = StaticData(x=torch.from_numpy(values.astype(np.float32)))
        pos = x.get("pos") if isinstance(x, StaticData) else None
        is_posed = pos is not None and pos.dim() == 3
        if is_posed:
            data.pos = pos
        if isinstance(x, StaticData) and x.get("num_frames") is not None:
            data.num_frames = x.num_frames
        describe = TaxelDescriptors(as_layout(self.layout), posed=is_posed)
        at_once = max(1, _AT_ONCE // max(1, values[0].size)) if len(values) else 1
        parts = [data.index_select(rows) for rows in torch.arange(len(values)).split(at_once)]
        found = [describe(part).descriptors.numpy() for part in parts or [data]]
        return np.concatenate(found)
