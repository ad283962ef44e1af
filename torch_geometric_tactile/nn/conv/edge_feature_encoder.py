r"""The edge feature encoder from the paper."""

from typing import Optional

import torch
from torch import Tensor
from torch_geometric.typing import OptTensor

from torch_geometric_tactile.nn._sizes import check_sizes
from torch_geometric_tactile.nn.conv._edge_checks import check_edge_features
from torch_geometric_tactile.nn.conv._lazy_weight import lazy_linear


class EdgeFeatureEncoder(torch.nn.Module):
    r"""The edge feature encoder from the "Tactile Object Property Recognition using Geometrical
    Graph Edge Features and Multi-Thread Graph Convolutional Network" paper: one linear map from the
    features of all edges to the features of all taxels.

    .. math::
        \mathrm{vec}(\mathbf{H}) = \mathbf{W} \, \mathrm{vec}(\mathbf{E}) + \mathbf{b}

    Each edge has separate weights, so that the encoder supports only one topology with a fixed
    order of edges. Unlike :class:`EdgeMessageEncoder`, it is not permutation equivariant. For the
    hand in the paper, it has :math:`1401 \cdot 4 \cdot 384 \cdot 4 + 1536 = 8\,609\,280`
    parameters.

    Args:
        num_nodes (int): Number of taxels :math:`N`.
        num_edges (int): Number of directed edges :math:`|\mathcal{E}|`.
        edge_dim (int): Size of each edge feature :math:`D`, or -1 to infer it from the first input.
        out_channels (int): Size of each output feature.

    Shapes:
        - **input:** edge features, in metres or scaled, :math:`(|\mathcal{E}|, D)`,
          :math:`(B, |\mathcal{E}|, D)` or, for a PyG batch, :math:`(B \cdot |\mathcal{E}|, D)`
        - **output:** node features :math:`(N, F)`, :math:`(B, N, F)` or :math:`(B \cdot N, F)`

    Raises:
        ValueError: If a size is below one, or :obj:`edge_attr` has the wrong number of edges or
            features.

    Examples:
        >>> encoder = EdgeFeatureEncoder(num_nodes=384, num_edges=1401)
        >>> encoder
        EdgeFeatureEncoder(384, 1401, edge_dim=4, out_channels=4)
        >>> encoder(torch.zeros(2, 1401, 4)).shape
        torch.Size([2, 384, 4])
    """

    def __init__(
        self, num_nodes: int, num_edges: int, edge_dim: int = 4, out_channels: int = 4
    ) -> None:
        super().__init__()
        check_sizes(num_nodes=num_nodes, num_edges=num_edges, out_channels=out_channels)
        self.num_nodes = num_nodes
        self.num_edges = num_edges
        self.edge_dim = edge_dim
        self.out_channels = out_channels
        self.lin = lazy_linear("edge_dim", edge_dim, num_edges, num_nodes * out_channels)

    def reset_parameters(self) -> None:
        r"""Resets all learnable parameters."""
        self.lin.reset_parameters()

    def forward(
        self, edge_attr: Tensor, edge_index: OptTensor = None, num_nodes: Optional[int] = None
    ) -> Tensor:
        r"""Returns the node features that encode the edge features.

        Args:
            edge_attr (torch.Tensor): Edge features.
            edge_index (torch.Tensor, optional): Not used, since edges are identified by their
                order.
            num_nodes (int, optional): Not used.
        """
        num_rows = edge_attr.size(-2) if edge_attr.dim() in (2, 3) else -1
        is_batch = edge_attr.dim() == 2 and num_rows % self.num_edges == 0
        if num_rows != self.num_edges and not is_batch:
            raise ValueError(
                f"'edge_attr' must have {self.num_edges} rows, one for each edge in the order of "
                f"the training data (got shape {tuple(edge_attr.shape)})"
            )
        if self.edge_dim == -1:
            self.edge_dim = edge_attr.size(-1)
        check_edge_features(edge_attr, self.edge_dim)
        out = self.lin(edge_attr.reshape(-1, self.num_edges * self.edge_dim))
        if edge_attr.dim() == 3:
            return out.view(edge_attr.size(0), self.num_nodes, self.out_channels)
        return out.view(-1, self.out_channels)

    def __repr__(self) -> str:
        return (
            f"{type(self).__name__}({self.num_nodes}, {self.num_edges}, edge_dim={self.edge_dim}, "
            f"out_channels={self.out_channels})"
        )
