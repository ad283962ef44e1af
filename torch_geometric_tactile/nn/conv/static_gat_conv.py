r"""The graph attention layer of PyG for many samples on one topology."""

from functools import partial
from typing import Any, Optional, Union

import torch
import torch.nn.functional as F
from torch import Tensor
from torch.autograd import Function
from torch_geometric.nn import GATConv
from torch_geometric.typing import Adj, OptTensor, Size

from torch_geometric_tactile.nn.conv._attention_edges import AttentionCache, AttentionEdges
from torch_geometric_tactile.nn.conv._attention_product import (
    Attention,
    attend_by_messages,
    differentiable_gradients,
    edge_factors,
    slot_gradient,
)
from torch_geometric_tactile.nn.conv._plain import is_plain_linear
from torch_geometric_tactile.nn.conv._static_attention import (
    LoopCache,
    StaticAttention,
    as_long,
    check_attention_input,
)


class StaticGATConv(StaticAttention, GATConv):
    r"""The graph attention layer from the `"Graph Attention Networks"
    <https://arxiv.org/abs/1710.10903>`_ paper, for many samples on one topology.

    .. math::
        \mathbf{x}'_i = \sum_{j \in \mathcal{N}(i) \cup \{ i \}} \alpha_{ij} \mathbf{W}
        \mathbf{x}_j, \qquad \alpha_{ij} = \mathrm{softmax}_j \left( \mathrm{LeakyReLU} \left(
        \mathbf{a}_s^{\top} \mathbf{W} \mathbf{x}_j + \mathbf{a}_t^{\top} \mathbf{W} \mathbf{x}_i
        \right) \right)

    This is a :class:`torch_geometric.nn.GATConv` with the same arguments, results and
    :obj:`state_dict`. It also accepts many samples :math:`(B, N, F)`. On a CPU, it then folds the
    attention vectors into the linear map and multiplies by sparse matrices. The sparsity pattern is
    cached as long as the edges do not change.

    As in PyG, messages are passed along edges in all other cases:

    * for a single sample or a PyG batch :math:`(N, F)`;
    * with :obj:`edge_attr`, a sparse matrix, :obj:`return_attention_weights` or :obj:`fast=False`;
    * if the degrees of the nodes differ greatly;
    * on other devices, and in compiled and exported models;
    * if an explainer, a hook, a different aggregation, or a subclass that overrides :meth:`message`
      or :meth:`edge_update` needs the messages.

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
        bias (bool): Whether to add a learnable bias.
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
            per edge.

    Examples:
        >>> conv = StaticGATConv(3, 8, heads=2)
        >>> conv
        StaticGATConv(3, 8, heads=2)
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
        size: Size = None,
        return_attention_weights: Optional[bool] = None,
    ) -> Any:
        r"""Returns the node features after attention over the neighbours.

        Args:
            x (torch.Tensor): Node features. For a bipartite graph, a pair with the features of the
                sources and the targets, as in PyG.
            edge_index (torch.Tensor): Edges, or a sparse matrix.
            edge_attr (torch.Tensor, optional): Edge features.
            size (tuple, optional): Numbers of sources and targets of a bipartite graph.
            return_attention_weights (bool, optional): If :obj:`True`, also returns the edges with
                self-loops, and their attention coefficients for each sample
                :math:`(|\mathcal{E}'|, H)`.
        """
        if not isinstance(x, Tensor) or not isinstance(edge_index, Tensor):
            return super().forward(x, edge_index, edge_attr, size, return_attention_weights)
        check_attention_input(self, x, edge_index, edge_attr)
        return self._attend(x, edge_index, edge_attr, size, return_attention_weights)

    def _sparse_attention(self, x: Tensor, edge_index: Tensor) -> OptTensor:
        lin = self.lin
        if lin is None or not is_plain_linear(lin):
            return None
        edges = self._cached_edges(edge_index, x.size(1))
        if edges is None:
            return None
        dropout = self.dropout if self.training else 0.0
        weights = (lin.weight, self.att_src, self.att_dst)
        outs = [
            _GATProduct.apply(samples, *weights, edges, self.negative_slope, dropout)
            for samples in x.split(edges.max_samples(self.heads))
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
        maps = (self.lin, self.lin) if self.lin is not None else (self.lin_src, self.lin_dst)
        source = self._split_heads(maps[0](x))
        target = source if maps[1] is maps[0] else self._split_heads(maps[1](x))
        logits = ((source * self.att_src).sum(dim=-1), (target * self.att_dst).sum(dim=-1))
        if is_removed is None:
            # edge_updater_type: (alpha: OptPairTensor, edge_attr: OptTensor)
            alpha = self.edge_updater(edge_index, alpha=logits, edge_attr=edge_attr, size=None)
        else:
            ends = edge_index if self.flow == "source_to_target" else edge_index.flip(0)
            edge_logits = logits[0].index_select(0, ends[0]) + logits[1].index_select(0, ends[1])
            edge_logits = self._with_edge_logits(edge_logits, edge_attr)
            edge_logits = F.leaky_relu(edge_logits, self.negative_slope)
            alpha = self._masked_softmax(edge_logits, ends[1], num_nodes, is_removed)
        # propagate_type: (x: OptPairTensor, alpha: Tensor)
        out = self.propagate(edge_index, x=(source, target), alpha=alpha, size=None)
        out = self._combine_heads(
            out.transpose(0, 1).contiguous(), self.res(x) if self.res else None
        )
        return out, (edge_index, alpha.transpose(0, 1))

    def edge_update(
        self,
        alpha_j: Tensor,
        alpha_i: OptTensor,
        edge_attr: OptTensor,
        index: Tensor,
        ptr: OptTensor,
        dim_size: Optional[int],
    ) -> Tensor:
        r"""Returns the attention coefficients of the edges; see
        :class:`torch_geometric.nn.GATConv`.
        """
        if alpha_j.dim() == 3 and edge_attr is not None:
            alpha_j, edge_attr = self._with_edge_logits(alpha_j, edge_attr), None
        out: Tensor = super().edge_update(alpha_j, alpha_i, edge_attr, index, ptr, dim_size)
        return out

    def _with_edge_logits(self, logits: Tensor, edge_attr: OptTensor) -> Tensor:
        if edge_attr is None or self.lin_edge is None:
            return logits
        edge_attr = edge_attr.view(-1, 1) if edge_attr.dim() == 1 else edge_attr
        features = self.lin_edge(edge_attr).view(-1, 1, self.heads, self.out_channels)
        return logits + (features * self.att_edge).sum(dim=-1)


class _GATProduct(Function):
    # Computes the layer without residual and bias in one operation, which has little overhead for a
    # single sample and saves no edge features for the backward pass.
    @staticmethod
    def forward(
        ctx: Any,
        x: Tensor,
        weight: Tensor,
        att_src: Tensor,
        att_dst: Tensor,
        edges: AttentionEdges,
        negative_slope: float,
        dropout: float,
    ) -> Tensor:
        heads, channels = att_src.shape[1:]
        pattern = edges.pattern(x.size(0), heads, x.dtype)
        rows = x.reshape(-1, x.size(-1))
        att = torch.cat([att_src, att_dst]).transpose(0, 1)  # (H, 2, C)
        folded = _fold(att, weight)
        features = rows.mm(weight.t()).view(-1, channels)
        source, target = rows.mm(folded.t()).view(-1, 2, heads).unbind(1)
        logits = source.reshape(-1).index_select(0, pattern.slot_columns)
        logits = logits.view(pattern.num_slots, -1).add_(target.reshape(-1))
        attention = Attention(F.leaky_relu(logits, negative_slope), pattern, dropout)
        out = attention.apply(features).view(*x.shape[:-1], heads, channels)
        ctx.save_for_backward(
            x,
            weight,
            att_src,
            att_dst,
            folded,
            features,
            logits,
            attention.slots,
            attention.values,
            attention.factors,
        )
        ctx.edges, ctx.pattern, ctx.negative_slope = edges, pattern, negative_slope
        return out

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> tuple[OptTensor, ...]:
        x, weight, att_src, att_dst, folded, features, logits, slots, values, factors = (
            ctx.saved_tensors
        )
        pattern, edges = ctx.pattern, ctx.edges
        heads, channels = att_src.shape[1:]
        if torch.is_grad_enabled():  # a second derivative is needed
            compute = partial(
                _attention_by_messages,
                edges=edges,
                negative_slope=ctx.negative_slope,
                factors=edge_factors(factors, pattern),
            )
            inputs = (x, weight, att_src, att_dst)
            needs_grad = ctx.needs_input_grad[:4]
            return *differentiable_gradients(compute, inputs, needs_grad, grad), None, None, None
        grad = grad.reshape(-1, channels)
        grad_logits = slot_gradient(slots, factors, grad, features, pattern)
        grad_logits = torch.ops.aten.leaky_relu_backward(
            grad_logits, logits, ctx.negative_slope, False
        )
        grad_source = grad_logits.new_zeros(grad_logits.size(1))
        grad_source.index_add_(0, pattern.slot_columns, grad_logits.view(-1))
        grad_pair = torch.stack(
            [grad_source.view(-1, heads), grad_logits.sum(0).view(-1, heads)], dim=1
        )
        grad_pair = grad_pair.view(-1, 2 * heads)
        grad_features = Attention.apply_transposed(values, grad, pattern).view(-1, weight.size(0))
        rows = x.reshape(-1, x.size(-1))
        grad_x = grad_weight = grad_att_src = grad_att_dst = None
        if ctx.needs_input_grad[0]:
            grad_x = grad_features.mm(weight).addmm_(grad_pair, folded).view_as(x)
        if any(ctx.needs_input_grad[1:4]):
            grad_folded = grad_pair.t().mm(rows).view(2, heads, -1).transpose(0, 1)  # (H, 2, F)
            att = torch.cat([att_src, att_dst]).transpose(0, 1)
            grad_weight = grad_features.t().mm(rows)
            grad_weight.view(heads, channels, -1).baddbmm_(att.transpose(1, 2), grad_folded)
            grad_att = grad_folded.matmul(weight.view(heads, channels, -1).transpose(1, 2))
            grad_att_src, grad_att_dst = grad_att.transpose(0, 1).unsqueeze(1).unbind(0)
        return grad_x, grad_weight, grad_att_src, grad_att_dst, None, None, None


def _fold(att: Tensor, weight: Tensor) -> Tensor:
    # Returns the product of the attention vectors (H, 2, C) and the linear map. The result (2 * H,
    # F) maps inputs directly to the logits of sources and targets.
    heads, _, channels = att.shape
    folded = torch.matmul(att, weight.view(heads, channels, -1))
    return folded.transpose(0, 1).reshape(2 * heads, -1)


def _attention_by_messages(
    x: Tensor,
    weight: Tensor,
    att_src: Tensor,
    att_dst: Tensor,
    edges: AttentionEdges,
    negative_slope: float,
    factors: OptTensor,
) -> Tensor:
    features = F.linear(x, weight).view(*x.shape[:-1], *att_src.shape[1:])
    source, target = (features * att_src).sum(dim=-1), (features * att_dst).sum(dim=-1)
    logits = source.index_select(1, edges.source) + target.index_select(1, edges.target)
    return attend_by_messages(F.leaky_relu(logits, negative_slope), features, edges, factors)
