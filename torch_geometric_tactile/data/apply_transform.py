r"""Applies transforms to many samples at once."""

import copy
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import torch
from torch import Tensor
from torch_geometric.data import Data

from torch_geometric_tactile._typing import Transform
from torch_geometric_tactile.data._levels import Schema
from torch_geometric_tactile.data._static_rule import StaticRule
from torch_geometric_tactile.data._transform_rules import (
    _UNKNOWN,
    flat,
    own_declaration,
    static_rule,
)
from torch_geometric_tactile.data.static_data import StaticData

_EDGES = ("edge_index", "edge_attr", "edge_weight")


def apply_transform(transform: Transform | None, data: StaticData) -> StaticData:
    r"""Applies a transform to many samples at once, with the same result as one call per sample.

    * A transform whose class declares :obj:`supports_static = True` is called once with all
      samples. A subclass that overrides :obj:`forward` must declare it again.
    * PyG's deterministic transforms of edges and positions, such as
      :class:`~torch_geometric.transforms.Distance` and
      :class:`~torch_geometric.transforms.ToUndirected`, are called once if all samples share the
      attributes that the transform reads. The same holds for transforms declared with
      :func:`~torch_geometric_tactile.transforms._static_transform`.
    * Any other transform is called for each sample.

    Args:
        transform (callable, optional): Maps a :class:`~torch_geometric.data.Data` to a
            :class:`~torch_geometric.data.Data`.
        data (StaticData): The samples.

    Raises:
        TypeError: If the transform does not return a sample.
        ValueError: If the transform gives the samples different topologies, or changes a shared
            tensor in place.

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
        with forbid_writes(part, shared):
            data = _apply_part(part, data)
    return data


def _apply_part(transform: Transform, data: StaticData) -> StaticData:
    if own_declaration(transform, "supports_static"):
        out: StaticData = call_transform(transform, data)
        return out
    rule = static_rule(transform)
    transformed = _apply_once(transform, rule, data)
    if transformed is not None:
        return transformed
    if data.num_samples == 0:
        return data
    samples = [call_transform(transform, sample) for sample in data.to_data_list()]
    return stack_like(samples, data, rule)


@contextmanager
def forbid_writes(transform: Transform, stored: Mapping[str, Any]) -> Iterator[None]:
    r"""Checks that a transform, called within the context, does not change the tensors of a data
    set in place. Such a change would affect all samples and accumulate at each access.

    Raises:
        ValueError: If a tensor was changed.
    """
    versions = [(key, value, _version(value)) for key, value in stored.items()]
    yield
    for key, value, version in versions:
        if _version(value) != version:
            raise ValueError(
                f"'transform' must not change the stored tensor of '{key}' in place (got a write "
                f"by {transform!r}): assign a new tensor, as in data.{key} = data.{key} * 2, and "
                "build the data set again"
            )


def _version(value: Any) -> int:
    return value._version if isinstance(value, Tensor) and not value.is_inference() else 0


def call_transform(transform: Transform, data: Data, return_type: type = Data) -> Any:
    r"""Calls a transform and checks the type of its output.

    Raises:
        TypeError: If the transform does not return a :obj:`return_type`.
    """
    out = transform(data)
    if out is None or not isinstance(out, return_type):
        type_name = "None" if out is None else type(out).__name__
        raise TypeError(
            f"'transform' must return the sample as a Data object (got {type_name} from "
            f"{transform!r})"
        )
    return out


def _apply_once(transform: Transform, rule: StaticRule, data: StaticData) -> StaticData | None:
    # Calls the transform for one sample, and shares the attributes that it sets. Returns None if
    # this is not possible because the samples differ in an attribute that the transform reads, or
    # the transform sets an undeclared attribute.
    before = data.to_dict()
    if rule.reads is None or not all(data.is_shared(key) for key in rule.reads if key in before):
        return None
    sample = (data if data.num_samples else _zero_sample(data)).sample(0)
    attributes = sample.to_dict()  # read before the call, which may change `sample` itself
    new_attributes = call_transform(transform, sample).to_dict()
    # Transforms copy shallowly, so that an unchanged attribute is the same object.
    changed = {
        key: value for key, value in new_attributes.items() if value is not attributes.get(key)
    }
    if "x" in changed and rule.x is not None:
        changed["x"] = _repeat_columns(data.x, changed["x"], rule)
    allowed = {"x"} if rule.x is not None else set()
    allowed.update(rule.node, rule.edge, rule.shared, _EDGES)
    for key, value in changed.items():
        is_new = key == "x" or key not in before
        if not (key in allowed or not isinstance(value, Tensor) if is_new else data.is_shared(key)):
            return None  # the transform sets an attribute that its rule does not declare
    out = _declare_levels(copy.copy(data), rule)
    for key in before.keys() - new_attributes.keys():
        del out[key]
    # 'x' and 'edge_index' first, since other attributes are checked against their sizes.
    for key in sorted(changed, key=lambda key: key not in ("x", "edge_index")):
        out[key] = changed[key]
    return out


def _declare_levels(data: StaticData, rule: StaticRule) -> StaticData:
    names = (*rule.node, *rule.edge, *rule.shared)
    return data.declare(node=rule.node, edge=rule.edge, shared=names) if names else data


def _zero_sample(data: StaticData) -> StaticData:
    # A sample of zeros, so that an empty batch gets the same edges as other batches.
    values = {
        key: value if data.is_shared(key) else value.new_zeros((1, *value.shape[1:]))
        for key, value in data.to_dict().items()
    }
    arguments: dict[str, Any] = values | data.schema
    return type(data)(**arguments, num_samples=1)


def _repeat_columns(x: Tensor, sample_x: Tensor, rule: StaticRule) -> Tensor:
    # The readings of all samples, with the columns that the transform added to one of them.
    columns = sample_x if rule.x == "replace" else sample_x[:, x.size(-1) :]
    columns = columns.expand(x.size(0), *columns.shape)
    if rule.x == "replace":
        return columns.contiguous()
    return torch.cat([x.to(sample_x.dtype), columns], dim=-1)


def stack_like(
    samples: Sequence[Data], source: StaticData, rule: StaticRule = _UNKNOWN
) -> StaticData:
    r"""Stacks samples after a transform.

    Args:
        samples (sequence of Data): The transformed samples.
        source (StaticData): The samples before the transform, whose class and schema are used.
        rule (StaticRule): The attributes that the transform adds.
    """
    new_attributes = Schema.from_names(rule.node, rule.edge, rule.shared)
    schema = Schema.from_names(**source.schema).update(new_attributes).to_dict()
    return type(source).from_data_list(samples, **schema)
