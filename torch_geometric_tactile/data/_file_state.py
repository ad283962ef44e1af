r"""Whether a raw file is still the one that was processed."""

import hashlib
import os
from pathlib import Path

from torch_geometric_tactile._typing import PathLike

_END = 1 << 16  # bytes read at each end


def file_state(path: PathLike) -> str:
    r"""Returns a text that changes with a file: its size, a hash of its first and last 64 KiB and,
    where that is not all of it, the time of its last change. It takes no time that depends on the
    size of the file.

    A short file that was copied or touched stays the same; a long one counts as changed, since only
    its time can tell of its middle.
    """
    with Path(path).open("rb") as file:
        stat = os.fstat(file.fileno())
        code = hashlib.blake2b(file.read(_END), digest_size=16)
        if stat.st_size > _END:
            file.seek(max(_END, stat.st_size - _END))
            code.update(file.read(_END))
    time = f",{stat.st_mtime_ns}" if stat.st_size > 2 * _END else ""
    return f"{stat.st_size},{code.hexdigest()}{time}"
