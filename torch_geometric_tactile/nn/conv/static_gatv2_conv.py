r"""The dynamic graph attention layer of PyG for many samples on one topology."""

from collections.abc import Iterator
from functools import partial
from typing import Any, Optional, Union

import torch
import torch.nn.functional as F
from torch import Tensor
from torch.autograd import Function
from torch_geometric.nn import GATv2Conv
from torch_geometric.typing import Adj, OptTensor

from torch_geometric_tactile.nn.conv._attention_edges import (
    AttentionCache,
    AttentionEdges,
    EdgeBlock,
)
from torch_geometric_tactile.nn.conv._attention_product import (
    Attention,
    attend_by_messages,
    differentiable_gradients,
    edge_factors,
    slot_gradient,
    sum_edges,
)
from torch_geometric_tactile.nn.conv._static_attention import (
    LoopCache,
    StaticAttention,
    as_long,
    check_attention_input,
)

# Number of edge features in one block, which fits in the cache of a CPU.
_BLOCK_SIZE = 2**16


class StaticGATv2Conv(StaticAttention, GATv2Conv):
    r"""The graph attention layer from the `"How Attentive are Graph Attention Networks?"
    <https://arxiv.org/abs/2105.14491>`_ paper, for many samples on one topology.

    .. math::
        \mathbf{x}'_i = \sum_{j \in \mathcal{N}(i) \cup \{ i \}} \alpha_{ij} \mathbf{W}_s
        \mathbf{x}_j, \qquad \alpha_{ij} = \mathrm{softmax}_j \left( \mathbf{a}^{\top}
        \mathrm{LeakyReLU} \left( \mathbf{W}_s \mathbf{x}_j + \mathbf{W}_t \mathbf{x}_i \right)
        \right)

    This is a :class:`torch_geometric.nn.GATv2Conv` with the same arguments, results and
    :obj:`state_dict`. It also accepts many samples :math:`(B, N, F)`. On a CPU, it then computes
    the logits in blocks of samples, so that their edge features stay in the cache, and multiplies
    by sparse matrices. The sparsity pattern is cached as long as the edges do not change.

    Messages are passed along edges in the same cases as in
    :class:`~torch_geometric_tactile.nn.conv.StaticGATConv`.

    Args:
        in_channels (int or tuple): Size of each input feature, or -1 to infer it from the first
            input. For a bipartite graph, a tuple with the sizes of sources and targets.
        out_channels (int): Size of each output feature of one head.
        heads (int): Number of attention heads.
        concat (bool): Whether to concatenate the heads. If :obj:`False`, they are averaged.
        negative_slope (float): Slope of the LeakyReLU below zero.
        dropout (float): Probability of dropping an attention coefficient during training.
        add_self_loops (bool): Whether to add self-loops.
        edge_dim (int, optional): Size of each edge feature, if edges have features.
        fill_value (float, torch.Tensor or str): Edge features of added self-loops, or the name of a
            reduction that computes them from the other edges of the node.
        bias (bool): Whether to add learnable biases.
        share_weights (bool): Whether sources and targets share one linear map.
        residual (bool): Whether to add a linear map of the input.
        fast (bool): Whether to propagate samples on one topology with sparse matrix products.
        **kwargs: Further arguments of :class:`torch_geometric.nn.MessagePassing`.

    Shapes:
        - **input:** node features :math:`(N, F_{in})`, :math:`(B, N, F_{in})` or, for a PyG batch,
          :math:`(B \cdot N, F_{in})`, edges :math:`(2, |\mathcal{E}|)` or a sparse matrix
          :math:`(N, N)` of targets and sources (PyG's :obj:`adj_t`), optional edge features
          :math:`(|\mathcal{E}|, D)`, shared by all samples
        - **output:** node features with the same leading shape and width :math:`H \cdot F_{out}`,
          or :math:`F_{out}` if :obj:`concat=False`

    Raises:
        ValueError: If :obj:`x` has fewer than two dimensions, has the wrong number of features or
            does not hold floating-point numbers; if :obj:`edge_index` has the wrong shape, does not
            hold integers or has indices out of range; or if :obj:`edge_attr` does not have one row
            per edge, or is passed without :obj:`edge_dim`.

    Examples:
        >>> conv = StaticGATv2Conv(3, 8, heads=2)
        >>> conv
        StaticGATv2Conv(3, 8, heads=2)
        >>> conv(torch.zeros(5, 4, 3), torch.tensor([[0, 1], [1, 0]])).shape
        torch.Size([5, 4, 16])
    """

    def __init__(
        self,
        in_channels: Union[int, tuple[int, int]],
        out_channels: int,
        heads: int = 1,
        concat: bool = True,
        negative_slope: float = 0.2,
        dropout: float = 0.0,
        add_self_loops: bool = True,
        edge_dim: Optional[int] = None,
        fill_value: Union[float, Tensor, str] = "mean",
        bias: bool = True,
        share_weights: bool = False,
        residual: bool = False,
        *,
        fast: bool = True,
        **kwargs: Any,
    ) -> None:
        super().__init__(
            in_channels,
            out_channels,
            heads,
            concat,
            negative_slope,
            dropout,
            add_self_loops,
            edge_dim,
            fill_value,
            bias,
            share_weights,
            residual,
            **kwargs,
        )
        self.fast = fast
        self._edge_cache, self._loop_cache = AttentionCache(), LoopCache()

    def forward(
        self,
        x: Any,
        edge_index: Adj,
        edge_attr: OptTensor = None,
        return_attention_weights: Optional[bool] = None,
    ) -> Any:
        r"""Returns the node features after attention over the neighbours.

        Args:
            x (torch.Tensor): Node features. For a bipartite graph, a pair with the features of the
                sources and the targets, as in PyG.
            edge_index (torch.Tensor): Edges, or a sparse matrix.
            edge_attr (torch.Tensor, optional): Edge features.
            return_attention_weights (bool, optional): If :obj:`True`, also returns the edges with
                self-loops, and their attention coefficients for each sample
                :math:`(|\mathcal{E}'|, H)`.
        """
        if not isinstance(x, Tensor) or not isinstance(edge_index, Tensor):
            return super().forward(x, edge_index, edge_attr, return_attention_weights)
        if edge_attr is not None and self.lin_edge is None:
            raise ValueError(
                "'edge_attr' must be None without 'edge_dim', the size of each edge feature "
                f"(got shape {tuple(edge_attr.shape)})"
            )
        check_attention_input(self, x, edge_index, edge_attr)
        return self._attend(x, edge_index, edge_attr, return_attention_weights)

    def _sparse_attention(self, x: Tensor, edge_index: Tensor) -> OptTensor:
        edges = self._cached_edges(edge_index, x.size(1))
        if edges is None:
            return None
        source = self.lin_l(x)
        target = source if self.share_weights else self.lin_r(x)
        dropout = self.dropout if self.training else 0.0
        size = edges.max_samples(self.heads)
        outs = [
            _GATv2Product.apply(*pair, self.att, edges, self.negative_slope, dropout)
            for pair in zip(source.split(size), target.split(size), strict=True)
        ]
        out = outs[0] if len(outs) == 1 else torch.cat(outs)
        return self._combine_heads(out, None if self.res is None else self.res(x))

    def _pass_messages(
        self, x: Tensor, edge_index: Adj, edge_attr: OptTensor
    ) -> tuple[Tensor, tuple[Tensor, Tensor]]:
        # PyG's `forward` with features of shape (N, B, H, C).
        num_nodes = x.size(1)
        if edge_attr is not None and self._overrides_edge_update:
            return self._attend_by_sample(x, as_long(edge_index), edge_attr)
        edge_index, edge_attr, is_removed = self._add_loops(edge_index, edge_attr, num_nodes)
        source = self._split_heads(self.lin_l(x))
        target = source if self.share_weights else self._split_heads(self.lin_r(x))
        if is_removed is None:
            # edge_updater_type: (x: PairTensor, edge_attr: OptTensor)
            alpha = self.edge_updater(edge_index, x=(source, target), edge_attr=edge_attr)
        else:
            ends = edge_index if self.flow == "source_to_target" else edge_index.flip(0)
            edge_features = source.index_select(0, ends[0]) + target.index_select(0, ends[1])
            edge_features = F.leaky_relu(
                self._with_edge_features(edge_features, edge_attr), self.negative_slope
            )
            alpha = self._masked_softmax(
                (edge_features * self.att).sum(dim=-1), ends[1], num_nodes, is_removed
            )
        # propagate_type: (x: PairTensor, alpha: Tensor)
        out = self.propagate(edge_index, x=(source, target), alpha=alpha)
        out = self._combine_heads(
            out.transpose(0, 1).contiguous(), self.res(x) if self.res else None
        )
        return out, (edge_index, alpha.transpose(0, 1))

    def edge_update(
        self,
        x_j: Tensor,
        x_i: Tensor,
        edge_attr: OptTensor,
        index: Tensor,
        ptr: OptTensor,
        dim_size: Optional[int],
    ) -> Tensor:
        r"""Returns the attention coefficients of the edges; see
        :class:`torch_geometric.nn.GATv2Conv`.
        """
        if x_j.dim() == 4 and edge_attr is not None:
            x_j, edge_attr = self._with_edge_features(x_j, edge_attr), None
        out: Tensor = super().edge_update(x_j, x_i, edge_attr, index, ptr, dim_size)
        return out

    def _with_edge_features(self, x: Tensor, edge_attr: OptTensor) -> Tensor:
        if edge_attr is None:
            return x
        edge_attr = edge_attr.view(-1, 1) if edge_attr.dim() == 1 else edge_attr
        features: Tensor = self.lin_edge(edge_attr)
        return x + features.view(-1, 1, self.heads, self.out_channels)


class _GATv2Product(Function):
    # The edge features (E, H, C) are computed in blocks of samples that fit in the cache. The
    # backward pass recomputes them.
    @staticmethod
    def forward(
        ctx: Any,
        source: Tensor,
        target: Tensor,
        att: Tensor,
        edges: AttentionEdges,
        negative_slope: float,
        dropout: float,
    ) -> Tensor:
        heads, channels = att.shape[1:]
        source, target = source.contiguous(), target.contiguous()
        pattern = edges.pattern(source.size(0), heads, source.dtype)
        logits = source.new_empty(source.size(0), edges.num_edges, heads)
        for start, stop, edge_features, _ in _edge_blocks(source, target, edges):
            activations = (
                F.leaky_relu_(edge_features, negative_slope).view(-1, heads, channels).mul_(att)
            )
            torch.sum(activations, dim=-1, out=logits[start:stop].view(-1, heads))
        slots = logits.view(-1).index_select(0, pattern.slot_edges)
        attention = Attention(slots.view(pattern.num_slots, -1), pattern, dropout)
        out = attention.apply(source.view(-1, channels))
        ctx.save_for_backward(
            source, target, att, attention.slots, attention.values, attention.factors
        )
        ctx.edges, ctx.pattern, ctx.negative_slope = edges, pattern, negative_slope
        return out.view(*source.shape[:-1], heads, channels)

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> tuple[OptTensor, ...]:
        source, target, att, slots, values, factors = ctx.saved_tensors
        pattern, edges = ctx.pattern, ctx.edges
        heads, channels = att.shape[1:]
        if torch.is_grad_enabled():  # a second derivative is needed
            compute = partial(
                _attention_by_messages,
                edges=edges,
                negative_slope=ctx.negative_slope,
                factors=edge_factors(factors, pattern),
            )
            inputs, needs_grad = (source, target, att), ctx.needs_input_grad[:3]
            return *differentiable_gradients(compute, inputs, needs_grad, grad), None, None, None
        grad = grad.reshape(-1, channels)
        grad_logits = slot_gradient(slots, factors, grad, source.view(-1, channels), pattern)
        grad_logits = grad_logits.view(-1).index_select(0, pattern.edge_slots)
        grad_logits = grad_logits.view(source.size(0), -1, heads, 1)
        # Slopes are first summed over the edges of each node and then multiplied by the attention
        # vector, so that there is one multiplication per node instead of one per edge.
        grad_source, grad_target = torch.empty_like(source), torch.empty_like(target)
        for start, stop, edge_features, block in _edge_blocks(source, target, edges):
            head_features = edge_features.view(-1, heads, channels)
            grad_block = grad_logits[start:stop].reshape(-1, heads, 1).expand_as(head_features)
            slope = torch.ops.aten.leaky_relu_backward(
                grad_block, head_features, ctx.negative_slope, False
            )
            slope = slope.view_as(edge_features)
            sums = sum_edges(slope, block.by_source, block.source_starts)
            grad_source[start:stop] = sums.view_as(source[start:stop])
            sums = sum_edges(slope, block.by_target, block.target_starts)
            grad_target[start:stop] = sums.view_as(target[start:stop])
        grad_att = None
        if ctx.needs_input_grad[2]:
            total = (grad_source * source).sum(dim=(0, 1)) + (grad_target * target).sum(dim=(0, 1))
            grad_att = total.view_as(att)
        message_grad = Attention.apply_transposed(values, grad, pattern).view_as(source)
        grad_source.mul_(att.view(-1)).add_(message_grad)
        grad_target.mul_(att.view(-1))
        return grad_source, grad_target, grad_att, None, None, None


def _edge_blocks(
    source: Tensor, target: Tensor, edges: AttentionEdges
) -> Iterator[tuple[int, int, Tensor, EdgeBlock]]:
    # Yields the range of samples, the sums of source and target features of their edges, and the
    # edges of each block.
    num_samples, _, width = source.shape
    size = max(1, _BLOCK_SIZE // (edges.num_edges * width))
    for start in range(0, num_samples, size):
        stop = min(start + size, num_samples)
        block = edges.block(stop - start)
        edge_features = source[start:stop].view(-1, width).index_select(0, block.source)
        edge_features += target[start:stop].view(-1, width).index_select(0, block.target)
        yield start, stop, edge_features, block


def _attention_by_messages(
    source: Tensor,
    target: Tensor,
    att: Tensor,
    edges: AttentionEdges,
    negative_slope: float,
    factors: OptTensor,
) -> Tensor:
    shape = (*source.shape[:-1], *att.shape[1:])
    source, target = source.view(shape), target.view(shape)
    edge_features = source.index_select(1, edges.source) + target.index_select(1, edges.target)
    logits = (F.leaky_relu(edge_features, negative_slope) * att).sum(dim=-1)
    return attend_by_messages(logits, source, edges, factors)
