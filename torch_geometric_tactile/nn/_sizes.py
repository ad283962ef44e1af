r"""The sizes that layers and models are given."""

from collections.abc import Sequence
from numbers import Integral
from typing import Any

from torch import Tensor

from torch_geometric_tactile._checks import need

_MAX_LAYERS = 1000


def check_sizes(advice: str = "", **sizes: Any) -> None:
    r"""Checks that sizes are whole numbers from one on, and that layers can be counted."""
    for name, size in sizes.items():
        if not isinstance(size, Integral) or size < 1:
            raise ValueError(f"'{name}' must be at least 1 (got {size}){advice}")
        if name in ("depth", "num_layers"):  # a list of so many is made before the first layer
            need(size <= _MAX_LAYERS, f"'{name}' must be at most {_MAX_LAYERS}", size)


def given_widths(widths: Sequence[int]) -> tuple[int, ...]:
    r"""Returns the widths of layers, of which there is one at least."""
    widths = tuple(widths)
    need(widths and min(widths) >= 1, "'widths' must be at least one width of at least 1", widths)
    return widths


def is_of_taxels(x: Tensor, num_taxels: int, num_channels: int | None = None) -> bool:
    r"""Tells whether features of any form are those of so many taxels in each sample, and so wide.

    Shapes:
        - **x:** Features :math:`(N, F)`, :math:`(B, N, F)` or those of a PyG batch.
    """
    if x.dim() not in (2, 3) or (num_channels is not None and x.size(-1) != num_channels):
        return False
    return x.size(1) == num_taxels if x.dim() == 3 else x.size(0) % num_taxels == 0
