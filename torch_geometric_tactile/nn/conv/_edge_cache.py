r"""What follows from edges, kept for as long as the same edges come in."""

import weakref
from collections.abc import Callable, Sequence
from typing import Any, Generic, NamedTuple, Optional, TypeVar

import torch
from torch import Tensor
from torch.nn import Parameter
from torch_geometric.typing import Adj, OptTensor

from torch_geometric_tactile.nn.conv._edge_checks import Forgetful

_PLAIN = (Tensor, Parameter)
_Value = TypeVar("_Value")


class _Entry(NamedTuple):
    key: tuple[Any, ...]
    kept: "list[KeptTensor]"
    value: Any


class EdgeCache(Forgetful, Generic[_Value]):
    r"""Keeps what follows from the last edges for as long as the same tensors come in.

    They are compared by value with a copy of its own, so that no way of changing them goes unseen:
    neither :obj:`tensor.data` nor a NumPy array that shares their memory counts as a write. On a
    GPU, comparing values would wait for everything under way; there, a tensor is taken to be the
    same if it is the same object with the same memory and PyTorch counted no write to it, and
    values are compared otherwise. Only a write through :obj:`tensor.data` goes unseen there.

    One entry is kept and replaced as a whole, so that threads may share the cache.
    """

    def __init__(self) -> None:
        self._entry: Optional[_Entry] = None

    @property
    def current(self) -> Optional[_Value]:
        r"""What is kept, :obj:`None` at first."""
        return None if self._entry is None else self._entry.value

    def _found(self, key: tuple[Any, ...], tensors: Sequence[Tensor]) -> Optional[_Value]:
        entry = self._entry
        if entry is None or entry.key != key or len(entry.kept) != len(tensors):
            return None
        same = all(kept.equals(tensor) for kept, tensor in zip(entry.kept, tensors, strict=True))
        return entry.value if same else None

    def _keep(
        self, key: tuple[Any, ...], tensors: Sequence[Tensor], make: Callable[[], _Value]
    ) -> _Value:
        # A matrix computed in inference mode (by a validation before the training) could not take
        # part in a later training step.
        with torch.inference_mode(False), torch.no_grad():
            entry = _Entry(key, [KeptTensor(tensor) for tensor in tensors], make())
        self._entry = entry  # at last and as a whole
        value: _Value = entry.value
        return value


class KeptTensor:
    r"""A copy of a tensor, which tells whether another one has its values; see
    :class:`EdgeCache`.
    """

    def __init__(self, tensor: Tensor) -> None:
        self.copy = tensor.clone()
        self.note(tensor)

    def note(self, tensor: Tensor) -> None:
        r"""Notes which object has the values."""
        # A weak reference: the caller's tensor may die, and another be born at its address.
        self.seen = weakref.ref(tensor)
        self.state = (tensor.data_ptr(), None if tensor.is_inference() else tensor._version)

    def equals(self, tensor: Tensor) -> bool:
        r"""Tells whether a tensor has the values of the copy."""
        copy = self.copy
        if tensor.dtype != copy.dtype or tensor.requires_grad or type(tensor) not in _PLAIN:
            return False
        if tensor.is_cpu and copy.is_cpu:
            try:
                return torch.equal(tensor, copy)
            except RuntimeError:  # the tensor of a `vmap` has many values
                return False
        if tensor.device != copy.device or tensor.shape != copy.shape:
            return False
        if (
            self.seen() is tensor
            and not tensor.is_inference()
            and self.state == (tensor.data_ptr(), tensor._version)
        ):
            return True
        if not torch.equal(tensor, copy):
            return False
        self.note(tensor)
        return True


def may_be_kept(edge_index: Adj, edge_weight: OptTensor = None) -> bool:
    r"""Tells whether what follows from edges may be kept: not from those that need a gradient, nor
    from a fake tensor or another subclass, which may have no values.
    """
    return edge_index.layout in (torch.strided, torch.sparse_coo, torch.sparse_csr) and not any(
        tensor.requires_grad
        or type(tensor) not in _PLAIN
        or tensor.device.type == "meta"
        or is_wrapped(tensor)
        for tensor in (edge_index, edge_weight)
        if tensor is not None
    )


def is_wrapped(tensor: Tensor) -> bool:
    r"""Tells whether a tensor is wrapped by a transform of :mod:`torch.func`, whose tensors have no
    memory of their own.
    """
    if tensor.layout != torch.strided:
        return False
    try:
        tensor.data_ptr()
    except RuntimeError:
        return True
    return False
