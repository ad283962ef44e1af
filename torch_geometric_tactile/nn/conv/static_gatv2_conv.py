r"""The dynamic graph attention layer of PyG, for one topology and many samples."""

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

# Features of edges that are computed at once: few enough to stay in the cache of a processor.
_BLOCK_SIZE = 2**16


class StaticGATv2Conv(StaticAttention, GATv2Conv):
    r"""The graph attention layer of the `"How Attentive are Graph Attention Networks?"
    <https://arxiv.org/abs/2105.14491>`_ paper, for many samples on one topology.

    .. math::
        \mathbf{x}'_i = \sum_{j \in \mathcal{N}(i) \cup \{ i \}} \alpha_{ij} \mathbf{W}_s
        \mathbf{x}_j, \qquad \alpha_{ij} = \mathrm{softmax}_j \left( \mathbf{a}^{\top}
        \mathrm{LeakyReLU} \left( \mathbf{W}_s \mathbf{x}_j + \mathbf{W}_t \mathbf{x}_i \right)
        \right)

    It is a :class:`torch_geometric.nn.GATv2Conv`, with the same arguments, the same numbers and the
    same :obj:`state_dict`, which also takes :math:`(B, N, F)`. For these, on a processor, it
    computes the logits a few samples at a time, so that the features of edges stay in the cache,
    and multiplies by sparse matrices, whose pattern is computed once and kept for as long as the
    same edges come in.

    It passes messages where :class:`~torch_geometric_tactile.nn.conv.StaticGATConv` does.

    Args:
        in_channels (int or tuple): Size of each input feature, or -1 to take it from the first
            input; a tuple of those of sources and targets for a bipartite graph.
        out_channels (int): Size of each output feature of one head.
        heads (int): Number of attention heads.
        concat (bool): Whether to concatenate the heads; their mean is taken otherwise.
        negative_slope (float): Slope of the LeakyReLU below zero.
        dropout (float): Probability of dropping an attention coefficient in training.
        add_self_loops (bool): Whether to add self-loops.
        edge_dim (int, optional): Size of each edge feature, if there are any.
        fill_value (float, torch.Tensor or str): Edge features of added self-loops, or how to
            compute them from those of the other edges of the node.
        bias (bool): Whether to add learnable biases.
        share_weights (bool): Whether sources and targets share one linear map.
        residual (bool): Whether to add a linear map of the input.
        fast (bool): Whether to multiply the samples of one topology by sparse matrices.
        **kwargs: Further arguments of :class:`torch_geometric.nn.MessagePassing`.

    Shapes:
        - **input:** node features :math:`(N, F_{in})`, :math:`(B, N, F_{in})` or those of a PyG
          batch :math:`(B \cdot N, F_{in})`, edges :math:`(2, |\mathcal{E}|)` or a sparse matrix
          :math:`(N, N)` of targets and sources (PyG's :obj:`adj_t`), optional edge features
          :math:`(|\mathcal{E}|, D)`, shared by all samples
        - **output:** node features of the same leading shape, :math:`H \cdot F_{out}` wide, or
          :math:`F_{out}` if :obj:`concat=False`

    Raises:
        ValueError: If :obj:`x` has fewer than two dimensions, other features or no real numbers,
            :obj:`edge_index` has another shape, holds no integers or joins other nodes,
            :obj:`edge_attr` does not hold one row for each edge, or comes without :obj:`edge_dim`.

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
        self._kept, self._kept_loops = AttentionCache(), LoopCache()

    def forward(
        self,
        x: Any,
        edge_index: Adj,
        edge_attr: OptTensor = None,
        return_attention_weights: Optional[bool] = None,
    ) -> Any:
        r"""Attends to the neighbours.

        Args:
            x (torch.Tensor): Node features; a pair of those of sources and targets for a bipartite
                graph, as in PyG.
            edge_index (torch.Tensor): Edges, or a sparse matrix.
            edge_attr (torch.Tensor, optional): Edge features.
            return_attention_weights (bool, optional): Whether to return the edges with self-loops
                and their attention coefficients as well, :math:`(|\mathcal{E}'|, H)` of each
                sample.
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

    def _multiply(self, x: Tensor, edge_index: Tensor) -> OptTensor:
        edges = self._edges(edge_index, x.size(1))
        if edges is None:
            return None
        source = self.lin_l(x)
        target = source if self.share_weights else self.lin_r(x)
        dropout = self.dropout if self.training else 0.0
        size = edges.max_samples(self.heads)
        parts = [
            _GATv2Product.apply(*pair, self.att, edges, self.negative_slope, dropout)
            for pair in zip(source.split(size), target.split(size), strict=True)
        ]
        out = parts[0] if len(parts) == 1 else torch.cat(parts)
        return self._finish(out, None if self.res is None else self.res(x))

    def _pass_messages(
        self, x: Tensor, edge_index: Adj, edge_attr: OptTensor
    ) -> tuple[Tensor, tuple[Tensor, Tensor]]:
        # PyG's `forward`, with the samples behind the nodes (N, B, H, C).
        num_nodes = x.size(1)
        if edge_attr is not None and self._has_own_edge_update:
            return self._each_sample(x, as_long(edge_index), edge_attr)
        edge_index, edge_attr, removed = self._looped(edge_index, edge_attr, num_nodes)
        source = self._split_heads(self.lin_l(x))
        target = source if self.share_weights else self._split_heads(self.lin_r(x))
        if removed is None:
            # edge_updater_type: (x: PairTensor, edge_attr: OptTensor)
            alpha = self.edge_updater(edge_index, x=(source, target), edge_attr=edge_attr)
        else:
            ends = edge_index if self.flow == "source_to_target" else edge_index.flip(0)
            each = source.index_select(0, ends[0]) + target.index_select(0, ends[1])
            each = F.leaky_relu(self._with_edge_features(each, edge_attr), self.negative_slope)
            alpha = self._normalize((each * self.att).sum(dim=-1), ends[1], num_nodes, removed)
        # propagate_type: (x: PairTensor, alpha: Tensor)
        out = self.propagate(edge_index, x=(source, target), alpha=alpha)
        out = self._finish(out.transpose(0, 1).contiguous(), self.res(x) if self.res else None)
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
        r"""Returns the attention coefficients of the edges."""
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
    # The features of edges (E, H, C), which cannot be avoided, are computed for a few samples at a
    # time and again in the backward pass.
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
        for start, stop, pre, _ in _edge_blocks(source, target, edges):
            each = F.leaky_relu_(pre, negative_slope).view(-1, heads, channels).mul_(att)
            torch.sum(each, dim=-1, out=logits[start:stop].view(-1, heads))
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
        if torch.is_grad_enabled():  # somebody asks for a second derivative
            compute = partial(
                _by_messages,
                edges=edges,
                negative_slope=ctx.negative_slope,
                factors=edge_factors(factors, pattern),
            )
            inputs, needed = (source, target, att), ctx.needs_input_grad[:3]
            return *differentiable_gradients(compute, inputs, needed, grad), None, None, None
        grad = grad.reshape(-1, channels)
        grad_logits = slot_gradient(slots, factors, grad, source.view(-1, channels), pattern)
        grad_logits = grad_logits.view(-1).index_select(0, pattern.edge_slots)
        grad_logits = grad_logits.view(source.size(0), -1, heads, 1)
        # Sums of the slopes over the edges of each node, which the attention vector multiplies
        # afterwards: of all nodes, not of all edges.
        grad_source, grad_target = torch.empty_like(source), torch.empty_like(target)
        for start, stop, pre, block in _edge_blocks(source, target, edges):
            each = pre.view(-1, heads, channels)
            part = grad_logits[start:stop].reshape(-1, heads, 1).expand_as(each)
            slope = torch.ops.aten.leaky_relu_backward(part, each, ctx.negative_slope, False)
            slope = slope.view_as(pre)
            sums = sum_edges(slope, block.by_source, block.source_starts)
            grad_source[start:stop] = sums.view_as(source[start:stop])
            sums = sum_edges(slope, block.by_target, block.target_starts)
            grad_target[start:stop] = sums.view_as(target[start:stop])
        grad_att = None
        if ctx.needs_input_grad[2]:
            total = (grad_source * source).sum(dim=(0, 1)) + (grad_target * target).sum(dim=(0, 1))
            grad_att = total.view_as(att)
        passed = Attention.apply_transposed(values, grad, pattern).view_as(source)
        grad_source.mul_(att.view(-1)).add_(passed)
        grad_target.mul_(att.view(-1))
        return grad_source, grad_target, grad_att, None, None, None


def _edge_blocks(
    source: Tensor, target: Tensor, edges: AttentionEdges
) -> Iterator[tuple[int, int, Tensor, EdgeBlock]]:
    # A few samples at a time: which, the sums of both ends of their edges, and these edges.
    num_samples, _, width = source.shape
    size = max(1, _BLOCK_SIZE // (edges.num_edges * width))
    for start in range(0, num_samples, size):
        stop = min(start + size, num_samples)
        block = edges.block(stop - start)
        pre = source[start:stop].view(-1, width).index_select(0, block.source)
        pre += target[start:stop].view(-1, width).index_select(0, block.target)
        yield start, stop, pre, block


def _by_messages(
    source: Tensor,
    target: Tensor,
    att: Tensor,
    edges: AttentionEdges,
    negative_slope: float,
    factors: OptTensor,
) -> Tensor:
    shape = (*source.shape[:-1], *att.shape[1:])
    source, target = source.view(shape), target.view(shape)
    each = source.index_select(1, edges.source) + target.index_select(1, edges.target)
    logits = (F.leaky_relu(each, negative_slope) * att).sum(dim=-1)
    return attend_by_messages(logits, source, edges, factors)
