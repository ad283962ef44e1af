r"""What the scaling transforms share."""

import logging
from collections.abc import Callable, Iterable, Mapping, Set
from typing import Any, Literal, Protocol, Self

import torch
from torch import Tensor
from torch_geometric.data import Data
from torch_geometric.transforms import BaseTransform

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.data._graph_samples import GraphSamples, without_transform
from torch_geometric_tactile.transforms._attributes import FRAMES, require
from torch_geometric_tactile.transforms._samples import AnySamples, FlatSamples, Samples, is_static
from torch_geometric_tactile.transforms._scaling import (
    KeptTables,
    by_sample,
    center_and_scale,
    check_size,
    expand_shared,
    mean_and_deviation,
    tables_like,
)
from torch_geometric_tactile.transforms._windows import repeated, require_num_frames
from torch_geometric_tactile.transforms.tactile_transform import TactileTransform

_CHUNK = 8192  # samples read at a time, at most

# Of a scale: what single precision leaves over of a centre, that does not count.
_NEGLIGIBLE = 1e-7
_PER = ("taxel", "channel", "signal")

_logger = logging.getLogger(__name__)


class _Attributes(Protocol):
    def __contains__(self, key: str) -> bool: ...

    def __getitem__(self, key: str) -> Any: ...


class FittedTransform(TactileTransform):
    r"""Base class of transforms that subtract a centre from the readings, or from another
    attribute, and divide by a scale, both fitted before: for each number of a sample (each taxel
    and channel, for example) or for all numbers of a channel, and separately for each value of the
    sample attribute :obj:`key`.

    A subclass says with :meth:`moments` what centre and scale are, and with :meth:`measured` on
    which samples they are fitted.

    An attribute that all samples share, such as edge features :math:`(|\mathcal{E}|, D)` in
    :class:`~torch_geometric_tactile.data.StaticData`, stays shared. Number by number it never
    changes, so that nothing but its distance from the centre is left of it, which is zero.

    Args:
        key (str, optional): Integer attribute of the samples that chooses centre and scale.
        unit_scale (bool): Whether to leave the scale at one.
        first (int, optional): How many samples, in their order, of each value of :obj:`key` are
            used to fit. All if left out.
        attr (str): What is scaled: :obj:`"x"`, or another attribute of floating-point numbers such
            as :obj:`"edge_attr"`, :obj:`"joint"`, :obj:`"absolute"` or :obj:`"pos"`.
        per (str): Of what centre and scale are: of each number by itself (:obj:`"taxel"`), one of
            all taxels, or other rows, of a channel, the last dimension (:obj:`"channel"`), or one
            of all frames of a taxel and channel in windows (:obj:`"signal"`).

    Raises:
        ValueError: If :obj:`per` is none of these, or :obj:`"signal"` of other than :obj:`"x"`.

    Examples:
        >>> import torch
        >>> from torch_geometric_tactile.data import StaticData
        >>> data = StaticData(x=torch.tensor([[[1.0]], [[3.0]]]))
        >>> FittedTransform(unit_scale=True).fit(data)(data).x.view(-1)  # subtracts the mean
        tensor([-1.,  1.])
    """

    @property
    def reads(self) -> tuple[str, ...]:
        r"""What is scaled, the numbers of its samples, and the frames of windows."""
        key = (self.key, "x") if self.key else ()
        return (self.attr, *key, *(FRAMES if self.per == "signal" else ()))

    @property
    def writes(self) -> tuple[str, ...]:
        r"""What is scaled."""
        return (self.attr,)

    @property
    def per_frame(self) -> bool:
        r"""Whether all frames of a window have one centre and scale."""
        return self.attr != "x" or self.per == "signal"

    def __init__(
        self,
        key: str | None = None,
        unit_scale: bool = False,
        first: int | None = None,
        attr: str = "x",
        per: Literal["taxel", "channel", "signal"] = "taxel",
    ) -> None:
        need(per in _PER, f"'per' must be one of {list(_PER)} (got {per!r})")
        need(per != "signal" or attr == "x", f"'attr' must be 'x' with per='signal' (got {attr!r})")
        self.key = key
        self.unit_scale = unit_scale
        self.first = first
        self.attr = attr
        self.per = per
        # (K, N, F), or (K, ...) with the shape of the attribute in a sample; (K, 1, F) of channels,
        # (K, N, C) of signals. Double: raw counts are large and vary little.
        self.center: Tensor | None = None
        self.scale: Tensor | None = None  # of the same shape
        self.key_values: Tensor | None = None  # (K,), sorted
        self._kept: KeptTables | None = None

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_kept": None}  # a cache, which is no part of a copy

    def fit(self, data: AnySamples, before: BaseTransform | None = None) -> Self:
        r"""Measures centre and scale on the readings of :obj:`data`, which are read a few samples
        at a time; labels are not used.

        Missing readings (NaN) do not count. A taxel that never changes keeps the scale one.

        Args:
            data (Dataset or StaticData or list of Data): The samples, before the :obj:`transform`
                of their data set: PyG's :class:`~torch_geometric.data.InMemoryDataset`, a
                :class:`~torch.utils.data.Subset`, ...
            before (BaseTransform, optional): Applied to the samples first.

        Raises:
            ValueError: If there is no sample, or the samples lack the attribute :obj:`key` or
                :obj:`attr`.
        """
        samples = self._read(data, before)
        self.center = self.scale = self.key_values = None
        return self._measure(samples, self._keys(samples))

    def adapt(self, data: AnySamples, before: BaseTransform | None = None) -> Self:
        r"""Measures only those values of :obj:`key` that were not measured before.

        Does nothing where :obj:`key` is :obj:`None`: a scaler of the training part stays as it is.

        Args:
            data (Dataset or StaticData or list of Data): The samples, before the :obj:`transform`
                of their data set: PyG's :class:`~torch_geometric.data.InMemoryDataset`, a
                :class:`~torch.utils.data.Subset`, ...
            before (BaseTransform, optional): Applied to the samples first.
        """
        if self.key is None:
            return self
        samples = self._read(data, before)
        return self._measure(samples, self._keys(samples))

    def _read(self, data: AnySamples, before: BaseTransform | None) -> Samples | FlatSamples:
        if is_static(data):
            return Samples(data, before, _CHUNK)
        if self.per == "channel" and len(data):  # type: ignore[arg-type]  # of any taxels
            return FlatSamples(data, before)
        samples = Samples(data, before, _CHUNK)
        if samples.num_samples:
            self._check_taxels(GraphSamples(without_transform(data)))
        return samples

    def _check_taxels(self, samples: GraphSamples) -> None:
        if self.attr == "x" and samples.is_mixed:
            raise ValueError(
                f"{type(self).__name__} must be fitted on samples of the same taxels, unless with "
                f"per='channel', one centre and scale of all taxels of a channel (got samples of "
                f"{samples.describe_taxels()})"
            )

    def _keys(self, samples: Samples | FlatSamples) -> Tensor:
        if samples.num_samples == 0:
            raise ValueError(f"{type(self).__name__} must be fitted on samples (got none)")
        if self.key is None:
            return torch.zeros(samples.num_samples, dtype=torch.long)
        return self.sample_values(samples, self.key, samples.num_samples).long()

    def sample_values(self, data: _Attributes, key: str, num_samples: int) -> Tensor:
        r"""Returns an attribute that must have one number a sample.

        Args:
            data (torch_geometric.data.Data or Samples): The samples.
            key (str): Name of the attribute.
            num_samples (int): The number of samples :math:`S`.

        Shapes:
            - **output:** :math:`(S,)`

        Raises:
            ValueError: If there is no such attribute, or it has another number of values.
        """
        need(key in data, f"{type(self).__name__} needs samples with '{key}' (got none)")
        values = torch.as_tensor(data[key]).reshape(-1).cpu()
        if len(values) != num_samples:
            raise ValueError(
                f"'{key}' must have {num_samples} values, one a sample (got {len(values)})"
            )
        return values

    def _measure(self, samples: Samples | FlatSamples, keys: Tensor) -> Self:
        values = keys.unique()
        if self.key_values is not None:
            values = values[~torch.isin(values, self.key_values)]
        if len(values) == 0:
            return self
        need(self.attr in samples, f"{type(self).__name__} needs '{self.attr}' (got none)")
        if samples.is_shared(self.attr) and self.per == "taxel":
            _logger.warning("all samples share one '%s', which %r sets to zero", self.attr, self)
        parts = [center_and_scale(self, samples, (keys == v).nonzero().view(-1)) for v in values]
        center, scale = zip(*parts, strict=True)
        new = [torch.stack(center), torch.stack(scale), values]
        if self.center is not None and self.scale is not None and self.key_values is not None:
            known = [self.center, self.scale, self.key_values]
            new = [torch.cat(pair) for pair in zip(known, new, strict=True)]
        order = new[2].argsort()
        self.center, self.scale, self.key_values = (value[order] for value in new)
        return self

    def measured(self, samples: Samples | FlatSamples, index: Tensor) -> Tensor:
        r"""Returns which samples count, of those with one value of :obj:`key`.

        Args:
            samples (Samples): All samples; :obj:`samples[name]` is an attribute of them.
            index (torch.Tensor): Indices of those with this value, ascending and at least one.

        Returns:
            torch.Tensor: Some of these indices, ascending and at least one.
        """
        return index[: self.first]

    def noise(self, center: Tensor) -> Tensor | float:
        r"""Returns the largest change that may be rounding, and does not count as one.

        Readings come as they were measured, whereas other attributes are computed, in single
        precision: the length of an edge within a rigid patch is the same in all samples but for
        some nanometres.

        Args:
            center (torch.Tensor): The centres.
        """
        if self.attr == "x" or center.numel() == 0:
            return 0.0
        return 1e-5 * center.abs().max()

    def moments(self, parts: Iterable[Tensor]) -> tuple[Tensor, Tensor]:
        r"""Returns centre and scale: mean and standard deviation, without missing readings.

        Args:
            parts (iterable of torch.Tensor): The readings in parts, double, each to be read once.

        Shapes:
            - **input:** at least one part :math:`(S_i, N, F)`, with :math:`S_i \ge 1`; or
              :math:`(S_i, \ldots)` of another attribute
            - **output:** :math:`(N, F)` each, or :math:`(\ldots)`; the centre double
        """
        center, deviation = mean_and_deviation(parts)
        if self.unit_scale:
            return center, torch.ones_like(deviation).float()
        return center, self.usable(center, deviation)

    def usable(self, center: Tensor, deviation: Tensor) -> Tensor:
        r"""Returns deviations as scales: one where nothing changes by more than rounding does.

        Args:
            center (torch.Tensor): The centres.
            deviation (torch.Tensor): The deviations, of the same shape.
        """
        changes = deviation > 1e-6 * center.abs().clamp(min=1e-6)
        return torch.where(changes & (deviation > self.noise(center)), deviation, 1.0).float()

    def forward(self, data: Data) -> Data:
        r"""Scales the readings :math:`(N, F)`, :math:`(B, N, F)`, or those of a PyG batch; or
        another attribute of them.
        """
        if self.center is None or self.scale is None:
            raise RuntimeError(f"{type(self).__name__} must be fitted before it is applied")
        x = require(self, data, self.attr)
        x = x if x.is_floating_point() else x.float()  # counts may be integers
        frames = require_num_frames(self, data) if self.per == "signal" else None
        size = self.center.shape[1:]  # of one sample
        if frames is not None:
            size = torch.Size((*size[:-1], frames * size[-1]))
        check_size(self, x, size)
        if x.numel() > 0:
            self._kept = kept = tables_like(self._kept, self.center, self.scale, x, frames)
            near, rest, scale = kept.tables
            if self.key is None:
                shape = x.shape
                x = x.reshape(-1, *size)
                near, rest, scale = near[0], rest[0], scale[0]
            else:
                x = expand_shared(self, data, x)
                shape = x.shape
                x, row = by_sample(self, data, x, size)
                near, rest, scale = (table[row.to(x.device)] for table in (near, rest, scale))
            x = ((x - near - rest) / scale).reshape(shape)
        data[self.attr] = x
        return data

    def graph_step(
        self, known: StaticData, changing: Set[str]
    ) -> Callable[[StaticData], StaticData]:
        r"""Returns a product with tables of the size of what is scaled."""
        return _Scaled(self)

    def state_dict(self) -> dict[str, Tensor]:
        r"""Returns what was fitted, for a checkpoint."""
        if self.center is None or self.scale is None or self.key_values is None:
            return {}
        return {"center": self.center, "scale": self.scale, "key_values": self.key_values}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        r"""Takes over what :meth:`state_dict` returned.

        Args:
            state (Mapping): The state; an empty one is that of an unfitted transform.
        """
        self.center = state.get("center")
        self.scale = state.get("scale")
        self.key_values = state.get("key_values")

    def _attr_repr(self) -> str:
        attr = "" if self.attr == "x" else f", attr='{self.attr}'"
        return attr if self.per == "taxel" else f"{attr}, per='{self.per}'"

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self._attr_repr().removeprefix(', ')})"


class _Scaled:
    r"""A scaler with tables of the size of what is scaled, which a runtime takes in long loops."""

    def __init__(self, part: FittedTransform) -> None:
        self.part = part
        self.kept: dict[torch.Size, tuple[Tensor, Tensor | None, Tensor]] = {}

    def __call__(self, data: StaticData) -> StaticData:
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
