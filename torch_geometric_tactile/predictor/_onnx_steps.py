r"""The transforms of a predictor as steps of one graph, without what depends on values."""

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import pad

from torch_geometric_tactile import transforms as T
from torch_geometric_tactile.data import StaticData, join_frames
from torch_geometric_tactile.sensors._pose_tables import FewTables, chain_few
from torch_geometric_tactile.transforms import FittedTransform
from torch_geometric_tactile.transforms._resampling import new_times, resampling_matrix
from torch_geometric_tactile.transforms._windows import joined_signals, repeated, require_signals

Step = Callable[[StaticData], StaticData]

# Of a scale: what single precision leaves over of a centre, that does not count.
_NEGLIGIBLE = 1e-7


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


class Scaled:
    r"""A scaler with tables of the size of what is scaled, which a runtime takes in long loops."""

    def __init__(self, part: FittedTransform) -> None:
        self.part = part
        self.kept: dict[torch.Size, tuple[Tensor, Tensor | None, Tensor]] = {}

    def __call__(self, data: StaticData) -> StaticData:
        r"""Applies it."""
        x = data[self.part.attr]
        if x.shape not in self.kept:
            num_frames = data.num_frames if self.part.per == "signal" else 1
            self.kept[x.shape] = self._tables(x.shape, num_frames)
        near, rest, factor = self.kept[x.shape]
        x = x - near
        data[self.part.attr] = (x if rest is None else x - rest) * factor
        return data

    def _tables(self, shape: torch.Size, num_frames: int) -> tuple[Tensor, Tensor | None, Tensor]:
        assert self.part.center is not None
        assert self.part.scale is not None
        center, scale = self.part.center[0].cpu(), self.part.scale[0].cpu().double()
        if self.part.per == "signal":
            center, scale = repeated(center, num_frames), repeated(scale, num_frames)
        near = center.float()
        rest = center - near
        is_small = bool((rest / scale).abs().max() < _NEGLIGIBLE) if rest.numel() else True
        near, rest, factor = (
            value.float().expand(shape).contiguous() for value in (near, rest, 1 / scale)
        )
        return near, None if is_small else rest, factor


class Posed:
    r"""Taxels placed by joint angles. Positions and normals are linear in the poses of the links:
    one product serves all taxels.
    """

    def __init__(self, part: T.TaxelPose) -> None:
        self.part = part
        joint = torch.zeros(1, part.kinematics.num_joints)
        self.few: FewTables = part.kinematics._kept_tables(part.layout, joint, few=True)
        self.links = self.few.link.unique()
        self.pos = self._table(self.few.pos)
        self.normal = None
        if part.normal and part.layout.normal is not None:
            self.normal = self._table(self.few.normal)

    def _table(self, places: Tensor) -> Tensor:
        # (12 L, 3 N): of each link three rows of four numbers.
        count = len(places)
        row = torch.searchsorted(self.links, self.few.link)
        table = torch.zeros(len(self.links), 3, 4, count, 3)
        for axis in range(3):
            table[row, axis, :, torch.arange(count), axis] = places[:, 0]
        return table.view(12 * len(self.links), 3 * count)

    def __call__(self, data: StaticData) -> StaticData:
        r"""Applies it."""
        joint = data.joint
        pose = chain_few(self.few, joint).index_select(1, self.links)[:, :, :3].flatten(1)
        shape = (len(joint), -1, 3)
        data.pos = (pose @ self.pos).view(shape)
        if self.normal is not None:
            data.normal = (pose @ self.normal).view(shape)
        if self.part.tangent:
            axes = self.part.kinematics.taxel_axes(self.part.layout, joint)
            data.tangent = axes[..., :2, :]
        return data


class Dropped:
    r"""Dead taxels, the same in all frames."""

    def __init__(self, part: T.DropTaxels, known: StaticData) -> None:
        self.value = part.value
        self.dead = part.dead(known, known.x)[0]

    def __call__(self, data: StaticData) -> StaticData:
        r"""Applies it."""
        data.x = data.x.masked_fill(self.dead.unsqueeze(-1), self.value)
        old = getattr(data, "dropped", None)
        data.dropped = self.dead if old is None else self.dead | old.bool()
        return data


class Segmented:
    r"""Edges within segments, chosen beforehand: their number must not depend on values."""

    def __init__(self, part: T.TopologicalSegmentation, known: StaticData) -> None:
        source, target = known.edge_index
        within = part.segment[source] == part.segment[target]
        self.kept = within.nonzero().view(-1)
        self.count = known.edge_index.size(1)
        self.segment = part.segment
        self.within = None if part.drop else within
        self.edge_index = known.edge_index[:, self.kept] if part.drop else known.edge_index

    def __call__(self, data: StaticData) -> StaticData:
        r"""Applies it."""
        rows = {}
        if self.within is None:
            for key, value in data.to_dict().items():
                if key != "edge_index" and isinstance(value, Tensor) and data.level(key) == "edge":
                    rows[key] = value.index_select(0 if data.is_shared(key) else 1, self.kept)
        for key in ("edge_is_within", *rows):
            if key in data:
                del data[key]
        data.edge_index = self.edge_index
        for key, value in rows.items():
            data[key] = value
        if self.within is not None:
            data.edge_is_within = self.within
        data.segment_batch = self.segment
        return data


class Resampled:
    r"""Windows of one length with another number of frames."""

    def __init__(self, part: T.Resample) -> None:
        self.part = part

    def __call__(self, data: StaticData) -> StaticData:
        r"""Applies it."""
        if getattr(data, "valid_frames", None) is not None:
            raise NotImplementedError(f"{self.part!r} cannot be exported for padded windows")
        signals, num = require_signals(self.part, data), self.part.num
        length = signals.size(-1)
        if length != num:
            matrix = resampling_matrix(length, num).t()
            nearest = (new_times(length, num) + 0.5).floor().long()
            missing = signals.isnan()
            bridged = _bridged(signals.double(), missing)
            level = bridged[..., :1]
            out = (level + (bridged - level) @ matrix).to(signals.dtype)
            out = torch.cat([signals[..., :1], out[..., 1:-1], signals[..., -1:]], dim=-1)
            signals = out.masked_fill(missing[..., nearest], torch.nan)
        data.x = joined_signals(signals, data)
        data.num_frames = num
        return data


def _bridged(values: Tensor, missing: Tensor) -> Tensor:
    # As of `_resampling`, with running maxima in steps of 1, 2, 4 and so on frames, since a graph
    # has none in one operation.
    length = values.size(-1)
    frames = torch.arange(length)
    left = torch.where(missing, -1, frames)
    right = torch.where(missing, length, frames)
    step = 1
    while step < length:
        left = torch.maximum(left, pad(left[..., :-step], (step, 0), value=-1))
        right = torch.minimum(right, pad(right[..., step:], (0, step), value=length))
        step *= 2
    first, last = left.clamp(min=0), right.clamp(max=length - 1)
    first, last = torch.where(left < 0, last, first), torch.where(right >= length, first, last)
    start, stop = values.gather(-1, first), values.gather(-1, last)
    part = (frames - first) / (last - first).clamp(min=1)
    line = start + part * (stop - start)
    return torch.where(missing, line, values).nan_to_num(nan=0.0)


def as_window(frames: Tensor) -> Tensor:
    r"""Returns frames :math:`(T, N, C)` as a window :math:`(1, N, C \cdot T)`."""
    return join_frames(frames.transpose(0, 1)).unsqueeze(0)
