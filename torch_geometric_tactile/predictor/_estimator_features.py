r"""Features of prepared samples. They are the first step of an estimator."""

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor
from torch.nn import Module

from torch_geometric_tactile._checks import need


class Step(Module):
    r"""A step of an estimator.

    Attributes:
        num_inputs (int, optional): Length of an input row; :obj:`None` if any length is accepted.
        num_outputs (int, optional): Length of an output row; :obj:`None` if it equals the length of
            the input row.
        modalities (tuple of str): Attributes that the step reads in addition to the readings.
    """

    num_inputs: int | None = None
    num_outputs: int | None = None
    modalities: tuple[str, ...] = ()

    def _register_tensor(
        self, name: str, value: Any, dims: int, dtype: torch.dtype = torch.double
    ) -> None:
        is_dense = isinstance(value, Tensor) and value.layout == torch.strided
        if not is_dense or value.dim() != dims or value.is_complex():
            raise ValueError(
                f"'{name}' must be a tensor with {dims} dimensions (got {value!r:.80})"
            )
        if dtype == torch.long and value.is_floating_point():
            raise ValueError(f"'{name}' must hold whole numbers (got {value.dtype})")
        self.register_buffer(name, value.to(dtype), persistent=False)


class Readings(Step):
    r"""A step that puts all readings of a sample into one row, with zeros for missing readings, as
    in :class:`~torch_geometric_tactile.baselines.FlatReadings`.
    """

    def forward(self, x: Tensor, attributes: Mapping[str, Tensor]) -> Tensor:
        r"""Returns the rows :math:`(B, N \cdot F)`."""
        return _nan_to_zero(x.flatten(1).double())


class Descriptors(Step):
    r"""The descriptors of :class:`~torch_geometric_tactile.transforms.TaxelDescriptors`, optionally
    followed by the readings, as in
    :class:`~torch_geometric_tactile.baselines.DescriptorFeatures`.

    Args:
        with_readings (bool): Whether the readings follow.
        balanced (bool): Whether descriptors are repeated until there are about as many as readings.
    """

    modalities = ("descriptors",)

    def __init__(self, with_readings: bool, balanced: bool) -> None:
        super().__init__()
        self.with_readings = bool(with_readings)
        self.balanced = bool(balanced)

    def forward(self, x: Tensor, attributes: Mapping[str, Tensor]) -> Tensor:
        r"""Returns the rows :math:`(B, K)`."""
        rows = attributes["descriptors"].double()
        if not self.with_readings:
            return rows
        flat = _nan_to_zero(x.flatten(1).double())
        # A forest draws features at random: repeated descriptors are drawn as often as readings.
        num_repeats = max(1, round(flat.size(1) / rows.size(1))) if self.balanced else 1
        return torch.cat([*[rows] * num_repeats, flat], dim=1)


class Signals(Step):
    r"""A step that computes 12 statistics of each signal of a window, as in
    :obj:`statistical_features`. Single frames keep their readings.

    Args:
        num_channels (int): Number of channels per taxel.
    """

    def __init__(self, num_channels: int) -> None:
        super().__init__()
        if type(num_channels) is not int or num_channels < 1:
            raise ValueError(f"'num_channels' must be at least 1 (got {num_channels!r:.80})")
        self.num_channels = num_channels

    def forward(self, x: Tensor, attributes: Mapping[str, Tensor]) -> Tensor:
        r"""Returns the rows :math:`(B, 12 \cdot N \cdot C)`."""
        if x.size(2) % self.num_channels:
            raise ValueError(f"readings must have {self.num_channels} channels (got {x.size(2)})")
        num_frames = x.size(2) // self.num_channels
        signal = _nan_to_zero(x.double()).reshape(x.size(0), -1, num_frames)
        if num_frames == 1:
            return signal[..., 0]
        magnitude = signal.abs()
        peak, mean_magnitude = magnitude.amax(2), magnitude.mean(2)
        mean = signal.mean(2)
        variance = (signal - mean.unsqueeze(2)).square().mean(2)
        root_mean_square = signal.square().mean(2).sqrt()
        statistics = [
            *(signal.amax(2), signal.amin(2), peak, mean, variance, variance.sqrt()),
            *(mean_magnitude, root_mean_square, _divide_or_zero(peak, root_mean_square)),
            *(
                _divide_or_zero(root_mean_square, mean_magnitude),
                _divide_or_zero(peak, mean_magnitude),
            ),
            _divide_or_zero(peak, magnitude.sqrt().mean(2).square()),
        ]
        return torch.stack(statistics, dim=2).flatten(1)


class PatchSums(Step):
    r"""A step that computes the force, contact position, contact direction and number of touched
    taxels of each patch in the frame of the palm, as in
    :class:`~torch_geometric_tactile.baselines.PosedSummary`.

    Args:
        rest (torch.Tensor): Readings at rest.
        patch (torch.Tensor): Index of the patch of each taxel.
        threshold (float): Magnitude above which a taxel counts as touched.
        has_normal (bool): Whether samples have normals.
        has_tangent (bool): Whether samples have tangents.

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
        self._register_tensor("rest", rest, 2)
        self._register_tensor("patch", patch, 1, torch.long)
        need(len(patch) == len(rest) > 0, "'patch' must have an entry for each taxel", len(patch))
        self.threshold = float(threshold)
        patches, self.patch = self.patch.unique(return_inverse=True)
        self.num_patches = len(patches)
        has_attribute = {"pos": True, "normal": has_normal, "tangent": has_tangent}
        self.modalities = tuple(
            name for name, is_available in has_attribute.items() if is_available
        )
        if has_tangent and not (has_normal and rest.size(1) == 3):
            raise ValueError(
                "'tangent' must come with normals and 3 channels (got "
                f"{rest.size(1)} channels, has_normal={has_normal})"
            )

    def forward(self, x: Tensor, attributes: Mapping[str, Tensor]) -> Tensor:
        r"""Returns the rows :math:`(B, K \cdot (F + 7))`."""
        num_taxels = self.rest.size(0)
        need(x.shape[1:] == self.rest.shape, f"'x' must be of {num_taxels} taxels", x.shape)
        force = _nan_to_zero(x.double() - self.rest)
        weight = force.square().sum(dim=2).sqrt()
        pressed = (weight > self.threshold).double()
        pos = attributes["pos"].double().reshape(-1, num_taxels, 3)
        normal = (
            attributes["normal"].double().reshape(-1, num_taxels, 3)
            if "normal" in attributes
            else None
        )
        if "tangent" in attributes and normal is not None:
            tangent = attributes["tangent"].double().reshape(-1, num_taxels, 2, 3)
            # The third channel points into the skin; the normal points out of it.
            force = (
                force[..., :1] * tangent[..., 0, :]
                + force[..., 1:2] * tangent[..., 1, :]
                - force[..., 2:] * normal
            )
        weight, force = weight * pressed, force * pressed.unsqueeze(2)
        normal = torch.zeros_like(pos) if normal is None else normal
        rows = []
        for number in range(self.num_patches):
            taxels = (self.patch == number).nonzero().view(-1)
            rows.append(_patch_row(*(v[:, taxels] for v in (force, weight, pressed, pos, normal))))
        return torch.cat(rows, dim=1)


FEATURES: dict[str, type[Step]] = {
    step.__name__: step for step in (Readings, Descriptors, Signals, PatchSums)
}


def _nan_to_zero(values: Tensor) -> Tensor:
    return values.masked_fill(values.isnan(), 0.0)


def _divide_or_zero(numerator: Tensor, denominator: Tensor) -> Tensor:
    is_zero = denominator <= 0
    return (numerator / denominator.masked_fill(is_zero, 1.0)).masked_fill(is_zero, 0.0)


def _patch_row(
    force: Tensor, weight: Tensor, pressed: Tensor, pos: Tensor, normal: Tensor
) -> Tensor:
    total = weight.sum(dim=1, keepdim=True)
    is_touched = total > 0
    share = (weight / total.masked_fill(~is_touched, 1.0)).unsqueeze(2)
    patch_center = pos.mean(dim=1)
    contact_center = torch.where(is_touched, (share * pos).sum(dim=1), patch_center)
    direction = (share * normal).sum(dim=1)
    return torch.cat(
        [force.sum(dim=1), contact_center, direction, pressed.sum(dim=1, keepdim=True)], dim=1
    )
