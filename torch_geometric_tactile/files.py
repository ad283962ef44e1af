r"""Files that are either whole or absent."""

import hashlib
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from torch_geometric_tactile.typing import PathLike


@contextmanager
def atomic_path(path: PathLike) -> Iterator[Path]:
    r"""Yields a temporary path beside :obj:`path` that becomes :obj:`path` when the block succeeds.

    A reader never sees half a file: on an error or a kill, :obj:`path` keeps its old content.

    Args:
        path (str or PathLike): Where the finished file shall be. Its folder is made if missing.

    Examples:
        >>> import tempfile
        >>> target = Path(tempfile.mkdtemp()) / "a.txt"
        >>> with atomic_path(target) as tmp:
        ...     _ = tmp.write_text("whole")
        >>> target.read_text()
        'whole'
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=".tmp")
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        share(temporary)
        with temporary.open("rb") as written:
            os.fsync(written.fileno())
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def share(path: PathLike) -> None:
    r"""Gives a file that was made as a private temporary one the rights that new files have.

    Args:
        path (str or PathLike): The file.
    """
    umask = os.umask(0)
    os.umask(umask)
    Path(path).chmod(0o666 & ~umask)


def file_sha256(path: PathLike) -> str:
    r"""Returns the SHA-256 of a file as a hexadecimal string.

    Args:
        path (str or PathLike): The file.
    """
    with Path(path).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
