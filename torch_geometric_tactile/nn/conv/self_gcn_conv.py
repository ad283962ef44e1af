r"""Graph convolutions with a weight of their own for the taxel itself."""

from typing import Any

import torch
from torch import Tensor
from torch_geometric.nn.dense.linear import Linear
from torch_geometric.typing import Adj, OptTensor
from torch_geometric.utils import scatter

from torch_geometric_tactile.nn.conv._edge_checks import (
    as_edges,
    check_conv_sizes,
    check_edge_index,
    check_edge_weight,
    check_tensor,
)
from torch_geometric_tactile.nn.conv._plain import sums_messages
from torch_geometric_tactile.nn.conv._static_adjacency import all_finite
from torch_geometric_tactile.nn.conv.static_gcn_conv import StaticGCNConv


class SelfGCNConv(torch.nn.Module):
    r"""A graph convolution with a separate weight for the taxel itself.

    .. math::
        \mathbf{x}'_i = \mathbf{W}_1 \mathbf{x}_i + \mathbf{b} + \sum_j \hat{a}_{ij} \mathbf{W}_2
        \mathbf{x}_j, \qquad \hat{\mathbf{A}} = \mathbf{D}^{-1/2} \mathbf{A} \mathbf{D}^{-1/2}

    or, with :obj:`difference=True`, of the differences to the neighbours,

    .. math::
        \mathbf{x}'_i = \mathbf{W}_1 \mathbf{x}_i + \mathbf{b} + \frac{1}{\sum_j a_{ij}} \sum_j
        a_{ij} \mathbf{V} (\mathbf{x}_i - \mathbf{x}_j)

    A :class:`~torch_geometric.nn.GCNConv` has one weight for both and smooths: what tells readings
    apart is often the difference between neighbours, which it cannot express. The convolution of
    the neighbours is a :class:`~torch_geometric_tactile.nn.conv.StaticGCNConv` without self-loops,
    with its kept adjacency.

    Args:
        in_channels (int): Size of each input feature.
        out_channels (int): Size of each output feature.
        difference (bool): Whether to use the differences to the neighbours, of which a taxel
            without neighbours has none.
        bias (bool): Whether to add a learnable bias.
        fast (bool): Whether to multiply the samples of one topology by one matrix.

    Shapes:
        - **input:** node features :math:`(N, F_{in})`, :math:`(B, N, F_{in})` or those of a PyG
          batch :math:`(B \cdot N, F_{in})`, edges :math:`(2, |\mathcal{E}|)` or a sparse matrix
          :math:`(N, N)` of targets and sources, optional edge weights :math:`(|\mathcal{E}|,)`
        - **output:** node features of the same leading shape, :math:`F_{out}` wide

    Raises:
        ValueError: If a size is below one, :obj:`x` has other features, or the edges are not those
            of its taxels.

    Examples:
        >>> conv = SelfGCNConv(3, 8)
        >>> conv
        SelfGCNConv(3, 8)
        >>> conv(torch.zeros(5, 4, 3), torch.tensor([[0, 1], [1, 0]])).shape
        torch.Size([5, 4, 8])
    """

    def __init__(
        self,
        in_channels: int,
        out_channels: int,
        difference: bool = False,
        bias: bool = True,
        *,
        fast: bool = True,
    ) -> None:
        super().__init__()
        check_conv_sizes(in_channels=in_channels, out_channels=out_channels)
        self.in_channels = in_channels
        self.out_channels = out_channels
        self.difference = difference
        self.lin = Linear(in_channels, out_channels, bias, weight_initializer="glorot")
        more: dict[str, Any] = {"normalize": False} if difference else {"add_self_loops": False}
        self.conv = StaticGCNConv(in_channels, out_channels, bias=False, fast=fast, **more)

    def reset_parameters(self) -> None:
        r"""Draws all weights anew."""
        self.lin.reset_parameters()
        self.conv.reset_parameters()

    def forward(self, x: Tensor, edge_index: Adj, edge_weight: OptTensor = None) -> Tensor:
        r"""Convolves node features.

        Args:
            x (torch.Tensor): Node features.
            edge_index (torch.Tensor): Edges, or a sparse matrix.
            edge_weight (torch.Tensor, optional): Weights of the edges; one if left out.
        """
        check_tensor(x)
        if not self.difference or x.dim() < 2:
            near = self.conv(x, edge_index, edge_weight)  # first: it checks
        else:
            edges, share, loops = _shares(edge_index, edge_weight, x)
            if sums_messages(self.conv):
                near = self._with_loops(x, edges, share, loops)
            else:  # where messages are watched, each is a difference, which can be left out
                near = self._as_messages(x, edges, share)
        return self.lin(x) + near

    def _as_messages(self, x: Tensor, edge_index: Tensor, share: Tensor) -> Tensor:
        source, target = edge_index
        mapped = self.conv.lin(x)
        each = mapped.index_select(-2, target) - mapped.index_select(-2, source)
        places = torch.stack([torch.arange(len(share), device=x.device), target])
        size = (len(share), x.size(-2))
        out: Tensor = self.conv.propagate(places, x=(each, None), edge_weight=share, size=size)
        return out

    def _with_loops(self, x: Tensor, edge_index: Tensor, share: Tensor, loops: Tensor) -> Tensor:
        loop = torch.arange(len(loops), device=x.device).expand(2, -1)
        if all_finite(x) is False:  # zero times infinity is NaN, also in a taxel of its own
            loop, loops = loop[:, loops], loops[loops]
        out: Tensor = self.conv(
            x, torch.cat([edge_index, loop], dim=1), torch.cat([-share, loops.to(share.dtype)])
        )
        return out

    def __repr__(self) -> str:
        difference = ", difference=True" if self.difference else ""
        return f"{type(self).__name__}({self.in_channels}, {self.out_channels}{difference})"


def _shares(edge_index: Adj, edge_weight: OptTensor, x: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    # The edges, their shares of the mean, and the sum of the shares: none or one.
    num_nodes = x.size(-2)
    check_edge_index(edge_index, num_nodes)
    check_edge_weight(edge_index, edge_weight)
    edge_index, edge_weight = as_edges(edge_index, edge_weight)
    edge_index = edge_index.long()
    target = edge_index[1]
    if edge_weight is None:
        edge_weight = x.new_ones(edge_index.size(1))
    weight = edge_weight.view(-1)
    weight = weight.to(torch.promote_types(weight.dtype, x.dtype))
    total = scatter(weight, target, dim_size=num_nodes, reduce="sum")
    some = total != 0
    return edge_index, weight / torch.where(some, total, 1.0)[target] * some[target], some
