r"""The widths and pools that threads have by default, and checks of them."""

from collections.abc import Mapping, Sequence
from typing import Any, Optional

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.nn._sizes import check_sizes, checked_layer_widths

# The thread of the paper for readings.
WIDTHS = (14, 28, 56, 112, 112)
POOLS = (1, 1, 2, 4, 16)


def checked_widths(
    in_channels: int, widths: Sequence[int], pools: Sequence[int]
) -> tuple[tuple[int, ...], tuple[int, ...], tuple[int, ...]]:
    r"""Returns widths and pools of layers, which must fit each other, and the width before each
    layer and after the last.
    """
    check_sizes(in_channels=in_channels)
    widths, pools = checked_layer_widths(widths), tuple(pools)
    need(
        len(pools) == len(widths),
        f"'pools' must have a size for each of {len(widths)} widths",
        pools,
    )
    for width, pool in zip(widths, pools, strict=True):
        if pool < 1 or width % pool:
            raise ValueError(f"'pools' must divide 'widths' (got {pool} for {width})")
    sizes = (in_channels, *(width // pool for width, pool in zip(widths, pools, strict=True)))
    return widths, pools, sizes


# The threads of the paper: of the readings, and of all other inputs.
_TACTILE_THREAD: dict[str, Any] = {"widths": WIDTHS, "pools": POOLS}
_OTHER_THREAD: dict[str, Any] = {"widths": (7, 14, 28, 28, 56), "pools": (1, 1, 2, 2, 8)}


def thread_settings(
    inputs: Sequence[str], threads: Optional[Mapping[str, Any]], keys: Sequence[str]
) -> dict[str, dict[str, Any]]:
    r"""Returns the settings of each thread, by default the paper's."""
    threads = threads or {}
    for name, own in threads.items():
        if name not in inputs:
            raise ValueError(f"'threads' must be of the inputs {tuple(inputs)} (got '{name}')")
        unknown = sorted(set(own or ()) - set(keys))
        if unknown:
            raise ValueError(
                f"a thread must have some of {list(keys)} (got '{unknown[0]}' in '{name}')"
            )
    return {
        name: {
            **(_TACTILE_THREAD if name == "tactile" else _OTHER_THREAD),
            **(threads.get(name) or {}),
        }
        for name in inputs
    }
