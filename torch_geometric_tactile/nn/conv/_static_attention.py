r"""The base class of attention layers for many samples on one topology."""

from collections.abc import Callable
from functools import partial
from typing import Any, ClassVar, Optional

import torch
import torch.nn.functional as F
from torch import Tensor
from torch.nn import Parameter
from torch_geometric import EdgeIndex
from torch_geometric.nn import MessagePassing
from torch_geometric.nn.aggr import SumAggregation
from torch_geometric.typing import Adj, OptTensor
from torch_geometric.utils import (
    add_self_loops,
    is_torch_sparse_tensor,
    remove_self_loops,
    scatter,
    softmax,
)

from torch_geometric_tactile.nn.conv._attention_edges import AttentionCache, AttentionEdges
from torch_geometric_tactile.nn.conv._edge_cache import EdgeCache, is_cacheable, is_transformed
from torch_geometric_tactile.nn.conv._edge_checks import (
    as_edges,
    check_edge_features,
    check_edge_form,
    compute_on_edges,
    is_traced,
    sorted_form,
)
from torch_geometric_tactile.nn.conv._explainable_propagate import (
    ExplainablePropagate,
    mark_overridden_methods,
    original_propagate,
)
from torch_geometric_tactile.nn.conv._plain import (
    MESSAGE_METHODS,
    has_global_hooks,
    is_hooked,
    is_static_batch,
)

_EDGE_METHODS = ("edge_update", "edge_updater")
_METHODS = (*MESSAGE_METHODS, *_EDGE_METHODS)
# Methods that users may replace on an instance. `propagate` and `edge_updater` are set on instances
# by PyG itself.
_INSTANCE_METHODS = frozenset(_METHODS) - {"propagate", "edge_updater"}
_HOOKS = tuple(
    f"_{method}_forward{kind}"
    for method in ("propagate", "message", "aggregate", "message_and_aggregate", "edge_update")
    for kind in ("_pre_hooks", "_hooks")
)
_TENSOR_TYPES = (Tensor, Parameter)


class LoopCache(EdgeCache[Tensor]):
    r"""A cache that holds the edges of the last topology with self-loops. Without the cache, a GPU
    would have to synchronise at each call to get the number of edges.
    """

    def get(self, edge_index: Tensor, num_nodes: int) -> Tensor:
        r"""Returns edges with exactly one self-loop for each node.

        Shapes:
            - **edge_index:** Edges :math:`(2, |\mathcal{E}|)`.
            - **num_nodes:** Number of taxels :math:`N`.
            - **output:** Edges :math:`(2, |\mathcal{E}'|)`.
        """

        def replace_loops() -> Tensor:
            edges: Tensor = add_self_loops(remove_self_loops(edge_index)[0], num_nodes=num_nodes)[0]
            return edges

        key, tensors = (num_nodes,), (edge_index,)
        cached_edges = self._lookup(key, tensors)
        return self._store(key, tensors, replace_loops) if cached_edges is None else cached_edges


def may_cache_loops(edge_index: Adj) -> bool:
    r"""Returns whether :class:`LoopCache` may be used. It may not be used while a compiler is
    recording, or for a sparse matrix, since PyG treats its values as edge features.
    """
    return not is_traced() and edge_index.layout == torch.strided and is_cacheable(edge_index)


class StaticAttention(ExplainablePropagate, MessagePassing):
    r"""The base class of :class:`~torch_geometric_tactile.nn.conv.StaticGATConv` and
    :class:`~torch_geometric_tactile.nn.conv.StaticGATv2Conv`. It is listed before PyG's base class.
    """

    in_channels: Any
    heads: int
    out_channels: int
    concat: bool
    dropout: float
    negative_slope: float
    add_self_loops: bool
    edge_dim: Optional[int]
    fill_value: Any
    lin_edge: Any
    res: Any
    bias: OptTensor
    fast: bool
    _edge_cache: AttentionCache
    _loop_cache: LoopCache
    _overrides_messages: ClassVar[bool] = False
    _overrides_edge_update: ClassVar[bool] = False
    _overrides_propagate: ClassVar[bool] = False

    # Set in each class, since PyG writes it into the class of the first layer; see StaticGCNConv.
    propagate = original_propagate()

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        if StaticAttention in cls.__bases__:
            return
        layer = next(base for base in cls.__mro__ if StaticAttention in base.__bases__)
        mark_overridden_methods(
            cls,
            layer,
            _overrides_messages=_METHODS,
            _overrides_edge_update=_EDGE_METHODS,
            _overrides_propagate=("propagate",),
        )

    def _is_fast(self, x: Tensor, edge_index: Adj, edge_attr: OptTensor) -> bool:
        attributes = self.__dict__
        aggr_module: Any = self.aggr_module
        return (
            self.fast
            and edge_attr is None
            and is_static_batch(x)
            and type(x) in _TENSOR_TYPES
            and edge_index.layout == torch.strided
            and not self._overrides_messages
            and not any(map(attributes.get, _HOOKS))
            and _INSTANCE_METHODS.isdisjoint(attributes)
            and not self.explain
            and self.node_dim == 0
            and self.decomposed_layers == 1
            and type(aggr_module) is SumAggregation
            and not is_hooked(aggr_module)
            and not has_global_hooks()
            and not torch.is_autocast_enabled("cpu")
            and not is_transformed()
        )

    def _attend(self, x: Tensor, edge_index: Adj, edge_attr: OptTensor, *options: Any) -> Any:
        # `options` are the further arguments of PyG's `forward`. The last one is
        # `return_attention_weights`.
        num_nodes = x.size(-2)
        if x.dim() == 2:
            arguments = (x, edge_index, edge_attr, *options)
            return compute_on_edges(self._compute_sample, num_nodes, *arguments)
        samples = x if x.dim() == 3 else x.flatten(0, -3)
        out = None
        if not options[-1] and self._is_fast(samples, edge_index, edge_attr):
            out = self._sparse_attention(samples, edge_index)
        if out is None:
            messages: Callable[..., Any] = self._pass_messages
            out, weights = compute_on_edges(messages, num_nodes, samples, edge_index, edge_attr)
        out = out.view(*x.shape[:-1], out.size(-1))
        if not options[-1]:
            return out
        edge_index, alpha = weights
        if isinstance(edge_index, Tensor):
            edge_index = edge_index.clone()  # the cache may hold it, and callers may write to it
        return out, (edge_index, alpha.reshape(*x.shape[:-2], *alpha.shape[1:]))

    def _compute_sample(
        self, x: Tensor, edge_index: Adj, edge_attr: OptTensor, *options: Any
    ) -> Any:
        has_defaults = all(argument is None for argument in options[:-1])
        if not has_defaults or is_torch_sparse_tensor(edge_index) or not self._should_mask_loops():
            return super().forward(x, as_long(edge_index), edge_attr, *options)
        out, (edge_index, alpha) = self._pass_messages(x.unsqueeze(0), edge_index, edge_attr)
        out, alpha = out.squeeze(0), alpha.squeeze(0)
        return (out, (edge_index, alpha)) if options[-1] else out

    def _attend_by_sample(
        self, x: Tensor, edge_index: Adj, edge_attr: OptTensor
    ) -> tuple[Tensor, tuple[Tensor, Tensor]]:
        # Calls PyG's layer for each sample. This is needed for a subclass whose `edge_update` takes
        # only the arguments that PyG passes to it. For an empty batch, one sample is computed and
        # discarded.
        samples = x if len(x) > 0 else x.new_zeros(1, *x.shape[1:])
        compute = partial(super().forward, return_attention_weights=True)
        outs, weights = zip(
            *[compute(sample, edge_index, edge_attr) for sample in samples], strict=True
        )
        alpha = torch.stack([pair[1] for pair in weights])
        return torch.stack(outs)[: len(x)], (weights[0][0], alpha[: len(x)])

    def _sparse_attention(self, x: Tensor, edge_index: Tensor) -> OptTensor:
        # Returns the output, computed with sparse matrix products, or None if messages are cheaper.
        raise NotImplementedError

    def _pass_messages(
        self, x: Tensor, edge_index: Adj, edge_attr: OptTensor
    ) -> tuple[Tensor, tuple[Tensor, Tensor]]:
        # Returns the output for samples (B, N, F), the edges with self-loops and their
        # coefficients.
        raise NotImplementedError

    def _cached_edges(self, edge_index: Tensor, num_nodes: int) -> Optional[AttentionEdges]:
        # Returns the sorted edges for sparse matrices, or None if messages are cheaper.
        if type(edge_index) is not Tensor and isinstance(edge_index, EdgeIndex):
            edge_index = edge_index.as_tensor()
        edges = self._edge_cache.get(edge_index, num_nodes, self.add_self_loops, self.flow)
        return edges if edges is not None and edges.has_little_padding else None

    def _should_mask_loops(self) -> bool:
        # PyG removes self-loops using a boolean mask. The size of the result depends on values,
        # which compilers do not support, so self-loops are masked in the softmax instead.
        return self.add_self_loops and is_traced() and not self._overrides_edge_update

    def _add_loops(
        self, edge_index: Adj, edge_attr: OptTensor, num_nodes: int
    ) -> tuple[Tensor, OptTensor, OptTensor]:
        # Returns the edges with self-loops, their features and, if loops are masked, a boolean mask
        # of the original self-loops. The original self-loops must have no effect.
        edge_index = as_long(edge_index)
        if not self.add_self_loops:
            return *_as_edges(edge_index, edge_attr), None
        if edge_attr is None and may_cache_loops(edge_index):
            return self._loop_cache.get(edge_index, num_nodes), None, None
        if not self._should_mask_loops():
            edge_index, edge_attr = remove_self_loops(edge_index, edge_attr)
            edge_index, edge_attr = add_self_loops(
                edge_index, edge_attr, fill_value=self.fill_value, num_nodes=num_nodes
            )
            return *_as_edges(edge_index, edge_attr), None
        edge_index, edge_attr = _as_edges(edge_index, edge_attr)
        is_loop = edge_index[0] == edge_index[1]
        if edge_attr is not None:
            loop_attr = self._loop_attr(edge_index, edge_attr, is_loop, num_nodes)
            edge_attr = torch.cat([edge_attr, loop_attr])
        nodes = torch.arange(num_nodes, device=edge_index.device)
        is_removed = torch.cat([is_loop, torch.zeros_like(nodes, dtype=torch.bool)])
        return torch.cat([edge_index, nodes.expand(2, -1)], dim=1), edge_attr, is_removed

    def _loop_attr(
        self, edge_index: Tensor, edge_attr: Tensor, is_loop: Tensor, num_nodes: int
    ) -> Tensor:
        fill, size = self.fill_value, (num_nodes, *edge_attr.shape[1:])
        if isinstance(fill, str):
            # The features of original self-loops are written to an extra last entry, which is
            # discarded.
            indices = edge_index[1].masked_fill(is_loop, num_nodes)
            return scatter(edge_attr, indices, dim_size=num_nodes + 1, reduce=fill)[:-1]
        if isinstance(fill, Tensor):
            fill = fill.to(edge_attr.device, edge_attr.dtype)
            fill = fill if edge_attr.dim() == fill.dim() else fill.unsqueeze(0)
            return fill.expand(size)
        return edge_attr.new_full(size, fill)

    def _masked_softmax(
        self, logits: Tensor, index: Tensor, num_nodes: int, is_removed: Tensor
    ) -> Tensor:
        # Like PyG's `edge_update`, but with zero coefficients for removed edges.
        is_removed = is_removed.view(-1, *[1] * (logits.dim() - 1))
        alpha = softmax(logits.masked_fill(is_removed, -torch.inf), index, num_nodes=num_nodes)
        return F.dropout(alpha, self.dropout, self.training)

    def _split_heads(self, x: Tensor) -> Tensor:
        # Returns (N, B, H, C): PyG's methods expect the nodes in the first dimension.
        return x.view(*x.shape[:2], self.heads, self.out_channels).transpose(0, 1)

    def _combine_heads(self, out: Tensor, residual: OptTensor) -> Tensor:
        # Concatenates or averages the heads of sums (..., H, C), then adds the residual and the
        # bias.
        out = out.flatten(-2) if self.concat else out.mean(dim=-2)
        for term in (residual, self.bias):
            out = out if term is None else out + term
        return out


def check_attention_input(
    conv: StaticAttention, x: Tensor, edge_index: Adj, edge_attr: OptTensor
) -> None:
    r"""Checks the shapes and types of the input of an attention layer.

    Shapes:
        - **x:** Node features :math:`(\ldots, N, F)`.
        - **edge_index:** Edges :math:`(2, |\mathcal{E}|)`, or a sparse matrix
          :math:`(N, N)`.
        - **edge_attr:** Edge features :math:`(|\mathcal{E}|, D)` or :math:`(|\mathcal{E}|,)`.
    """
    if x.dim() < 2:
        raise ValueError(
            "'x' must have shape (num_nodes, in_channels) or (batch_size, num_nodes, "
            f"in_channels) (got {tuple(x.shape)})"
        )
    if not x.is_floating_point():
        raise ValueError(f"'x' must hold floating-point numbers (got {x.dtype})")
    size = conv.in_channels
    if isinstance(size, int) and size != -1 and x.size(-1) != size:
        raise ValueError(f"'x' must have {size} features (got shape {tuple(x.shape)})")
    check_edge_form(edge_index, x.size(-2))
    if edge_attr is None or is_torch_sparse_tensor(edge_index):
        return
    if edge_attr.dim() not in (1, 2) or edge_attr.size(0) != edge_index.size(1):
        raise ValueError(
            f"'edge_attr' must have {edge_index.size(1)} rows, one for each edge "
            f"(got shape {tuple(edge_attr.shape)})"
        )
    if conv.edge_dim is not None and conv.edge_dim != -1:
        check_edge_features(
            edge_attr if edge_attr.dim() == 2 else edge_attr.unsqueeze(-1), conv.edge_dim
        )


def as_long(edge_index: Adj) -> Adj:
    r"""Returns edges as 64-bit integers, which is the only type that PyG's messages support on a
    CPU. Sparse matrices and :class:`~torch_geometric.EdgeIndex` keep their type. The indices of
    sparse matrices are sorted.
    """
    if is_torch_sparse_tensor(edge_index) or isinstance(edge_index, EdgeIndex):
        return sorted_form(edge_index)
    return edge_index.long()


def _as_edges(edge_index: Adj, edge_attr: OptTensor) -> tuple[Tensor, OptTensor]:
    if not is_torch_sparse_tensor(edge_index):
        return as_edges(edge_index, edge_attr)
    # As in PyG, the values of a sparse matrix are edge features only if they have several columns.
    edge_index, values = as_edges(sorted_form(edge_index))
    if edge_attr is None and values is not None and values.dim() > 1:
        edge_attr = values
    return edge_index, edge_attr
