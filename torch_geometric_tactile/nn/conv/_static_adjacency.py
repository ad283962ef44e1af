r"""The normalised adjacency of one topology, computed once."""

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

from torch_geometric_tactile.nn.conv._edge_cache import EdgeCache, is_wrapped, may_be_kept
from torch_geometric_tactile.nn.conv._edge_checks import (
    EdgeCheck,
    as_edges,
    check_edge_index,
    check_edge_weight,
    is_exported,
    is_traced,
    sorted_form,
)

# Above this number of nodes, a dense matrix of them costs more than gathering the edges.
MAX_DENSE_NODES = 1024
# Others have no sparse product with a sum.
_SPARSE_TYPES = (torch.float32, torch.float64)
# The most row blocks that one adjacency keeps: several batch sizes of the largest graph.
_MAX_ROWS = 4096
# The most matrices of batches that one adjacency keeps.
_MAX_BATCHES = 8
# Whether a trace may spread missing readings to all taxels, since its answer is missing anyway. No
# context variable: PyTorch 2.6 compiles none.
_traces_plain_products = False


class GCNNorm(NamedTuple):
    r"""How a graph convolution normalises its adjacency, as the arguments of
    :class:`~torch_geometric.nn.GCNConv`.
    """

    improved: bool = False
    add_self_loops: bool = True
    normalize: bool = True
    flow: str = "source_to_target"


# The same as a plain tuple, which a layer makes at each call.
Norm = tuple[bool, bool, bool, str]
GCN_NORM = GCNNorm()


class StaticAdjacency:
    r"""The matrix of a graph convolution :math:`(N, N)`, in the forms that products need.

    Args:
        edge_index (torch.Tensor): Sources and targets of its values :math:`(2, |\mathcal{E}|)`.
            The values of a pair that occurs twice add up.
        weight (torch.Tensor): Its values :math:`(|\mathcal{E}|,)`, also those that are zero.
        num_nodes (int): Number of taxels :math:`N`.
    """

    def __init__(self, edge_index: Tensor, weight: Tensor, num_nodes: int) -> None:
        self.num_nodes = num_nodes
        # Copies: the caller may write to edges before the transposed form is made.
        self._edges, self._weight = edge_index.clone(), weight.clone()
        # Whether products may change their order: infinity times a sum is not a sum of infinities.
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
        r"""The matrix with all its zeros :math:`(N, N)`."""
        if self._dense is None:
            with torch.inference_mode(False):
                self._dense = dense_matrix(self._edges, self._weight, self.num_nodes)
        return self._dense

    @property
    def pattern(self) -> Tensor:
        r"""One where an edge has a weight, zero elsewhere :math:`(N, N)`."""
        if self._pattern is None:
            with torch.inference_mode(False):
                self._pattern = edge_pattern(self.dense)
        return self._pattern

    def csr(self, transposed: bool = False) -> Tensor:
        r"""Returns the matrix, or the transposed one, in CSR format, computed once."""
        csr = self._csr.get(transposed)
        if csr is None:
            with torch.inference_mode(False):
                source, target = self._edges.flip(0) if transposed else self._edges
                # In the order of the edges, in which messages add up as well.
                order = target.argsort(stable=True)
                ends = target.bincount(minlength=self.num_nodes).cumsum(0)
                starts = torch.cat([ends.new_zeros(1), ends])
                csr = csr_matrix(starts, source[order], self._weight[order], self.num_nodes)
            self._csr[transposed] = csr
        return csr

    def batch_csr(self, num_samples: int, transposed: bool = False) -> Tensor:
        r"""Returns the matrix of a PyG batch of samples in CSR format :math:`(B N, B N)`, with the
        matrix of one in its blocks, computed once for the last few sizes of a batch.

        Args:
            num_samples (int): Number of samples :math:`B`.
            transposed (bool): Whether to transpose it.
        """
        if num_samples == 1:
            return self.csr(transposed)
        matrix = self._batches.get((num_samples, transposed))
        if matrix is None:
            if len(self._batches) >= _MAX_BATCHES:
                self._batches = {}  # not cleared in place: another thread may be reading it
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
        r"""Returns some rows in CSR format :math:`(S, N)`, computed once.

        Args:
            start (int): The first row.
            stop (int): The row behind the last.
        """
        rows = self._rows.get((start, stop))
        if rows is None:
            if len(self._rows) >= _MAX_ROWS:
                self._rows = {}  # not cleared in place: another thread may be reading it
            csr = self.csr()
            starts = csr.crow_indices()[start : stop + 1]
            part = slice(int(starts[0]), int(starts[-1]))
            columns, values = csr.col_indices()[part], csr.values()[part]
            rows = csr_matrix(starts - starts[0], columns, values, self.num_nodes)
            self._rows[start, stop] = rows
        return rows

    def blocks(self, group: int, nodes: Tensor) -> Tensor:
        r"""Returns the matrices of some segments of equal size, computed once for each group.

        Args:
            group (int): Number of the group.
            nodes (torch.Tensor): The taxels of each segment :math:`(S, n)`.

        Returns:
            torch.Tensor: The matrices :math:`(S, n, n)`.
        """
        if group not in self._blocks:
            with torch.inference_mode(False):  # a validation may come before the training
                self._blocks[group] = adjacency_blocks(self.dense, nodes)
        return self._blocks[group]

    def product(self, x: Tensor, transposed: bool = False) -> Tensor:
        r"""Multiplies features by the matrix or the transposed one, with gradients of any order.

        It multiplies along the edges and nowhere else, so that missing and infinite features and
        weights reach the same taxels as messages do.

        Shapes:
            - **x:** Features :math:`(\ldots, N, F)`, for which :func:`may_multiply`.
            - **output:** Sums of the same shape, with the taxels in the outermost dimension of the
              memory.
        """
        out: Tensor = _Product.apply(x, self, transposed)
        return out

    def dense_product(self, x: Tensor) -> Tensor:
        r"""Multiplies features by the matrix with all its zeros; see :func:`contained_product`.

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
    r"""Multiplies a CSR matrix by a dense one.

    Shapes:
        - **matrix:** The sparse matrix :math:`(M, N)`.
        - **h:** The dense matrix :math:`(N, K)`.
        - **output:** :math:`(M, K)`.
    """
    # With a reduction, this is PyTorch's own kernel: as fast as that of MKL, which is not on every
    # machine.
    return torch.sparse.mm(matrix, h, "sum")


def may_multiply(x: Tensor) -> bool:
    r"""Tells whether :meth:`StaticAdjacency.product` serves features: those of samples on one
    topology :math:`(\ldots, N, F)`, on a processor and in eager mode, outside of autocast and of
    the transforms of :mod:`torch.func`.
    """
    return (
        not is_traced()
        and x.dim() > 2
        and x.is_cpu
        and x.dtype in _SPARSE_TYPES
        and x.layout == torch.strided
        and x.numel() > 0
        and not torch.is_autocast_enabled("cpu")
        and not is_wrapped(x)
    )


class AdjacencyCache(EdgeCache[StaticAdjacency]):
    r"""Keeps the adjacency of the last topology."""

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
        r"""Returns the adjacency of a topology, or :obj:`None` where it must not be kept: for
        tensors that need a gradient, and while a compiler records.

        Shapes:
            - **edge_index:** Edges :math:`(2, |\mathcal{E}|)`, or a sparse matrix
              :math:`(N, N)`.
            - **edge_weight:** Their weights :math:`(|\mathcal{E}|,)`.
            - **num_nodes:** Number of taxels :math:`N`.
            - **segment:** The segment of each taxel :math:`(N,)`, always the
              same; edges between segments do not count.
        """
        traced = is_traced()
        key = (edge_index.layout, num_nodes, dtype, norm)
        tensors = () if traced else _tensors(edge_index, edge_weight)
        found = None if traced else self._found(key, tensors)
        if found is not None:
            return found
        if traced or not may_be_kept(edge_index, edge_weight):
            self._check(edge_index, num_nodes)
            check_edge_weight(edge_index, edge_weight)
            return None
        check_edge_index(edge_index, num_nodes)
        check_edge_weight(edge_index, edge_weight)

        def adjacency() -> StaticAdjacency:
            edges = self.normalize(edge_index, edge_weight, num_nodes, dtype, segment, norm)
            return StaticAdjacency(*edges, num_nodes)

        return self._keep(key, tensors, adjacency)

    def normalize(
        self,
        edge_index: Adj,
        edge_weight: OptTensor,
        num_nodes: int,
        dtype: torch.dtype,
        segment: OptTensor = None,
        norm: Norm = GCN_NORM,
    ) -> tuple[Tensor, Tensor]:
        r"""Returns the values of the matrix; see :func:`edge_norm`."""
        return edge_norm(edge_index, edge_weight, num_nodes, dtype, segment, GCNNorm(*norm))


def may_multiply_dense(x: Tensor) -> bool:
    r"""Tells whether a product of matrices is the fastest for features :math:`(\ldots, N, F)`: on
    GPUs, and in exports, for whose runtimes the matrix is a constant. A compiler on a processor
    writes a faster one from messages.
    """
    return x.size(-2) <= MAX_DENSE_NODES and (not x.is_cpu or is_exported())


def may_keep_messages(x: Tensor) -> bool:
    r"""Tells whether messages along kept edges are the fastest for features :math:`(B, N, F)`: on
    GPUs, which wait for the number of edges each time they are normalised.
    """
    return x.dim() > 2 and not x.is_cpu and not is_traced()


def message_type(x: Tensor, edge_weight: OptTensor) -> torch.dtype:
    r"""Returns the type of weighted messages, which is that of PyG's: integer weights are converted
    to the type of the features.
    """
    if edge_weight is None or not edge_weight.is_floating_point():
        return x.dtype
    return torch.promote_types(x.dtype, edge_weight.dtype)


def _tensors(edge_index: Adj, edge_weight: OptTensor) -> tuple[Tensor, ...]:
    if edge_index.layout == torch.sparse_coo:
        return edge_index._indices(), edge_index._values()
    if edge_index.layout == torch.sparse_csr:
        return edge_index.crow_indices(), edge_index.col_indices(), edge_index.values()
    return (edge_index,) if edge_weight is None else (edge_index, edge_weight)


def csr_matrix(starts: Tensor, columns: Tensor, values: Tensor, num_columns: int) -> Tensor:
    r"""Returns a sparse matrix :math:`(M, N)` in CSR format, without PyTorch's warning of it and
    without checks.

    Shapes:
        - **starts:** Where each row begins, and the end of the last :math:`(M + 1,)`.
        - **columns, values:** Its entries :math:`(K,)`, row by row.
        - **num_columns:** Number of columns :math:`N`.
    """
    size = (len(starts) - 1, num_columns)
    with warnings.catch_warnings(), torch.inference_mode(False):
        warnings.filterwarnings("ignore", message="Sparse CSR tensor support is in beta")
        return torch.sparse_csr_tensor(starts, columns, values, size, check_invariants=False)


def dense_matrix(edge_index: Tensor, weight: Tensor, num_nodes: int) -> Tensor:
    r"""Returns the matrix of targets and sources :math:`(N, N)`.

    Shapes:
        - **edge_index:** Sources and targets :math:`(2, |\mathcal{E}|)`.
        - **weight:** Their values :math:`(|\mathcal{E}|,)`, which add up.
    """
    source, target = edge_index
    return _scatter(target, source, weight, num_nodes)


def _scatter(target: Tensor, source: Tensor, weight: Tensor, num_nodes: int) -> Tensor:
    empty = weight.new_zeros(num_nodes * num_nodes)
    return empty.scatter_add(0, target * num_nodes + source, weight).view(num_nodes, num_nodes)


def edge_pattern(dense: Tensor) -> Tensor:
    r"""Returns one where a matrix is not zero, and zero elsewhere, in its type.

    Shapes:
        - **input:** a matrix :math:`(N, N)`, or several.
    """
    return (dense != 0).to(dense.dtype)


def all_finite(x: Tensor) -> Optional[bool]:
    r"""Tells whether all numbers are finite, or returns :obj:`None` where to ask costs more than
    it is worth (a GPU would wait for all that is under way) or a compiler records.

    It asks for the sum, in one pass and without memory. A sum that overflows counts as not finite.
    """
    if not x.is_cpu or is_traced():
        return None
    if x.requires_grad:
        x = x.detach()
    total = x.sum(dtype=torch.float32) if x.dtype == torch.float16 else x.sum()
    try:
        number = total.item()
    except RuntimeError:  # of `torch.func.vmap`, or of a tensor without values
        return None
    return math.isfinite(number) if isinstance(number, float) else bool(total.isfinite())


@contextmanager
def plain_products_when_traced() -> Iterator[None]:
    r"""Makes :func:`contained_product` a product of matrices alone in what is traced meanwhile: for
    graphs whose answer is NaN if any reading is missing, where containing it costs time only.
    """
    global _traces_plain_products
    before, _traces_plain_products = _traces_plain_products, True
    try:
        yield
    finally:
        _traces_plain_products = before


def contained_product(adjacency: Tensor, pattern: Tensor, x: Tensor) -> Tensor:
    r"""Multiplies features by an adjacency, such that an infinite or missing one of a taxel makes
    the sums of its neighbours NaN and leaves all others as they are. A product of matrices alone
    has it in each sum, as zero times infinity. It has no branch, so that a compiler may record it.

    Shapes:
        - **adjacency:** The matrix :math:`(N, N)`, or one for each segment.
        - **pattern:** One where it has an edge, zero elsewhere.
        - **x:** Features :math:`(\ldots, N, F)`.
    """
    if is_traced() and _traces_plain_products:
        return torch.matmul(adjacency, x)
    is_finite = x.isfinite()
    lost = (~is_finite.all(dim=-1, keepdim=True)).to(adjacency.dtype)
    is_near = torch.matmul(pattern, lost) != 0
    out = torch.matmul(adjacency, x.masked_fill(~is_finite, 0.0))
    return out.masked_fill(is_near, float("nan"))


def adjacency_blocks(dense: Tensor, nodes: Tensor) -> Tensor:
    r"""Returns the matrices of some segments of equal size.

    Shapes:
        - **dense:** The matrix of all taxels :math:`(N, N)`.
        - **nodes:** The taxels of each segment :math:`(S, n)`.
        - **returns:** torch.Tensor: The matrices :math:`(S, n, n)`.
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
    r"""Returns PyG's :func:`~torch_geometric.nn.conv.gcn_conv.gcn_norm` as sources and targets
    :math:`(2, |\mathcal{E}'|)` and their weights :math:`(|\mathcal{E}'|,)`.

    Shapes:
        - **edge_index:** Edges :math:`(2, |\mathcal{E}|)`, or a sparse matrix
          :math:`(N, N)` of targets and sources.
        - **edge_weight:** Their weights :math:`(|\mathcal{E}|,)`.
        - **num_nodes:** Number of taxels :math:`N`.
        - **segment:** The segment of each taxel :math:`(N,)`; edges between segments are left out.
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
    r"""Returns PyG's :func:`~torch_geometric.nn.conv.gcn_conv.gcn_norm` as one matrix
    :math:`(N, N)` of targets and sources.

    It drops no edges by a mask, whose result has an unknown size, so that ``torch.compile`` sees
    one graph.

    Shapes:
        - **edge_index:** Edges :math:`(2, |\mathcal{E}|)`, or a sparse matrix
          :math:`(N, N)` of targets and sources.
        - **edge_weight:** Their weights :math:`(|\mathcal{E}|,)`.
        - **num_nodes:** Number of taxels :math:`N`.
        - **segment:** The segment of each taxel :math:`(N,)`; edges between
          segments do not count.
    """
    if is_torch_sparse_tensor(edge_index) and segment is None:
        return sparse_norm(sorted_form(edge_index), num_nodes, dtype, norm).to_dense().to(dtype)
    edge_index, edge_weight = as_edges(edge_index, edge_weight)
    source, target = edge_index.long()
    if norm.flow == "target_to_source":
        source, target = target, source
    # As in PyG, where `improved` changes nothing without weights.
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
    # Edge by edge: of a negative sum, the root is NaN, which belongs to the edges that there are.
    weight = scale[target] * weight * scale[source]
    if segment is not None:
        weight = weight.masked_fill(segment[source] != segment[target], 0.0)
    adjacency = _scatter(target, source, weight, num_nodes)
    return adjacency + (scale * loop * scale).diag_embed() if add_self_loops else adjacency


def loop_weights(
    source: Tensor, is_loop: Tensor, weight: Tensor, num_nodes: int, loop_weight: float
) -> Tensor:
    r"""Returns the weights of self-loops :math:`(N,)`: those that there are keep their weight, and
    missing ones are added.

    Shapes:
        - **source:** The sources of the edges :math:`(|\mathcal{E}|,)`.
        - **is_loop:** Which edges are self-loops :math:`(|\mathcal{E}|,)`.
        - **weight:** Weights of the edges :math:`(|\mathcal{E}|,)`.
        - **num_nodes:** Number of taxels :math:`N`.
    """
    places = source.masked_fill(~is_loop, num_nodes)  # the last place takes all that is no loop
    return weight.new_full((num_nodes + 1,), loop_weight).scatter(0, places, weight)[:-1]


def sparse_norm(adj_t: Adj, num_nodes: int, dtype: torch.dtype, norm: GCNNorm) -> Tensor:
    r"""Returns a sparse adjacency as PyG normalises it, which adds a self-loop also where there is
    one.

    Shapes:
        - **adj_t:** The sparse matrix :math:`(N, N)` of targets and sources.
        - **num_nodes:** Number of taxels :math:`N`.
    """
    if not norm.normalize:
        return adj_t
    normed: Tensor = gcn_norm(
        adj_t, None, num_nodes, norm.improved, norm.add_self_loops, norm.flow, dtype
    )[0]
    return normed
