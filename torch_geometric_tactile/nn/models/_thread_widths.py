r"""The widths and pools that threads have by default, and checks of them."""

from collections.abc import Sequence

# The thread of the paper for readings.
WIDTHS = (14, 28, 56, 112, 112)
POOLS = (1, 1, 2, 4, 16)


def checked_widths(
    in_channels: int, widths: Sequence[int], pools: Sequence[int]
) -> tuple[tuple[int, ...], tuple[int, ...], tuple[int, ...]]:
    r"""Returns widths and pools of layers, which must fit each other, and the width before each
    layer and after the last.
    """
    widths, pools = tuple(widths), tuple(pools)
    if in_channels < 1:
        raise ValueError(f"'in_channels' must be at least 1 (got {in_channels})")
    if not widths or min(widths) < 1:
        raise ValueError(f"'widths' must be at least one width of at least 1 (got {widths})")
    if len(pools) != len(widths):
        raise ValueError(f"'pools' must have a size for each of {len(widths)} widths (got {pools})")
    for width, pool in zip(widths, pools, strict=True):
        if pool < 1 or width % pool:
            raise ValueError(f"'pools' must divide 'widths' (got {pool} for {width})")
    sizes = (in_channels, *(width // pool for width, pool in zip(widths, pools, strict=True)))
    return widths, pools, sizes
