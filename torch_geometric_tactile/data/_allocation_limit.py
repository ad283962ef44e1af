r"""Models from files that may name any size."""

from collections.abc import Iterable, Mapping
from typing import Any

import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._limits import MODEL_BYTES, MODEL_TENSORS


class AllocationLimit(TorchFunctionMode):
    r"""Ends the building of a model, or of transforms, that asks for much more memory than the
    tensors in the file take, or for many more tensors.

    The size of a tensor is counted before it is made, and a tensor of the file each time that it is
    named, in double precision, which a step may convert it to.
    """

    def __init__(self, weights: Iterable[Tensor]) -> None:
        super().__init__()
        held = [w.numel() * w.element_size() for w in weights if isinstance(w, Tensor)]
        self._most = MODEL_BYTES + 4 * sum(held)
        self._most_named = MODEL_BYTES + 8 * sum(held)
        self._named = 0
        self._most_tensors = MODEL_TENSORS + 4 * len(held)
        self._used = self._tensors = 0

    def __torch_function__(
        self,
        func: Any,
        types: Any,
        args: tuple[Any, ...] = (),
        kwargs: Mapping[str, Any] | None = None,
    ) -> Any:
        options = dict(kwargs or {})
        if func in _FACTORIES:
            self._count(func, args, options)
        return func(*args, **options)

    def name(self, tensor: Tensor) -> Tensor:
        r"""Counts that a tensor of the file is named once more, and returns it."""
        self._named += tensor.numel() * max(_WIDEST, tensor.element_size())
        need(
            self._named <= self._most_named,
            f"its tensors must not be named again and again (got more than {self._most_named} "
            "bytes in double precision)",
        )
        return tensor

    def _count(self, func: Any, args: tuple[Any, ...], options: dict[str, Any]) -> None:
        shape_only = {key: value for key, value in options.items() if key not in _OF_VALUES}
        if func in _OF_NO_TENSOR:
            shape_only["device"] = "meta"
            planned = func(*args, **shape_only)
        else:
            tensor = args[0]
            planned = func(tensor.to("meta"), *args[1:], **(shape_only | {"device": "meta"}))
        self._used += planned.numel() * planned.element_size()
        self._tensors += 1
        if self._used > self._most or self._tensors > self._most_tensors:
            raise ValueError(
                "the model must not be larger than its weights in the file (got more than "
                f"{self._most} bytes or {self._most_tensors} tensors)"
            )


_WIDEST = 8  # bytes of a number in double precision
_OF_VALUES = ("generator", "out", "pin_memory")  # options that do not change the size
_OF_NO_TENSOR = frozenset(
    [
        torch.empty,
        torch.eye,
        torch.zeros,
        torch.ones,
        torch.rand,
        torch.randn,
        torch.randperm,
        torch.full,
        torch.arange,
        torch.linspace,
    ]
)
_FACTORIES = _OF_NO_TENSOR | {
    Tensor.new_empty,
    Tensor.new_full,
    Tensor.new_ones,
    Tensor.new_zeros,
}
