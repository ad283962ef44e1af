r"""From one topology and many samples to PyG's block-diagonal batch."""

import copy
from typing import TYPE_CHECKING, Any, NamedTuple

import torch
from torch import Tensor
from torch_geometric.data import Batch, Data

if TYPE_CHECKING:
    from torch_geometric_tactile.data.static_data import StaticData

_NUM_CACHED = 4
_BYTES_CACHED = 2**26  # of all cached edges together


# Batches by the class of their samples, of which copies are made: PyG builds a class for every one.
_EMPTY: dict[type[Data], Batch] = {Data: Batch(_base_cls=Data)}


def to_batch(data: "StaticData") -> Batch:
    r"""Returns what :meth:`~torch_geometric.data.Batch.from_data_list` makes of the samples,
    without building a :class:`~torch_geometric.data.Data` object for each.
    """
    num_samples = data.num_samples
    numbers = torch.arange(num_samples + 1)
    sample = data.sample(0) if num_samples else _empty_sample(data)
    kind = data.sample_type
    if kind not in _EMPTY:
        _EMPTY[kind] = Batch(_base_cls=kind)
    out = copy.copy(_EMPTY[kind])
    joined = out._store._mapping  # as fast as a dictionary
    # PyG takes a batch apart by these: where the values of each sample begin, and what was added.
    slices: dict[str, Any] = {}
    increments: dict[str, Any] = {}
    others = []
    for key, value in data._store._mapping.items():
        if key == "num_nodes":
            joined[key] = value * num_samples
            out._num_nodes = [value] * num_samples
        elif type(value) is Tensor and value.layout == torch.strided:
            joined[key], slices[key], increments[key] = _join(data, sample, key, value, numbers)
        elif isinstance(value, str):
            joined[key] = [value] * num_samples
            slices[key], increments[key] = numbers, None
        else:
            others.append(key)
    if others and num_samples:
        _join_others(out, data, others, slices, increments)
    # As PyG has it, a batch of which nothing tells the number of nodes gets no 'batch' vector.
    if sample._store.can_infer_num_nodes:
        num_nodes = sample.num_nodes or 0
        values = data._store._mapping.values()
        device = next((v.device for v in values if isinstance(v, Tensor)), None)
        numbers = numbers.to(device)
        joined["batch"] = numbers[:-1].repeat_interleave(num_nodes)
        joined["ptr"] = num_nodes * numbers
    out._num_graphs = num_samples
    out._slice_dict = slices
    out._inc_dict = increments
    return out


def _empty_sample(data: "StaticData") -> Data:
    out = data.sample_type()
    for key, value in data._store.items():
        if data.is_shared(key):
            out[key] = value
        else:
            sample_level = data.level(key) == "sample"
            out[key] = value.new_zeros((1, *value.shape[1:]) if sample_level else value.shape[1:])
    return out


def _join(
    data: "StaticData", sample: Data, key: str, value: Tensor, numbers: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    one: Tensor = sample[key]
    num_samples = len(numbers) - 1
    shared = data.is_shared(key)
    dim, size = 0, 1
    if one.dim():
        dim = sample.__cat_dim__(key, one) % one.dim()
        size = one.size(dim)
    if "batch" in key and not shared:
        rows = value.flatten(1) if value.dim() > 1 else value.view(-1, 1)
        steps = rows.amax(1).long().cpu() + 1
        starts = steps.cumsum(0) - steps
        moved = num_samples > 1 and int(starts[-1]) != 0
    else:
        step = sample.__inc__(key, one)
        if step is None:  # PyG 2.6 does not say so
            raise RuntimeError(f"Unable to infer 'num_nodes', which '{key}' needs; please set it")
        starts = step * numbers[:-1]
        moved = num_samples > 1 and step != 0
        if moved and key == "edge_index":
            return _edges.get(value, step, num_samples), size * numbers, starts
    if shared:
        value = one.expand(num_samples, *one.shape)
    elif data.level(key) == "sample":
        value = value.unsqueeze(1)  # a sample of PyG keeps a row of its own
    if moved:
        # A number without dimensions does not change the type of a tensor of its kind.
        dtype = torch.result_type(one, starts[0])
        start = starts.to(dtype=dtype, device=value.device)
        value = value.to(dtype) + start.view(-1, *[1] * (value.dim() - 1))
    if one.dim() == 0:
        return value.clone(), numbers, starts
    if dim > 0:
        value = value.movedim(0, dim)
    return value.flatten(dim, dim + 1), size * numbers, starts


def _join_others(
    out: Batch,
    data: "StaticData",
    keys: list[str],
    slices: dict[str, Any],
    increments: dict[str, Any],
) -> None:
    # Sparse and other kinds of tensors, numbers, lists and dictionaries: by PyG itself.
    samples = data.to_data_list() if any(not data.is_shared(key) for key in keys) else None
    parts = [data.sample(0)] * data.num_samples if samples is None else samples
    excluded = [key for key in data.keys() if key not in keys]  # noqa: SIM118
    if "num_nodes" in data or any("index" in key for key in keys):
        excluded = [key for key in excluded if key != "x"]  # PyG adds the number of nodes
    joined = Batch.from_data_list(parts, exclude_keys=excluded)
    for key in keys:
        out[key] = joined[key]
        slices[key] = joined._slice_dict[key]
        increments[key] = joined._inc_dict[key]


class _Entry(NamedTuple):
    edge_index: Tensor  # a copy that nobody else writes to
    num_nodes: int
    num_samples: int
    edges: Tensor
    version: int

    def fits(self, edge_index: Tensor, num_nodes: int, num_samples: int) -> bool:
        return (
            (self.num_nodes, self.num_samples) == (num_nodes, num_samples)
            and self.edge_index.dtype == edge_index.dtype
            and self.edge_index.device == edge_index.device
            and self.edges._version == self.version  # a caller may have written to it
            and torch.equal(self.edge_index, edge_index)
        )


class _EdgeCache:
    r"""The last few block-diagonal edges. Building them costs more than all else of a batch.

    Edges are compared by their numbers, so that it does not matter who changed them, and how.
    """

    def __init__(self) -> None:
        self.entries: tuple[_Entry, ...] = ()  # replaced, not edited: threads may read

    def get(self, edge_index: Tensor, num_nodes: int, num_samples: int) -> Tensor:
        for entry in self.entries:
            if entry.fits(edge_index, num_nodes, num_samples):
                return entry.edges
        start = num_nodes * torch.arange(
            num_samples, dtype=edge_index.dtype, device=edge_index.device
        )
        edges = (edge_index.unsqueeze(1) + start.view(1, -1, 1)).flatten(1)
        if edges.is_inference():  # has no version
            return edges
        entry = _Entry(edge_index.clone(), num_nodes, num_samples, edges, edges._version)
        entries: list[_Entry] = []
        size = 0
        for kept in (entry, *self.entries):
            size += kept.edges.numel() * kept.edges.element_size()
            if size <= _BYTES_CACHED and len(entries) < _NUM_CACHED:
                entries.append(kept)
        self.entries = tuple(entries)
        return edges


_edges = _EdgeCache()
