r"""The base class of scaling transforms."""

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
    CachedTables,
    center_and_scale,
    check_size,
    convert_tables,
    expand_shared,
    mean_and_deviation,
    sample_rows,
)
from torch_geometric_tactile.transforms._windows import repeat_frames, require_num_frames
from torch_geometric_tactile.transforms.tactile_transform import TactileTransform

_MAX_CHUNK = 8192  # samples read at a time

# The rounding error of a centre in single precision is ignored up to this part of the scale.
_NEGLIGIBLE = 1e-7
_PER = ("taxel", "channel", "signal")

_logger = logging.getLogger(__name__)


class _Attributes(Protocol):
    def __contains__(self, key: str) -> bool: ...

    def __getitem__(self, key: str) -> Any: ...


class FittedTransform(TactileTransform):
    r"""The base class of transforms that subtract a centre from the readings, or from another
    attribute, and divide by a scale.

    Centre and scale are fitted in advance, separately for each value of the sample attribute
    :obj:`key`. A subclass overrides :meth:`moments` to compute centre and scale in another way, and
    :meth:`measured` to fit them on other samples.

    An attribute that all samples share, such as edge features :math:`(|\mathcal{E}|, D)` in
    :class:`~torch_geometric_tactile.data.StaticData`, stays shared. With :obj:`per="taxel"` it
    becomes zero, since each number equals its centre.

    Args:
        key (str, optional): Integer attribute of the samples that selects centre and scale.
        unit_scale (bool): If :obj:`True`, the scale is one.
        first (int, optional): Number of samples on which to fit, from the first sample of each
            value of :obj:`key` on. If left out, all samples are used.
        attr (str): The attribute to scale: :obj:`"x"`, or another attribute of floating-point
            numbers such as :obj:`"edge_attr"`, :obj:`"joint"`, :obj:`"absolute"` or :obj:`"pos"`.
        per (str): The numbers that share a centre and a scale:

            * :obj:`"taxel"`: each number of a sample has a separate centre and scale.
            * :obj:`"channel"`: all taxels (or other rows) of a channel share them. Channels are the
              last dimension.
            * :obj:`"signal"`: all frames of a taxel and channel in a window share them.

    Raises:
        ValueError: If :obj:`per` is unknown, or is :obj:`"signal"` while :obj:`attr` is not
            :obj:`"x"`.

    Examples:
        >>> import torch
        >>> from torch_geometric_tactile.data import StaticData
        >>> data = StaticData(x=torch.tensor([[[1.0]], [[3.0]]]))
        >>> FittedTransform(unit_scale=True).fit(data)(data).x.view(-1)  # subtracts the mean
        tensor([-1.,  1.])
    """

    @property
    def reads(self) -> tuple[str, ...]:
        r"""The scaled attribute, the key, and the number of frames of windows."""
        key = (self.key, "x") if self.key else ()
        return (self.attr, *key, *(FRAMES if self.per == "signal" else ()))

    @property
    def writes(self) -> tuple[str, ...]:
        r"""The scaled attribute."""
        return (self.attr,)

    @property
    def per_frame(self) -> bool:
        r"""Whether all frames of a window have the same centre and scale."""
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
        # Shape (K, N, F), or (K, ...) with the shape of the attribute in a sample; (K, 1, F) for
        # channels and (K, N, C) for signals. In double precision, since raw counts are large and
        # vary little.
        self.center: Tensor | None = None
        self.scale: Tensor | None = None  # same shape as the centre
        self.key_values: Tensor | None = None  # (K,), sorted
        self._kept: CachedTables | None = None

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_kept": None}  # a cache is neither copied nor saved

    def fit(self, data: AnySamples, before: BaseTransform | None = None) -> Self:
        r"""Fits centre and scale to the readings of :obj:`data`, which are read in chunks. Labels
        are not used.

        Missing readings (NaN) are ignored. A taxel that never changes gets the scale one.

        Args:
            data (Dataset or StaticData or list of Data): The samples, such as PyG's
                :class:`~torch_geometric.data.InMemoryDataset` or a
                :class:`~torch.utils.data.Subset`. The :obj:`transform` of their data set is not
                applied.
            before (BaseTransform, optional): A transform applied to the samples first.

        Raises:
            ValueError: If there is no sample, or the samples lack the attribute :obj:`key` or
                :obj:`attr`.
        """
        samples = self._read(data, before)
        self.center = self.scale = self.key_values = None
        return self._measure(samples, self._keys(samples))

    def adapt(self, data: AnySamples, before: BaseTransform | None = None) -> Self:
        r"""Fits centre and scale only for values of :obj:`key` that were not fitted before, such as
        new sessions.

        Does nothing if :obj:`key` is :obj:`None`, so that other data do not change a scaler of the
        training part.

        Args:
            data (Dataset or StaticData or list of Data): The samples, as in :meth:`fit`.
            before (BaseTransform, optional): A transform applied to the samples first.
        """
        if self.key is None:
            return self
        samples = self._read(data, before)
        return self._measure(samples, self._keys(samples))

    def _read(self, data: AnySamples, before: BaseTransform | None) -> Samples | FlatSamples:
        if is_static(data):
            return Samples(data, before, _MAX_CHUNK)
        if self.per == "channel" and len(data):  # type: ignore[arg-type]  # a data set or list
            return FlatSamples(data, before)
        samples = Samples(data, before, _MAX_CHUNK)
        if samples.num_samples:
            self._check_taxels(GraphSamples(without_transform(data)))
        return samples

    def _check_taxels(self, samples: GraphSamples) -> None:
        if self.attr == "x" and samples.is_mixed:
            raise ValueError(
                f"{type(self).__name__} must be fitted on samples with the same taxels, except "
                f"with per='channel', which has one centre and scale for all taxels of a channel "
                f"(got samples of {samples.describe_taxels()})"
            )

    def _keys(self, samples: Samples | FlatSamples) -> Tensor:
        if samples.num_samples == 0:
            raise ValueError(f"{type(self).__name__} must be fitted on samples (got none)")
        if self.key is None:
            return torch.zeros(samples.num_samples, dtype=torch.long)
        return self.sample_values(samples, self.key, samples.num_samples).long()

    def sample_values(self, data: _Attributes, key: str, num_samples: int) -> Tensor:
        r"""Returns an attribute that has one number for each sample.

        Args:
            data (torch_geometric.data.Data or Samples): The samples.
            key (str): Name of the attribute.
            num_samples (int): The number of samples :math:`S`.

        Shapes:
            - **output:** :math:`(S,)`

        Raises:
            ValueError: If there is no such attribute, or it has the wrong number of values.
        """
        need(key in data, f"{type(self).__name__} needs samples with '{key}' (got none)")
        values = torch.as_tensor(data[key]).reshape(-1).cpu()
        if len(values) != num_samples:
            raise ValueError(
                f"'{key}' must have {num_samples} values, one for each sample (got {len(values)})"
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
        tables = [torch.stack(center), torch.stack(scale), values]
        if self.center is not None and self.scale is not None and self.key_values is not None:
            fitted_tables = [self.center, self.scale, self.key_values]
            tables = [torch.cat(pair) for pair in zip(fitted_tables, tables, strict=True)]
        order = tables[2].argsort()
        self.center, self.scale, self.key_values = (table[order] for table in tables)
        return self

    def measured(self, samples: Samples | FlatSamples, index: Tensor) -> Tensor:
        r"""Returns the samples with one value of :obj:`key` on which centre and scale are fitted.

        Args:
            samples (Samples): All samples; :obj:`samples[name]` returns an attribute of them.
            index (torch.Tensor): Indices of the samples with this value, increasing and not empty.

        Returns:
            torch.Tensor: A selection of these indices, increasing and not empty.
        """
        return index[: self.first]

    def noise(self, center: Tensor) -> Tensor | float:
        r"""Returns the largest change that counts as rounding.

        The limit is zero for readings, which are measured. Other attributes are computed in single
        precision: the length of an edge within a rigid patch, for example, varies by nanometres
        between samples.

        Args:
            center (torch.Tensor): The centres.
        """
        if self.attr == "x" or center.numel() == 0:
            return 0.0
        # Relative to the largest centre, since a small number may have the rounding error of large
        # ones, as the difference of two positions has.
        return 1e-5 * center.abs().max()

    def moments(self, parts: Iterable[Tensor]) -> tuple[Tensor, Tensor]:
        r"""Returns centre and scale: the mean and the standard deviation without missing readings.

        Args:
            parts (iterable of torch.Tensor): The readings in parts, in double precision. The parts
                can be iterated over only once.

        Shapes:
            - **parts:** at least one part :math:`(S_i, N, F)` with :math:`S_i \ge 1`, or
              :math:`(S_i, \ldots)` for another attribute
            - **output:** centre and scale :math:`(N, F)`, or :math:`(\ldots)` for another
              attribute; the centre in double precision
        """
        center, deviation = mean_and_deviation(parts)
        if self.unit_scale:
            return center, torch.ones_like(deviation).float()
        return center, self.usable(center, deviation)

    def usable(self, center: Tensor, deviation: Tensor) -> Tensor:
        r"""Returns deviations as scales, replacing deviations that are only rounding by one.

        Args:
            center (torch.Tensor): The centres.
            deviation (torch.Tensor): The deviations, of the same shape.
        """
        # Single precision has about seven digits. A smaller deviation is rounding, and division by
        # it would turn rounding errors into large numbers.
        is_changing = deviation > 1e-6 * center.abs().clamp(min=1e-6)
        return torch.where(is_changing & (deviation > self.noise(center)), deviation, 1.0).float()

    def forward(self, data: Data) -> Data:
        r"""Scales the readings :math:`(N, F)` or :math:`(B, N, F)`, the readings of a PyG batch, or
        another attribute.
        """
        if self.center is None or self.scale is None:
            raise RuntimeError(f"{type(self).__name__} must be fitted before it is applied")
        x = require(self, data, self.attr)
        x = x if x.is_floating_point() else x.float()  # counts may be integers
        num_frames = require_num_frames(self, data) if self.per == "signal" else None
        size = self.center.shape[1:]  # the shape of one sample
        if num_frames is not None:
            size = torch.Size((*size[:-1], num_frames * size[-1]))
        check_size(self, x, size)
        if x.numel() > 0:
            self._kept = cache = convert_tables(self._kept, self.center, self.scale, x, num_frames)
            center, remainder, scale = cache.tables
            if self.key is None:
                shape = x.shape
                x = x.reshape(-1, *size)
                center, remainder, scale = center[0], remainder[0], scale[0]
            else:
                x = expand_shared(self, data, x)
                shape = x.shape
                x, row = sample_rows(self, data, x, size)
                center, remainder, scale = (
                    table[row.to(x.device)] for table in (center, remainder, scale)
                )
            x = ((x - center - remainder) / scale).reshape(shape)
        data[self.attr] = x
        return data

    def graph_step(
        self, constants: StaticData, changing: Set[str]
    ) -> Callable[[StaticData], StaticData]:
        r"""Returns a step that uses precomputed tables with the shape of the scaled attribute."""
        return _ScaleStep(self)

    def state_dict(self) -> dict[str, Tensor]:
        r"""Returns the centre, scale and key values for a checkpoint."""
        if self.center is None or self.scale is None or self.key_values is None:
            return {}
        return {"center": self.center, "scale": self.scale, "key_values": self.key_values}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        r"""Loads the output of :meth:`state_dict`.

        Args:
            state (Mapping): The state; the state of an unfitted transform is empty.
        """
        self.center = state.get("center")
        self.scale = state.get("scale")
        self.key_values = state.get("key_values")

    def _attr_repr(self) -> str:
        attr = "" if self.attr == "x" else f", attr='{self.attr}'"
        return attr if self.per == "taxel" else f"{attr}, per='{self.per}'"

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self._attr_repr().removeprefix(', ')})"


class _ScaleStep:
    r"""The step of a scaler in an exported graph. Its tables have the shape of the scaled
    attribute, since runtimes are fastest without broadcasting.
    """

    def __init__(self, part: FittedTransform) -> None:
        self.part = part
        self.tables: dict[torch.Size, tuple[Tensor, Tensor | None, Tensor]] = {}

    def __call__(self, data: StaticData) -> StaticData:
        x = data[self.part.attr]
        if x.shape not in self.tables:
            num_frames = data.num_frames if self.part.per == "signal" else 1
            self.tables[x.shape] = self._build_tables(x.shape, num_frames)
        center, remainder, factor = self.tables[x.shape]
        x = x - center
        data[self.part.attr] = (x if remainder is None else x - remainder) * factor
        return data

    def _build_tables(
        self, shape: torch.Size, num_frames: int
    ) -> tuple[Tensor, Tensor | None, Tensor]:
        # The centre, its rounding error unless it is negligible, and the inverse of the scale.
        assert self.part.center is not None
        assert self.part.scale is not None
        center, scale = self.part.center[0].cpu(), self.part.scale[0].cpu().double()
        if self.part.per == "signal":
            center, scale = repeat_frames(center, num_frames), repeat_frames(scale, num_frames)
        rounded = center.float()
        remainder = center - rounded
        is_negligible = (
            bool((remainder / scale).abs().max() < _NEGLIGIBLE) if remainder.numel() else True
        )
        rounded, remainder, factor = (
            value.float().expand(shape).contiguous() for value in (rounded, remainder, 1 / scale)
        )
        return rounded, None if is_negligible else remainder, factor
