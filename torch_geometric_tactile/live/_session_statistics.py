r"""What transforms that measure sessions measure, in NumPy, for a robot without PyTorch."""

import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np


def cut_windows(frames: np.ndarray, length: int, hop: int) -> np.ndarray:
    r"""Returns windows of frames, each taxel with all frames of its first channel, then all of its
    second, and so on.

    Shapes:
        - **frames:** The frames :math:`(T, N, C)`.
        - **output:** :math:`(W, N, C \cdot T)`
    """
    starts = range(0, len(frames) - length + 1, hop)
    windows = [frames[start : start + length].transpose(1, 2, 0) for start in starts]
    return np.stack(windows).reshape(len(windows), frames.shape[1], -1)


def session_statistics(
    samples: np.ndarray, time: np.ndarray, rule: Mapping[str, Any], num_frames: int = 1
) -> tuple[np.ndarray, np.ndarray]:
    r"""Returns centre and scale of a session, with the numbers of
    :class:`~torch_geometric_tactile.transforms.Tare` and
    :class:`~torch_geometric_tactile.transforms.SessionZScore`. A reading that was never there has
    the centre NaN.

    Shapes:
        - **samples:** Readings :math:`(S, N, F)`.
        - **time:** Time of each in seconds :math:`(S,)`.
        - **output:** :math:`(N, F)` each, double; :math:`(1, F)` of channels, :math:`(N, C)` of
          signals
    """
    samples = samples[: rule["first"]]
    if rule["seconds"] is not None:
        samples = samples[time[: len(samples)] - time.min() < rule["seconds"]]
    values = samples.astype(np.float64)
    if rule["per"] == "signal":
        count, rows, _ = values.shape
        values = values.reshape(count, rows, -1, num_frames).transpose(0, 3, 1, 2)
        values = values.reshape(count * num_frames, rows, -1)
    elif rule["per"] == "channel":
        values = values.reshape(-1, 1, values.shape[-1])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of taxels that are missing throughout
        center = np.nanmean(values, axis=0)
        deviation = np.nanstd(values, axis=0)
    if not rule["has_scale"]:
        return center, np.ones_like(center)
    changes = deviation > 1e-6 * np.maximum(np.abs(center), 1e-6)
    return center, np.where(changes, deviation, 1.0)
