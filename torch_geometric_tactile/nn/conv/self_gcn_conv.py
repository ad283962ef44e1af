r"""A graph convolution with a separate weight for the taxel itself."""

from typing import Any

import torch
from torch import Tensor
from torch_geometric.nn import MessagePassing
from torch_geometric.nn.conv.gcn_conv import gcn_norm
from torch_geometric.nn.dense.linear import Linear
from torch_geometric.typing import Adj, OptTensor
from torch_geometric.utils import scatter

from torch_geometric_tactile.nn.conv._edge_checks import (
    as_edges,
    check_conv_sizes,
    check_edge_form,
    check_edge_weight,
    check_features,
    check_tensor,
    compute_on_edges,
    is_traced,
)
from torch_geometric_tactile.nn.conv._explainable_propagate import ExplainablePropagate
from torch_geometric_tactile.nn.conv._plain import is_plain_linear, sums_messages
from torch_geometric_tactile.nn.conv._sparse_gcn import sparse_gcn
from torch_geometric_tactile.nn.conv._static_adjacency import (
    GCN_NORM,
    AdjacencyCache,
    GCNNorm,
    Norm,
    contained_product,
    dense_matrix,
    edge_norm,
    edge_pattern,
    may_multiply,
    may_multiply_dense,
    message_type,
)

_RENAMED_WEIGHTS = {  # names in versions before 0.3
    "lin.weight": "lin_root.weight",
    "lin.bias": "lin_rel.bias",
    "conv.lin.weight": "lin_rel.weight",
}


class SelfGCNConv(ExplainablePropagate, MessagePassing):
    r"""A graph convolution with a separate weight for the taxel itself.

    .. math::
        \mathbf{x}'_i = \mathbf{W}_1 \mathbf{x}_i + \mathbf{b} + \mathbf{W}_2 \sum_j \hat{a}_{ij}
        \mathbf{x}_j, \qquad \hat{\mathbf{A}} = \mathbf{D}^{-1/2} \mathbf{A} \mathbf{D}^{-1/2}

    or, with :obj:`difference=True`, with the differences between the taxel and its neighbours,

    .. math::
        \mathbf{x}'_i = \mathbf{W}_1 \mathbf{x}_i + \mathbf{b} + \mathbf{W}_2 \frac{1}{\sum_j
        a_{ij}} \sum_j a_{ij} (\mathbf{x}_i - \mathbf{x}_j)

    A :class:`~torch_geometric.nn.GCNConv` uses one weight for the taxel and its neighbours. It
    therefore smooths the features and cannot express differences between neighbours, which are
    often what distinguishes readings. With :obj:`normalize=False`, this layer is equivalent to
    PyG's :class:`~torch_geometric.nn.GraphConv` and has the same :obj:`state_dict`.

    Many samples on one topology :math:`(B, N, F)` are multiplied by a cached matrix, as in
    :class:`~torch_geometric_tactile.nn.conv.StaticGCNConv`.

    Args:
        in_channels (int): Size of each input feature, or -1 to infer it from the first input.
        out_channels (int): Size of each output feature.
        difference (bool): Whether to use the differences between the taxel and its neighbours. They
            are zero for a taxel without neighbours.
        bias (bool): Whether to add a learnable bias.
        normalize (bool): Whether to normalise the adjacency. If :obj:`False`, messages are weighted
            by the edge weights and summed.
        fast (bool): Whether to propagate samples on one topology with a matrix product.
        **kwargs: Further arguments of :class:`torch_geometric.nn.MessagePassing`.

    Shapes:
        - **input:** node features :math:`(N, F_{in})`, :math:`(B, N, F_{in})` or, for a PyG batch,
          :math:`(B \cdot N, F_{in})`, edges :math:`(2, |\mathcal{E}|)` or a sparse matrix
          :math:`(N, N)` of targets and sources, optional edge weights :math:`(|\mathcal{E}|,)`
        - **output:** node features with the same leading shape and width :math:`F_{out}`

    Raises:
        ValueError: If a size is below one, :obj:`x` has the wrong number of features, or
            :obj:`edge_index` or :obj:`edge_weight` is invalid.

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
        normalize: bool = True,
        fast: bool = True,
        **kwargs: Any,
    ) -> None:
        super().__init__(**{"aggr": "add", **kwargs})
        check_conv_sizes(in_channels=in_channels, out_channels=out_channels)
        self.out_channels = out_channels
        self.difference = difference
        self.normalize = normalize
        self.fast = fast
        self.lin_root = Linear(in_channels, out_channels, False, weight_initializer="glorot")
        self.lin_rel = Linear(in_channels, out_channels, bias, weight_initializer="glorot")
        # Initialised twice, as in earlier versions, so that a seed reproduces the weights of
        # published results.
        self.lin_rel.reset_parameters()
        self._edge_cache = _DifferenceCache() if difference else AdjacencyCache()
        self.register_load_state_dict_pre_hook(_rename_weights)

    @property
    def in_channels(self) -> int:
        r"""Size of each input feature."""
        return int(self.lin_root.in_channels)

    def reset_parameters(self) -> None:
        r"""Resets all learnable parameters."""
        super().reset_parameters()
        self.lin_root.reset_parameters()
        self.lin_rel.reset_parameters()

    def forward(self, x: Tensor, edge_index: Adj, edge_weight: OptTensor = None) -> Tensor:
        r"""Returns the node features after the convolution.

        Args:
            x (torch.Tensor): Node features.
            edge_index (torch.Tensor): Edges, or a sparse matrix.
            edge_weight (torch.Tensor, optional): Edge weights. Defaults to ones.
        """
        check_tensor(x)
        has_plain_linears = is_plain_linear(self.lin_root) and is_plain_linear(self.lin_rel)
        check_features(x, self.lin_root.in_channels if has_plain_linears else None)
        if self._may_multiply(x):
            out = self._multiply(x, edge_index, edge_weight, has_plain_linears)
            if out is not None:
                return out
        check_edge_form(edge_index, x.size(-2))
        check_edge_weight(edge_index, edge_weight)
        sums = compute_on_edges(self._neighbor_sums, x.size(-2), x, edge_index, edge_weight)
        return self._combine(x, sums)

    def _combine(self, x: Tensor, sums: Tensor) -> Tensor:
        out: Tensor = self.lin_root(x) + self.lin_rel(sums.to(x.dtype))
        return out if sums.dtype == x.dtype else out.to(sums.dtype)  # type of the edge weights

    def _may_multiply(self, x: Tensor) -> bool:
        return (
            self.fast
            and type(self).message is SelfGCNConv.message
            and x.layout == torch.strided
            and (may_multiply(x) or (x.dim() > 2 and may_multiply_dense(x)))
            and sums_messages(self)
        )

    def _norm(self) -> Norm:
        return False, False, self.normalize, self.flow

    def _multiply(
        self, x: Tensor, edge_index: Adj, edge_weight: OptTensor, has_plain_linears: bool
    ) -> OptTensor:
        num_nodes, dtype, norm = x.size(-2), message_type(x, edge_weight), self._norm()
        adjacency = self._edge_cache.get(edge_index, edge_weight, num_nodes, dtype, norm=norm)
        if may_multiply(x):
            if adjacency is None or not adjacency.may_reorder:
                return None  # weights need a gradient or are infinite
            if has_plain_linears and dtype == x.dtype:
                lin = self.lin_rel
                return sparse_gcn(x, adjacency, lin.weight, lin.bias, self.lin_root.weight)
            return self._combine(x, adjacency.product(x.to(dtype)))
        if adjacency is not None:
            return self._combine(x, adjacency.dense_product(x.to(dtype)))
        edges = self._edge_cache.normalize(edge_index, edge_weight, num_nodes, dtype, norm=norm)
        dense = dense_matrix(*edges, num_nodes)
        return self._combine(x, contained_product(dense, edge_pattern(dense), x.to(dtype)))

    def _neighbor_sums(self, x: Tensor, edge_index: Adj, edge_weight: OptTensor) -> Tensor:
        num_nodes, dtype = x.size(-2), message_type(x, edge_weight)
        edge_index, edge_weight = as_edges(edge_index, edge_weight)
        edge_index = edge_index.long()
        if edge_weight is not None:
            edge_weight = edge_weight.view(-1).to(dtype)
        if not self.difference:
            if self.normalize:
                edge_index, edge_weight = gcn_norm(
                    edge_index, edge_weight, num_nodes, False, False, self.flow, dtype
                )
            return self.propagate(edge_index, x=x, edge_weight=edge_weight, center=None)
        if self.normalize:
            target = edge_index[1 if self.flow == "source_to_target" else 0]
            if edge_weight is None:
                edge_weight = torch.ones(len(target), dtype=dtype, device=x.device)
            edge_weight, _ = _shares(target, edge_weight, num_nodes)
        return self.propagate(edge_index, x=x, edge_weight=edge_weight, center=x)

    def message(self, x_j: Tensor, center_i: OptTensor, edge_weight: OptTensor) -> Tensor:
        r"""Returns the weighted features of the neighbour, or the weighted difference between the
        taxel and the neighbour.
        """
        out = x_j if center_i is None else center_i - x_j
        return out if edge_weight is None else edge_weight.view(-1, 1) * out

    def __repr__(self) -> str:
        difference = ", difference=True" if self.difference else ""
        return f"{type(self).__name__}({self.in_channels}, {self.out_channels}{difference})"


class _DifferenceCache(AdjacencyCache):
    # A cache of the adjacency for differences. A difference is the taxel itself minus its
    # neighbours, so the matrix has positive self-loops and negative edges.
    def normalize(
        self,
        edge_index: Adj,
        edge_weight: OptTensor,
        num_nodes: int,
        dtype: torch.dtype,
        segment: OptTensor = None,
        norm: Norm = GCN_NORM,
    ) -> tuple[Tensor, Tensor]:
        edges, weight = edge_norm(
            edge_index,
            edge_weight,
            num_nodes,
            dtype,
            segment,
            GCNNorm(normalize=False, flow=norm[3]),
        )
        if norm[2]:
            weight, loop = _shares(edges[1], weight, num_nodes)
        else:
            loop = scatter(weight, edges[1], dim_size=num_nodes, reduce="sum")
        nodes = torch.arange(num_nodes, device=edges.device)
        # Taxels without neighbours get no self-loop, since its weight would be zero, and zero times
        # a missing reading is NaN. Compilers skip this step, since they do not support sizes that
        # depend on values.
        if not is_traced():
            is_target = torch.zeros_like(nodes, dtype=torch.bool).index_fill(0, edges[1], True)
            nodes, loop = nodes[is_target], loop[is_target]
        return torch.cat([edges, nodes.expand(2, -1)], dim=1), torch.cat([-weight, loop])


def _shares(target: Tensor, weight: Tensor, num_nodes: int) -> tuple[Tensor, Tensor]:
    # Returns the share of each edge in the mean at its target, and the sum of the shares at each
    # node, which is one, or zero for nodes without neighbours.
    total = scatter(weight, target, dim_size=num_nodes, reduce="sum")
    share_sum = (total != 0).to(weight.dtype)
    return weight / torch.where(share_sum != 0, total, 1.0)[target] * share_sum[target], share_sum


def _rename_weights(module: SelfGCNConv, state_dict: dict[str, Any], prefix: str, *_: Any) -> None:
    # Loads checkpoints from versions before 0.3, in which the layer was not a MessagePassing layer.
    for old, new in _RENAMED_WEIGHTS.items():
        if prefix + old in state_dict and prefix + new not in state_dict:
            state_dict[prefix + new] = state_dict.pop(prefix + old)
