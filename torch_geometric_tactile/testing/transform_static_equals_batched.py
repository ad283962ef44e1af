r"""Asserts that a transform returns the same attributes for static and single samples."""

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
    r"""Asserts that a transform returns the same attributes for
    :class:`~torch_geometric_tactile.data.StaticData`, for each sample, and for PyG's block-diagonal
    batch. A transform with :obj:`supports_static = True` must satisfy this law.

    Args:
        transform (callable): The fitted transform.
        data (StaticData): The samples.
        atol (float): The largest allowed difference.

    Raises:
        AssertionError: If an attribute is missing, superfluous or differs.
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
        law = f"{name} must give the same attributes on StaticData as on sample {i}"
        _assert_same_attributes(law, transform(data.sample(i)), expected, atol)
    law = f"{name} must give the same attributes on PyG's batch as on StaticData"
    batch = transform(Batch.from_data_list(data.to_data_list()))
    _assert_same_attributes(law, batch, Batch.from_data_list(static), atol)


def _assert_same_attributes(law: str, actual: Data, expected: Data, atol: float) -> None:
    # PyG's empty attributes (`edge_attr=None`) are ignored.
    actual_keys, expected_keys = (
        {key for key, actual_value in data.to_dict().items() if actual_value is not None}
        for data in (actual, expected)
    )
    if actual_keys != expected_keys:
        raise AssertionError(
            f"{law}: the attributes differ, {sorted(actual_keys)} and {sorted(expected_keys)}"
        )
    for key in sorted(actual_keys):
        actual_value, expected_value = actual[key], expected[key]
        if isinstance(actual_value, Tensor) and isinstance(expected_value, Tensor):
            assert_equal_numbers(f"{law}, in '{key}'", actual_value, expected_value, atol)
        elif (
            isinstance(actual_value, Tensor)
            or isinstance(expected_value, Tensor)
            or actual_value != expected_value
        ):
            raise AssertionError(
                f"{law}, in '{key}': {actual_value!r} and {expected_value!r} differ"
            )
