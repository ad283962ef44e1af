r"""Convolutions on several maps at once."""

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor
from torch.nn import Module, ModuleList, Parameter
from torch.nn.init import trunc_normal_, zeros_

from torch_geometric_tactile.nn.models._hand_maps import HandMap
from torch_geometric_tactile.nn.models._ms_cnn_patterns import Stage

SD = 0.1  # of the weights at the beginning


class MapConv(Module):
    r"""Convolutions with filters of one size on maps of one size, each with filters of its own or
    all with the same. There is no padding.

    The cells under a filter are gathered and multiplied with it, for all maps in one matrix
    product: on maps of a few cells that takes half the time of :class:`torch.nn.Conv2d`, also of a
    grouped one.

    Shapes:
        - **cell:** Which of the features is where, on each map :math:`(G, R, C)`.
        - **input:** features :math:`(B, M, F)`
        - **output:** features of the cells of all maps, map by map and row by row
          :math:`(B, G \cdot R' \cdot C', F')`
    """

    cell: Tensor

    def __init__(
        self,
        in_channels: int,
        out_channels: int,
        cell: np.ndarray,
        size: tuple[int, int],
        stride: int = 1,
        share_weights: bool = False,
    ) -> None:
        super().__init__()
        self.in_channels = in_channels
        self.out_channels = out_channels
        self.filter_size = size
        self.stride = stride
        self.share_weights = share_weights
        self.num_maps = len(cell)
        self.in_size: tuple[int, int] = cell.shape[1:]
        under = np.lib.stride_tricks.sliding_window_view(cell, size, axis=(1, 2))
        under = under[:, ::stride, ::stride]  # maps, rows, columns, and the filter's
        self.out_size: tuple[int, int] = under.shape[1:3]
        self.register_buffer("cell", torch.from_numpy(under.flatten()), persistent=False)
        sets = 1 if share_weights else self.num_maps
        self.weight = Parameter(torch.empty(sets, *size, in_channels, out_channels))
        self.bias = Parameter(torch.empty(sets, out_channels))
        self.reset_parameters()

    def reset_parameters(self) -> None:
        r"""Draws the weights anew."""
        trunc_normal_(self.weight, std=SD, a=-2 * SD, b=2 * SD)
        zeros_(self.bias)

    def forward(self, x: Tensor) -> Tensor:
        r"""Returns the features of the maps."""
        weight = self.weight.flatten(1, 3)
        sets, width = weight.size(0), weight.size(1)
        rows = self.out_size[0] * self.out_size[1] * (self.num_maps // sets)
        under = x.index_select(1, self.cell).reshape(x.size(0), sets, rows, width)
        under = under.transpose(0, 1).reshape(sets, -1, width)
        out = torch.baddbmm(self.bias.unsqueeze(1), under, weight)
        out = out.view(sets, x.size(0), rows, self.out_channels)
        return out.transpose(0, 1).flatten(1, 2)

    def __repr__(self) -> str:
        return (
            f"{type(self).__name__}({self.in_channels}, {self.out_channels}, "
            f"maps={self.num_maps}, size={self.in_size}, filter={self.filter_size}, "
            f"stride={self.stride}, share_weights={self.share_weights})"
        )


class MapStage(Module):
    r"""One convolution of a pattern: a :class:`MapConv` for the maps of each size, and ReLU."""

    def __init__(
        self,
        in_channels: int,
        out_channels: int,
        maps: Sequence[HandMap],
        stage: Stage,
        share_weights: bool,
    ) -> None:
        super().__init__()
        alike: dict[tuple[tuple[int, int], tuple[int, int]], list[HandMap]] = {}
        for one in maps:
            size = stage.filter_of(one.kinds)
            if one.size[0] < size[0] or one.size[1] < size[1]:
                raise ValueError(
                    f"'pattern' must have filters that fit on its maps (got {size} for {one.size} "
                    f"cells of '{one.name}')"
                )
            alike.setdefault((one.size, size), []).append(one)
        self.convs = ModuleList()
        self.maps: list[HandMap] = []
        first = 0
        for (_, size), group in alike.items():
            cell = np.stack([one.cell for one in group])
            conv = MapConv(in_channels, out_channels, cell, size, stage.stride, share_weights)
            self.convs.append(conv)
            numbers = np.arange(first, first + len(group) * conv.out_size[0] * conv.out_size[1])
            first += len(numbers)
            for one, found in zip(group, numbers.reshape(-1, *conv.out_size), strict=True):
                self.maps.append(one._replace(cell=found))
        order = [one.name for one in maps]
        self.maps.sort(key=lambda one: order.index(one.name))
        self.num_cells = first

    def reset_parameters(self) -> None:
        r"""Draws all weights anew."""
        for conv in self.convs:
            conv.reset_parameters()  # type: ignore[operator]

    def forward(self, x: Tensor) -> Tensor:
        r"""Returns the features of the cells of all maps :math:`(B, M', F')`.

        Shapes:
            - **x:** Features :math:`(B, M, F)`.
        """
        parts = [conv(x) for conv in self.convs]
        return (parts[0] if len(parts) == 1 else torch.cat(parts, dim=1)).relu()
