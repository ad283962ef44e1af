r"""The graph convolution from the papers for many samples on one topology."""

from collections.abc import Callable
from functools import partial
from typing import Any, ClassVar, Optional

import torch
from torch import Tensor
from torch.nn.functional import linear
from torch_geometric import EdgeIndex
from torch_geometric.nn import GCNConv
from torch_geometric.nn.conv.gcn_conv import gcn_norm
from torch_geometric.typing import Adj, OptTensor
from torch_geometric.utils import is_torch_sparse_tensor

from torch_geometric_tactile.nn.conv._edge_checks import (
    as_edges,
    check_edge_form,
    check_edge_index,
    check_edge_weight,
    check_features,
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
    is_hooked,
    is_plain_linear,
    sums_messages,
)
from torch_geometric_tactile.nn.conv._sparse_gcn import sparse_gcn
from torch_geometric_tactile.nn.conv._static_adjacency import (
    GCN_NORM,
    AdjacencyCache,
    GCNNorm,
    Norm,
    StaticAdjacency,
    contained_product,
    dense_norm,
    edge_pattern,
    loop_weights,
    may_cache_edges,
    may_multiply,
    may_multiply_dense,
    message_type,
)


class StaticGCNConv(ExplainablePropagate, GCNConv):
    r"""The graph convolution from the "Tactile Object Property Recognition using Geometrical Graph
    Edge Features and Multi-Thread Graph Convolutional Network" paper (eq. 1), but without the
    activation.

    .. math::
        \mathbf{X}' = \hat{\mathbf{D}}^{-1/2} (\mathbf{A} + \mathbf{I}) \hat{\mathbf{D}}^{-1/2}
        \mathbf{X} \mathbf{W} + \mathbf{b}

    This is a :class:`torch_geometric.nn.GCNConv` with the same arguments, results and
    :obj:`state_dict`. Use it for many samples on one topology :math:`(B, N, F)`. They are
    multiplied by the normalised adjacency matrix, which is cached as long as edges and weights do
    not change. Weights that need a gradient are not cached.

    An infinite or missing reading affects only the neighbours of its taxel. On a CPU, the
    neighbours get the same values as in PyG. On a GPU and in exported models, all features of the
    neighbours are NaN.

    As in PyG, messages are passed along edges for a single sample or a PyG batch :math:`(N, F)`,
    for more than 1024 nodes on a GPU or in exported models, under :func:`torch.compile` on a CPU,
    and with :obj:`fast=False`. They are also passed if an explainer, a message hook, a different
    aggregation or a subclass that overrides :meth:`message` needs them. All cases are listed in
    :doc:`/layers`.

    Args:
        in_channels (int): Size of each input feature, or -1 to infer it from the first input.
        out_channels (int): Size of each output feature.
        improved (bool): Whether added self-loops have weight two. As in PyG, this has no effect on
            edges without weights.
        cached (bool): Whether to use the normalised edges of the first call in all later calls,
            even if different edges are passed. This does not make the layer faster.
        add_self_loops (bool, optional): Whether to add self-loops. Defaults to :obj:`normalize`.
        normalize (bool): Whether to normalise the adjacency.
        bias (bool): Whether to add a learnable bias.
        fast (bool): Whether to propagate samples on one topology with a matrix product.
        **kwargs: Further arguments of :class:`torch_geometric.nn.MessagePassing`.

    Shapes:
        - **input:** node features :math:`(N, F_{in})`, :math:`(B, N, F_{in})` or, for a PyG batch,
          :math:`(B \cdot N, F_{in})`, edges :math:`(2, |\mathcal{E}|)` or a sparse matrix
          :math:`(N, N)` of targets and sources (PyG's :obj:`adj_t`), optional edge weights
          :math:`(|\mathcal{E}|,)`
        - **output:** node features with the same leading shape and width :math:`F_{out}`

    Raises:
        ValueError: If :obj:`x` has fewer than two dimensions, has the wrong number of features or
            does not hold floating-point numbers; if :obj:`edge_index` has the wrong shape, does not
            hold integers or has indices out of range; or if :obj:`edge_weight` does not hold one
            real number per edge.

    Examples:
        >>> conv = StaticGCNConv(3, 8)
        >>> conv
        StaticGCNConv(3, 8)
        >>> conv(torch.zeros(5, 4, 3), torch.tensor([[0, 1], [1, 0]])).shape
        torch.Size([5, 4, 8])
    """

    _cached_edge_index: Optional[tuple[Adj, OptTensor]]
    _overrides_messages: ClassVar[bool] = False

    _overrides_propagate: ClassVar[bool] = False

    # Set in each class. PyG writes the compiled form into the class of the first layer that is
    # created. Subclasses would inherit this form, but explainers need the uncompiled form.
    propagate = original_propagate()

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        mark_overridden_methods(
            cls,
            StaticGCNConv,
            _overrides_messages=MESSAGE_METHODS,
            _overrides_propagate=("propagate",),
        )

    def __init__(
        self,
        in_channels: int,
        out_channels: int,
        improved: bool = False,
        cached: bool = False,
        add_self_loops: Optional[bool] = None,
        normalize: bool = True,
        bias: bool = True,
        *,
        fast: bool = True,
        **kwargs: Any,
    ) -> None:
        super().__init__(
            in_channels, out_channels, improved, cached, add_self_loops, normalize, bias, **kwargs
        )
        self.fast = fast
        self._edge_cache = AdjacencyCache()

    def forward(self, x: Tensor, edge_index: Adj, edge_weight: OptTensor = None) -> Tensor:
        r"""Returns the node features after the convolution.

        Args:
            x (torch.Tensor): Node features.
            edge_index (torch.Tensor): Edges, or a sparse matrix.
            edge_weight (torch.Tensor, optional): Edge weights. Defaults to ones.
        """
        if not isinstance(x, Tensor) or not isinstance(edge_index, Tensor):
            # PyG supports further types, and raises an error for unsupported ones.
            return super().forward(x, edge_index, edge_weight)
        edge_index = sorted_form(edge_index)
        lin: Any = self._modules["lin"]  # faster than the attribute look-up of `self.lin`
        has_plain_linear = is_plain_linear(lin)
        check_features(x, lin.in_channels if has_plain_linear else None)
        if self._may_multiply(x, edge_index):
            out = self._multiply(x, edge_index, edge_weight, has_plain_linear)
            if out is not None:
                return out
        num_nodes = x.size(int(self.node_dim))
        check_edge_form(edge_index, num_nodes)
        check_edge_weight(edge_index, edge_weight)
        if self.cached and self._cached_edge_index is None:
            check_edge_index(edge_index, num_nodes)  # before PyG caches them
        return compute_on_edges(self._convolve_edges, num_nodes, x, edge_index, edge_weight)

    def is_plain(self) -> bool:
        r"""Returns whether the layer is unmodified. An unmodified layer has the default arguments,
        and no hook, wrapped weight, explainer or subclass that changes or observes it.
        """
        return (
            type(self) is StaticGCNConv
            and self.fast
            and not self.cached
            and self._norm() == GCN_NORM
            and not is_hooked(self)
            and is_plain_linear(self.lin)
            and sums_messages(self)
        )

    def _norm(self) -> Norm:
        return self.improved, self.add_self_loops, self.normalize, self.flow

    def _may_multiply(self, x: Tensor, edge_index: Adj) -> bool:
        return (
            self.fast
            and x.dim() > 2
            and x.layout == torch.strided
            and not self._overrides_messages
            and sums_messages(self)
            # PyG raises an error for a sparse matrix with the reversed flow.
            and (edge_index.layout == torch.strided or self.flow == "source_to_target")
        )

    def _multiply(
        self, x: Tensor, edge_index: Adj, edge_weight: OptTensor, has_plain_linear: bool
    ) -> OptTensor:
        # Returns the output, computed with a product with the adjacency, or None if messages are
        # faster or necessary.
        is_sparse = may_multiply(x)
        is_dense = not is_sparse and may_multiply_dense(x)
        uses_cached_edges = self.normalize and not self.cached and may_cache_edges(x)
        if not is_sparse and not is_dense and not uses_cached_edges:
            return None
        if type(edge_index) is not Tensor and isinstance(edge_index, EdgeIndex):
            edge_index = edge_index.as_tensor()
        num_nodes, norm = x.size(-2), self._norm()
        if self.normalize and self.cached:
            edge_index, edge_weight = self._normalized_edges(x, edge_index, edge_weight)
            norm = (*norm[:2], False, self.flow)
        dtype = message_type(x, edge_weight)
        adjacency = self._edge_cache.get(edge_index, edge_weight, num_nodes, dtype, norm=norm)
        if is_sparse and (adjacency is None or not adjacency.may_reorder):
            return None  # weights need a gradient or are infinite
        if not is_sparse and not is_dense:
            return None if adjacency is None else self._pass_messages(x, adjacency)
        if adjacency is not None:
            if is_sparse and has_plain_linear and dtype == x.dtype:
                return sparse_gcn(x, adjacency, self.lin.weight, self.bias)
            product: Callable[[Tensor], Tensor] = (
                adjacency.product if is_sparse else adjacency.dense_product
            )
        else:
            dense = dense_norm(edge_index, edge_weight, num_nodes, dtype, norm=GCNNorm(*norm))
            product = partial(contained_product, dense, edge_pattern(dense))
        # The product with the adjacency is cheaper on the narrower side of the linear map.
        if has_plain_linear and x.size(-1) <= self.out_channels and dtype == x.dtype:
            return linear(product(x), self.lin.weight, self.bias)
        out = product(self.lin(x).to(dtype))
        return out.contiguous() if self.bias is None else (out + self.bias).contiguous()

    def _pass_messages(self, x: Tensor, adjacency: StaticAdjacency) -> Tensor:
        edge_index, edge_weight = adjacency.edges  # from sources to targets in either flow
        if self.flow == "target_to_source":
            edge_index = edge_index.flip(0)
        out: Tensor = self.propagate(edge_index, x=self.lin(x), edge_weight=edge_weight)
        return out if self.bias is None else out + self.bias

    def _convolve_edges(self, x: Tensor, edge_index: Adj, edge_weight: OptTensor) -> Tensor:
        if not is_torch_sparse_tensor(edge_index):
            if not isinstance(edge_index, EdgeIndex):
                edge_index = edge_index.long()
            if edge_weight is not None and not edge_weight.is_floating_point():
                edge_weight = edge_weight.to(x.dtype)
            if not is_traced() or not self.normalize or not self.add_self_loops or self.cached:
                return super().forward(x, edge_index, edge_weight)
            # PyG replaces self-loops using a boolean mask. The size of the result depends on
            # values, which compilers do not support.
            edge_index, edge_weight = self._add_loops(x, edge_index, edge_weight)
            out = self.propagate(edge_index, x=self.lin(x), edge_weight=edge_weight)
            return out if self.bias is None else out + self.bias
        if x.dim() == 2 or self.flow == "target_to_source":
            return super().forward(x, edge_index, edge_weight)
        # PyG's product with a sparse matrix does not support a batch of samples; messages do.
        if self.normalize:
            edge_index, edge_weight = self._normalized_edges(x, edge_index, None)
        edge_index, edge_weight = as_edges(edge_index, edge_weight)
        out = self.propagate(edge_index, x=self.lin(x), edge_weight=edge_weight)
        return out if self.bias is None else out + self.bias

    def _add_loops(
        self, x: Tensor, edge_index: Tensor, edge_weight: OptTensor
    ) -> tuple[Tensor, Tensor]:
        num_nodes, edge_index = x.size(int(self.node_dim)), as_edges(edge_index)[0]
        loop_weight = 2.0 if self.improved and edge_weight is not None else 1.0
        weight = x.new_ones(edge_index.size(1)) if edge_weight is None else edge_weight.view(-1)
        is_loop = edge_index[0] == edge_index[1]
        loops = loop_weights(edge_index[0], is_loop, weight, num_nodes, loop_weight)
        nodes = torch.arange(num_nodes, device=x.device).expand(2, -1)
        edge_index = torch.cat([edge_index, nodes], dim=1)
        weight = torch.cat([weight.masked_fill(is_loop, 0.0), loops])
        normalized: tuple[Tensor, Tensor] = gcn_norm(
            edge_index, weight, num_nodes, False, False, self.flow, x.dtype
        )
        return normalized

    def _normalized_edges(
        self, x: Tensor, edge_index: Adj, edge_weight: OptTensor
    ) -> tuple[Adj, OptTensor]:
        # Uses PyG's attribute, so that the product and PyG's `forward` share the cache.
        pair = self._cached_edge_index
        if pair is None:
            num_nodes = x.size(int(self.node_dim))
            check_edge_index(edge_index, num_nodes)
            check_edge_weight(edge_index, edge_weight)
            pair = gcn_norm(
                edge_index, edge_weight, num_nodes, *self._norm()[:2], self.flow, x.dtype
            )
            if self.cached:
                self._cached_edge_index = pair
        return pair
