r"""The normalised adjacency matrix of one topology, its products and its cache."""

import math
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple, Optional

import torch
from torch import Tensor
from torch.autograd import Function
from torch_geometric.nn.conv.gcn_conv import gcn_norm
from torch_geometric.typing import Adj, OptTensor
from torch_geometric.utils import is_torch_sparse_tensor

from torch_geometric_tactile.nn.conv._edge_cache import EdgeCache, is_cacheable, is_transformed
from torch_geometric_tactile.nn.conv._edge_checks import (
    EdgeCheck,
    as_edges,
    check_edge_index,
    check_edge_weight,
    is_exported,
    is_traced,
    sorted_form,
)

# Above this number of nodes, a dense matrix costs more than gathering the edges.
MAX_DENSE_NODES = 1024
# PyTorch's sparse product with a sum supports only these types.
_SPARSE_TYPES = (torch.float32, torch.float64)
# Cached row blocks per adjacency: enough for several batch sizes of the largest graph.
_MAX_ROW_BLOCKS = 4096
# Cached matrices of PyG batches per adjacency.
_MAX_BATCHES = 8
# Whether traced products may spread missing readings to all taxels. This is for models whose output
# is then NaN anyway. A context variable is not an option, since PyTorch 2.6 cannot compile it.
_traces_plain_products = False


class GCNNorm(NamedTuple):
    r"""The normalisation of an adjacency, with the arguments of
    :class:`~torch_geometric.nn.GCNConv`.
    """

    improved: bool = False
    add_self_loops: bool = True
    normalize: bool = True
    flow: str = "source_to_target"


# The fields of `GCNNorm`. Layers create this value at each call, and a plain tuple is faster.
Norm = tuple[bool, bool, bool, str]
GCN_NORM = GCNNorm()


class StaticAdjacency:
    r"""The adjacency matrix of a graph convolution :math:`(N, N)`, in cached formats for products.

    Args:
        edge_index (torch.Tensor): Sources and targets of the entries :math:`(2, |\mathcal{E}|)`.
            The values of repeated edges are summed.
        weight (torch.Tensor): Values of the entries :math:`(|\mathcal{E}|,)`, including zeros.
        num_nodes (int): Number of taxels :math:`N`.
    """

    def __init__(self, edge_index: Tensor, weight: Tensor, num_nodes: int) -> None:
        self.num_nodes = num_nodes
        # Copies are needed, since the formats are computed on demand and the caller may change the
        # edges before.
        self._edges, self._weight = edge_index.clone(), weight.clone()
        # Whether the linear map may be applied after the sum. With an infinite weight, infinity
        # times a sum is not the same as a sum of infinities.
        self.may_reorder = not bool(self._weight.isinf().any())
        self._csr: dict[bool, Tensor] = {}
        self._rows: dict[tuple[int, int], Tensor] = {}
        self._batches: dict[tuple[int, bool], Tensor] = {}
        self._blocks: dict[int, Tensor] = {}
        self._dense: OptTensor = None
        self._pattern: OptTensor = None

    @property
    def edges(self) -> tuple[Tensor, Tensor]:
        r"""Sources and targets :math:`(2, |\mathcal{E}|)` and values :math:`(|\mathcal{E}|,)`."""
        return self._edges, self._weight

    @property
    def dense(self) -> Tensor:
        r"""The dense matrix :math:`(N, N)`."""
        if self._dense is None:
            with torch.inference_mode(False):
                self._dense = dense_matrix(self._edges, self._weight, self.num_nodes)
        return self._dense

    @property
    def pattern(self) -> Tensor:
        r"""The matrix with ones for nonzero entries and zeros elsewhere :math:`(N, N)`."""
        if self._pattern is None:
            with torch.inference_mode(False):
                self._pattern = edge_pattern(self.dense)
        return self._pattern

    def csr(self, transposed: bool = False) -> Tensor:
        r"""Returns the matrix in CSR format, and caches it.

        Args:
            transposed (bool): Whether to transpose it.
        """
        csr = self._csr.get(transposed)
        if csr is None:
            with torch.inference_mode(False):
                source, target = self._edges.flip(0) if transposed else self._edges
                # The stable sort keeps the order of the edges, in which messages are also summed.
                order = target.argsort(stable=True)
                ends = target.bincount(minlength=self.num_nodes).cumsum(0)
                starts = torch.cat([ends.new_zeros(1), ends])
                csr = csr_matrix(starts, source[order], self._weight[order], self.num_nodes)
            self._csr[transposed] = csr
        return csr

    def batch_csr(self, num_samples: int, transposed: bool = False) -> Tensor:
        r"""Returns the block-diagonal matrix of a PyG batch in CSR format :math:`(B N, B N)`, and
        caches it.

        Args:
            num_samples (int): Number of samples :math:`B`.
            transposed (bool): Whether to transpose it.
        """
        if num_samples == 1:
            return self.csr(transposed)
        matrix = self._batches.get((num_samples, transposed))
        if matrix is None:
            if len(self._batches) >= _MAX_BATCHES:
                self._batches = {}  # replaced, not cleared: another thread may be reading it
            with torch.inference_mode(False):
                csr, sample = self.csr(transposed), torch.arange(num_samples).view(-1, 1)
                starts, columns, values = csr.crow_indices(), csr.col_indices(), csr.values()
                ends = (starts[1:] + len(columns) * sample).view(-1)
                columns = (columns + self.num_nodes * sample).view(-1)
                starts, values = torch.cat([starts[:1], ends]), values.repeat(num_samples)
                matrix = csr_matrix(starts, columns, values, num_samples * self.num_nodes)
            self._batches[num_samples, transposed] = matrix
        return matrix

    def rows(self, start: int, stop: int) -> Tensor:
        r"""Returns the rows from :obj:`start` to :obj:`stop - 1` in CSR format :math:`(S, N)`, and
        caches them.

        Args:
            start (int): Index of the first row.
            stop (int): Index after the last row.
        """
        rows = self._rows.get((start, stop))
        if rows is None:
            if len(self._rows) >= _MAX_ROW_BLOCKS:
                self._rows = {}  # replaced, not cleared: another thread may be reading it
            csr = self.csr()
            starts = csr.crow_indices()[start : stop + 1]
            entries = slice(int(starts[0]), int(starts[-1]))
            columns, values = csr.col_indices()[entries], csr.values()[entries]
            rows = csr_matrix(starts - starts[0], columns, values, self.num_nodes)
            self._rows[start, stop] = rows
        return rows

    def blocks(self, group: int, nodes: Tensor) -> Tensor:
        r"""Returns the matrices of a group of segments of equal size :math:`(S, n, n)`, and caches
        them.

        Args:
            group (int): Index of the group.
            nodes (torch.Tensor): Indices of the taxels of each segment :math:`(S, n)`.
        """
        if group not in self._blocks:
            # Inference tensors, for example from a validation before training, cannot be used in
            # training.
            with torch.inference_mode(False):
                self._blocks[group] = adjacency_blocks(self.dense, nodes)
        return self._blocks[group]

    def product(self, x: Tensor, transposed: bool = False) -> Tensor:
        r"""Multiplies features by the sparse matrix, with gradients of any order.

        Only the entries of edges are multiplied, so that missing and infinite features and weights
        affect the same taxels as they do with messages.

        Shapes:
            - **x:** Features :math:`(\ldots, N, F)` that :func:`may_multiply` accepts.
            - **transposed:** Whether to transpose the matrix.
            - **output:** Sums with the same shape. The taxels are the outermost dimension in
              memory.
        """
        out: Tensor = _Product.apply(x, self, transposed)
        return out

    def dense_product(self, x: Tensor) -> Tensor:
        r"""Multiplies features by the dense matrix; see :func:`contained_product`.

        Shapes:
            - **x:** Features :math:`(\ldots, N, F)`.
        """
        return contained_product(self.dense, self.pattern, x)


class _Product(Function):
    @staticmethod
    def forward(ctx: Any, x: Tensor, adjacency: StaticAdjacency, transposed: bool) -> Tensor:
        ctx.adjacency, ctx.transposed = adjacency, transposed
        h = x.movedim(-2, 0)
        out = sparse_product(adjacency.csr(transposed), h.reshape(len(h), -1))
        return out.view(h.shape).movedim(0, -2)

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> tuple[OptTensor, ...]:
        return _Product.apply(grad, ctx.adjacency, not ctx.transposed), None, None

    @staticmethod
    def jvp(ctx: Any, tangent: Tensor, *_: None) -> Tensor:
        out: Tensor = _Product.apply(tangent, ctx.adjacency, ctx.transposed)
        return out


def sparse_product(matrix: Tensor, h: Tensor) -> Tensor:
    r"""Multiplies a CSR matrix by a dense matrix.

    Shapes:
        - **matrix:** The sparse matrix :math:`(M, N)`.
        - **h:** The dense matrix :math:`(N, K)`.
        - **output:** :math:`(M, K)`.
    """
    # With a reduction, PyTorch uses its own kernel. It is as fast as the kernel in MKL, which is
    # not available on every machine.
    return torch.sparse.mm(matrix, h, "sum")


def may_multiply(x: Tensor) -> bool:
    r"""Returns whether :meth:`StaticAdjacency.product` supports features. They must be samples on
    one topology :math:`(\ldots, N, F)` on a CPU, in eager mode, outside autocast and outside the
    transforms in :mod:`torch.func`.
    """
    return (
        not is_traced()
        and x.dim() > 2
        and x.is_cpu
        and x.dtype in _SPARSE_TYPES
        and x.layout == torch.strided
        and x.numel() > 0
        and not torch.is_autocast_enabled("cpu")
        and not is_transformed()
    )


class AdjacencyCache(EdgeCache[StaticAdjacency]):
    r"""A cache that holds the adjacency of the last topology."""

    def __init__(self) -> None:
        super().__init__()
        self._check = EdgeCheck()

    def get(
        self,
        edge_index: Adj,
        edge_weight: OptTensor,
        num_nodes: int,
        dtype: torch.dtype,
        segment: OptTensor = None,
        norm: Norm = GCN_NORM,
    ) -> Optional[StaticAdjacency]:
        r"""Returns the adjacency of a topology. Returns :obj:`None` if it may not be cached. This
        is the case for tensors that need a gradient, and while a compiler is recording.

        Args:
            edge_index (torch.Tensor): Edges :math:`(2, |\mathcal{E}|)`, or a sparse matrix
                :math:`(N, N)`.
            edge_weight (torch.Tensor, optional): Edge weights :math:`(|\mathcal{E}|,)`.
            num_nodes (int): Number of taxels :math:`N`.
            dtype (torch.dtype): Data type of the matrix.
            segment (torch.Tensor, optional): Segment of each taxel :math:`(N,)`. Edges between
                segments are removed. It must be the same in each call, since it is not part of the
                key.
            norm (tuple): Fields of a :class:`GCNNorm`.

        Raises:
            ValueError: If an edge or a weight is invalid.
        """
        is_recording = is_traced()
        key = (edge_index.layout, num_nodes, dtype, norm)
        tensors = () if is_recording else _edge_tensors(edge_index, edge_weight)
        cached_adjacency = None if is_recording else self._lookup(key, tensors)
        if cached_adjacency is not None:
            return cached_adjacency
        if is_recording or not is_cacheable(edge_index, edge_weight):
            self._check(edge_index, num_nodes)
            check_edge_weight(edge_index, edge_weight)
            return None
        check_edge_index(edge_index, num_nodes)
        check_edge_weight(edge_index, edge_weight)

        def compute_adjacency() -> StaticAdjacency:
            edges = self.normalize(edge_index, edge_weight, num_nodes, dtype, segment, norm)
            return StaticAdjacency(*edges, num_nodes)

        return self._store(key, tensors, compute_adjacency)

    def normalize(
        self,
        edge_index: Adj,
        edge_weight: OptTensor,
        num_nodes: int,
        dtype: torch.dtype,
        segment: OptTensor = None,
        norm: Norm = GCN_NORM,
    ) -> tuple[Tensor, Tensor]:
        r"""Returns the edges and values of the matrix; see :func:`edge_norm`."""
        return edge_norm(edge_index, edge_weight, num_nodes, dtype, segment, GCNNorm(*norm))


def may_multiply_dense(x: Tensor) -> bool:
    r"""Returns whether a product with a dense matrix is fastest for features
    :math:`(\ldots, N, F)`. This is the case on GPUs, and in exports, whose runtimes store the
    matrix as a constant. With compilers on a CPU, messages are faster.
    """
    return x.size(-2) <= MAX_DENSE_NODES and (not x.is_cpu or is_exported())


def may_cache_edges(x: Tensor) -> bool:
    r"""Returns whether messages along cached edges are fastest for features :math:`(B, N, F)`. This
    is the case on GPUs, which would have to synchronise at each normalisation to get the number of
    edges.
    """
    return x.dim() > 2 and not x.is_cpu and not is_traced()


def message_type(x: Tensor, edge_weight: OptTensor) -> torch.dtype:
    r"""Returns the data type of weighted messages, which is the same as in PyG. Integer weights are
    converted to the type of the features.
    """
    if edge_weight is None or not edge_weight.is_floating_point():
        return x.dtype
    return torch.promote_types(x.dtype, edge_weight.dtype)


def _edge_tensors(edge_index: Adj, edge_weight: OptTensor) -> tuple[Tensor, ...]:
    # Returns the strided tensors that determine the edges, for comparison.
    if edge_index.layout == torch.sparse_coo:
        return edge_index._indices(), edge_index._values()
    if edge_index.layout == torch.sparse_csr:
        return edge_index.crow_indices(), edge_index.col_indices(), edge_index.values()
    return (edge_index,) if edge_weight is None else (edge_index, edge_weight)


def csr_matrix(starts: Tensor, columns: Tensor, values: Tensor, num_columns: int) -> Tensor:
    r"""Returns a sparse matrix :math:`(M, N)` in CSR format. PyTorch's beta warning is suppressed,
    and the indices are not checked.

    Shapes:
        - **starts:** Start of each row, and the end of the last row :math:`(M + 1,)`.
        - **columns, values:** Columns and values of the entries :math:`(K,)`, row by row.
        - **num_columns:** Number of columns :math:`N`.
    """
    size = (len(starts) - 1, num_columns)
    with warnings.catch_warnings(), torch.inference_mode(False):
        warnings.filterwarnings("ignore", message="Sparse CSR tensor support is in beta")
        return torch.sparse_csr_tensor(starts, columns, values, size, check_invariants=False)


def dense_matrix(edge_index: Tensor, weight: Tensor, num_nodes: int) -> Tensor:
    r"""Returns the dense adjacency matrix :math:`(N, N)` with targets as rows and sources as
    columns.

    Shapes:
        - **edge_index:** Sources and targets :math:`(2, |\mathcal{E}|)`.
        - **weight:** Values of the edges :math:`(|\mathcal{E}|,)`. The values of repeated edges are
          summed.
        - **num_nodes:** Number of taxels :math:`N`.
    """
    source, target = edge_index
    return _scatter(target, source, weight, num_nodes)


def _scatter(target: Tensor, source: Tensor, weight: Tensor, num_nodes: int) -> Tensor:
    zeros = weight.new_zeros(num_nodes * num_nodes)
    return zeros.scatter_add(0, target * num_nodes + source, weight).view(num_nodes, num_nodes)


def edge_pattern(dense: Tensor) -> Tensor:
    r"""Returns a matrix with ones at the nonzero entries of a matrix and zeros elsewhere, with the
    same data type.

    Shapes:
        - **input:** Matrix :math:`(N, N)`, or several matrices.
    """
    return (dense != 0).to(dense.dtype)


def all_finite(x: Tensor) -> Optional[bool]:
    r"""Returns whether all values are finite. Returns :obj:`None` on a GPU, where the check would
    have to wait for all pending work, and while a compiler is recording.

    The check uses the sum, which needs one pass and no memory. A sum that overflows counts as not
    finite.
    """
    if not x.is_cpu or is_traced():
        return None
    if x.requires_grad:
        x = x.detach()
    total = x.sum(dtype=torch.float32) if x.dtype == torch.float16 else x.sum()
    try:
        number = total.item()
    except RuntimeError:  # raised inside `torch.func.vmap`, and for tensors without values
        return None
    return math.isfinite(number) if isinstance(number, float) else bool(total.isfinite())


@contextmanager
def plain_products_when_traced() -> Iterator[None]:
    r"""Makes :func:`contained_product` a plain matrix product in code that is traced inside this
    context. It is for models whose output is NaN if any reading is missing. For such models,
    containing NaN would only cost time.
    """
    global _traces_plain_products
    previous, _traces_plain_products = _traces_plain_products, True
    try:
        yield
    finally:
        _traces_plain_products = previous


def contained_product(adjacency: Tensor, pattern: Tensor, x: Tensor) -> Tensor:
    r"""Multiplies features by an adjacency matrix. Infinite or missing features of a taxel make
    only the sums at its neighbours NaN. In a plain product, zero times infinity would make all sums
    NaN. The function has no branches that depend on values, so that compilers can record it.

    Shapes:
        - **adjacency:** Matrix :math:`(N, N)`, or one matrix for each segment.
        - **pattern:** Matrix of the same shape with ones at edges and zeros elsewhere.
        - **x:** Features :math:`(\ldots, N, F)`.
    """
    if is_traced() and _traces_plain_products:
        return torch.matmul(adjacency, x)
    is_finite = x.isfinite()
    is_invalid = (~is_finite.all(dim=-1, keepdim=True)).to(adjacency.dtype)
    has_invalid_neighbor = torch.matmul(pattern, is_invalid) != 0
    out = torch.matmul(adjacency, x.masked_fill(~is_finite, 0.0))
    return out.masked_fill(has_invalid_neighbor, float("nan"))


def adjacency_blocks(dense: Tensor, nodes: Tensor) -> Tensor:
    r"""Returns the matrices of segments of equal size.

    Shapes:
        - **dense:** Matrix of all taxels :math:`(N, N)`.
        - **nodes:** Indices of the taxels of each segment :math:`(S, n)`.
        - **output:** Matrices :math:`(S, n, n)`.
    """
    return dense[nodes.unsqueeze(2), nodes.unsqueeze(1)]


def edge_norm(
    edge_index: Adj,
    edge_weight: OptTensor,
    num_nodes: int,
    dtype: torch.dtype,
    segment: OptTensor = None,
    norm: GCNNorm = GCN_NORM,
) -> tuple[Tensor, Tensor]:
    r"""Returns the edges from :func:`~torch_geometric.nn.conv.gcn_conv.gcn_norm` as sources and
    targets :math:`(2, |\mathcal{E}'|)`, and their weights :math:`(|\mathcal{E}'|,)`.

    Shapes:
        - **edge_index:** Edges :math:`(2, |\mathcal{E}|)`, or a sparse matrix
          :math:`(N, N)` of targets and sources.
        - **edge_weight:** Weights of the edges :math:`(|\mathcal{E}|,)`.
        - **num_nodes:** Number of taxels :math:`N`.
        - **segment:** Segment of each taxel :math:`(N,)`. Edges between segments are removed.
    """
    if is_torch_sparse_tensor(edge_index) and segment is None:
        matrix = sparse_norm(sorted_form(edge_index), num_nodes, dtype, norm)
        edges, weight = as_edges(matrix)
        assert weight is not None
        return edges, weight.to(dtype)
    edges, edge_weight = as_edges(edge_index, edge_weight)
    edges = edges.long()
    weight = None if edge_weight is None else edge_weight.view(-1).to(dtype)
    if segment is not None:
        is_within = segment[edges[0]] == segment[edges[1]]
        edges, weight = edges[:, is_within], None if weight is None else weight[is_within]
    if norm.normalize:
        edges, weight = gcn_norm(
            edges, weight, num_nodes, norm.improved, norm.add_self_loops, norm.flow, dtype
        )
    if weight is None:
        weight = torch.ones(edges.size(1), dtype=dtype, device=edges.device)
    return edges.flip(0) if norm.flow == "target_to_source" else edges, weight


def dense_norm(
    edge_index: Adj,
    edge_weight: OptTensor,
    num_nodes: int,
    dtype: torch.dtype,
    segment: OptTensor = None,
    norm: GCNNorm = GCN_NORM,
) -> Tensor:
    r"""Returns the adjacency matrix :math:`(N, N)` from
    :func:`~torch_geometric.nn.conv.gcn_conv.gcn_norm`, with targets as rows and sources as columns.

    Edges are given zero weight instead of being removed with a mask. A mask would produce a tensor
    of unknown size and break the graph in ``torch.compile``.

    Shapes:
        - **edge_index:** Edges :math:`(2, |\mathcal{E}|)`, or a sparse matrix
          :math:`(N, N)` of targets and sources.
        - **edge_weight:** Weights of the edges :math:`(|\mathcal{E}|,)`.
        - **num_nodes:** Number of taxels :math:`N`.
        - **segment:** Segment of each taxel :math:`(N,)`. Edges between segments have no effect.
    """
    if is_torch_sparse_tensor(edge_index) and segment is None:
        return sparse_norm(sorted_form(edge_index), num_nodes, dtype, norm).to_dense().to(dtype)
    edge_index, edge_weight = as_edges(edge_index, edge_weight)
    source, target = edge_index.long()
    if norm.flow == "target_to_source":
        source, target = target, source
    # As in PyG, where `improved` has no effect without edge weights.
    loop_weight = 2.0 if norm.improved and edge_weight is not None else 1.0
    if edge_weight is None:
        edge_weight = torch.ones(edge_index.size(1), dtype=dtype, device=edge_index.device)
    weight = edge_weight.view(-1).to(dtype)
    if segment is not None:
        weight = weight.masked_fill(segment[source] != segment[target], 0.0)
    is_loop = source == target
    add_self_loops, loop_edge_weight = norm.normalize and norm.add_self_loops, weight
    if add_self_loops:
        weight = weight.masked_fill(is_loop, 0.0)
    adjacency = _scatter(target, source, weight, num_nodes)
    if add_self_loops:
        loop = loop_weights(source, is_loop, loop_edge_weight, num_nodes, loop_weight)
        adjacency = adjacency + loop.diag_embed()
    if not norm.normalize:
        return adjacency
    scale = adjacency.sum(dim=1).pow(-0.5)
    scale = scale.masked_fill(scale == float("inf"), 0.0)
    # The root of a negative sum is NaN. Scaling each edge instead of the dense matrix limits NaN to
    # entries with edges.
    weight = scale[target] * weight * scale[source]
    if segment is not None:
        weight = weight.masked_fill(segment[source] != segment[target], 0.0)
    adjacency = _scatter(target, source, weight, num_nodes)
    return adjacency + (scale * loop * scale).diag_embed() if add_self_loops else adjacency


def loop_weights(
    source: Tensor, is_loop: Tensor, weight: Tensor, num_nodes: int, loop_weight: float
) -> Tensor:
    r"""Returns the weight of each node's self-loop :math:`(N,)`. Existing self-loops keep their
    weight, and missing self-loops get :obj:`loop_weight`.

    Shapes:
        - **source:** Sources of the edges :math:`(|\mathcal{E}|,)`.
        - **is_loop:** Whether each edge is a self-loop :math:`(|\mathcal{E}|,)`.
        - **weight:** Weights of the edges :math:`(|\mathcal{E}|,)`.
        - **num_nodes:** Number of taxels :math:`N`.
    """
    # Edges that are not self-loops are written to an extra last entry, which is discarded.
    indices = source.masked_fill(~is_loop, num_nodes)
    return weight.new_full((num_nodes + 1,), loop_weight).scatter(0, indices, weight)[:-1]


def sparse_norm(adj_t: Adj, num_nodes: int, dtype: torch.dtype, norm: GCNNorm) -> Tensor:
    r"""Returns a sparse adjacency matrix, normalised by PyG. PyG adds a self-loop to each node,
    even to nodes that already have one.

    Shapes:
        - **adj_t:** Sparse matrix :math:`(N, N)` of targets and sources.
        - **num_nodes:** Number of taxels :math:`N`.
    """
    if not norm.normalize:
        return adj_t
    normalized: Tensor = gcn_norm(
        adj_t, None, num_nodes, norm.improved, norm.add_self_loops, norm.flow, dtype
    )[0]
    return normalized
