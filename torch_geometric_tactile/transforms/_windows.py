r"""What the transforms ask of windows of frames."""

from typing import Any

import torch
from torch import Tensor
from torch_geometric.data import Batch, Data

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.data import StaticData, join_frames, split_frames
from torch_geometric_tactile.transforms._attributes import require_x


def given_num_frames(data: Data) -> int | None:
    r"""Returns the number of frames :math:`T` of windows, or :obj:`None` of other samples."""
    value: Any = getattr(data, "num_frames", None)
    if value is None:
        return None
    numbers = torch.as_tensor(value).unique()
    if len(numbers) != 1 or numbers.is_floating_point() or int(numbers[0]) < 1:
        raise ValueError(
            f"'num_frames' must be one whole number, at least 1, for all samples (got {value})"
        )
    return int(numbers[0])


def require_num_frames(transform: object, data: Data) -> int:
    r"""Returns the number of frames :math:`T`, which must be there."""
    num_frames = given_num_frames(data)
    if num_frames is None:
        raise ValueError(
            f"{type(transform).__name__} needs 'num_frames' (got none): samples must be windows of "
            "frames, as data.Windows and data.Trials cut them"
        )
    return num_frames


def require_signals(transform: object, data: Data) -> Tensor:
    r"""Returns the readings of windows with time as the last dimension.

    Shapes:
        - **output:** :math:`(S, N, C, T)`, in floating point
    """
    x = require_x(transform, data)
    x = x if x.is_floating_point() else x.float()  # counts may be integers
    if isinstance(data, Batch):
        sizes = data.ptr.diff().unique().tolist()
        need(len(sizes) == 1, "all samples must have the same number of taxels", sizes)
        x = x.view(-1, sizes[0], x.size(-1))
    frames = split_frames(x, require_num_frames(transform, data)).transpose(-1, -2)
    return frames if frames.dim() == 4 else frames.unsqueeze(0)


def joined_signals(signals: Tensor, data: Data) -> Tensor:
    r"""Returns signals in the form of the readings of windows.

    Shapes:
        - **signals:** The signals :math:`(S, N, C, T)`.
    """
    x = join_frames(signals.transpose(-1, -2))
    return x if isinstance(data, StaticData) or data.x.dim() == 3 else x.flatten(0, 1)


def valid_frames(data: Data, num_samples: int, num_frames: int, device: torch.device) -> Tensor:
    r"""Returns how many frames of each window are its own: all, if the windows are not ragged.

    Shapes:
        - **num_samples:** Their number :math:`S`.
        - **num_frames:** Number of frames :math:`T`, with the padding.
        - **output:** :math:`(S,)`
    """
    value: Any = getattr(data, "valid_frames", None)
    if value is None:
        return torch.full((num_samples,), num_frames, device=device)
    valid = torch.as_tensor(value, device=device).reshape(-1).long()
    if len(valid) != num_samples:
        raise ValueError(
            f"'valid_frames' must have {num_samples} numbers, one a sample (got {len(valid)})"
        )
    if num_samples and (int(valid.min()) < 1 or int(valid.max()) > num_frames):
        raise ValueError(
            f"'valid_frames' must be 1 to {num_frames}, the frames of a window (got "
            f"{int(valid.min())} to {int(valid.max())})"
        )
    return valid


def refuse_ragged(transform: object, data: Data) -> None:
    r"""Checks that all frames of windows are their own."""
    if getattr(data, "valid_frames", None) is not None:
        raise ValueError(
            f"{type(transform).__name__} must get windows of one length (got padded ones, with "
            "'valid_frames'): put Resample() before it, or cut trials to one length"
        )


def repeated(values: Tensor, num_frames: int) -> Tensor:
    r"""Returns the numbers of signals as those of all frames of a window.

    Shapes:
        - **values:** A number for each channel :math:`(\ldots, N, C)`.
        - **num_frames:** Number of frames :math:`T`.
        - **output:** :math:`(\ldots, N, C \cdot T)`
    """
    size = (*values.shape[:-1], num_frames, values.size(-1))
    return join_frames(values.unsqueeze(-2).expand(size))


def num_channels_and_frames(data: Data, x: Tensor) -> tuple[int, int]:
    r"""Returns the number of channels :math:`C` and of frames :math:`T` of windows, which is one of
    other samples.

    Shapes:
        - **x:** Their readings :math:`(\ldots, N, C \cdot T)`.
    """
    num_frames = given_num_frames(data) or 1
    return split_frames(x, num_frames).size(-1), num_frames


def padded_frames(transform: object, data: Data) -> Tensor | None:
    r"""Returns which numbers of ragged windows are padding, or :obj:`None` if there is none.

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
    return joined_signals(padding, data)
