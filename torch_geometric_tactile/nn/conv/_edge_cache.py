r"""Caches of values that are computed from edges and reused as long as the edges do not change."""

import weakref
from collections.abc import Callable, Sequence
from typing import Any, Generic, NamedTuple, Optional, TypeVar

import torch
from torch import Tensor
from torch.autograd import forward_ad
from torch.nn import Parameter
from torch_geometric.typing import Adj, OptTensor

from torch_geometric_tactile.nn.conv._edge_checks import StatelessCopy

_TENSOR_TYPES = (Tensor, Parameter)
_Value = TypeVar("_Value")


class _Entry(NamedTuple):
    key: tuple[Any, ...]
    snapshots: "list[TensorSnapshot]"
    value: Any


class EdgeCache(StatelessCopy, Generic[_Value]):
    r"""A cache of one value that was computed from edges. The value is reused as long as the key
    and the values of the tensors do not change.

    On a CPU, the tensors are compared with a copy of their values. A version counter would not be
    sufficient, since it does not count writes through :obj:`tensor.data` or through a NumPy array
    that shares the memory. On a GPU, comparing values has to wait for all pending work. There, a
    tensor counts as unchanged if it is the same object with the same memory and version counter,
    and values are compared only if it is not. Writes through :obj:`tensor.data` are the only
    changes that go unnoticed.

    The entry is replaced atomically, so that threads may share the cache.
    """

    def __init__(self) -> None:
        self._entry: Optional[_Entry] = None

    @property
    def current(self) -> Optional[_Value]:
        r"""The cached value, or :obj:`None` if the cache is empty."""
        return None if self._entry is None else self._entry.value

    def _lookup(self, key: tuple[Any, ...], tensors: Sequence[Tensor]) -> Optional[_Value]:
        entry = self._entry
        if entry is None or entry.key != key or len(entry.snapshots) != len(tensors):
            return None
        is_unchanged = all(
            snapshot.equals(tensor)
            for snapshot, tensor in zip(entry.snapshots, tensors, strict=True)
        )
        return entry.value if is_unchanged else None

    def _store(
        self, key: tuple[Any, ...], tensors: Sequence[Tensor], compute: Callable[[], _Value]
    ) -> _Value:
        # A matrix computed in inference mode (by a validation before training) could not be used in
        # a later training step.
        with torch.inference_mode(False), torch.no_grad():
            entry = _Entry(key, [TensorSnapshot(tensor) for tensor in tensors], compute())
        self._entry = entry  # one assignment, so that other threads see a complete entry
        value: _Value = entry.value
        return value


class TensorSnapshot:
    r"""A copy of a tensor, to which later tensors are compared; see :class:`EdgeCache`."""

    def __init__(self, tensor: Tensor) -> None:
        self.copy = tensor.clone()
        self.set_source(tensor)

    def set_source(self, tensor: Tensor) -> None:
        r"""Stores the identity and the version of a tensor that has the values of the copy."""
        # A weak reference is needed, since a new tensor may get the address of a freed one.
        self.source = weakref.ref(tensor)
        self.state = (tensor.data_ptr(), None if tensor.is_inference() else tensor._version)

    def equals(self, tensor: Tensor) -> bool:
        r"""Returns whether a tensor has the values of the copy."""
        copy = self.copy
        if tensor.dtype != copy.dtype or tensor.requires_grad or type(tensor) not in _TENSOR_TYPES:
            return False
        if tensor.is_cpu and copy.is_cpu:
            try:
                return torch.equal(tensor, copy)
            except RuntimeError:  # inside `vmap`, a tensor represents several tensors
                return False
        if tensor.device != copy.device or tensor.shape != copy.shape:
            return False
        if (
            self.source() is tensor
            and not tensor.is_inference()
            and self.state == (tensor.data_ptr(), tensor._version)
        ):
            return True
        if not torch.equal(tensor, copy):
            return False
        self.set_source(tensor)
        return True


def is_cacheable(edge_index: Adj, edge_weight: OptTensor = None) -> bool:
    r"""Returns whether values computed from edges may be cached. They may not be cached if a tensor
    requires a gradient, or is a fake tensor or an instance of another subclass, which may have no
    values.
    """
    return edge_index.layout in (torch.strided, torch.sparse_coo, torch.sparse_csr) and not any(
        tensor.requires_grad
        or type(tensor) not in _TENSOR_TYPES
        or tensor.device.type == "meta"
        or is_wrapped(tensor)
        for tensor in (edge_index, edge_weight)
        if tensor is not None
    )


def is_wrapped(tensor: Tensor) -> bool:
    r"""Returns whether a tensor is a wrapper from :mod:`torch.func`, which has no storage."""
    if tensor.layout != torch.strided:
        return False
    try:
        tensor.data_ptr()
    except RuntimeError:
        return True
    return False


def is_transformed() -> bool:
    r"""Returns whether a transform from :mod:`torch.func` or forward-mode differentiation is
    active. The sparse products support neither.
    """
    # PyTorch has no public function for either; a test covers both names.
    return torch._C._are_functorch_transforms_active() or forward_ad._current_level >= 0
