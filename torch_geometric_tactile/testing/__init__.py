r"""Assertions for tests, which check laws that layers and transforms must satisfy."""

from torch_geometric_tactile.testing.permutation_equivariant import assert_permutation_equivariant
from torch_geometric_tactile.testing.static_equals_batched import assert_static_equals_batched
from torch_geometric_tactile.testing.streaming_equals_window import assert_streaming_equals_window
from torch_geometric_tactile.testing.transform_static_equals_batched import (
    assert_transform_static_equals_batched,
)

__all__ = [
    "assert_permutation_equivariant",
    "assert_static_equals_batched",
    "assert_streaming_equals_window",
    "assert_transform_static_equals_batched",
]
