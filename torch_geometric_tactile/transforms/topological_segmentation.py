r"""Segmentation of a graph, such as by the digits of a hand."""

import copy
from collections.abc import Callable, Sequence, Set
from typing import Any

import torch
from torch import Tensor
from torch_geometric.data import Batch, Data
from torch_geometric.data.datapipes import functional_transform

from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.sensors import TaxelLayout
from torch_geometric_tactile.transforms._attributes import EDGES, check_num_taxels, require
from torch_geometric_tactile.transforms._segments import repeat_rows, segment_numbers
from torch_geometric_tactile.transforms.tactile_transform import TactileTransform

_NEW_ATTRIBUTES = ("segment_batch", "edge_is_within")


@functional_transform("topological_segmentation")
class TopologicalSegmentation(TactileTransform):
    r"""Divides the taxels into segments, such as the digits of a hand, and removes the edges
    between segments (functional name: :obj:`topological_segmentation`).

    The method is from the "Multifingered Object Recognition with Tactile Sensors and Graph
    Convolutional Networks using Topological Graph Segmentation" paper: :obj:`"digit"` is its
    method I, and :obj:`"patch"` its method II.

    .. math::
        \mathcal{E}' = \{ (j, i) \in \mathcal{E} : s_j = s_i \}

    The segments :math:`s` are stored as :obj:`segment_batch`. In a batch of PyG's
    :class:`~torch_geometric.loader.DataLoader`, segments of different samples have different
    numbers, so that :obj:`segment_batch` can be used as the :obj:`batch` of a pooling layer.
    :meth:`split` returns the segments one by one.

    Args:
        by (str or sequence of int): The segments: :obj:`"digit"` or :obj:`"patch"` of the layout,
            or an integer for each taxel :math:`(N,)`. Segments are numbered from zero without gaps,
            in the order of these integers.
        layout (TaxelLayout or str or PathLike, optional): The taxels: a layout, the name of a
            layout of this package, or a layout file; required for :obj:`"digit"` and
            :obj:`"patch"`.
        drop (bool): If :obj:`True`, edges between segments are removed, with their :obj:`edge_attr`
            and :obj:`edge_weight`. Otherwise, all edges are kept, and :obj:`edge_is_within` is true
            for edges within a segment.

    Shapes:
        - **input:** :obj:`edge_index` :math:`(2, |\mathcal{E}|)`, :obj:`edge_attr`
          :math:`(|\mathcal{E}|, D)` or :math:`(B, |\mathcal{E}|, D)`
        - **output:** :obj:`segment_batch` :math:`(N,)`, shared by the samples of
          :class:`~torch_geometric_tactile.data.StaticData`, or :math:`(B \cdot N,)` for a PyG
          batch; :obj:`edge_index` :math:`(2, |\mathcal{E}'|)`, or booleans :obj:`edge_is_within`
          :math:`(|\mathcal{E}|,)`

    Raises:
        ValueError: If :obj:`by` is invalid or requires a layout, there are no edges, or a sample
            has the wrong number of taxels.

    Examples:
        >>> edge_index = torch.tensor([[0, 1, 1, 2], [1, 0, 2, 1]])
        >>> transform = TopologicalSegmentation([0, 0, 1])
        >>> data = transform(Data(x=torch.ones(3, 1), edge_index=edge_index))
        >>> data.segment_batch, data.edge_index.tolist()
        (tensor([0, 0, 1]), [[0, 1], [1, 0]])
        >>> transform.split(data)
        [Data(x=[2, 1], edge_index=[2, 2]), Data(x=[1, 1], edge_index=[2, 0])]
    """

    reads = (*EDGES, "edge_is_within")
    writes = (*EDGES, "segment_batch", "edge_is_within")
    per_frame = True

    def __init__(
        self,
        by: str | Sequence[int] | Tensor,
        layout: TaxelLayout | PathLike | None = None,
        drop: bool = True,
    ) -> None:
        self.by = by if isinstance(by, str) else "numbers"
        self.layout = layout
        self.drop = drop
        self.segment = segment_numbers(by, layout, "by")  # (N,), from zero without gaps
        self.num_segments = int(self.segment.max()) + 1

    def arguments(self) -> dict[str, Any]:
        r"""Returns the arguments of the constructor, in which segments are numbered from zero."""
        by = self.segment if self.by == "numbers" else self.by
        return {"by": by, "layout": self.layout, "drop": self.drop}

    def forward(self, data: Data) -> Data:
        r"""Sets :obj:`segment_batch`, and :obj:`edge_index` or :obj:`edge_is_within`."""
        edge_index, segment = self._checked(data)
        num_samples = data.num_graphs if isinstance(data, Batch) else 1
        shift = self.num_segments * torch.arange(num_samples, device=segment.device)
        source, target = edge_index
        is_within = segment[source] == segment[target]
        if self.drop:
            if "edge_is_within" in data:
                del data["edge_is_within"]
            edges = is_within.nonzero().view(-1)
            counts = _count_edges(data, source[edges])
            dims = _row_dims(data, "edge", edge_index.size(1))
            data.edge_index = edge_index[:, edges]
            _update_slices(data, "edge_index", counts)
            for key, dim in dims.items():
                data[key] = data[key].index_select(dim, edges)
                _update_slices(data, key, counts)
        else:
            data.edge_is_within = is_within
            _update_slices(data, "edge_is_within", _count_edges(data, source))
        data.segment_batch = segment + repeat_rows(shift, len(self.segment))
        taxels = torch.full((num_samples,), len(self.segment))
        _update_slices(data, "segment_batch", taxels, self.num_segments)
        return data

    def split(self, data: Data) -> list[Data]:
        r"""Returns each segment as a separate object of the same class as :obj:`data`. A segment
        has its taxels, numbered from zero, and the edges between them.

        Attributes with a row for each taxel or edge are divided; all other attributes are copied to
        each segment unchanged. :class:`~torch_geometric_tactile.data.StaticData` declares the level
        of each attribute. In other data, an attribute is divided if it has as many rows as there
        are taxels (or edges, if its name contains :obj:`edge`), except the angles :obj:`joint`.

        Args:
            data (torch_geometric.data.Data): The data, before or after the transform.

        Raises:
            ValueError: If there are no edges, or a sample has the wrong number of taxels.
        """
        edge_index, segment = self._checked(data)
        return [self._cut(data, edge_index, segment == k) for k in range(self.num_segments)]

    def _checked(self, data: Data) -> tuple[Tensor, Tensor]:
        edge_index = require(self, data, "edge_index")
        check_num_taxels(data, len(self.segment), "the segmentation")
        segment = self.segment.to(edge_index.device)
        return edge_index, segment.repeat(data.num_graphs) if isinstance(data, Batch) else segment

    def _cut(self, data: Data, edge_index: Tensor, mask: Tensor) -> Data:
        # The taxels in the mask and the edges between them.
        part = copy.copy(data)
        for key in _NEW_ATTRIBUTES:
            if key in part:
                del part[key]
        taxels = mask.nonzero().view(-1)
        source, target = edge_index
        # Both ends of an edge belong to the same graph of a batch, so edges within a segment stay
        # within a sample.
        edges = (mask[source] & mask[target]).nonzero().view(-1)
        num_graphs = data.num_graphs if isinstance(data, Batch) else 1
        num_taxels = len(taxels) // max(1, num_graphs)
        counts = torch.full((num_graphs,), num_taxels)
        for key, dim in _row_dims(part, "node", len(mask)).items():
            part[key] = part[key].index_select(dim, taxels)
            _update_slices(part, key, counts)
        edge_counts = _count_edges(data, source[edges])
        dims = _row_dims(part, "edge", edge_index.size(1))
        new_number = mask.long().cumsum(0) - 1
        part.edge_index = new_number[edge_index[:, edges]]
        _update_slices(part, "edge_index", edge_counts, num_taxels)
        for key, dim in dims.items():
            part[key] = part[key].index_select(dim, edges)
            _update_slices(part, key, edge_counts)
        if "num_nodes" in part:
            part.num_nodes = len(taxels)
            if isinstance(part, Batch):
                part._num_nodes = counts.tolist()
        if isinstance(part, Batch):
            part.batch = data.batch[taxels]
            part.ptr = num_taxels * torch.arange(num_graphs + 1, device=data.ptr.device)
        return part

    def graph_step(
        self, constants: StaticData, changing: Set[str]
    ) -> Callable[[StaticData], StaticData]:
        r"""Returns a step with a fixed selection of edges if all frames have the same edges."""
        return self if "edge_index" in changing else _SegmentationStep(self, constants)

    def __repr__(self) -> str:
        by = self.by if self.by == "numbers" else f"'{self.by}'"
        return f"{type(self).__name__}({by}, num_segments={self.num_segments}, drop={self.drop})"


def _row_dims(data: Data, level: str, num_rows: int) -> dict[str, int]:
    # Returns the dimension that holds the rows of each attribute of a level, "node" or "edge".
    dims = {}
    for key, value in data.to_dict().items():
        if not isinstance(value, Tensor) or key in ("edge_index", "adj", "adj_t", *_NEW_ATTRIBUTES):
            continue
        if isinstance(data, StaticData):
            if data.level(key) == level:
                dims[key] = 0 if data.is_shared(key) else 1
        # In PyG, the names of attributes with indices contain 'index' or 'face'.
        elif key not in ("joint", "batch", "ptr") and "index" not in key and "face" not in key:
            size = value.size(0) if value.dim() else None
            if size == num_rows and ("edge" in key) == (level == "edge"):
                dims[key] = 0
    return dims


def _count_edges(data: Data, source: Tensor) -> Tensor:
    if not isinstance(data, Batch):
        return torch.tensor([len(source)])
    counts: Tensor = data.batch[source].bincount(minlength=data.num_graphs).cpu()
    return counts


def _update_slices(data: Data, key: str, counts: Tensor, increment: int | None = None) -> None:
    # PyG stores the first row of each sample in each attribute to separate the samples of a batch.
    # These rows must be updated when the number of rows changes.
    if not isinstance(data, Batch) or not hasattr(data, "_slice_dict"):
        return
    start = torch.nn.functional.pad(counts.cumsum(0), (1, 0))
    data._slice_dict = {**data._slice_dict, key: start}
    if increment is not None or key not in data._inc_dict:
        shift = (increment or 0) * torch.arange(len(counts))
        data._inc_dict = {**data._inc_dict, key: shift}


class _SegmentationStep:
    r"""The step of :class:`TopologicalSegmentation` in an exported graph. The edges are selected in
    advance, since their number must not depend on values.
    """

    is_same_for_all = True  # sets the same values for all frames

    def __init__(self, part: TopologicalSegmentation, constants: StaticData) -> None:
        source, target = constants.edge_index
        is_within = part.segment[source] == part.segment[target]
        self.edges = is_within.nonzero().view(-1)
        self.num_edges = constants.edge_index.size(1)
        self.segment = part.segment
        self.is_within = None if part.drop else is_within
        self.edge_index = constants.edge_index[:, self.edges] if part.drop else constants.edge_index

    def __call__(self, data: StaticData) -> StaticData:
        rows = {}
        if self.is_within is None:
            for key, value in data.to_dict().items():
                if key != "edge_index" and isinstance(value, Tensor) and data.level(key) == "edge":
                    rows[key] = value.index_select(0 if data.is_shared(key) else 1, self.edges)
        for key in ("edge_is_within", *rows):
            if key in data:
                del data[key]
        data.edge_index = self.edge_index
        for key, value in rows.items():
            data[key] = value
        if self.is_within is not None:
            data.edge_is_within = self.is_within
        data.segment_batch = self.segment
        return data
