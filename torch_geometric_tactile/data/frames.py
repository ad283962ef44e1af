r"""The order of the numbers in a window of frames."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

_MAX_GATHER_SIZE = 256  # up to this many readings in a frame, one call gathers all windows


def split_frames(x: Tensor, num_frames: int) -> Tensor:
    r"""Reshapes a window of frames so that frames and channels are separate dimensions.

    In a window, each taxel has all frames of its first channel, then all frames of its second
    channel, and so on. Only this function and :func:`join_frames` depend on this order.

    Args:
        x (torch.Tensor): The window :math:`(\ldots, N, C \cdot T)`.
        num_frames (int): Number of frames :math:`T`.

    Shapes:
        - **output:** :math:`(\ldots, N, T, C)`, a view of :obj:`x` if its memory allows

    Raises:
        ValueError: If the last dimension is not a multiple of :obj:`num_frames`.

    Examples:
        >>> window = torch.tensor([[1, 2, 3, 10, 20, 30]])  # 1 taxel, 2 channels, 3 frames
        >>> split_frames(window, num_frames=3)
        tensor([[[ 1, 10],
                 [ 2, 20],
                 [ 3, 30]]])
    """
    size = x.size(-1) if x.dim() else 0
    if x.dim() < 2 or num_frames < 1 or size % num_frames:
        raise ValueError(
            f"'x' must have shape (..., num_taxels, num_channels * num_frames), {num_frames} "
            f"frames of each channel (got {tuple(x.shape)})"
        )
    return x.unflatten(-1, (size // num_frames, num_frames)).transpose(-1, -2)


def join_frames(x: Tensor) -> Tensor:
    r"""Reshapes frames to a window: the inverse of :func:`split_frames`. In a window, each taxel
    has all frames of its first channel, then all frames of its second channel, and so on.

    Args:
        x (torch.Tensor): The frames :math:`(\ldots, N, T, C)`.

    Shapes:
        - **output:** :math:`(\ldots, N, C \cdot T)`

    Raises:
        ValueError: If there are fewer than three dimensions.

    Examples:
        >>> join_frames(torch.tensor([[[1, 10], [2, 20], [3, 30]]]))
        tensor([[ 1,  2,  3, 10, 20, 30]])
    """
    if x.dim() < 3:
        raise ValueError(
            f"'x' must have shape (..., num_taxels, num_frames, num_channels) (got "
            f"{tuple(x.shape)})"
        )
    return x.transpose(-1, -2).flatten(-2)


def cut_windows(x: Tensor, rows: Tensor | Sequence[slice | np.ndarray], num_frames: int) -> Tensor:
    r"""Cuts windows from frames, with a single copy of the readings.

    Args:
        x (torch.Tensor): Frames :math:`(S, N, C)`.
        rows (torch.Tensor or sequence of slice or numpy.ndarray): The first frame of each window
            :math:`(B,)`, or all frames of each window. Windows with fewer than :obj:`num_frames`
            frames are padded with NaN.
        num_frames (int): Number of frames in each window :math:`T`.

    Shapes:
        - **output:** :math:`(B, N, C \cdot T)`
    """
    shape = (len(rows), *x.shape[1:], num_frames)
    if x.device.type != "cpu" or x.requires_grad or x.dtype == torch.bfloat16:
        windows = x.new_empty(shape)
        for i, index in enumerate(_window_slices(rows, num_frames)):
            _fill_window(windows[i], x[index].movedim(0, -1))
        return windows.flatten(-2)
    # On a CPU, NumPy transposes faster than PyTorch.
    frames = x.numpy()
    if isinstance(rows, Tensor) and x.is_contiguous() and x.shape[1:].numel() <= _MAX_GATHER_SIZE:
        # For small frames, a loop over the windows would spend most of its time in calls.
        index = rows.numpy(force=True)[:, None] + np.arange(num_frames)
        size = x.shape[1:].numel()
        gathered = frames.reshape(len(frames), size).take(index.reshape(-1), axis=0)
        gathered = gathered.reshape(len(rows), num_frames, size).transpose(0, 2, 1)
        return torch.from_numpy(np.ascontiguousarray(gathered)).reshape(*shape).flatten(-2)
    # Large frames are first copied to a buffer in their order, so that the transposition reads from
    # the cache of the processor.
    array = np.empty(shape, frames.dtype)
    buffer = np.empty((num_frames, *x.shape[1:]), frames.dtype)
    transposed = buffer.transpose(1, 2, 0)
    for window, index in zip(array, _window_slices(rows, num_frames), strict=True):
        window_frames = frames[index]
        size = len(window_frames)
        buffer[:size] = window_frames
        _fill_window(window, transposed if size == num_frames else transposed[..., :size])
    return torch.from_numpy(array).flatten(-2)


def _window_slices(
    rows: Tensor | Sequence[slice | np.ndarray], num_frames: int
) -> Sequence[slice | np.ndarray]:
    if isinstance(rows, Tensor):
        return [slice(start, start + num_frames) for start in rows.tolist()]
    return rows


def _fill_window(window: Any, frames: Any) -> None:
    size = frames.shape[-1]
    if size < window.shape[-1]:
        window[..., size:] = np.nan
    window[..., :size] = frames
