r"""Taxel descriptors of samples as the features of estimators."""

from typing import Any

import numpy as np
import torch

from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.baselines._readings import num_repeats, readings
from torch_geometric_tactile.baselines.flat_readings import FlatReadings
from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.sensors import TaxelLayout, as_layout
from torch_geometric_tactile.transforms import TaxelDescriptors

_BLOCK_READINGS = 1 << 18  # samples are processed in blocks of about this size, to save memory


class DescriptorFeatures(FlatReadings):
    r"""Computes the :func:`~torch_geometric_tactile.sensors.taxel_descriptors` of samples. Use it
    as the first step of a scikit-learn pipeline. Windows are processed as in
    :class:`~torch_geometric_tactile.transforms.TaxelDescriptors`. Scale the readings first, with
    one scale per channel. Missing readings (NaN) are replaced by the mean of their neighbours.

    Args:
        layout (TaxelLayout or str or PathLike): The layout, the name of a stock layout, or the path
            of a layout file.
        with_readings (bool): If :obj:`True`, appends the readings to the descriptors. Missing
            readings are replaced by zero.
        balanced (bool): If :obj:`True` and :obj:`with_readings` is :obj:`True`, repeats the
            descriptors until they are about as many as the readings. This is useful for forests,
            which draw their features uniformly.

    Shapes:
        - **input:** readings :math:`(S, N, F)`, or samples, which may be windows
        - **output:** rows :math:`(S, K)`

    Raises:
        ValueError: If the samples do not have as many taxels as the layout.

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
        r"""Returns one row of features for each sample :math:`(S, K)`.

        Args:
            x (StaticData or array-like): Samples, or readings :math:`(S, N, F)`.
        """
        descriptors = self._descriptors(x)
        if not self.with_readings:
            return descriptors
        flat_readings = super().transform(x)
        num_copies = (
            num_repeats(flat_readings.shape[1], descriptors.shape[1]) if self.balanced else 1
        )
        return np.concatenate([*[descriptors] * num_copies, flat_readings], axis=1)

    def _descriptors(self, x: Any) -> np.ndarray:
        values = readings(x)
        data = StaticData(x=torch.from_numpy(values.astype(np.float32)))
        pos = x.get("pos") if isinstance(x, StaticData) else None
        is_posed = pos is not None and pos.dim() == 3
        if is_posed:
            data.pos = pos
        if isinstance(x, StaticData) and x.get("num_frames") is not None:
            data.num_frames = x.num_frames
        describe = TaxelDescriptors(as_layout(self.layout), posed=is_posed)
        block_size = max(1, _BLOCK_READINGS // max(1, values[0].size)) if len(values) else 1
        blocks = [data.index_select(rows) for rows in torch.arange(len(values)).split(block_size)]
        descriptors = [describe(block).descriptors.numpy() for block in blocks or [data]]
        return np.concatenate(descriptors)
