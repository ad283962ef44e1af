r"""The edges of one topology in the orders that attention over neighbours needs, computed once."""

from typing import NamedTuple, Optional

import torch
from torch import Tensor
from torch_geometric.utils import add_self_loops, remove_self_loops

from torch_geometric_tactile.nn.conv._edge_cache import EdgeCache, may_be_kept
from torch_geometric_tactile.nn.conv._edge_checks import check_edge_index
from torch_geometric_tactile.nn.conv._static_adjacency import csr_matrix

# A softmax over neighbours pads all nodes to the largest degree. Beyond this multiple of the edges,
# as with a hub that all nodes join, the padding costs more than messages do.
_MAX_PADDING = 4
# Attention coefficients of one product: larger batches are split, which bounds the cached indices.
_MAX_COEFFICIENTS = 2**20
# Batch sizes for which one topology keeps its indices: of training, its last batch, and validation.
_MAX_PATTERNS = 8


class AttentionPattern(NamedTuple):
    r"""Indices of a sparse matrix of attention coefficients, of all samples and heads of a batch.

    Its :math:`R = B \cdot N \cdot H` rows are targets and its columns sources, each a node of one
    sample and head, in the order of contiguous features :math:`(B, N, H, C)`. Its coefficients have
    three orders: by rows, as CSR matrices need; by columns, for the transposed product; and as
    slots :math:`(K, R)`, one row of slots for each neighbour up to the largest degree :math:`K`.
    """

    num_slots: int  # K
    row_starts: Tensor  # (R + 1,)
    columns: Tensor  # (coefficients,), the source of each coefficient
    column_starts: Tensor  # (R + 1,)
    rows_by_column: Tensor  # (coefficients,), the targets, ordered by source
    by_column: Tensor  # (coefficients,), numbers of coefficients, ordered by source
    slots: Tensor  # (coefficients,), the slot of each coefficient
    slot_coefficients: Tensor  # (K * R,), the coefficient of each slot
    slot_columns: Tensor  # (K * R,), the source of each slot
    padding: Optional[Tensor]  # (K, R), which slots a softmax leaves out, if any
    empty: Optional[Tensor]  # (K, R), the same and all slots of rows without neighbours
    matrix: Tensor  # CSR (R, R), its values are not used
    edge_coefficients: Tensor  # (B * E * H,), the coefficient of each edge (B, E, H)
    edge_slots: Tensor  # (B * E * H,), the slot of each edge (B, E, H)
    slot_edges: Tensor  # (K * R,), the place of each slot in (B, E, H)


class EdgeBlock(NamedTuple):
    r"""Edges of one disjoint graph, sorted by their targets."""

    source: Tensor  # (E,)
    target: Tensor  # (E,)
    by_source: Tensor  # (E,), numbers of edges, ordered by source
    source_starts: Tensor  # (N + 1,)
    by_target: Tensor  # (E,), numbers of edges, ordered by target
    target_starts: Tensor  # (N + 1,)


class AttentionEdges:
    r"""The edges of one topology with self-loops, sorted by their targets.

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
        r"""Number of edges, self-loops included."""
        return self.source.numel()

    @property
    def is_padded_cheaply(self) -> bool:
        r"""Whether there are edges, and their targets have similar numbers of neighbours."""
        return 0 < self.max_degree * self.num_nodes <= _MAX_PADDING * self.num_edges

    def max_samples(self, heads: int) -> int:
        r"""Returns how many samples one product takes.

        Args:
            heads (int): Number of heads.
        """
        return max(1, _MAX_COEFFICIENTS // (self.max_degree * self.num_nodes * heads))

    def pattern(self, num_samples: int, heads: int, dtype: torch.dtype) -> AttentionPattern:
        r"""Returns the indices for batches of one size, computed once.

        Args:
            num_samples (int): Number of samples :math:`B`.
            heads (int): Number of heads :math:`H`.
            dtype (torch.dtype): Type of the coefficients.
        """
        key = (num_samples, heads, dtype)
        pattern = self._patterns.get(key)
        if pattern is None:
            with torch.inference_mode(False):  # a validation may come before the training
                pattern = self._make_pattern(num_samples, heads, dtype)
            if len(self._patterns) >= _MAX_PATTERNS:
                self._patterns = {}  # not cleared in place: another thread may be reading it
            self._patterns[key] = pattern
        return pattern

    def block(self, num_samples: int) -> EdgeBlock:
        r"""Returns the edges of some samples as those of one disjoint graph, computed once.

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
        shift = self.num_nodes * torch.arange(num_samples).view(-1, 1)
        return (self.source + shift).view(-1), (self.target + shift).view(-1)

    def _make_pattern(self, num_samples: int, heads: int, dtype: torch.dtype) -> AttentionPattern:
        source, target = self._repeat(num_samples)
        head = torch.arange(heads)
        num_rows = num_samples * self.num_nodes * heads
        rows = (target.view(-1, 1) * heads + head).view(-1)  # (B, E, H)
        columns = (source.view(-1, 1) * heads + head).view(-1)
        # Stable, so that the coefficients of a row keep the order of its edges.
        coefficient_edges = rows.argsort(stable=True)
        edge_coefficients = coefficient_edges.argsort()
        rows, columns = rows[coefficient_edges], columns[coefficient_edges]
        row_starts = _starts(rows, num_rows)
        coefficients = torch.arange(rows.numel())
        slots = (coefficients - row_starts[rows]) * num_rows + rows
        # An empty slot repeats the first neighbour of its row: whatever a missing reading does
        # there, it does to the row anyway. A row without neighbours has slots that nothing reads.
        first = row_starts[:-1].clamp(max=rows.numel() - 1)
        slot_coefficients = first.repeat(self.max_degree)
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
    r"""Keeps the sorted edges of the last topology."""

    def get(
        self, edge_index: Tensor, num_nodes: int, self_loops: bool, flow: str
    ) -> Optional[AttentionEdges]:
        r"""Returns the edges of a topology, or :obj:`None` where they must not be kept.

        Shapes:
            - **edge_index:** Edges :math:`(2, |\mathcal{E}|)`.
            - **num_nodes:** Number of nodes :math:`N`.
            - **self_loops:** Whether to replace the self-loops by one for each node, as PyG does.
            - **flow:** As in :class:`torch_geometric.nn.MessagePassing`.
        """
        key = (num_nodes, self_loops, flow)
        edges = self._found(key, (edge_index,))
        if edges is not None or not may_be_kept(edge_index):
            return edges
        check_edge_index(edge_index, num_nodes)

        def make() -> AttentionEdges:
            joined = edge_index.long()
            if self_loops:
                joined = add_self_loops(remove_self_loops(joined)[0], num_nodes=num_nodes)[0]
            source, target = joined if flow == "source_to_target" else joined.flip(0)
            return AttentionEdges(source, target, num_nodes)

        return self._keep(key, (edge_index,), make)


def _starts(numbers: Tensor, size: int) -> Tensor:
    # Where the entries of each number begin, once they are sorted.
    counts = torch.bincount(numbers, minlength=size)
    return torch.cat([counts.new_zeros(1), counts.cumsum(0)])
