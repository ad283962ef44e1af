r"""The features that estimators take, computed of prepared samples: the first step of each."""

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor
from torch.nn import Module

from torch_geometric_tactile._checks import need


class Step(Module):
    r"""A step: how many numbers it takes and gives, :obj:`None` for any and for as many as it
    takes, and the attributes of samples that it reads beside the readings.
    """

    takes: int | None = None
    gives: int | None = None
    modalities: tuple[str, ...] = ()

    def _keep(self, name: str, value: Any, dims: int, dtype: torch.dtype = torch.double) -> None:
        is_number = isinstance(value, Tensor) and value.layout == torch.strided
        if not is_number or value.dim() != dims or value.is_complex():
            raise ValueError(f"'{name}' must be a tensor of {dims} dimensions (got {value!r:.80})")
        if dtype == torch.long and value.is_floating_point():
            raise ValueError(f"'{name}' must hold whole numbers (got {value.dtype})")
        self.register_buffer(name, value.to(dtype), persistent=False)


class Readings(Step):
    r"""All readings side by side, missing ones as zero, as
    :class:`~torch_geometric_tactile.baselines.FlatReadings`.
    """

    def forward(self, x: Tensor, given: Mapping[str, Tensor]) -> Tensor:
        r"""Returns the rows :math:`(B, N \cdot F)`."""
        return _filled(x.flatten(1).double())


class Descriptors(Step):
    r"""The descriptors that :class:`~torch_geometric_tactile.transforms.TaxelDescriptors` set, and
    the readings after them if wanted, as
    :class:`~torch_geometric_tactile.baselines.DescriptorFeatures`.
    """

    modalities = ("descriptors",)

    def __init__(self, with_readings: bool, balanced: bool) -> None:
        super().__init__()
        self.with_readings = bool(with_readings)
        self.balanced = bool(balanced)

    def forward(self, x: Tensor, given: Mapping[str, Tensor]) -> Tensor:
        r"""Returns the rows :math:`(B, K)`."""
        rows = given["descriptors"].double()
        if not self.with_readings:
            return rows
        flat = _filled(x.flatten(1).double())
        times = max(1, round(flat.size(1) / rows.size(1))) if self.balanced else 1
        return torch.cat([*[rows] * times, flat], dim=1)


class Signals(Step):
    r"""The 12 statistics of each signal of a window, as
    :func:`~torch_geometric_tactile.baselines.statistical_features`; the readings themselves of one
    frame.
    """

    def __init__(self, num_channels: int) -> None:
        super().__init__()
        if type(num_channels) is not int or num_channels < 1:
            raise ValueError(f"'num_channels' must be at least 1 (got {num_channels!r:.80})")
        self.num_channels = num_channels

    def forward(self, x: Tensor, given: Mapping[str, Tensor]) -> Tensor:
        r"""Returns the rows :math:`(B, 12 \cdot N \cdot C)`."""
        if x.size(2) % self.num_channels:
            raise ValueError(f"readings must be of {self.num_channels} channels (got {x.size(2)})")
        num_frames = x.size(2) // self.num_channels
        signal = _filled(x.double()).reshape(x.size(0), -1, num_frames)
        if num_frames == 1:
            return signal[..., 0]
        size = signal.abs()
        peak, low_mean = size.amax(2), size.mean(2)
        mean = signal.mean(2)
        variance = (signal - mean.unsqueeze(2)).square().mean(2)
        root_mean_square = signal.square().mean(2).sqrt()
        found = [
            *(signal.amax(2), signal.amin(2), peak, mean, variance, variance.sqrt()),
            *(low_mean, root_mean_square, _ratio(peak, root_mean_square)),
            *(_ratio(root_mean_square, low_mean), _ratio(peak, low_mean)),
            _ratio(peak, size.sqrt().mean(2).square()),
        ]
        return torch.stack(found, dim=2).flatten(1)


class PatchSums(Step):
    r"""What each patch feels in the frame of the palm, as
    :class:`~torch_geometric_tactile.baselines.PosedSummary`, with what that measured.

    Shapes:
        - **rest:** :math:`(N, F)`
        - **patch:** :math:`(N,)`
    """

    rest: Tensor
    patch: Tensor

    def __init__(
        self, rest: Tensor, patch: Tensor, threshold: float, has_normal: bool, has_tangent: bool
    ) -> None:
        super().__init__()
        self._keep("rest", rest, 2)
        self._keep("patch", patch, 1, torch.long)
        need(len(patch) == len(rest) > 0, "'patch' must be of all taxels", len(patch))
        self.threshold = float(threshold)
        found, self.patch = self.patch.unique(return_inverse=True)
        self.num_patches = len(found)
        read = {"pos": True, "normal": has_normal, "tangent": has_tangent}
        self.modalities = tuple(name for name, is_read in read.items() if is_read)
        if has_tangent and not (has_normal and rest.size(1) == 3):
            raise ValueError(
                "'tangent' must come with normals and 3 channels (got "
                f"{rest.size(1)} channels, has_normal={has_normal})"
            )

    def forward(self, x: Tensor, given: Mapping[str, Tensor]) -> Tensor:
        r"""Returns the rows :math:`(B, K \cdot (F + 7))`."""
        num_taxels = self.rest.size(0)
        need(x.shape[1:] == self.rest.shape, f"'x' must be of {num_taxels} taxels", x.shape)
        felt = _filled(x.double() - self.rest)
        weight = felt.square().sum(dim=2).sqrt()
        pressed = (weight > self.threshold).double()
        pos = given["pos"].double().reshape(-1, num_taxels, 3)
        normal = given["normal"].double().reshape(-1, num_taxels, 3) if "normal" in given else None
        if "tangent" in given and normal is not None:
            tangent = given["tangent"].double().reshape(-1, num_taxels, 2, 3)
            felt = (
                felt[..., :1] * tangent[..., 0, :]
                + felt[..., 1:2] * tangent[..., 1, :]
                - felt[..., 2:] * normal
            )
        weight, felt = weight * pressed, felt * pressed.unsqueeze(2)
        normal = torch.zeros_like(pos) if normal is None else normal
        rows = []
        for number in range(self.num_patches):
            of_patch = (self.patch == number).nonzero().view(-1)
            rows.append(_patch_row(*(v[:, of_patch] for v in (felt, weight, pressed, pos, normal))))
        return torch.cat(rows, dim=1)


FEATURES: dict[str, type[Step]] = {
    step.__name__: step for step in (Readings, Descriptors, Signals, PatchSums)
}


def _filled(values: Tensor) -> Tensor:
    return values.masked_fill(values.isnan(), 0.0)


def _ratio(numerator: Tensor, denominator: Tensor) -> Tensor:
    is_zero = denominator <= 0
    return (numerator / denominator.masked_fill(is_zero, 1.0)).masked_fill(is_zero, 0.0)


def _patch_row(
    felt: Tensor, weight: Tensor, pressed: Tensor, pos: Tensor, normal: Tensor
) -> Tensor:
    total = weight.sum(dim=1, keepdim=True)
    is_touched = total > 0
    share = (weight / total.masked_fill(~is_touched, 1.0)).unsqueeze(2)
    middle = pos.mean(dim=1)
    centre = torch.where(is_touched, (share * pos).sum(dim=1), middle)
    direction = (share * normal).sum(dim=1)
    return torch.cat([felt.sum(dim=1), centre, direction, pressed.sum(dim=1, keepdim=True)], dim=1)
