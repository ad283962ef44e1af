r"""From edge features to node features, by messages."""

from collections.abc import Sequence
from typing import Any, Optional, Union

import torch
from torch import Tensor
from torch.nn import Linear, Parameter, ReLU, Sequential
from torch_geometric.nn import MessagePassing
from torch_geometric.nn.inits import glorot, reset
from torch_geometric.typing import Adj
from torch_geometric.utils import is_torch_sparse_tensor, softmax

from torch_geometric_tactile.nn._sizes import check_sizes
from torch_geometric_tactile.nn.conv._edge_checks import (
    EdgeCheck,
    check_edge_features,
    check_edge_form,
)
from torch_geometric_tactile.nn.conv._lazy_weight import lazy_linear
from torch_geometric_tactile.nn.conv._own_propagate import OwnPropagate


class EdgeMessageEncoder(OwnPropagate, MessagePassing):
    r"""One small network on the features of each edge, aggregated at the target.

    .. math::
        \mathbf{h}_i = \mathrm{aggr}_{j \in \mathcal{N}(i)} \, \mathrm{MLP}(\mathbf{e}_{ij})

    A variant of the paper's :class:`EdgeFeatureEncoder` that is ours: it shares its weights over
    all edges, works on any graph and is permutation equivariant. A taxel without an edge gets
    zeros.

    Args:
        edge_dim (int): Features of each edge :math:`D`, or -1 to take it from the first input.
        out_channels (int): Features of each taxel.
        hidden_channels (int): Width of the network's hidden layer.
        aggr (str): How messages meet at the target, any of PyG's aggregations.
        **kwargs: Further arguments of :class:`torch_geometric.nn.MessagePassing`.

    Shapes:
        - **input:** edge features :math:`(|\mathcal{E}|, D)`, :math:`(B, |\mathcal{E}|, D)` or
          those of a PyG batch :math:`(B \cdot |\mathcal{E}|, D)`, edges
          :math:`(2, |\mathcal{E}|)`
        - **output:** node features :math:`(N, F)`, :math:`(B, N, F)` or :math:`(B \cdot N, F)`

    Raises:
        ValueError: If :obj:`edge_attr` has other features, or other edges than :obj:`edge_index`,
            or :obj:`edge_index` is sparse, has another shape, holds no integers or joins other
            taxels.

    Examples:
        >>> encoder = EdgeMessageEncoder(edge_dim=4, out_channels=4)
        >>> encoder(torch.zeros(2, 3, 4), torch.tensor([[0, 1, 2], [1, 2, 0]])).shape
        torch.Size([2, 3, 4])
    """

    def __init__(
        self,
        edge_dim: int = 4,
        out_channels: int = 4,
        hidden_channels: int = 16,
        aggr: str = "mean",
        **kwargs: Any,
    ) -> None:
        super().__init__(aggr=aggr, **kwargs)
        self.edge_dim = edge_dim
        self.out_channels = out_channels
        self.hidden_channels = hidden_channels
        self.mlp = _mlp(edge_dim, hidden_channels, out_channels)
        self._check = EdgeCheck()

    def reset_parameters(self) -> None:
        r"""Draws all weights anew."""
        super().reset_parameters()
        reset(self.mlp)

    def forward(
        self, edge_attr: Tensor, edge_index: Adj, num_nodes: Optional[int] = None
    ) -> Tensor:
        r"""Encodes edge features.

        Args:
            edge_attr (torch.Tensor): Edge features.
            edge_index (torch.Tensor): Edges.
            num_nodes (int, optional): Number of taxels, of all samples of a PyG batch together;
                the largest in :obj:`edge_index` and one if left out.
        """
        num_nodes = self._checked(edge_attr, edge_index, num_nodes)
        hidden = self.encode(edge_attr, edge_index, num_nodes)
        return self.propagate(edge_index, hidden=hidden, size=(num_nodes, num_nodes))

    def _checked(self, edge_attr: Tensor, edge_index: Adj, num_nodes: Optional[int]) -> int:
        if is_torch_sparse_tensor(edge_index):
            raise ValueError(
                "'edge_index' must have shape (2, num_edges): a sparse matrix does not keep the "
                f"order of 'edge_attr' (got shape {tuple(edge_index.shape)}, {edge_index.layout})"
            )
        check_edge_form(edge_index, 0)
        num_edges = edge_index.size(1)
        if edge_attr.dim() not in (2, 3) or edge_attr.size(-2) != num_edges:
            raise ValueError(
                f"'edge_attr' must have {num_edges} rows, one for each edge of 'edge_index' "
                f"(got shape {tuple(edge_attr.shape)})"
            )
        if self.edge_dim == -1:
            self.edge_dim = edge_attr.size(-1)
        check_edge_features(edge_attr, self.edge_dim)
        if num_nodes is None:
            num_nodes = int(edge_index.max()) + 1 if num_edges else 0
        # A source out of range would go unseen: the messages come from the edges alone.
        self._check(edge_index, num_nodes)
        return num_nodes

    def encode(self, edge_attr: Tensor, edge_index: Tensor, num_nodes: int) -> Tensor:
        r"""Returns the message of each edge.

        Args:
            edge_attr (torch.Tensor): Edge features.
            edge_index (torch.Tensor): Edges.
            num_nodes (int): Number of taxels.
        """
        return self.mlp(edge_attr)

    def message(self, hidden: Tensor) -> Tensor:
        r"""Passes the message on."""
        return hidden

    def __repr__(self) -> str:
        return (
            f"{type(self).__name__}({self.edge_dim}, {self.out_channels}, "
            f"hidden_channels={self.hidden_channels})"
        )


class EdgeAttentionEncoder(EdgeMessageEncoder):
    r"""One small network on the features of each edge, weighted by attention at the target.

    .. math::
        \mathbf{h}_i = \sum_{j \in \mathcal{N}(i)} \alpha_{ij} \mathbf{m}_{ij}, \qquad
        \alpha_{ij} = \mathrm{softmax}_j \left( \mathbf{a}^{\top}
        \mathrm{LeakyReLU}(\mathbf{m}_{ij}) \right), \qquad
        \mathbf{m}_{ij} = \mathrm{MLP}(\mathbf{e}_{ij})

    A variant of the paper's :class:`EdgeFeatureEncoder` that is ours.

    Args:
        edge_dim (int): Features of each edge :math:`D`, or -1 to take it from the first input.
        out_channels (int): Features of each taxel.
        hidden_channels (int): Width of the network's hidden layer.
        **kwargs: Further arguments of :class:`torch_geometric.nn.MessagePassing`.

    Shapes:
        - **input:** as :class:`EdgeMessageEncoder`
        - **output:** as :class:`EdgeMessageEncoder`

    Raises:
        ValueError: As :class:`EdgeMessageEncoder`.

    Examples:
        >>> EdgeAttentionEncoder(edge_dim=4, out_channels=4)
        EdgeAttentionEncoder(4, 4, hidden_channels=16)
    """

    def __init__(
        self, edge_dim: int = 4, out_channels: int = 4, hidden_channels: int = 16, **kwargs: Any
    ) -> None:
        super().__init__(edge_dim, out_channels, hidden_channels, aggr="add", **kwargs)
        self.att = Parameter(torch.empty(1, out_channels))
        glorot(self.att)

    def reset_parameters(self) -> None:
        r"""Draws all weights anew."""
        super().reset_parameters()
        glorot(self.att)

    def encode(self, edge_attr: Tensor, edge_index: Tensor, num_nodes: int) -> Tensor:
        r"""Returns the weighted message of each edge."""
        hidden = self.mlp(edge_attr)
        score = (torch.nn.functional.leaky_relu(hidden, 0.2) * self.att).sum(-1, keepdim=True)
        target = edge_index[1 if self.flow == "source_to_target" else 0]
        return hidden * softmax(score, target, num_nodes=num_nodes, dim=-2)


class EdgePatchEncoder(EdgeMessageEncoder):
    r"""One small network for the edges within a patch and another for those between patches,
    aggregated at the target.

    .. math::
        \mathbf{h}_i = \mathrm{aggr}_{j \in \mathcal{N}(i)}
        \begin{cases}
        \mathrm{MLP}(\mathbf{e}_{ij}) & \text{if } s_i = s_j \\
        \mathrm{MLP}'(\mathbf{e}_{ij}) & \text{otherwise}
        \end{cases}

    A variant of the paper's :class:`EdgeFeatureEncoder` that is ours, after its finding that the
    encoder tells both kinds of edges apart.

    Args:
        segment (sequence of int or torch.Tensor): The patch :math:`s_i` of each taxel
            :math:`(N,)`, as :obj:`layout.segments("patch")`.
        edge_dim (int): Features of each edge :math:`D`, or -1 to take it from the first input.
        out_channels (int): Features of each taxel.
        hidden_channels (int): Width of the networks' hidden layers.
        aggr (str): How messages meet at the target, any of PyG's aggregations.
        **kwargs: Further arguments of :class:`torch_geometric.nn.MessagePassing`.

    Shapes:
        - **input:** as :class:`EdgeMessageEncoder`
        - **output:** as :class:`EdgeMessageEncoder`

    Raises:
        ValueError: As :class:`EdgeMessageEncoder`, or if the number of taxels is no multiple of
            those in :obj:`segment`.

    Examples:
        >>> encoder = EdgePatchEncoder([0, 0, 1])
        >>> encoder(torch.zeros(2, 4), torch.tensor([[0, 1], [1, 2]])).shape
        torch.Size([3, 4])
    """

    segment: Tensor

    def __init__(
        self,
        segment: Union[Sequence[int], Tensor],
        edge_dim: int = 4,
        out_channels: int = 4,
        hidden_channels: int = 16,
        aggr: str = "mean",
        **kwargs: Any,
    ) -> None:
        super().__init__(edge_dim, out_channels, hidden_channels, aggr, **kwargs)
        self.register_buffer("segment", torch.as_tensor(segment).long(), persistent=False)
        if self.segment.dim() != 1 or len(self.segment) == 0:
            raise ValueError(
                f"'segment' must have a number for each taxel (got {tuple(self.segment.shape)})"
            )
        self.mlp_between = _mlp(edge_dim, hidden_channels, out_channels)

    def reset_parameters(self) -> None:
        r"""Draws all weights anew."""
        super().reset_parameters()
        reset(self.mlp_between)

    def encode(self, edge_attr: Tensor, edge_index: Tensor, num_nodes: int) -> Tensor:
        r"""Returns the message of each edge, by its kind."""
        segment = self.segment[edge_index % len(self.segment)]
        within = (segment[0] == segment[1]).unsqueeze(-1)
        return torch.where(within, self.mlp(edge_attr), self.mlp_between(edge_attr))

    def forward(
        self, edge_attr: Tensor, edge_index: Adj, num_nodes: Optional[int] = None
    ) -> Tensor:
        r"""Encodes edge features.

        Args:
            edge_attr (torch.Tensor): Edge features.
            edge_index (torch.Tensor): Edges.
            num_nodes (int, optional): Number of taxels, of all samples of a PyG batch together;
                those of one sample if left out.
        """
        num_nodes = len(self.segment) if num_nodes is None else num_nodes
        if num_nodes % len(self.segment):
            raise ValueError(
                f"'num_nodes' must be a multiple of the {len(self.segment)} taxels in 'segment' "
                f"(got {num_nodes})"
            )
        return super().forward(edge_attr, edge_index, num_nodes)


def _mlp(edge_dim: int, hidden_channels: int, out_channels: int) -> Sequential:
    check_sizes(hidden_channels=hidden_channels, out_channels=out_channels)
    first = lazy_linear("edge_dim", edge_dim, 1, hidden_channels)
    return Sequential(first, ReLU(), Linear(hidden_channels, out_channels))
