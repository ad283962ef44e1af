r"""Weights whose size is inferred from the first input."""

from typing import Any

import torch
from torch import Tensor
from torch.nn import LazyLinear, Linear, Parameter
from torch.nn.parameter import UninitializedParameter

from torch_geometric_tactile.nn.conv._edge_checks import check_lazy_size


class LazyWeight:
    r"""Adds a :obj:`weight` to a layer. List this base class before
    :class:`~torch_geometric.nn.MessagePassing`. If :obj:`in_channels` is -1, the size of the weight
    is inferred from the first input or from a loaded :obj:`state_dict`, as in PyG's
    :class:`~torch_geometric.nn.dense.Linear`.
    """

    in_channels: int
    weight: Parameter

    def weight_size(self, in_channels: int) -> tuple[int, ...]:
        r"""Returns the shape of the weight.

        Args:
            in_channels (int): Size of each input feature.
        """
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
        for name, parameter in self._parameters.items():  # type: ignore[attr-defined]
            if parameter is not None:  # an uninitialized parameter cannot be detached
                destination[prefix + name] = parameter

    def _load_from_state_dict(self, state_dict: Any, prefix: str, *args: Any) -> None:
        weight, shape = state_dict.get(f"{prefix}weight"), self.weight_size(-1)
        is_sized = isinstance(weight, Tensor) and not isinstance(weight, UninitializedParameter)
        if is_sized and isinstance(self.weight, UninitializedParameter):
            self.in_channels = weight.size(shape.index(-1))
            self.weight.materialize(weight.shape)
        super()._load_from_state_dict(state_dict, prefix, *args)  # type: ignore[misc]


def lazy_linear(name: str, size: int, repeats: int, out_features: int) -> Linear:
    r"""Returns a linear map with :obj:`size * repeats` input features. If :obj:`size` is -1, their
    number is inferred from the first input.

    Args:
        name (str): Name of the argument, for error messages.
        size (int): Size of each part of the input, or -1.
        repeats (int): Number of parts.
        out_features (int): Size of the output.
    """
    check_lazy_size(name, size)
    if size == -1:
        return LazyLinear(out_features)
    return Linear(size * repeats, out_features)
