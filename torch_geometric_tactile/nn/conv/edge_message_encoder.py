r"""Edge feature encoders that pass messages along edges."""

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
from torch_geometric_tactile.nn.conv._explainable_propagate import ExplainablePropagate
from torch_geometric_tactile.nn.conv._lazy_weight import lazy_linear


class EdgeMessageEncoder(ExplainablePropagate, MessagePassing):
    r"""Encodes the features of each edge with a small network, and aggregates the results at the
    target.

    .. math::
        \mathbf{h}_i = \mathrm{aggr}_{j \in \mathcal{N}(i)} \, \mathrm{MLP}(\mathbf{e}_{ij})

    This variant of the paper's :class:`EdgeFeatureEncoder` is not from the paper. All edges share
    the weights, so that the encoder supports any graph and is permutation equivariant. The output
    is zero for taxels without edges.

    Args:
        edge_dim (int): Size of each edge feature :math:`D`, or -1 to infer it from the first input.
        out_channels (int): Size of each output feature.
        hidden_channels (int): Width of the hidden layer.
        aggr (str): Aggregation of the messages at the target, as in PyG.
        **kwargs: Further arguments of :class:`torch_geometric.nn.MessagePassing`.

    Shapes:
        - **input:** edge features :math:`(|\mathcal{E}|, D)`, :math:`(B, |\mathcal{E}|, D)` or, for
          a PyG batch, :math:`(B \cdot |\mathcal{E}|, D)`, edges :math:`(2, |\mathcal{E}|)`
        - **output:** node features :math:`(N, F)`, :math:`(B, N, F)` or :math:`(B \cdot N, F)`

    Raises:
        ValueError: If :obj:`edge_attr` has the wrong number of features or does not match the
            number of edges in :obj:`edge_index`; or if :obj:`edge_index` is sparse, has the wrong
            shape, does not hold integers or has indices out of range.

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
        r"""Resets all learnable parameters."""
        super().reset_parameters()
        reset(self.mlp)

    def forward(
        self, edge_attr: Tensor, edge_index: Adj, num_nodes: Optional[int] = None
    ) -> Tensor:
        r"""Returns the node features that encode the edge features.

        Args:
            edge_attr (torch.Tensor): Edge features.
            edge_index (torch.Tensor): Edges.
            num_nodes (int, optional): Number of taxels in all samples of a PyG batch. Defaults to
                the largest index in :obj:`edge_index` plus one.
        """
        num_nodes = self._checked_num_nodes(edge_attr, edge_index, num_nodes)
        hidden = self.encode(edge_attr, edge_index, num_nodes)
        return self.propagate(edge_index, hidden=hidden, size=(num_nodes, num_nodes))

    def _checked_num_nodes(
        self, edge_attr: Tensor, edge_index: Adj, num_nodes: Optional[int]
    ) -> int:
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
        # Messages are computed from edge features only, so a source out of range would raise no
        # error.
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
        r"""Returns the encoded features of the edges."""
        return hidden

    def __repr__(self) -> str:
        return (
            f"{type(self).__name__}({self.edge_dim}, {self.out_channels}, "
            f"hidden_channels={self.hidden_channels})"
        )


class EdgeAttentionEncoder(EdgeMessageEncoder):
    r"""Encodes the features of each edge with a small network, and sums the results at the target,
    weighted by attention coefficients.

    .. math::
        \mathbf{h}_i = \sum_{j \in \mathcal{N}(i)} \alpha_{ij} \mathbf{m}_{ij}, \qquad
        \alpha_{ij} = \mathrm{softmax}_j \left( \mathbf{a}^{\top}
        \mathrm{LeakyReLU}(\mathbf{m}_{ij}) \right), \qquad
        \mathbf{m}_{ij} = \mathrm{MLP}(\mathbf{e}_{ij})

    This variant of the paper's :class:`EdgeFeatureEncoder` is not from the paper.

    Args:
        edge_dim (int): Size of each edge feature :math:`D`, or -1 to infer it from the first input.
        out_channels (int): Size of each output feature.
        hidden_channels (int): Width of the hidden layer.
        **kwargs: Further arguments of :class:`torch_geometric.nn.MessagePassing`.

    Shapes:
        - **input:** same as for :class:`EdgeMessageEncoder`
        - **output:** same as for :class:`EdgeMessageEncoder`

    Raises:
        ValueError: In the same cases as :class:`EdgeMessageEncoder`.

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
        r"""Resets all learnable parameters."""
        super().reset_parameters()
        glorot(self.att)

    def encode(self, edge_attr: Tensor, edge_index: Tensor, num_nodes: int) -> Tensor:
        r"""Returns the message of each edge, multiplied by its attention coefficient.

        Args:
            edge_attr (torch.Tensor): Edge features.
            edge_index (torch.Tensor): Edges.
            num_nodes (int): Number of taxels.
        """
        hidden = self.mlp(edge_attr)
        logits = (torch.nn.functional.leaky_relu(hidden, 0.2) * self.att).sum(-1, keepdim=True)
        target = edge_index[1 if self.flow == "source_to_target" else 0]
        return hidden * softmax(logits, target, num_nodes=num_nodes, dim=-2)


class EdgePatchEncoder(EdgeMessageEncoder):
    r"""Encodes the features of edges within a patch with one small network and the features of
    edges between patches with another, and aggregates the results at the target.

    .. math::
        \mathbf{h}_i = \mathrm{aggr}_{j \in \mathcal{N}(i)}
        \begin{cases}
        \mathrm{MLP}(\mathbf{e}_{ij}) & \text{if } s_i = s_j \\
        \mathrm{MLP}'(\mathbf{e}_{ij}) & \text{otherwise}
        \end{cases}

    This variant of the paper's :class:`EdgeFeatureEncoder` is not from the paper. It is motivated
    by the paper's finding that the encoder distinguishes these two kinds of edges.

    Args:
        segment (sequence of int or torch.Tensor): Patch :math:`s_i` of each taxel :math:`(N,)`, as
            returned by :obj:`layout.segments("patch")`.
        edge_dim (int): Size of each edge feature :math:`D`, or -1 to infer it from the first input.
        out_channels (int): Size of each output feature.
        hidden_channels (int): Width of the hidden layer in both networks.
        aggr (str): Aggregation of the messages at the target, as in PyG.
        **kwargs: Further arguments of :class:`torch_geometric.nn.MessagePassing`.

    Shapes:
        - **input:** same as for :class:`EdgeMessageEncoder`
        - **output:** same as for :class:`EdgeMessageEncoder`

    Raises:
        ValueError: In the same cases as :class:`EdgeMessageEncoder`, or if the number of taxels is
            not a multiple of the length of :obj:`segment`.

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
        r"""Resets all learnable parameters."""
        super().reset_parameters()
        reset(self.mlp_between)

    def encode(self, edge_attr: Tensor, edge_index: Tensor, num_nodes: int) -> Tensor:
        r"""Returns the message of each edge, computed by the network for this kind of edge.

        Args:
            edge_attr (torch.Tensor): Edge features.
            edge_index (torch.Tensor): Edges.
            num_nodes (int): Number of taxels.
        """
        # The modulo maps the taxels of a PyG batch to the taxels of one sample.
        segment = self.segment[edge_index % len(self.segment)]
        is_within = (segment[0] == segment[1]).unsqueeze(-1)
        return torch.where(is_within, self.mlp(edge_attr), self.mlp_between(edge_attr))

    def forward(
        self, edge_attr: Tensor, edge_index: Adj, num_nodes: Optional[int] = None
    ) -> Tensor:
        r"""Returns the node features that encode the edge features.

        Args:
            edge_attr (torch.Tensor): Edge features.
            edge_index (torch.Tensor): Edges.
            num_nodes (int, optional): Number of taxels in all samples of a PyG batch. Defaults to
                the number of taxels in one sample.
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
    input_layer = lazy_linear("edge_dim", edge_dim, 1, hidden_channels)
    return Sequential(input_layer, ReLU(), Linear(hidden_channels, out_channels))
