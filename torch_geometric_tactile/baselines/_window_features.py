r"""Statistical features of windows as the first step of a pipeline."""

from typing import Any

import numpy as np

from torch_geometric_tactile.baselines._readings import readings
from torch_geometric_tactile.baselines.flat_readings import FlatReadings
from torch_geometric_tactile.baselines.grasp_svm import GraspSVM


class WindowFeatures(FlatReadings):
    r"""Computes the features of :class:`GraspSVM` for windows of frames. Missing readings (NaN) are
    replaced by zero.

    Args:
        num_channels (int): Number of channels per taxel. Their frames are concatenated.

    Shapes:
        - **input:** readings :math:`(S, N, F \cdot T)`
        - **output:** rows :math:`(S, K)`
    """

    def __init__(self, num_channels: int = 1) -> None:
        self.num_channels = num_channels

    def transform(self, x: Any) -> np.ndarray:
        r"""Returns one row of features for each sample :math:`(S, K)`.

        Args:
            x (StaticData or array-like): Samples, or readings :math:`(S, N, F \cdot T)`.
        """
        values = np.nan_to_num(readings(x), nan=0.0)
        return GraspSVM(num_fingers=self.num_channels).features(values)
