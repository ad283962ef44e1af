r"""A graph convolution with a weight for each direction."""

from typing import Any

import torch
from torch import Tensor
from torch.nn import Parameter
from torch_geometric.nn import MessagePassing
from torch_geometric.nn.inits import glorot, zeros
from torch_geometric.typing import Adj

from torch_geometric_tactile.nn.conv._edge_checks import (
    check_conv_sizes,
    check_edge_form,
    check_tensor,
    compute_on_edges,
)
from torch_geometric_tactile.nn.conv._lazy_weight import LazyWeight
from torch_geometric_tactile.nn.conv._own_propagate import ExplainablePropagate
from torch_geometric_tactile.nn.conv._plain import is_static_batch, sums_messages
from torch_geometric_tactile.nn.conv._sector_product import (
    SectorCache,
    is_product_faster,
    sector_product,
)


class SectorConv(LazyWeight, ExplainablePropagate, MessagePassing):
    r"""A graph convolution with separate weights for the taxel itself and for the neighbour in each
    direction. It corresponds to a :math:`3 \times 3` convolution of images, on any layout.

    .. math::
        \mathbf{x}'_i = \mathbf{W}_{\mathrm{self}} \mathbf{x}_i + \mathbf{b} +
        \sum_{s=0}^{S-1} \mathbf{W}_s \mathbf{x}_{n(i,s)}

    where :math:`n(i, s)` is the neighbour of taxel :math:`i` in sector :math:`s` of its tangent
    plane, as computed by :func:`~torch_geometric_tactile.sensors.sector_edges`. An empty sector
    contributes zero, and several neighbours in one sector are added up. On a grid whose pitches
    differ by at most a factor of two, eight sectors give the same results as
    :class:`torch.nn.Conv2d` with a :math:`3 \times 3` kernel and zero padding.

    For samples on one topology :math:`(B, N, F)` on a processor, the features of neighbours are
    multiplied sector by sector, and the sorted edges are cached while they stay the same. On a
    grid, images are convolved, which is twice as fast again. Messages are passed along edges for a
    single sample or a PyG batch :math:`(N, F)`, for fewer than eight samples of many taxels, on
    other devices, with :obj:`fast=False`, and if an explainer, a hook or a subclass needs them.

    Args:
        in_channels (int): Size of each input feature, or -1 to infer it from the first input.
        out_channels (int): Size of each output feature.
        num_sectors (int): Number of sectors :math:`S`.
        bias (bool): Whether to add a learnable bias.
        fast (bool): Whether to multiply sector by sector if it is faster. This has no second
            derivative.
        **kwargs: Further arguments of :class:`torch_geometric.nn.MessagePassing`, except for
            :obj:`flow`.

    Shapes:
        - **input:** node features :math:`(N, F_{in})`, :math:`(B, N, F_{in})` or those of a PyG
          batch :math:`(B \cdot N, F_{in})`, edges :math:`(2, |\mathcal{E}|)`, sectors
          :math:`(|\mathcal{E}|,)`
        - **output:** node features of the same leading shape, :math:`F_{out}` wide

    Raises:
        ValueError: If a size is below one, :obj:`x` has another number of features,
            :obj:`edge_index` has another shape, no integers or indices out of range, or
            :obj:`edge_sector` does not hold a sector for each edge.

    Examples:
        >>> conv = SectorConv(3, 8, num_sectors=4)
        >>> conv
        SectorConv(3, 8, num_sectors=4)
        >>> conv(torch.zeros(5, 2, 3), torch.tensor([[0, 1], [1, 0]]), torch.tensor([0, 2])).shape
        torch.Size([5, 2, 8])
    """

    def __init__(
        self,
        in_channels: int,
        out_channels: int,
        num_sectors: int = 8,
        bias: bool = True,
        *,
        fast: bool = True,
        **kwargs: Any,
    ) -> None:
        if "flow" in kwargs:
            raise ValueError(
                "'flow' must be left out: edges run from the neighbour to the taxel (got "
                f"{kwargs['flow']!r})"
            )
        if kwargs.get("decomposed_layers", 1) != 1:
            raise ValueError(
                "'decomposed_layers' must be 1, since features of a sector cannot be split (got "
                f"{kwargs['decomposed_layers']})"
            )
        super().__init__(**{"aggr": "add", **kwargs})
        check_conv_sizes(
            in_channels=in_channels, out_channels=out_channels, num_sectors=num_sectors
        )
        self.out_channels = out_channels
        self.num_sectors = num_sectors
        self.fast = fast
        # The weight of the taxel itself is the first.
        self._add_weight(in_channels)
        if bias:
            self.bias = Parameter(torch.empty(out_channels))
        else:
            self.register_parameter("bias", None)
        self._edge_cache = SectorCache()
        self.reset_parameters()

    def reset_parameters(self) -> None:
        r"""Resets all learnable parameters."""
        super().reset_parameters()
        if not self._is_lazy():
            glorot(self.weight.flatten(0, 1))
        zeros(self.bias)

    def weight_size(self, in_channels: int) -> tuple[int, ...]:
        r"""Returns the shape of the weight.

        Args:
            in_channels (int): Size of each input feature.
        """
        return 1 + self.num_sectors, in_channels, self.out_channels

    def forward(self, x: Tensor, edge_index: Adj, edge_sector: Tensor) -> Tensor:
        r"""Returns the convolved node features.

        Args:
            x (torch.Tensor): Node features.
            edge_index (torch.Tensor): Edges from the neighbour to the taxel.
            edge_sector (torch.Tensor): Sector of the taxel in which the neighbour of each edge is.
        """
        check_tensor(x)
        self._initialize_weight(x)
        if x.dim() not in (2, 3) or x.size(-1) != self.in_channels:
            raise ValueError(
                f"'x' must have shape (num_nodes, {self.in_channels}) or (batch_size, num_nodes, "
                f"{self.in_channels}) (got {tuple(x.shape)})"
            )
        check_edge_form(edge_index, x.size(-2))
        if self._is_fast(x):
            table = self._edge_cache.get(edge_index, edge_sector, x.size(1), self.num_sectors)
            if table is not None and is_product_faster(x, table):
                return sector_product(x, table, self.weight, self.bias)
        self._edge_cache.check(edge_index, edge_sector, self.num_sectors)
        return compute_on_edges(self._convolve_edges, x.size(-2), x, edge_index, edge_sector)

    def _is_fast(self, x: Tensor) -> bool:
        return self.fast and is_static_batch(x) and type(self) is SectorConv and sums_messages(self)

    def _convolve_edges(self, x: Tensor, edge_index: Adj, edge_sector: Tensor) -> Tensor:
        # Passes messages on a bipartite graph, whose targets are the sectors of all taxels.
        num_nodes, num_targets = x.size(-2), x.size(-2) * self.num_sectors
        source, target = edge_index.long()
        sector_edges = torch.stack([source, target * self.num_sectors + edge_sector.long()])
        sums = self.propagate(sector_edges, x=(x, None), size=(num_nodes, num_targets))
        sums = sums.reshape(*x.shape[:-1], self.num_sectors * self.in_channels)
        out = x @ self.weight[0] + sums @ self.weight[1:].flatten(0, 1)
        return out if self.bias is None else out + self.bias

    def message(self, x_j: Tensor) -> Tensor:
        r"""Returns the neighbour's features."""
        return x_j

    def __repr__(self) -> str:
        return (
            f"{type(self).__name__}({self.in_channels}, {self.out_channels}, "
            f"num_sectors={self.num_sectors})"
        )
