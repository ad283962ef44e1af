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
        self._kept: tuple[object, ...] = ()
        self.reset_parameters()

    def reset_parameters(self) -> None:
        r"""Draws the weights anew and sets the bias to zero."""
        super().reset_parameters()
        self.lin.reset_parameters()
        zeros(self.bias)
        self._kept = ()

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
            adjacency = self._adjacency(edge_index, edge_weight, num_nodes, x.dtype)
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

    def _adjacency(
        self, edge_index: Tensor, edge_weight: OptTensor, num_nodes: int, dtype: torch.dtype
    ) -> Tensor:
        given = [edge_index] if edge_weight is None else [edge_index, edge_weight]
        if torch.compiler.is_compiling() or any(
            tensor.requires_grad or tensor.is_inference() for tensor in given
        ):
            # The gradient needs the way back; inference tensors do not tell whether they changed.
            return _dense_norm(edge_index, edge_weight, num_nodes, dtype)
        # In-place changes raise the version, so that a changed tensor is never taken for the old.
        key = (*given, *(tensor._version for tensor in given), num_nodes, dtype)
        kept = self._kept
        if len(kept) != len(key) + 1 or any(
            a is not b if isinstance(a, Tensor) else a != b
            for a, b in zip(key, kept[:-1], strict=True)
        ):
            # A matrix made in inference mode (by a validation before the training) could not take
            # part in a later training step.
            with torch.inference_mode(False):
                adjacency = _dense_norm(edge_index, edge_weight, num_nodes, dtype)
            self._kept = kept = (*key, adjacency)
        out = kept[-1]
        assert isinstance(out, Tensor)
        return out

    def __getstate__(self) -> dict[str, object]:
        state: dict[str, object] = dict(super().__getstate__())
        state["_kept"] = ()
        return state


def _dense_norm(
    edge_index: Tensor, edge_weight: OptTensor, num_nodes: int, dtype: torch.dtype
) -> Tensor:
    # PyG's gcn_norm as one matrix. It drops no edges by a mask, whose result has an unknown size,
    # so that torch.compile sees one graph.
    source, target = edge_index[0], edge_index[1]
    if edge_weight is None:
        edge_weight = torch.ones(edge_index.size(1), dtype=dtype, device=edge_index.device)
    weight = edge_weight.view(-1).to(dtype)
    is_loop = source == target
    adjacency = weight.new_zeros(num_nodes * num_nodes).scatter_add(
        0, target * num_nodes + source, weight.masked_fill(is_loop, 0.0)
    )
    # Self-loops keep their weight, missing ones get one; the last place takes all other edges.
    loop = weight.new_ones(num_nodes + 1).scatter(
        0, source.masked_fill(~is_loop, num_nodes), weight
    )
    adjacency = adjacency.view(num_nodes, num_nodes) + loop[:-1].diag_embed()
    scale = adjacency.sum(dim=1).pow(-0.5)
    scale = scale.masked_fill(scale == float("inf"), 0.0)
    return scale.view(-1, 1) * adjacency * scale
