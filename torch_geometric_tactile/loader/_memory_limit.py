r"""How much memory there is for data."""

import os
from contextlib import suppress
from pathlib import Path
from typing import Any

from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data._batches import static_parts

_CGROUPS = "/sys/fs/cgroup"
_OWN = "/proc/self/cgroup"


def memory_limit(cgroups: PathLike = _CGROUPS, own: PathLike = _OWN) -> int | None:
    r"""Returns the bytes of memory that this process may use: those of the machine or, if less, of
    its control group (of a container or a job). It is :obj:`None` where neither is known.
    """
    found = [_group_limit(Path(cgroups), line) for line in _lines(Path(own))]
    with suppress(AttributeError, OSError, ValueError):  # not on Windows
        found.append(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    return min((limit for limit in found if limit is not None), default=None)


def exceeds_memory(dataset: Any, limit: int | None = None) -> bool:
    r"""Tells whether the samples of a data set, in a memory-mapped file, are larger than memory."""
    limit = memory_limit() if limit is None else limit
    return limit is not None and sum(part.nbytes for part in static_parts(dataset)) > limit


def _lines(path: Path) -> list[str]:
    try:
        return path.read_text(encoding="utf-8").splitlines()
    except OSError:
        return []


def _group_limit(cgroups: Path, line: str) -> int | None:
    # A line is 'number:controllers:path', without controllers in version 2. The limits of all
    # groups above count as well.
    _, _, rest = line.partition(":")
    controllers, _, path = rest.partition(":")
    if controllers == "":
        folder, name = cgroups, "memory.max"
    elif "memory" in controllers.split(","):
        folder, name = cgroups / "memory", "memory.limit_in_bytes"
    else:
        return None
    steps = [part for part in path.split("/") if part not in ("", "..")]
    folders = [folder.joinpath(*steps[:depth]) for depth in range(len(steps) + 1)]
    limits = [text for one in folders for text in _lines(one / name)]
    return min((int(text) for text in limits if text.isdigit()), default=None)
