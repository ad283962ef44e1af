r"""Access to the frames of windows in transforms."""

from typing import Any

import torch
from torch import Tensor
from torch_geometric.data import Batch, Data

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.data import StaticData, join_frames, split_frames
from torch_geometric_tactile.transforms._attributes import require_x


def get_num_frames(data: Data) -> int | None:
    r"""Returns the number of frames :math:`T` of windows, or :obj:`None` for other samples.

    Raises:
        ValueError: If the number is not a positive integer, or differs between samples.
    """
    value: Any = getattr(data, "num_frames", None)
    if value is None:
        return None
    numbers = torch.as_tensor(value).unique()
    if len(numbers) != 1 or numbers.is_floating_point() or int(numbers[0]) < 1:
        raise ValueError(
            f"'num_frames' must be one integer, at least 1, for all samples (got {value})"
        )
    return int(numbers[0])


def require_num_frames(transform: object, data: Data) -> int:
    r"""Returns the number of frames :math:`T` of windows.

    Raises:
        ValueError: If the samples are not windows; the message names the transform.
    """
    num_frames = get_num_frames(data)
    if num_frames is None:
        raise ValueError(
            f"{type(transform).__name__} needs 'num_frames' (got none): samples must be windows of "
            "frames, such as samples of data.Windows and data.Trials"
        )
    return num_frames


def require_signals(transform: object, data: Data) -> Tensor:
    r"""Returns the readings of windows as signals, with time as the last dimension.

    Shapes:
        - **output:** floating-point numbers :math:`(S, N, C, T)`
    """
    x = require_x(transform, data)
    x = x if x.is_floating_point() else x.float()  # counts may be integers
    if isinstance(data, Batch):
        sizes = data.ptr.diff().unique().tolist()
        need(len(sizes) == 1, "all samples must have the same number of taxels", sizes)
        x = x.view(-1, sizes[0], x.size(-1))
    frames = split_frames(x, require_num_frames(transform, data)).transpose(-1, -2)
    return frames if frames.dim() == 4 else frames.unsqueeze(0)


def signals_to_windows(signals: Tensor, data: Data) -> Tensor:
    r"""Converts signals to the readings of windows.

    Args:
        signals (torch.Tensor): The signals :math:`(S, N, C, T)`.
        data (torch_geometric.data.Data): The samples; the output has the shape of their readings.

    Shapes:
        - **output:** :math:`(N, C \cdot T)`, :math:`(S, N, C \cdot T)`, or
          :math:`(S \cdot N, C \cdot T)` for a PyG batch
    """
    x = join_frames(signals.transpose(-1, -2))
    return x if isinstance(data, StaticData) or data.x.dim() == 3 else x.flatten(0, 1)


def valid_frames(data: Data, num_samples: int, num_frames: int, device: torch.device) -> Tensor:
    r"""Returns the number of frames of each window without its padding.

    Args:
        data (torch_geometric.data.Data): The samples.
        num_samples (int): Number of samples :math:`S`.
        num_frames (int): Number of frames :math:`T` with the padding.
        device (torch.device): The device of the output.

    Shapes:
        - **output:** :math:`(S,)`

    Raises:
        ValueError: If :obj:`valid_frames` has the wrong length, or a number is not between 1 and
            :math:`T`.
    """
    value: Any = getattr(data, "valid_frames", None)
    if value is None:
        return torch.full((num_samples,), num_frames, device=device)
    valid = torch.as_tensor(value, device=device).reshape(-1).long()
    if len(valid) != num_samples:
        raise ValueError(
            f"'valid_frames' must have {num_samples} numbers, one for each sample (got "
            f"{len(valid)})"
        )
    if num_samples and (int(valid.min()) < 1 or int(valid.max()) > num_frames):
        raise ValueError(
            f"'valid_frames' must be between 1 and {num_frames}, the number of frames of a window "
            f"(got {int(valid.min())} to {int(valid.max())})"
        )
    return valid


def refuse_ragged(transform: object, data: Data) -> None:
    r"""Checks that windows are not padded.

    Raises:
        ValueError: If windows are padded. The message names the transform.
    """
    if getattr(data, "valid_frames", None) is not None:
        raise ValueError(
            f"{type(transform).__name__} needs windows of one length (got padded windows with "
            "'valid_frames'): put Resample() before it, or crop trials to one length"
        )


def repeat_frames(values: Tensor, num_frames: int) -> Tensor:
    r"""Repeats a value of each channel for all frames of a window.

    Args:
        values (torch.Tensor): A value for each taxel and channel :math:`(\ldots, N, C)`.
        num_frames (int): Number of frames :math:`T`.

    Shapes:
        - **output:** :math:`(\ldots, N, C \cdot T)`
    """
    size = (*values.shape[:-1], num_frames, values.size(-1))
    return join_frames(values.unsqueeze(-2).expand(size))


def num_channels_and_frames(data: Data, x: Tensor) -> tuple[int, int]:
    r"""Returns the number of channels :math:`C` and the number of frames :math:`T` of windows.
    Other samples have one frame.

    Args:
        data (torch_geometric.data.Data): The samples.
        x (torch.Tensor): Their readings :math:`(\ldots, N, C \cdot T)`.
    """
    num_frames = get_num_frames(data) or 1
    return split_frames(x, num_frames).size(-1), num_frames


def padding_mask(transform: object, data: Data) -> Tensor | None:
    r"""Returns which readings of windows are padding, or :obj:`None` if the windows have none.

    Shapes:
        - **output:** booleans of the shape of :obj:`x`
    """
    if getattr(data, "valid_frames", None) is None:
        return None
    signals = require_signals(transform, data)
    num_frames = signals.size(-1)
    valid = valid_frames(data, len(signals), num_frames, signals.device)
    frames = torch.arange(num_frames, device=signals.device)
    padding = (frames >= valid.unsqueeze(1))[:, None, None].expand_as(signals)
    return signals_to_windows(padding, data)
