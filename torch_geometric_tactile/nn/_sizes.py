r"""The sizes that layers and models are given."""

from collections.abc import Sequence
from numbers import Integral
from typing import Any

from torch_geometric_tactile._checks import need


def check_sizes(advice: str = "", **sizes: Any) -> None:
    r"""Checks that sizes are whole numbers from one on."""
    for name, size in sizes.items():
        if not isinstance(size, Integral) or size < 1:
            raise ValueError(f"'{name}' must be at least 1 (got {size}){advice}")


def given_widths(widths: Sequence[int]) -> tuple[int, ...]:
    r"""Returns the widths of layers, of which there is one at least."""
    widths = tuple(widths)
    need(widths and min(widths) >= 1, "'widths' must be at least one width of at least 1", widths)
    return widths
