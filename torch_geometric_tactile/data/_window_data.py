r"""Windows that are stored as indices of frames and cut at each access."""

import copy
from collections.abc import Sequence
from typing import Any, Self

import torch
from torch import Tensor
from torch_geometric.data import Data

from torch_geometric_tactile._typing import Transform
from torch_geometric_tactile.data._levels import Level
from torch_geometric_tactile.data.apply_transform import apply_transform
from torch_geometric_tactile.data.frames import cut_windows
from torch_geometric_tactile.data.static_data import StaticData


class WindowData:
    r"""Windows stored as the frames, without a copy, and the start of each window. A data set of
    windows stores this object in place of :class:`~torch_geometric_tactile.data.StaticData`, and
    cuts windows from the frames at each access.

    Args:
        frames (StaticData): The frames.
        starts (torch.Tensor): The first frame of each window :math:`(W,)`: its row in
            :obj:`frames`, or its index into :obj:`order`.
        length (int): Number of frames in a window :math:`T`.
        valid (torch.Tensor, optional): The number of frames before the padding of each window
            :math:`(W,)`; :obj:`length` if left out. Readings in the padding are NaN.
        order (torch.Tensor, optional): The rows of the selected frames in :obj:`frames`; all rows
            if left out.
        target (str, optional): The attribute of the frames that labels a window.
        horizon (int): Distance from the last frame of the window to the labelled frame, in frames.
        series (sequence of str): Names of attributes that a window keeps for all its frames.
        transform (callable, optional): Applied to the frames before a window is cut.
    """

    def __init__(
        self,
        frames: StaticData,
        starts: Tensor,
        length: int,
        *,
        valid: Tensor | None = None,
        order: Tensor | None = None,
        target: str | None = None,
        horizon: int = 0,
        series: Sequence[str] = (),
        transform: Transform | None = None,
    ) -> None:
        self.frames = frames
        self.starts = starts
        self.length = length
        self.valid = valid
        self.order = order
        self.target = target
        self.horizon = horizon
        self.series = tuple(series)
        self.transform = transform

    @property
    def num_samples(self) -> int:
        r"""The number of windows."""
        return len(self.starts)

    @property
    def num_nodes(self) -> int:
        r"""The number of taxels."""
        return int(self.frames.num_nodes)

    def __contains__(self, key: str) -> bool:
        if key == "y":
            return self.target is not None
        return (
            key == "num_frames"
            or (key == "valid_frames" and self.valid is not None)
            or (key in self.frames)
        )

    def is_shared(self, key: str) -> bool:
        r"""Returns whether all windows share one value of an attribute."""
        if key in ("y", "num_frames", "valid_frames"):
            return key == "num_frames"
        return self.frames.is_shared(key)

    def level(self, key: str) -> Level:
        r"""Returns the level of an attribute; :obj:`y` has the level of the frames' target."""
        return self.frames.level(self.target if key == "y" and self.target is not None else key)

    def __getitem__(self, key: str) -> Any:
        r"""Returns an attribute of all windows, before the transform of the frames."""
        if key == "num_frames":
            return self.length
        if key == "valid_frames" and self.valid is not None:
            return self.valid
        if key in ("x", *self.series):
            windows = self if self.transform is None else self._with(transform=None)
            return windows.index_select(slice(None))[key]
        if key == "y":
            assert self.target is not None
            return self.frames[self.target][self._rows(self._last_index() + self.horizon)]
        value = self.frames[key]
        return value if self.frames.is_shared(key) else value[self._rows(self._last_index())]

    def sample(self, i: int) -> Data:
        r"""Returns one window as PyG's :class:`~torch_geometric.data.Data`."""
        if not -self.num_samples <= i < self.num_samples:
            raise IndexError(f"'i' must be below {self.num_samples} (got {i})")
        return self.index_select(torch.tensor([i % self.num_samples])).sample(0)

    def select(self, index: Any) -> Self:
        r"""Returns a selection of the windows without cutting them.

        Shapes:
            - **index:** Indices :math:`(B,)`.
        """
        valid = None if self.valid is None else self.valid[index]
        return self._with(starts=self.starts[index], valid=valid)

    def index_select(self, index: Any) -> StaticData:
        r"""Cuts a selection of the windows from the frames.

        Shapes:
            - **index:** Indices :math:`(B,)`.
        """
        return self.select(index)._cut()

    def clone(self) -> Self:
        r"""Returns a copy with its own memory that has only the frames that the windows need."""
        used_rows = self._used_rows()
        frames = self.frames.index_select(used_rows)
        new_row = torch.full((self.frames.num_samples,), -1)
        new_row[used_rows] = torch.arange(len(used_rows))
        order = None if self.order is None else new_row[self.order]
        starts = self.starts.clone() if order is not None else new_row[self.starts]
        valid = None if self.valid is None else self.valid.clone()
        return self._with(frames=frames.clone(), starts=starts, order=order, valid=valid)

    def to(self, device: Any) -> Self:
        r"""Moves the frames to a device, in place."""
        self.frames = copy.copy(self.frames).to(device)
        for name in ("starts", "valid", "order"):
            value = getattr(self, name)
            setattr(self, name, None if value is None else value.to(device))
        return self

    def _with(self, **changes: Any) -> Self:
        out = copy.copy(self)
        out.__dict__.update(changes)
        return out

    def _last_index(self) -> Tensor:
        if self.valid is None:
            return self.starts + (self.length - 1)
        return self.starts + self.valid - 1

    def _rows(self, index: Tensor) -> Tensor:
        return index if self.order is None else self.order[index]

    def _step_indices(self) -> Tensor:
        # The index of each frame of each window (B, T). Windows are padded with their last frame.
        steps = torch.arange(self.length, device=self.starts.device)
        if self.valid is None:
            return self.starts[:, None] + steps
        return self.starts[:, None] + torch.minimum(steps, self.valid[:, None] - 1)

    def _used_rows(self) -> Tensor:
        rows = self._rows(
            torch.cat([self._step_indices().view(-1), self._last_index() + self.horizon])
        )
        return rows.unique()

    def _cut(self) -> StaticData:
        if self.transform is not None:
            return self._transform_frames()._cut()
        frames, last = self.frames, self._rows(self._last_index())
        out = copy.copy(frames)
        # Written to the mapping directly, without new checks: all attributes keep their levels.
        mapping = out._store._mapping
        for key, value in list(mapping.items()):
            if frames.is_shared(key) or key == "y":
                continue
            if key == "x":
                mapping[key] = cut_windows(value, self._window_rows(), self.length)
            elif key in self.series:
                mapping[key] = self._cut_series(value)
            else:
                mapping[key] = value.index_select(0, last)
        if self.target is not None:
            label = frames[self.target]
            mapping["y"] = self["y"] if self.horizon else label.index_select(0, last)
        mapping["num_frames"] = self.length
        if self.valid is not None:
            mapping["valid_frames"] = self.valid
        return out

    def _window_rows(self) -> Any:
        # The first row of each window, or all rows of each window if they are not consecutive.
        if self.order is None and self.valid is None:
            return self.starts
        starts = self.starts.tolist()
        counts = [self.length] * len(starts) if self.valid is None else self.valid.tolist()
        spans = [slice(a, a + n) for a, n in zip(starts, counts, strict=True)]
        if self.order is None:
            return spans
        rows = self.order.numpy(force=True)
        return [rows[span] for span in spans]

    def _cut_series(self, value: Tensor) -> Tensor:
        out = value[self._rows(self._step_indices())]
        if self.valid is None:
            return out
        steps = torch.arange(self.length, device=self.valid.device)
        is_after = steps >= self.valid[:, None]
        if not out.is_floating_point():
            return out
        return out.masked_fill_(is_after.view(*is_after.shape, *(1,) * (out.dim() - 2)), torch.nan)

    def _transform_frames(self) -> Self:
        # Applies the transform to the frames of these windows, stored one window after another.
        # With a horizon, each window has one more frame: the labelled one.
        indices = self._step_indices()
        if self.horizon:
            indices = torch.cat([indices, (self._last_index() + self.horizon)[:, None]], dim=1)
        chunk = self.frames.index_select(self._rows(indices.view(-1)))
        starts = torch.arange(len(indices), device=indices.device) * indices.size(1)
        return self._with(
            frames=apply_transform(self.transform, chunk),
            starts=starts,
            order=None,
            horizon=min(self.horizon, 1),
            transform=None,
        )
