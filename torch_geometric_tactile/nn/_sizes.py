r"""Checks of the sizes of layers and models."""

from collections.abc import Sequence
from numbers import Integral
from typing import Any

from torch import Tensor

from torch_geometric_tactile._checks import need

_MAX_LAYERS = 1000


def check_sizes(advice: str = "", **sizes: Any) -> None:
    r"""Checks that sizes are positive integers, and that the number of layers is not excessive.

    Args:
        advice (str): Text to append to the message.
        **sizes: Sizes by argument name.

    Raises:
        ValueError: If a size is below one or not an integer, or there are too many layers.
    """
    for name, size in sizes.items():
        if not isinstance(size, Integral) or size < 1:
            raise ValueError(f"'{name}' must be at least 1 (got {size}){advice}")
        # Models create a list of this length before the first layer, which could exhaust the
        # memory.
        if name in ("depth", "num_layers"):
            need(size <= _MAX_LAYERS, f"'{name}' must be at most {_MAX_LAYERS}", size)


def checked_layer_widths(widths: Sequence[int]) -> tuple[int, ...]:
    r"""Returns the widths of layers as a tuple.

    Raises:
        ValueError: If there is no width, or a width is below one.
    """
    widths = tuple(widths)
    need(
        widths and min(widths) >= 1,
        "'widths' must hold at least one width, each at least 1",
        widths,
    )
    return widths


def has_taxels(x: Tensor, num_taxels: int, num_channels: int | None = None) -> bool:
    r"""Returns whether features have :obj:`num_taxels` taxels in each sample and, unless it is
    :obj:`None`, :obj:`num_channels` channels.

    Shapes:
        - **x:** Features :math:`(N, F)`, :math:`(B, N, F)` or, for a PyG batch,
          :math:`(B \cdot N, F)`.
    """
    if x.dim() not in (2, 3) or (num_channels is not None and x.size(-1) != num_channels):
        return False
    return x.size(1) == num_taxels if x.dim() == 3 else x.size(0) % num_taxels == 0
