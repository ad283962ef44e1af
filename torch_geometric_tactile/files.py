r"""Files that are either whole or absent."""

import hashlib
import os
import tempfile
import zipfile
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
    import zipfile
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


def check_zip(path: PathLike) -> None:
    r"""Compares every entry of a zip file with its checksum. The entries must be stored without
    compression, as PyTorch stores them, such that no more is read than the file holds.

    Args:
        path (str or PathLike): The file.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If the file is no whole zip file, or an entry is damaged or compressed.
    """
    problem = ""
    try:
        with zipfile.ZipFile(path) as archive:
            for entry in archive.infolist():
                # PyTorch reads a file that is marked as a folder (0x10) as zeros.
                if entry.compress_type != zipfile.ZIP_STORED or entry.external_attr & 0x10:
                    problem = f"its part {entry.filename!r} is no stored file"
            damaged = None if problem else archive.testzip()
            if damaged is not None:
                problem = f"its part {damaged!r} differs from its checksum"
    except FileNotFoundError:
        raise
    except (
        zipfile.BadZipFile,
        EOFError,
        NotImplementedError,
        OSError,
        OverflowError,
        RuntimeError,
        ValueError,
    ) as error:
        problem = str(error)
    if problem:
        raise ValueError(
            f"'{path}' is damaged or was cut off ({problem}): copy or write it again"
        ) from None
