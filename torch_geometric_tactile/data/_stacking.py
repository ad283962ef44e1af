r"""From samples one by one to one tensor for all of them."""

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor
from torch_geometric.data import Data

from torch_geometric_tactile.data._levels import KNOWN_ATTRIBUTES, TOPOLOGY, Schema


def stack_samples(data_list: Sequence[Data], schema: Schema) -> dict[str, Any]:
    r"""Returns the attributes of many samples by their levels."""
    if len(data_list) == 0:
        raise ValueError("'data_list' must hold at least one sample (got none)")
    for i, data in enumerate(data_list):
        if not isinstance(data, Data):
            raise TypeError(
                "'data_list' must hold torch_geometric.data.Data objects, with one kind of nodes "
                f"(got {type(data).__name__} as sample {i})"
            )
    first = set(data_list[0].keys())
    for i, data in enumerate(data_list):
        keys = set(data.keys())
        for a, b, missing in ((i, 0, first - keys), (0, i, keys - first)):
            if missing:
                raise ValueError(
                    f"sample {a} must have '{min(missing)}' as sample {b} has (got none)"
                )
    return {
        key: _stack(key, [data[key] for data in data_list], schema)
        for key in data_list[0].keys()  # noqa: SIM118
    }


def _stack(key: str, values: list[Any], schema: Schema) -> Any:
    first = values[0]
    known = KNOWN_ATTRIBUTES.get(key)
    level = schema.level(key)
    declared = key in schema.node or key in schema.edge
    is_number = isinstance(first, (bool, int, float))
    if is_number and known is not None and level == "sample" and key not in schema.shared:
        return torch.tensor(values)  # as PyG's loader does
    if key in schema.shared or not isinstance(first, Tensor) or key in TOPOLOGY:
        _require_same(key, values)
        return first
    shapes = {tuple(value.shape) for value in values}
    if len(shapes) > 1:
        raise ValueError(f"all samples must have '{key}' in one shape (got {sorted(shapes)})")
    if key == "x" or declared:
        return torch.stack(values)
    if level != "sample" and known is not None:
        if first.dim() not in known.ranks:
            ranks = " or ".join(map(str, known.ranks))
            raise ValueError(
                f"'{key}' must have {ranks} dimensions in a sample (got shape "
                f"{tuple(first.shape)}); name it in '{level}' to declare another shape"
            )
        # What a sample gets is the same whether equal values are stored once or for each.
        if all(_same(value, first) for value in values):
            return first
        if first.dim() != known.ranks[-1]:
            raise ValueError(
                f"'{key}' must be named in '{level}' if it differs between samples and has "
                f"shape {tuple(first.shape)} in each"
            )
        return torch.stack(values)
    if first.dim() == 0:
        return torch.stack(values)
    if first.size(0) != 1:
        raise ValueError(
            f"'{key}' must have a first dimension of size 1 in each sample (got shape "
            f"{tuple(first.shape)}); name it in 'node' or 'edge' if it has a row for each taxel "
            "or edge, and in 'shared' if it is the same for all samples"
        )
    return torch.cat(values)


def _require_same(key: str, values: list[Any]) -> None:
    for i, value in enumerate(values):
        if not _same(value, values[0]):
            raise ValueError(
                f"sample {i} must have the same '{key}' as sample 0: one topology, many samples; "
                "use torch_geometric.data.InMemoryDataset where it differs"
            )


def _same(value: Any, first: Any) -> bool:
    if value is first:
        return True
    if not isinstance(value, Tensor) or not isinstance(first, Tensor):
        try:
            return bool(value == first)
        except (RuntimeError, ValueError):  # arrays and lists of tensors have no single answer
            return False
    if (value.shape, value.dtype, value.layout) != (first.shape, first.dtype, first.layout):
        return False
    if value.layout == torch.strided:
        return torch.equal(value, first)
    value, first = value.to_sparse_coo().coalesce(), first.to_sparse_coo().coalesce()
    return torch.equal(value.indices(), first.indices()) and torch.equal(
        value.values(), first.values()
    )
