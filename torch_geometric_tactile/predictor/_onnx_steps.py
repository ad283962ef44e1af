r"""The steps of a graph that no transform has by itself."""

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from torch_geometric_tactile.data import StaticData, join_frames
from torch_geometric_tactile.transforms import FittedTransform
from torch_geometric_tactile.transforms._windows import repeated

Step = Callable[[StaticData], StaticData]


class GivenRest:
    r"""A transform that measures sessions, with what it measured as an input of the graph."""

    def __init__(self, part: FittedTransform, of_windows: bool) -> None:
        if part.attr != "x":
            raise NotImplementedError(
                f"{part!r} cannot be exported: only readings may be measured by session (got "
                f"attr='{part.attr}')"
            )
        self.part = part
        self.of_windows = of_windows
        self.reads_changed = False  # whether steps before it change the readings
        self.center: Tensor | None = None
        self.scale: Tensor | None = None
        self.seen: Tensor | None = None

    @property
    def has_scale(self) -> bool:
        r"""Whether it divides by a scale as well."""
        return not self.part.unit_scale

    def __call__(self, data: StaticData) -> StaticData:
        r"""Subtracts and divides."""
        assert self.center is not None
        self.seen = x = data.x
        center, scale = self.center, self.scale
        if self.part.per == "signal":
            center = repeated(center, data.num_frames)
            scale = None if scale is None else repeated(scale, data.num_frames)
        # Raw counts are large and vary little.
        x = (x.double() - center).to(x.dtype)
        data.x = x if scale is None else x / scale
        return data


class Set:
    r"""Attributes that are the same for all frames, and columns of the readings."""

    def __init__(self, before: StaticData, after: StaticData, replaces: bool) -> None:
        self.replaces = replaces
        old, new = before.to_dict(), after.to_dict()
        self.removed = [key for key in old if key not in new]
        self.values = {
            key: value for key, value in new.items() if key != "x" and value is not old.get(key)
        }
        self.schema = after
        columns = after.x.size(-1)
        self.columns = after.x if columns else None

    def __call__(self, data: StaticData) -> StaticData:
        r"""Applies it."""
        schema: Any = self.schema.schema
        data = data.declare(**schema)
        for key in self.removed:
            if key in data:
                del data[key]
        for key in sorted(self.values, key=lambda key: key != "edge_index"):
            data[key] = self.values[key]
        if self.columns is not None:
            columns = self.columns.to(data.x).expand(data.x.size(0), -1, -1)
            data.x = columns if self.replaces else torch.cat([data.x, columns], dim=-1)
        return data


def as_window(frames: Tensor) -> Tensor:
    r"""Returns frames :math:`(T, N, C)` as a window :math:`(1, N, C \cdot T)`."""
    return join_frames(frames.transpose(0, 1)).unsqueeze(0)
