r"""Edges of one topology, sorted and indexed for attention over neighbours."""

from typing import NamedTuple, Optional

import torch
from torch import Tensor
from torch_geometric.utils import add_self_loops, remove_self_loops

from torch_geometric_tactile.nn.conv._edge_cache import EdgeCache, is_cacheable
from torch_geometric_tactile.nn.conv._edge_checks import check_edge_index
from torch_geometric_tactile.nn.conv._static_adjacency import csr_matrix

# A softmax over neighbours pads all nodes to the largest degree. If the padded size exceeds this
# multiple of the number of edges (for example, if one hub is a neighbour of all nodes), the padding
# costs more than messages.
_MAX_PADDING_RATIO = 4
# Maximum number of attention coefficients in one product. Larger batches are split, which limits
# the memory of the cached indices.
_MAX_COEFFICIENTS = 2**20
# Cached batch sizes per topology. Training, its last batch and validation have different batch
# sizes.
_MAX_PATTERNS = 8


class AttentionPattern(NamedTuple):
    r"""Indices of a sparse matrix of attention coefficients for all samples and heads of a batch.

    The :math:`R = B \cdot N \cdot H` rows are targets and the columns are sources. Each row and
    column is a node of one sample and head, in the order of contiguous features
    :math:`(B, N, H, C)`. The coefficients are indexed in three orders: by row, as in CSR matrices;
    by column, for the transposed product; and in slots :math:`(K, R)`, where slot :math:`(k, r)` is
    the :math:`k`-th neighbour of row :math:`r` and :math:`K` is the largest degree.
    """

    num_slots: int  # K
    row_starts: Tensor  # (R + 1,)
    columns: Tensor  # (coefficients,), the source of each coefficient
    column_starts: Tensor  # (R + 1,)
    rows_by_column: Tensor  # (coefficients,), the targets, sorted by source
    by_column: Tensor  # (coefficients,), indices of coefficients, sorted by source
    slots: Tensor  # (coefficients,), the slot of each coefficient
    slot_coefficients: Tensor  # (K * R,), the coefficient of each slot
    slot_columns: Tensor  # (K * R,), the source of each slot
    padding: Optional[Tensor]  # (K, R), slots that the softmax masks, or None if there are none
    empty: Optional[Tensor]  # (K, R), `padding` and all slots of rows without neighbours
    matrix: Tensor  # CSR (R, R), its values are not used
    edge_coefficients: Tensor  # (B * E * H,), the coefficient of each edge (B, E, H)
    edge_slots: Tensor  # (B * E * H,), the slot of each edge (B, E, H)
    slot_edges: Tensor  # (K * R,), the index of each slot's edge in (B, E, H)


class EdgeBlock(NamedTuple):
    r"""Edges of several samples as one disjoint graph, sorted by target."""

    source: Tensor  # (E,)
    target: Tensor  # (E,)
    by_source: Tensor  # (E,), indices of edges, sorted by source
    source_starts: Tensor  # (N + 1,), start of each node's edges in `by_source`
    by_target: Tensor  # (E,), indices of edges, sorted by target
    target_starts: Tensor  # (N + 1,), start of each node's edges in `by_target`


class AttentionEdges:
    r"""The edges of one topology, sorted by target, with cached indices for each batch size.

    Args:
        source (torch.Tensor): Sources :math:`(|\mathcal{E}|,)`.
        target (torch.Tensor): Targets :math:`(|\mathcal{E}|,)`.
        num_nodes (int): Number of nodes :math:`N`.
    """

    def __init__(self, source: Tensor, target: Tensor, num_nodes: int) -> None:
        order = target.argsort(stable=True)
        self.source, self.target = source[order], target[order]
        self.num_nodes = num_nodes
        self.degree = torch.bincount(self.target, minlength=num_nodes)
        self.max_degree = int(self.degree.max()) if num_nodes > 0 else 0
        self._patterns: dict[tuple[int, int, torch.dtype], AttentionPattern] = {}
        self._blocks: dict[int, EdgeBlock] = {}

    @property
    def num_edges(self) -> int:
        r"""Number of edges, including self-loops."""
        return self.source.numel()

    @property
    def has_little_padding(self) -> bool:
        r"""Whether there are edges and the degrees are similar enough that padding costs little."""
        return 0 < self.max_degree * self.num_nodes <= _MAX_PADDING_RATIO * self.num_edges

    def max_samples(self, heads: int) -> int:
        r"""Returns the maximum number of samples in one product.

        Args:
            heads (int): Number of heads.
        """
        return max(1, _MAX_COEFFICIENTS // (self.max_degree * self.num_nodes * heads))

    def pattern(self, num_samples: int, heads: int, dtype: torch.dtype) -> AttentionPattern:
        r"""Returns the indices for batches of one size, and caches them.

        Args:
            num_samples (int): Number of samples :math:`B`.
            heads (int): Number of heads :math:`H`.
            dtype (torch.dtype): Data type of the coefficients.
        """
        key = (num_samples, heads, dtype)
        pattern = self._patterns.get(key)
        if pattern is None:
            # Inference tensors, for example from a validation before training, cannot be used in
            # training.
            with torch.inference_mode(False):
                pattern = self._compute_pattern(num_samples, heads, dtype)
            if len(self._patterns) >= _MAX_PATTERNS:
                self._patterns = {}  # replaced, not cleared: another thread may be reading it
            self._patterns[key] = pattern
        return pattern

    def block(self, num_samples: int) -> EdgeBlock:
        r"""Returns the edges of several samples as one disjoint graph, and caches them.

        Args:
            num_samples (int): Number of samples :math:`b`.
        """
        block = self._blocks.get(num_samples)
        if block is None:
            with torch.inference_mode(False):
                source, target = self._repeat(num_samples)
                num_nodes = num_samples * self.num_nodes
                block = EdgeBlock(
                    source,
                    target,
                    source.argsort(stable=True),
                    _starts(source, num_nodes),
                    torch.arange(target.numel()),
                    _starts(target, num_nodes),
                )
            if len(self._blocks) >= _MAX_PATTERNS:
                self._blocks = {}
            self._blocks[num_samples] = block
        return block

    def _repeat(self, num_samples: int) -> tuple[Tensor, Tensor]:
        offset = self.num_nodes * torch.arange(num_samples).view(-1, 1)
        return (self.source + offset).view(-1), (self.target + offset).view(-1)

    def _compute_pattern(
        self, num_samples: int, heads: int, dtype: torch.dtype
    ) -> AttentionPattern:
        source, target = self._repeat(num_samples)
        head = torch.arange(heads)
        num_rows = num_samples * self.num_nodes * heads
        rows = (target.view(-1, 1) * heads + head).view(-1)  # (B, E, H)
        columns = (source.view(-1, 1) * heads + head).view(-1)
        # The stable sort keeps the order of the edges within each row.
        coefficient_edges = rows.argsort(stable=True)
        edge_coefficients = coefficient_edges.argsort()
        rows, columns = rows[coefficient_edges], columns[coefficient_edges]
        row_starts = _starts(rows, num_rows)
        coefficients = torch.arange(rows.numel())
        slots = (coefficients - row_starts[rows]) * num_rows + rows
        # An empty slot refers to the first neighbour of its row, since a missing reading of this
        # neighbour makes the row NaN anyway. The slots of rows without neighbours are never read.
        first_coefficients = row_starts[:-1].clamp(max=rows.numel() - 1)
        slot_coefficients = first_coefficients.repeat(self.max_degree)
        slot_coefficients[slots] = coefficients
        empty = torch.ones(self.max_degree, num_rows, dtype=torch.bool)
        empty.view(-1)[slots] = False
        padding = empty & (row_starts.diff() > 0)
        by_column = columns.argsort(stable=True)
        return AttentionPattern(
            num_slots=self.max_degree,
            row_starts=row_starts,
            columns=columns,
            column_starts=_starts(columns, num_rows),
            rows_by_column=rows[by_column],
            by_column=by_column,
            slots=slots,
            slot_coefficients=slot_coefficients,
            slot_columns=columns[slot_coefficients],
            padding=padding if bool(padding.any()) else None,
            empty=empty if bool(empty.any()) else None,
            matrix=csr_matrix(row_starts, columns, torch.ones(len(columns), dtype=dtype), num_rows),
            edge_coefficients=edge_coefficients,
            edge_slots=slots[edge_coefficients],
            slot_edges=coefficient_edges[slot_coefficients],
        )


class AttentionCache(EdgeCache[AttentionEdges]):
    r"""A cache that holds the sorted edges of the last topology."""

    def get(
        self, edge_index: Tensor, num_nodes: int, self_loops: bool, flow: str
    ) -> Optional[AttentionEdges]:
        r"""Returns the sorted edges of a topology, or :obj:`None` if they may not be cached.

        Args:
            edge_index (torch.Tensor): Edges :math:`(2, |\mathcal{E}|)`.
            num_nodes (int): Number of nodes :math:`N`.
            self_loops (bool): Whether to replace all self-loops by exactly one for each node, as
                PyG does.
            flow (str): Direction of messages, as in
                :class:`torch_geometric.nn.MessagePassing`.
        """
        key = (num_nodes, self_loops, flow)
        edges = self._lookup(key, (edge_index,))
        if edges is not None or not is_cacheable(edge_index):
            return edges
        check_edge_index(edge_index, num_nodes)

        def sort_edges() -> AttentionEdges:
            long_edges = edge_index.long()
            if self_loops:
                long_edges = add_self_loops(remove_self_loops(long_edges)[0], num_nodes=num_nodes)[
                    0
                ]
            source, target = long_edges if flow == "source_to_target" else long_edges.flip(0)
            return AttentionEdges(source, target, num_nodes)

        return self._store(key, (edge_index,), sort_edges)


def _starts(indices: Tensor, size: int) -> Tensor:
    # Returns the position of the first entry of each index after sorting (size + 1,).
    counts = torch.bincount(indices, minlength=size)
    return torch.cat([counts.new_zeros(1), counts.cumsum(0)])
