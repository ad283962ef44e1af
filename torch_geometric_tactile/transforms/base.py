r"""What the scaling transforms share."""

from collections.abc import Iterable, Mapping
from typing import Any, Self

import torch
from torch import Tensor
from torch_geometric.data import Data
from torch_geometric.transforms import BaseTransform, Compose

from torch_geometric_tactile.data import StaticData, StaticDataset, apply_transform

_CHUNK = 8192  # samples read at a time, so that fitting a memory-mapped data set needs no copy

_Place = tuple[torch.dtype, torch.device]


class FittedTransform(BaseTransform):
    r"""Subtracts a centre from the readings and divides them by a scale, both fitted before, for
    each taxel and channel, and separately for each value of the sample attribute :obj:`key`.

    A subclass says with :meth:`moments` what centre and scale are, and with :meth:`measured` on
    which samples they are fitted.

    Args:
        key (str, optional): Integer attribute of the samples that chooses centre and scale.
        unit_scale (bool): Whether to leave the scale at one.
        first (int, optional): How many samples, in their order, of each value of :obj:`key` are
            used to fit. All if left out.
    """

    supports_static = True

    def __init__(
        self, key: str | None = None, unit_scale: bool = False, first: int | None = None
    ) -> None:
        self.key = key
        self.unit_scale = unit_scale
        self.first = first
        self.center: Tensor | None = None  # (K, N, F), double: raw counts are large and vary little
        self.scale: Tensor | None = None  # (K, N, F)
        self.key_values: Tensor | None = None  # (K,), sorted
        self._kept: tuple[Tensor, Tensor, _Place, tuple[Tensor, Tensor, Tensor]] | None = None

    def fit(self, data: StaticDataset | StaticData) -> Self:
        r"""Measures centre and scale on the readings of :obj:`data`; labels are not used.

        Missing readings (NaN) do not count. A taxel that never changes keeps the scale one.

        Args:
            data (StaticDataset or StaticData): The samples, before any :obj:`transform`.

        Raises:
            ValueError: If there is no sample, or the samples lack the attribute :obj:`key`.
        """
        data = data.data if isinstance(data, StaticDataset) else data
        self.center = self.scale = self.key_values = None
        return self._measure(data, self._keys(data))

    def adapt(self, data: StaticDataset | StaticData) -> Self:
        r"""Measures only those values of :obj:`key` that were not measured before.

        Does nothing where :obj:`key` is :obj:`None`: a scaler of the training part stays as it is.

        Args:
            data (StaticDataset or StaticData): The samples, before any :obj:`transform`.
        """
        if self.key is None:
            return self
        data = data.data if isinstance(data, StaticDataset) else data
        keys = self._keys(data)
        known = self.key_values
        if known is not None:
            unknown = ~torch.isin(keys, known)
            data, keys = data.index_select(unknown), keys[unknown]
        return self._measure(data, keys) if len(keys) else self

    def _keys(self, data: StaticData) -> Tensor:
        if data.num_samples == 0:
            raise ValueError(f"{type(self).__name__} must be fitted on samples (got none)")
        if self.key is None:
            return torch.zeros(data.num_samples, dtype=torch.long)
        return self._sample_keys(data, data.num_samples)

    def _sample_keys(self, data: Data, num_samples: int) -> Tensor:
        assert self.key is not None
        return self.sample_values(data, self.key, num_samples).long()

    def sample_values(self, data: Data, key: str, num_samples: int) -> Tensor:
        r"""Returns an attribute that must have one number a sample.

        Args:
            data (torch_geometric.data.Data): The samples.
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

    def _measure(self, data: StaticData, keys: Tensor) -> Self:
        values = keys.unique()
        center, scale = zip(
            *(self._moments(data, (keys == value).nonzero().view(-1)) for value in values),
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

    def _moments(self, data: StaticData, index: Tensor) -> tuple[Tensor, Tensor]:
        index = self.measured(data, index)
        center, scale = self.moments(data.x[part].double() for part in index.split(_CHUNK))
        return center.cpu(), scale.cpu()

    def measured(self, data: StaticData, index: Tensor) -> Tensor:
        r"""Returns which samples count, of those with one value of :obj:`key`.

        Args:
            data (StaticData): All samples.
            index (torch.Tensor): Indices of those with this value, ascending and at least one.

        Returns:
            torch.Tensor: Some of these indices, at least one.
        """
        return index[: self.first]

    def moments(self, parts: Iterable[Tensor]) -> tuple[Tensor, Tensor]:
        r"""Returns centre and scale: mean and standard deviation, without missing readings.

        Args:
            parts (iterable of torch.Tensor): The readings in parts, double, each to be read once.

        Shapes:
            - **input:** at least one part :math:`(S_i, N, F)`, with :math:`S_i \ge 1`
            - **output:** :math:`(N, F)` each, the centre double
        """
        shift: Tensor | None = None
        for part in parts:
            if shift is None:
                shift = part[0].nan_to_num()  # keeps the sum of squares small
                count = torch.zeros_like(shift)
                total, square = torch.zeros_like(shift), torch.zeros_like(shift)
            value = part - shift
            count += (~value.isnan()).sum(0)
            total += value.nansum(0)
            square += value.square().nansum(0)
        assert shift is not None
        count = count.clamp(min=1)
        mean = total / count
        deviation = (square / count - mean.square()).clamp(min=0).sqrt()
        scale = torch.where(deviation > 1e-6 * (shift + mean).abs().clamp(min=1e-6), deviation, 1.0)
        if self.unit_scale:
            scale = torch.ones_like(scale)
        return shift + mean, scale.float()

    def forward(self, data: Data) -> Data:
        r"""Scales the readings :math:`(N, F)`, :math:`(B, N, F)`, or those of a PyG batch."""
        if self.center is None or self.scale is None:
            raise RuntimeError(f"{type(self).__name__} must be fitted before it is applied")
        x = data.x if data.x.is_floating_point() else data.x.float()  # counts may be integers
        num_taxels, num_features = self.center.shape[1:]
        if (
            x.dim() not in (2, 3)
            or x.size(-1) != num_features
            or x.size(-2) % num_taxels
            or (x.dim() == 3 and x.size(-2) != num_taxels)  # only a PyG batch joins its samples
        ):
            raise ValueError(
                f"'x' must have {num_taxels} taxels and {num_features} features, as "
                f"{type(self).__name__} was fitted on (got shape {tuple(x.shape)})"
            )
        near, rest, scale = self._tables(self.center, self.scale, x)
        if self.key is None:
            near, rest, scale = near[0], rest[0], scale[0]
        else:
            row = self._row(data, x.numel() // (num_taxels * num_features)).to(x.device)
            near, rest, scale = near[row], rest[row], scale[row]
        out = (x.reshape(-1, num_taxels, num_features) - near - rest) / scale
        data.x = out.reshape(x.shape)
        return data

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


def _place(x: Tensor) -> _Place:
    return x.dtype, x.device


def fitted_parts(transform: BaseTransform | None) -> list[FittedTransform]:
    r"""Returns the parts of a transform that are fitted, in their order.

    Args:
        transform (BaseTransform, optional): A transform or PyG's :class:`Compose` of transforms.
    """
    if isinstance(transform, Compose):
        return [part for inner in transform.transforms for part in fitted_parts(inner)]
    return [transform] if isinstance(transform, FittedTransform) else []


def fit_transform(
    transform: BaseTransform | None, data: StaticDataset | StaticData, adapt: bool = False
) -> StaticData:
    r"""Fits every part of a transform on what the parts before it return, and applies it.

    Args:
        transform (BaseTransform, optional): A transform or PyG's :class:`Compose` of transforms.
        data (StaticDataset or StaticData): The samples.
        adapt (bool): Whether to call :meth:`FittedTransform.adapt` instead of :obj:`fit`.
    """
    data = data.data if isinstance(data, StaticDataset) else data
    if isinstance(transform, Compose):
        for part in transform.transforms:
            data = fit_transform(part, data, adapt)
        return data
    if isinstance(transform, FittedTransform):
        transform.adapt(data) if adapt else transform.fit(data)
    return apply_transform(transform, data)
