r"""A transform on many samples at once is the transform of each."""

from collections.abc import Callable
from typing import Any

from torch import Tensor
from torch_geometric.data import Batch, Data

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.testing._compare import assert_equal_numbers


def assert_transform_static_equals_batched(
    transform: Callable[[Any], Any], data: StaticData, atol: float = 1e-5
) -> None:
    r"""Asserts that a transform gives the same attributes on
    :class:`~torch_geometric_tactile.data.StaticData`, sample by sample, and on PyG's block-diagonal
    batch. What declares :obj:`supports_static = True` must keep this law.

    Args:
        transform (callable): The transform, fitted.
        data (StaticData): The samples.
        atol (float): The difference that is allowed.

    Raises:
        AssertionError: If an attribute is missing, superfluous or has other numbers.
        ValueError: If :obj:`data` holds no sample.

    Examples:
        >>> import torch
        >>> from torch_geometric_tactile.sensors import grid
        >>> from torch_geometric_tactile.transforms import KNNGraph
        >>> data = StaticData(x=torch.randn(5, 6, 3), pos=grid(2, 3, pitch=0.002).pos)
        >>> assert_transform_static_equals_batched(KNNGraph(k=2), data)
    """
    need(data.num_samples != 0, "'data' must hold at least one sample (got none)")
    name = type(transform).__name__
    static = transform(data).to_data_list()
    for i, expected in enumerate(static):
        law = f"{name} must give on StaticData what it gives on sample {i}"
        _assert_same_attributes(law, transform(data.sample(i)), expected, atol)
    law = f"{name} must give on PyG's batch what it gives on StaticData"
    batch = transform(Batch.from_data_list(data.to_data_list()))
    _assert_same_attributes(law, batch, Batch.from_data_list(static), atol)


def _assert_same_attributes(law: str, found: Data, expected: Data, atol: float) -> None:
    # PyG's empty slots (`edge_attr=None`) are no attributes.
    found_keys, expected_keys = (
        {key for key, value in data.to_dict().items() if value is not None}
        for data in (found, expected)
    )
    if found_keys != expected_keys:
        raise AssertionError(
            f"{law}: the attributes differ, {sorted(found_keys)} and {sorted(expected_keys)}"
        )
    for key in sorted(found_keys):
        value, other = found[key], expected[key]
        if isinstance(value, Tensor) and isinstance(other, Tensor):
            assert_equal_numbers(f"{law}, in '{key}'", value, other, atol)
        elif isinstance(value, Tensor) or isinstance(other, Tensor) or value != other:
            raise AssertionError(f"{law}, in '{key}': {value!r} and {other!r} differ")
