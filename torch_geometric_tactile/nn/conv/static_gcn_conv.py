r"""The graph convolution of the papers, for one topology and many samples."""

import torch
from torch import Tensor
from torch.nn import Parameter
from torch.nn.functional import linear
from torch_geometric.nn import MessagePassing
from torch_geometric.nn.conv.gcn_conv import gcn_norm
from torch_geometric.nn.dense.linear import Linear
from torch_geometric.nn.inits import zeros
from torch_geometric.typing import OptTensor

from torch_geometric_tactile.nn.conv.static_adjacency import AdjacencyCache, dense_norm

# Above this number of nodes, a dense matrix of them costs more than gathering the edges.
_MAX_DENSE_NODES = 1024


class StaticGCNConv(MessagePassing):
    r"""The graph convolution of the "Tactile Object Property Recognition using Geometrical Graph
    Edge Features and Multi-Thread Graph Convolutional Network" paper (eq. 1), without its
    activation.

    .. math::
        \mathbf{X}' = \hat{\mathbf{D}}^{-1/2} (\mathbf{A} + \mathbf{I}) \hat{\mathbf{D}}^{-1/2}
        \mathbf{X} \mathbf{W} + \mathbf{b}

    It equals :class:`torch_geometric.nn.GCNConv` and takes over its :obj:`state_dict`. For many
    samples on one topology :math:`(B, N, F)` the normalised adjacency is built once and applied as
    one matrix product. It is kept for as long as the same :obj:`edge_index` and
    :obj:`edge_weight` tensors come in, unchanged; weights that need a gradient are never kept.

    Args:
        in_channels (int): Size of each input feature, or -1 to take it from the first input.
        out_channels (int): Size of each output feature.
        bias (bool): Whether to add a learnable bias.

    Shapes:
        - **input:** node features :math:`(N, F_{in})`, :math:`(B, N, F_{in})` or those of a PyG
          batch :math:`(B \cdot N, F_{in})`, edges :math:`(2, |\mathcal{E}|)`, optional edge weights
          :math:`(|\mathcal{E}|,)`
        - **output:** node features of the same leading shape, :math:`F_{out}` wide

    Raises:
        ValueError: If :obj:`x` has other than two or three dimensions.

    Examples:
        >>> conv = StaticGCNConv(3, 8)
        >>> conv
        StaticGCNConv(3, 8)
        >>> conv(torch.zeros(5, 4, 3), torch.tensor([[0, 1], [1, 0]])).shape
        torch.Size([5, 4, 8])
    """

    def __init__(self, in_channels: int, out_channels: int, bias: bool = True) -> None:
        super().__init__(aggr="add", node_dim=-2)
        self.in_channels = in_channels
        self.out_channels = out_channels
        self.lin = Linear(in_channels, out_channels, bias=False, weight_initializer="glorot")
        if bias:
            self.bias = Parameter(torch.empty(out_channels))
        else:
            self.register_parameter("bias", None)
        self._kept = AdjacencyCache()
        self.reset_parameters()

    def reset_parameters(self) -> None:
        r"""Draws the weights anew and sets the bias to zero."""
        super().reset_parameters()
        self.lin.reset_parameters()
        zeros(self.bias)
        self._kept.clear()

    def forward(self, x: Tensor, edge_index: Tensor, edge_weight: OptTensor = None) -> Tensor:
        r"""Convolves node features.

        Args:
            x (torch.Tensor): Node features.
            edge_index (torch.Tensor): Edges.
            edge_weight (torch.Tensor, optional): Weights of the edges; one if left out.
        """
        if x.dim() not in (2, 3):
            raise ValueError(
                "'x' must have shape (num_nodes, in_channels) or (batch_size, num_nodes, "
                f"in_channels) (got {tuple(x.shape)})"
            )
        num_nodes = x.size(-2)
        if x.dim() == 3 and num_nodes <= _MAX_DENSE_NODES and not self.explain:
            kept = self._kept.get(edge_index, edge_weight, num_nodes, x.dtype)
            if kept is None:
                adjacency = dense_norm(edge_index, edge_weight, num_nodes, x.dtype)
            else:
                adjacency = kept.dense
            # The product with the adjacency is cheaper on the narrower side of the linear map.
            if self.in_channels == x.size(-1) < self.out_channels:
                return linear(torch.matmul(adjacency, x), self.lin.weight, self.bias)
            out = torch.matmul(adjacency, self.lin(x))
        else:
            edge_index, norm = gcn_norm(edge_index, edge_weight, num_nodes, dtype=x.dtype)
            out = self.propagate(edge_index, x=self.lin(x), norm=norm)
        return out if self.bias is None else out + self.bias

    def message(self, x_j: Tensor, norm: Tensor) -> Tensor:
        r"""Weights the neighbour's features."""
        return norm.view(-1, 1) * x_j
