r"""What the scaling transforms share."""

import logging
from collections.abc import Iterable, Mapping
from math import prod
from typing import Any, Literal, Protocol, Self

import torch
from torch import Tensor
from torch_geometric.data import Batch, Data
from torch_geometric.transforms import BaseTransform

from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.transforms._attributes import require
from torch_geometric_tactile.transforms._moments import check_size, mean_and_deviation
from torch_geometric_tactile.transforms._samples import AnySamples, Samples

_CHUNK = 8192  # samples read at a time, at most

_PER = ("taxel", "channel")

_logger = logging.getLogger(__name__)

_Place = tuple[torch.dtype, torch.device]


class _Attributes(Protocol):
    def __contains__(self, key: str) -> bool: ...

    def __getitem__(self, key: str) -> Any: ...


class FittedTransform(BaseTransform):
    r"""Subtracts a centre from the readings, or from another attribute, and divides them by a
    scale, both fitted before, for each number of a sample (each taxel and channel, for example)
    or for all numbers of a channel, and separately for each value of the sample attribute
    :obj:`key`.

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
        per (str): Of what centre and scale are: of each number by itself (:obj:`"taxel"`), or one
            of all taxels, or other rows, of a channel, the last dimension (:obj:`"channel"`).

    Raises:
        ValueError: If :obj:`per` is neither.
    """

    supports_static = True

    def __init__(
        self,
        key: str | None = None,
        unit_scale: bool = False,
        first: int | None = None,
        attr: str = "x",
        per: Literal["taxel", "channel"] = "taxel",
    ) -> None:
        if per not in _PER:
            raise ValueError(f"'per' must be one of {list(_PER)} (got {per!r})")
        self.key = key
        self.unit_scale = unit_scale
        self.first = first
        self.attr = attr
        self.per = per
        # (K, N, F), or (K, ...) with the shape of the attribute in a sample; (K, 1, F) of channels.
        # Double: raw counts are large and vary little.
        self.center: Tensor | None = None
        self.scale: Tensor | None = None  # of the same shape
        self.key_values: Tensor | None = None  # (K,), sorted
        self._kept: tuple[Tensor, Tensor, _Place, tuple[Tensor, Tensor, Tensor]] | None = None

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
        samples = Samples(data, before, _CHUNK)
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
        samples = Samples(data, before, _CHUNK)
        return self._measure(samples, self._keys(samples))

    def _keys(self, samples: Samples) -> Tensor:
        if samples.num_samples == 0:
            raise ValueError(f"{type(self).__name__} must be fitted on samples (got none)")
        if self.key is None:
            return torch.zeros(samples.num_samples, dtype=torch.long)
        return self._sample_keys(samples, samples.num_samples)

    def _sample_keys(self, data: _Attributes, num_samples: int) -> Tensor:
        assert self.key is not None
        return self.sample_values(data, self.key, num_samples).long()

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
        if key not in data:
            raise ValueError(f"{type(self).__name__} needs samples with '{key}' (got none)")
        values = torch.as_tensor(data[key]).reshape(-1).cpu()
        if len(values) != num_samples:
            raise ValueError(
                f"'{key}' must have {num_samples} values, one a sample (got {len(values)})"
            )
        return values

    def _measure(self, samples: Samples, keys: Tensor) -> Self:
        values = keys.unique()
        if self.key_values is not None:
            values = values[~torch.isin(values, self.key_values)]
        if len(values) == 0:
            return self
        if self.attr not in samples:
            raise ValueError(f"{type(self).__name__} needs '{self.attr}' (got none)")
        if samples.is_shared(self.attr) and self.per == "taxel":
            _logger.warning("all samples share one '%s', which %r sets to zero", self.attr, self)
        center, scale = zip(
            *(self._moments(samples, (keys == value).nonzero().view(-1)) for value in values),
            strict=True,
        )
        new_center, new_scale = torch.stack(center), torch.stack(scale)
        if self.key_values is not None:
            assert self.center is not None
            assert self.scale is not None
            values = torch.cat([self.key_values, values])
            new_center = torch.cat([self.center, new_center])
            new_scale = torch.cat([self.scale, new_scale])
        order = values.argsort()
        self.key_values = values[order]
        self.center, self.scale = new_center[order], new_scale[order]
        return self

    def _moments(self, samples: Samples, index: Tensor) -> tuple[Tensor, Tensor]:
        parts = samples.values(self.attr, self.measured(samples, index))
        if self.per == "taxel":
            center, scale = self.moments(part.double() for part in parts)
            return center.cpu(), scale.cpu()
        first = samples.first[self.attr]
        dims = first.dim() - (0 if samples.first.is_shared(self.attr) else 1)
        moments = self.moments(part.double().flatten(end_dim=-2) for part in parts)
        center, scale = (value.cpu().view(*(1,) * (dims - 1), -1) for value in moments)
        return center, scale

    def measured(self, samples: Samples, index: Tensor) -> Tensor:
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
        size = self.center.shape[1:]  # of one sample
        check_size(self, x, size)
        if x.numel() > 0:
            near, rest, scale = self._tables(self.center, self.scale, x)
            shape = x.shape
            if self.key is None:
                x = x.reshape(-1, *size)
                near, rest, scale = near[0], rest[0], scale[0]
            else:
                if isinstance(data, StaticData) and data.is_shared(self.attr):
                    if self.attr in data.schema["shared"]:
                        raise ValueError(
                            f"'{self.attr}' must have a value for each sample, since "
                            f"{type(self).__name__} scales them by '{self.key}' (got one that is "
                            "declared in 'shared')"
                        )
                    x = x.expand(data.num_samples, *x.shape)
                    shape = x.shape
                x, row = self._by_sample(data, x, size)
                near, rest, scale = (table[row.to(x.device)] for table in (near, rest, scale))
            x = ((x - near - rest) / scale).reshape(shape)
        data[self.attr] = x
        return data

    def _by_sample(self, data: Data, x: Tensor, size: torch.Size) -> tuple[Tensor, Tensor]:
        # The readings of each sample, and the row of its centre and scale.
        if self.per == "taxel":
            return x.reshape(-1, *size), self._row(data, x.numel() // prod(size))
        if isinstance(data, Batch):
            row = self._row(data, data.num_graphs)
            counts = data._slice_dict[self.attr].diff()  # of rows; samples may differ in them
            return x.reshape(-1, *size), row.repeat_interleave(counts)
        num_samples = data.num_samples if isinstance(data, StaticData) else 1
        return x.reshape(num_samples, *x.shape[-len(size) :]), self._row(data, num_samples)

    def _tables(self, center: Tensor, scale: Tensor, x: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        # The centre in the precision of x, and what that leaves over: together as good as double.
        # Kept, since converting them costs as much as scaling a batch.
        kept = self._kept
        if kept is None or kept[0] is not center or kept[1] is not scale or kept[2] != _place(x):
            near = center.to(x.dtype)
            tables = near.to(x.device), (center - near).to(x), scale.to(x)
            self._kept = kept = (center, scale, _place(x), tables)
        return kept[3]

    def _row(self, data: Data, num_samples: int) -> Tensor:
        assert self.key_values is not None
        wanted = self._sample_keys(data, num_samples)
        row = torch.searchsorted(self.key_values, wanted).clamp(max=len(self.key_values) - 1)
        unknown = self.key_values[row] != wanted
        if unknown.any():
            raise ValueError(
                f"{type(self).__name__} has not seen {self.key} {int(wanted[unknown][0])}: call "
                f"'adapt' with its (unlabelled) samples first"
            )
        return row

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


def _place(x: Tensor) -> _Place:
    return x.dtype, x.device
