r"""A limit on the memory of models that are built from untrusted files."""

from collections.abc import Iterable, Mapping
from typing import Any

import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._limits import MODEL_BYTES, MODEL_TENSORS


class AllocationLimit(TorchFunctionMode):
    r"""A context that limits the memory and the number of tensors that a model or a transform
    allocates while it is built from a file. The limits are proportional to the tensors in the file.

    A tensor is counted before it is allocated. A tensor in the file is counted at each reference,
    in double precision, since a transform may convert it.

    Args:
        weights (iterable of torch.Tensor): The tensors in the file.
    """

    def __init__(self, weights: Iterable[Tensor]) -> None:
        super().__init__()
        sizes = [w.numel() * w.element_size() for w in weights if isinstance(w, Tensor)]
        # Leaves room for the parameters of a model and the few copies that building it allocates.
        self._max_bytes = MODEL_BYTES + 4 * sum(sizes)
        self._max_referenced_bytes = MODEL_BYTES + 8 * sum(sizes)
        self._referenced_bytes = 0
        self._max_tensors = MODEL_TENSORS + 4 * len(sizes)
        self._num_bytes = self._num_tensors = 0

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

    def count_reference(self, tensor: Tensor) -> Tensor:
        r"""Counts a reference to a tensor in the file and returns the tensor.

        Raises:
            ValueError: If the references take more memory than the limit.
        """
        self._referenced_bytes += tensor.numel() * max(_DOUBLE_BYTES, tensor.element_size())
        need(
            self._referenced_bytes <= self._max_referenced_bytes,
            f"its tensors must not be referenced too often (got more than "
            f"{self._max_referenced_bytes} bytes in double precision)",
        )
        return tensor

    def _count(self, func: Any, args: tuple[Any, ...], options: dict[str, Any]) -> None:
        shape_options = {key: value for key, value in options.items() if key not in _VALUE_OPTIONS}
        # On the meta device, the call returns the shape and type without allocating memory.
        if func in _FREE_FACTORIES:
            shape_options["device"] = "meta"
            meta_tensor = func(*args, **shape_options)
        else:
            tensor = args[0]
            meta_tensor = func(tensor.to("meta"), *args[1:], **(shape_options | {"device": "meta"}))
        self._num_bytes += meta_tensor.numel() * meta_tensor.element_size()
        self._num_tensors += 1
        if self._num_bytes > self._max_bytes or self._num_tensors > self._max_tensors:
            raise ValueError(
                "the model must not be larger than its weights in the file (got more than "
                f"{self._max_bytes} bytes or {self._max_tensors} tensors)"
            )


_DOUBLE_BYTES = 8  # bytes of a number in double precision
_VALUE_OPTIONS = ("generator", "out", "pin_memory")  # options that do not change the size
#: Functions that create a tensor without a tensor argument.
_FREE_FACTORIES = frozenset(
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
_FACTORIES = _FREE_FACTORIES | {
    Tensor.new_empty,
    Tensor.new_full,
    Tensor.new_ones,
    Tensor.new_zeros,
}
