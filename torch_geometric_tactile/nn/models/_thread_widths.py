r"""Default widths and pool sizes of threads, and their checks."""

from collections.abc import Mapping, Sequence
from typing import Any, Optional

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.nn._sizes import check_sizes, checked_layer_widths

# Defaults for readings, from the paper.
WIDTHS = (14, 28, 56, 112, 112)
POOLS = (1, 1, 2, 4, 16)


def checked_widths(
    in_channels: int, widths: Sequence[int], pools: Sequence[int]
) -> tuple[tuple[int, ...], tuple[int, ...], tuple[int, ...]]:
    r"""Returns the widths of layers, their pool sizes, and the widths before each layer and after
    the last layer.

    Raises:
        ValueError: If there is no layer, the numbers of widths and pool sizes differ, a pool size
            does not divide its width, or a size is below one.
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


# The paper's settings for the thread of the readings and the threads of all other inputs.
_TACTILE_THREAD: dict[str, Any] = {"widths": WIDTHS, "pools": POOLS}
_NARROW_THREAD: dict[str, Any] = {"widths": (7, 14, 28, 28, 56), "pools": (1, 1, 2, 2, 8)}


def thread_settings(
    inputs: Sequence[str], threads: Optional[Mapping[str, Any]], keys: Sequence[str]
) -> dict[str, dict[str, Any]]:
    r"""Returns the settings of each input's thread. Missing settings are taken from the paper.

    Args:
        inputs (sequence of str): Inputs of the model.
        threads (dict, optional): Settings by input.
        keys (sequence of str): Names of possible settings.

    Raises:
        ValueError: If an input or a setting is unknown.
    """
    threads = threads or {}
    for name, settings in threads.items():
        if name not in inputs:
            raise ValueError(f"'threads' must only have the inputs {tuple(inputs)} (got '{name}')")
        unknown_keys = sorted(set(settings or ()) - set(keys))
        if unknown_keys:
            raise ValueError(
                f"'threads' must only have the settings {list(keys)} (got '{unknown_keys[0]}' in "
                f"'{name}')"
            )
    return {
        name: {
            **(_TACTILE_THREAD if name == "tactile" else _NARROW_THREAD),
            **(threads.get(name) or {}),
        }
        for name in inputs
    }
