r"""Determines the memory that a process may use, and whether a data set exceeds it."""

import os
from contextlib import suppress
from pathlib import Path
from typing import Any

from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data._batches import static_parts

_CGROUP_FOLDER = "/sys/fs/cgroup"
_PROCESS_GROUPS = "/proc/self/cgroup"


def memory_limit(
    cgroup_folder: PathLike = _CGROUP_FOLDER, process_groups: PathLike = _PROCESS_GROUPS
) -> int | None:
    r"""Returns the memory in bytes that this process may use. This is the memory of the machine or
    the limit of the control group (of a container or a job), whichever is lower. Returns
    :obj:`None` if neither is known.
    """
    limits = [_group_limit(Path(cgroup_folder), line) for line in _read_lines(Path(process_groups))]
    with suppress(AttributeError, OSError, ValueError):  # not on Windows
        limits.append(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    return min((limit for limit in limits if limit is not None), default=None)


def exceeds_memory(dataset: Any, limit: int | None = None) -> bool:
    r"""Returns whether the samples of a memory-mapped data set exceed the memory."""
    limit = memory_limit() if limit is None else limit
    return limit is not None and sum(part.nbytes for part in static_parts(dataset)) > limit


def _read_lines(path: Path) -> list[str]:
    try:
        return path.read_text(encoding="utf-8").splitlines()
    except OSError:
        return []


def _group_limit(cgroup_folder: Path, line: str) -> int | None:
    # A line has the form 'number:controllers:path'. In version 2, there are no controllers. The
    # limits of all parent groups also apply.
    _, _, controllers_and_path = line.partition(":")
    controllers, _, path = controllers_and_path.partition(":")
    if controllers == "":
        folder, name = cgroup_folder, "memory.max"
    elif "memory" in controllers.split(","):
        folder, name = cgroup_folder / "memory", "memory.limit_in_bytes"
    else:
        return None
    group_names = [part for part in path.split("/") if part not in ("", "..")]
    folders = [folder.joinpath(*group_names[:depth]) for depth in range(len(group_names) + 1)]
    limits = [text for group_folder in folders for text in _read_lines(group_folder / name)]
    return min((int(text) for text in limits if text.isdigit()), default=None)
