r"""A weight whose size comes from the first input."""

from typing import Any

import torch
from torch import Tensor
from torch.nn import LazyLinear, Linear, Parameter
from torch.nn.parameter import UninitializedParameter

from torch_geometric_tactile.nn.conv._edge_checks import check_lazy_size


class LazyWeight:
    r"""Gives a layer a :obj:`weight` for the number of its input features: a base class before
    :class:`~torch_geometric.nn.MessagePassing`. With -1, the first input or the first
    :obj:`state_dict` that is loaded has it, as in PyG's :class:`~torch_geometric.nn.dense.Linear`.
    """

    in_channels: int
    weight: Parameter

    def weight_size(self, in_channels: int) -> tuple[int, ...]:
        r"""Returns the shape of the weight."""
        raise NotImplementedError

    def _add_weight(self, in_channels: int) -> None:
        self.in_channels = in_channels
        if in_channels == -1:
            self.weight = UninitializedParameter()  # type: ignore[assignment]
        else:
            self.weight = Parameter(torch.empty(self.weight_size(in_channels)))

    def _is_lazy(self) -> bool:
        return isinstance(self.weight, UninitializedParameter)

    def _initialize_weight(self, x: Tensor) -> None:
        if isinstance(self.weight, UninitializedParameter):
            self.in_channels = x.size(-1)
            self.weight.materialize(self.weight_size(self.in_channels))
            self.reset_parameters()  # type: ignore[attr-defined]

    def _save_to_state_dict(self, destination: Any, prefix: str, keep_vars: bool) -> None:
        if not isinstance(self.weight, UninitializedParameter):
            super()._save_to_state_dict(destination, prefix, keep_vars)  # type: ignore[misc]
            return
        for name, value in self._parameters.items():  # type: ignore[attr-defined]
            if value is not None:  # an uninitialized one cannot be detached
                destination[prefix + name] = value

    def _load_from_state_dict(self, state_dict: Any, prefix: str, *args: Any) -> None:
        weight, sizes = state_dict.get(f"{prefix}weight"), self.weight_size(-1)
        is_sized = isinstance(weight, Tensor) and not isinstance(weight, UninitializedParameter)
        if is_sized and isinstance(self.weight, UninitializedParameter):
            self.in_channels = weight.size(sizes.index(-1))
            self.weight.materialize(weight.shape)
        super()._load_from_state_dict(state_dict, prefix, *args)  # type: ignore[misc]


def lazy_linear(name: str, size: int, repeats: int, out_features: int) -> Linear:
    r"""Returns a linear map for a multiple of a size, or with -1 for that of the first input."""
    check_lazy_size(name, size)
    if size == -1:
        return LazyLinear(out_features)
    return Linear(size * repeats, out_features)
