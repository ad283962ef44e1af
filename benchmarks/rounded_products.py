r"""Linear layers that round as autocast to bfloat16 does, on processors without such instructions,
where PyTorch's own are a hundred times slower: what goes in and what comes out has the digits of
bfloat16, and sums are in float32. For accuracies, not for speed.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest.mock import patch

import torch
from torch import Tensor, nn
from torch.autograd import Function


def has_bfloat16() -> bool:
    """Whether the processor multiplies in bfloat16."""
    path = Path("/proc/cpuinfo")
    flags = path.read_text().split() if path.is_file() else []
    return bool({"avx512_bf16", "amx_bf16", "bf16"}.intersection(flags))


@contextmanager
def rounded_products() -> Iterator[None]:
    """Rounds all linear layers, forward and backward."""
    with patch.object(nn.Linear, "forward", _forward):
        yield


def _forward(self: nn.Linear, x: Tensor) -> Tensor:
    out: Tensor = _Product.apply(x, self.weight, self.bias)
    return out


def _rounded(x: Tensor) -> Tensor:
    return x.to(torch.bfloat16).to(torch.float32)


class _Product(Function):
    @staticmethod
    def forward(ctx: Any, x: Tensor, weight: Tensor, bias: Tensor | None) -> Tensor:
        x, weight = _rounded(x), _rounded(weight)
        ctx.save_for_backward(x, weight)
        return _rounded(nn.functional.linear(x, weight, None if bias is None else _rounded(bias)))

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, ...]:  # type: ignore[override]
        x, weight = ctx.saved_tensors
        grad = _rounded(grad)
        rows, out = x.flatten(0, -2), grad.flatten(0, -2)
        grad_bias = _rounded(out.sum(dim=0)) if ctx.needs_input_grad[2] else None
        return _rounded(grad @ weight), _rounded(out.t() @ rows), grad_bias
