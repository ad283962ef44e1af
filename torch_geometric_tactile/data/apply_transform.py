r"""Transforms of many samples at once."""

import copy
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import torch
from torch import Tensor
from torch_geometric.data import Data

from torch_geometric_tactile._typing import Transform
from torch_geometric_tactile.data._levels import Schema
from torch_geometric_tactile.data._transform_rules import (
    _UNKNOWN,
    flat,
    own_declaration,
    static_rule,
)
from torch_geometric_tactile.data.static_data import StaticData
from torch_geometric_tactile.data.static_rule import StaticRule

_EDGES = ("edge_index", "edge_attr", "edge_weight")


def apply_transform(transform: Transform | None, data: StaticData) -> StaticData:
    r"""Applies a transform to many samples at once. The result is that of applying it to each.

    * A transform whose class declares :obj:`supports_static = True` gets all samples in one call; a
      subclass with a :obj:`forward` of its own declares it again.
    * PyG's deterministic transforms of edges and positions
      (:class:`~torch_geometric.transforms.Distance`,
      :class:`~torch_geometric.transforms.ToUndirected`, ...), and those declared with
      :func:`~torch_geometric_tactile.transforms.static_transform`, run once if all samples share
      the attributes that they read.
    * Any other transform is called for each sample.

    Args:
        transform (callable, optional): From :class:`~torch_geometric.data.Data` to
            :class:`~torch_geometric.data.Data`.
        data (StaticData): The samples.

    Raises:
        TypeError: If the transform does not return the sample.
        ValueError: If the transform gives the samples different topologies, or writes into what
            they share.

    Examples:
        >>> from torch_geometric.transforms import ToUndirected
        >>> from torch_geometric_tactile.datasets import FakeTactileDataset
        >>> data = FakeTactileDataset(num_samples=3)[:3].data
        >>> apply_transform(ToUndirected(), data).num_samples
        3
    """
    for part in flat(transform):
        schema: Schema = data._schema
        values = data._store._mapping.items()
        shared = {key: value for key, value in values if schema.is_shared(key, value)}
        with unwritten(part, shared):
            data = _applied(part, data)
    return data


def _applied(transform: Transform, data: StaticData) -> StaticData:
    if own_declaration(transform, "supports_static"):
        out: StaticData = returned(transform, data)
        return out
    rule = static_rule(transform)
    once = _applied_once(transform, rule, data)
    if once is not None:
        return once
    if data.num_samples == 0:
        return data
    samples = [returned(transform, sample) for sample in data.to_data_list()]
    return stack_like(samples, data, rule)


@contextmanager
def unwritten(transform: Transform, stored: Mapping[str, Any]) -> Iterator[None]:
    r"""Checks that a transform, which is called within, writes into none of the tensors that a data
    set stores: they would change for all samples, and again at every access.
    """
    before = [(key, value, _version(value)) for key, value in stored.items()]
    yield
    for key, value, version in before:
        if _version(value) != version:
            raise ValueError(
                f"'transform' must leave the tensor of '{key}' as it is, which the data set keeps "
                f"(got a write into it by {transform!r}): set a new one, as in data.{key} = "
                f"data.{key} * 2, and make the data set again"
            )


def _version(value: Any) -> int:
    return value._version if isinstance(value, Tensor) and not value.is_inference() else 0


def returned(transform: Transform, data: Data, kind: type = Data) -> Any:
    r"""Returns what a transform makes of a sample."""
    out = transform(data)
    if out is None or not isinstance(out, kind):
        found = "None" if out is None else type(out).__name__
        raise TypeError(
            f"'transform' must return the sample, a Data object (got {found} from {transform!r})"
        )
    return out


def _applied_once(transform: Transform, rule: StaticRule, data: StaticData) -> StaticData | None:
    before = data.to_dict()
    if rule.reads is None or not all(data.is_shared(key) for key in rule.reads if key in before):
        return None
    sample = (data if data.num_samples else _blank(data)).sample(0)
    given = sample.to_dict()  # taken first, since a function may change `sample` itself
    found = returned(transform, sample).to_dict()
    # Transforms copy shallowly, so that an attribute that they leave alone is the same object.
    changed = {key: value for key, value in found.items() if value is not given.get(key)}
    if "x" in changed and rule.x is not None:
        changed["x"] = _widened(data.x, changed["x"], rule)
    allowed = {"x"} if rule.x is not None else set()
    allowed.update(rule.node, rule.edge, rule.shared, _EDGES)
    for key, value in changed.items():
        is_new = key == "x" or key not in before
        if not (key in allowed or not isinstance(value, Tensor) if is_new else data.is_shared(key)):
            return None  # it has other results than those declared
    out = _with_levels(copy.copy(data), rule)
    for key in before.keys() - found.keys():
        del out[key]
    # The numbers of taxels and edges first, with which the others have to agree.
    for key in sorted(changed, key=lambda key: key not in ("x", "edge_index")):
        out[key] = changed[key]
    return out


def _with_levels(data: StaticData, rule: StaticRule) -> StaticData:
    added = (*rule.node, *rule.edge, *rule.shared)
    return data.declare(node=rule.node, edge=rule.edge, shared=added) if added else data


def _blank(data: StaticData) -> StaticData:
    # One sample in place of none, so that an empty batch gets the same edges as any other.
    values = {
        key: value if data.is_shared(key) else value.new_zeros((1, *value.shape[1:]))
        for key, value in data.to_dict().items()
    }
    arguments: dict[str, Any] = values | data.schema
    return type(data)(**arguments, num_samples=1)


def _widened(x: Tensor, after: Tensor, rule: StaticRule) -> Tensor:
    columns = after if rule.x == "replace" else after[:, x.size(-1) :]
    columns = columns.expand(x.size(0), *columns.shape)
    if rule.x == "replace":
        return columns.contiguous()
    return torch.cat([x.to(after.dtype), columns], dim=-1)


def stack_like(
    samples: Sequence[Data], like: StaticData, rule: StaticRule = _UNKNOWN
) -> StaticData:
    r"""Stacks samples after a transform."""
    added = Schema.of(rule.node, rule.edge, rule.shared)
    schema = Schema.of(**like.schema).update(added).to_dict()
    return type(like).from_data_list(samples, **schema)
