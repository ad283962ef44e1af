r"""Models from files that may name any size."""

from collections.abc import Iterable, Mapping
from typing import Any

import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode

from torch_geometric_tactile._limits import MODEL_BYTES, MODEL_TENSORS


class AllocationLimit(TorchFunctionMode):
    r"""Ends the building of a model that asks for much more memory than its weights in the file
    take, or for many more tensors.

    Tensors are allocated before they are filled, so that a size beyond all measure in a damaged or
    hostile file is found before it takes the memory.
    """

    def __init__(self, weights: Iterable[Tensor]) -> None:
        super().__init__()
        held = [w.numel() * w.element_size() for w in weights if isinstance(w, Tensor)]
        self._most = MODEL_BYTES + 4 * sum(held)
        self._most_tensors = MODEL_TENSORS + 4 * len(held)
        self._used = self._tensors = 0

    def __torch_function__(
        self,
        func: Any,
        types: Any,
        args: tuple[Any, ...] = (),
        kwargs: Mapping[str, Any] | None = None,
    ) -> Any:
        out = func(*args, **(kwargs or {}))
        if isinstance(out, Tensor) and func in _FACTORIES:
            self._used += out.numel() * out.element_size()
            self._tensors += 1
            if self._used > self._most or self._tensors > self._most_tensors:
                raise ValueError(
                    "the model must not be larger than its weights in the file (got more than "
                    f"{self._most} bytes or {self._most_tensors} tensors)"
                )
        return out


_FACTORIES = (
    torch.empty,
    torch.zeros,
    torch.ones,
    torch.rand,
    torch.randn,
    torch.full,
    torch.arange,
)
