r"""Converts samples on one topology to PyG's block-diagonal batch."""

import copy
from typing import TYPE_CHECKING, Any, NamedTuple

import torch
from torch import Tensor
from torch_geometric.data import Batch, Data

if TYPE_CHECKING:
    from torch_geometric_tactile.data.static_data import StaticData

_MAX_CACHED_EDGES = 4
_MAX_CACHED_BYTES = 2**26  # of all cached edges together


# Empty batches by the class of their samples. They are copied, since PyG creates a new class for
# each batch that it constructs, which is slow.
_EMPTY_BATCHES: dict[type[Data], Batch] = {Data: Batch(_base_cls=Data)}


def to_batch(data: "StaticData") -> Batch:
    r"""Returns the batch that :meth:`~torch_geometric.data.Batch.from_data_list` builds of the
    samples, without creating a :class:`~torch_geometric.data.Data` object for each.
    """
    num_samples = data.num_samples
    numbers = torch.arange(num_samples + 1)
    sample = data.sample(0) if num_samples else _empty_sample(data)
    sample_type = data.sample_type
    if sample_type not in _EMPTY_BATCHES:
        _EMPTY_BATCHES[sample_type] = Batch(_base_cls=sample_type)
    out = copy.copy(_EMPTY_BATCHES[sample_type])
    mapping = out._store._mapping  # a dictionary, without the checks of PyG's attributes
    # PyG uses these to separate the samples of a batch again: the first row of each sample, and the
    # number that was added to its indices.
    slices: dict[str, Any] = {}
    increments: dict[str, Any] = {}
    pyg_keys = []
    for key, value in data._store._mapping.items():
        if key == "num_nodes":
            mapping[key] = value * num_samples
            out._num_nodes = [value] * num_samples
        elif type(value) is Tensor and value.layout == torch.strided:
            mapping[key], slices[key], increments[key] = _join_tensor(
                data, sample, key, value, numbers
            )
        elif isinstance(value, str):
            mapping[key] = [value] * num_samples
            slices[key], increments[key] = numbers, None
        else:
            pyg_keys.append(key)
    if pyg_keys and num_samples:
        _join_with_pyg(out, data, pyg_keys, slices, increments)
    # As in PyG, a batch has no 'batch' vector if no attribute determines the number of nodes.
    if sample._store.can_infer_num_nodes:
        num_nodes = sample.num_nodes or 0
        values = data._store._mapping.values()
        device = next((v.device for v in values if isinstance(v, Tensor)), None)
        numbers = numbers.to(device)
        mapping["batch"] = numbers[:-1].repeat_interleave(num_nodes)
        mapping["ptr"] = num_nodes * numbers
    out._num_graphs = num_samples
    out._slice_dict = slices
    out._inc_dict = increments
    return out


def _empty_sample(data: "StaticData") -> Data:
    # A sample of zeros, which has the types and shapes of an empty data set's attributes.
    out = data.sample_type()
    for key, value in data._store.items():
        if data.is_shared(key):
            out[key] = value
        else:
            sample_level = data.level(key) == "sample"
            out[key] = value.new_zeros((1, *value.shape[1:]) if sample_level else value.shape[1:])
    return out


def _join_tensor(
    data: "StaticData", sample: Data, key: str, value: Tensor, numbers: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    # The attribute in the batch, the first row of each sample in it, and the increment of each.
    # `sample` is the first sample, which has the type and shape of the others.
    sample_value: Tensor = sample[key]
    num_samples = len(numbers) - 1
    shared = data.is_shared(key)
    dim, size = 0, 1
    if sample_value.dim():
        dim = sample.__cat_dim__(key, sample_value) % sample_value.dim()
        size = sample_value.size(dim)
    if "batch" in key and not shared:
        rows = value.flatten(1) if value.dim() > 1 else value.view(-1, 1)
        counts = rows.amax(1).long().cpu() + 1
        starts = counts.cumsum(0) - counts
        has_increments = num_samples > 1 and int(starts[-1]) != 0
    else:
        step = sample.__inc__(key, sample_value)
        if step is None:  # PyG 2.6 returns None without an error
            raise RuntimeError(f"Unable to infer 'num_nodes', which '{key}' needs; please set it")
        starts = step * numbers[:-1]
        has_increments = num_samples > 1 and step != 0
        if has_increments and key == "edge_index":
            return _edges.get(value, step, num_samples), size * numbers, starts
    if shared:
        value = sample_value.expand(num_samples, *sample_value.shape)
    elif data.level(key) == "sample":
        value = value.unsqueeze(1)  # a sample of PyG has a first dimension of size one
    if has_increments:
        # A tensor without dimensions does not promote the type of another one of the same kind.
        dtype = torch.result_type(sample_value, starts[0])
        start = starts.to(dtype=dtype, device=value.device)
        value = value.to(dtype) + start.view(-1, *[1] * (value.dim() - 1))
    if sample_value.dim() == 0:
        return value.clone(), numbers, starts
    if dim > 0:
        value = value.movedim(0, dim)
    return value.flatten(dim, dim + 1), size * numbers, starts


def _join_with_pyg(
    out: Batch,
    data: "StaticData",
    keys: list[str],
    slices: dict[str, Any],
    increments: dict[str, Any],
) -> None:
    # Sparse tensors, numbers, lists and dictionaries are rare and left to PyG.
    samples = data.to_data_list() if any(not data.is_shared(key) for key in keys) else None
    parts = [data.sample(0)] * data.num_samples if samples is None else samples
    excluded = [key for key in data.keys() if key not in keys]  # noqa: SIM118
    if "num_nodes" in data or any("index" in key for key in keys):
        # PyG adds the number of nodes to indices, and reads this number from 'x'.
        excluded = [key for key in excluded if key != "x"]
    pyg_batch = Batch.from_data_list(parts, exclude_keys=excluded)
    for key in keys:
        out[key] = pyg_batch[key]
        slices[key] = pyg_batch._slice_dict[key]
        increments[key] = pyg_batch._inc_dict[key]


class _CachedEdges(NamedTuple):
    edge_index: Tensor  # a private copy, which no caller can write to
    num_nodes: int
    num_samples: int
    edges: Tensor
    version: int

    def matches(self, edge_index: Tensor, num_nodes: int, num_samples: int) -> bool:
        return (
            (self.num_nodes, self.num_samples) == (num_nodes, num_samples)
            and self.edge_index.dtype == edge_index.dtype
            and self.edge_index.device == edge_index.device
            and self.edges._version == self.version  # a caller may have written to it
            and torch.equal(self.edge_index, edge_index)
        )


class _EdgeCache:
    r"""A cache of the most recent block-diagonal edges. Building them takes longer than all other
    steps of building a batch.

    Edges are compared by their values, so that a change in place is noticed as well.
    """

    def __init__(self) -> None:
        # A tuple that is replaced, never edited, since other threads may be reading it.
        self.entries: tuple[_CachedEdges, ...] = ()

    def get(self, edge_index: Tensor, num_nodes: int, num_samples: int) -> Tensor:
        for entry in self.entries:
            if entry.matches(edge_index, num_nodes, num_samples):
                return entry.edges
        start = num_nodes * torch.arange(
            num_samples, dtype=edge_index.dtype, device=edge_index.device
        )
        edges = (edge_index.unsqueeze(1) + start.view(1, -1, 1)).flatten(1)
        if edges.is_inference():  # has no version, so that a write to it would go unnoticed
            return edges
        entry = _CachedEdges(edge_index.clone(), num_nodes, num_samples, edges, edges._version)
        entries: list[_CachedEdges] = []
        size = 0
        for candidate in (entry, *self.entries):
            size += candidate.edges.numel() * candidate.edges.element_size()
            if size <= _MAX_CACHED_BYTES and len(entries) < _MAX_CACHED_EDGES:
                entries.append(candidate)
        self.entries = tuple(entries)
        return edges


_edges = _EdgeCache()
