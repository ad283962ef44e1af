r"""The output file of an MCAP writer. It stays valid after a failed write."""

import os
from contextlib import suppress
from pathlib import Path
from typing import Any

from torch_geometric_tactile._files import lock_file

_INSTALL = "pip install 'torch-geometric-tactile[live]'"


def require_mcap() -> Any:
    r"""Returns :obj:`mcap.writer`, or raises an error with the command that installs it."""
    try:
        import mcap.writer
        import zstandard  # noqa: F401 - the compression of chunks
    except ImportError as error:
        raise ImportError(f"MCAP recordings need mcap: {_INSTALL}") from error
    return mcap.writer


class McapOutput:
    r"""A new file that is written sequentially. If a write fails, the file is truncated to its last
    committed state.

    Args:
        path (Path): The file.
        overwrite (bool): Whether to overwrite an existing file.
        lock (bool): Whether to lock the file against other writers.
    """

    def __init__(self, path: Path, overwrite: bool, lock: bool) -> None:
        self.path = path
        self.error: OSError | None = None
        self.closed = False
        self._position = self._committed = 0
        # Without O_BINARY, Windows would replace line breaks in the data.
        flags = os.O_RDWR | os.O_CREAT | getattr(os, "O_BINARY", 0)
        try:
            self._handle = os.open(path, flags | (0 if overwrite else os.O_EXCL), 0o666)
        except FileExistsError as error:
            raise FileExistsError(
                f"'{path}' exists: choose another name, or overwrite it (--overwrite)"
            ) from error
        try:
            # Truncated only after the lock, since another process may be writing the file.
            self._release = lock_file(self._handle, path) if lock else lambda: None
            os.ftruncate(self._handle, 0)
        except BaseException:
            os.close(self._handle)
            raise

    def tell(self) -> int:
        r"""Returns the number of bytes written so far."""
        return self._position

    def write(self, data: bytes | memoryview) -> int:
        r"""Writes bytes, and returns their number."""
        if self.error is not None:
            raise self.error
        view = memoryview(data)
        try:
            while view:
                count = os.write(self._handle, view)
                view, self._position = view[count:], self._position + count
        except OSError as error:
            self.error = OSError(error.errno, os.strerror(error.errno or 0), str(self.path))
            with suppress(OSError):
                os.ftruncate(self._handle, self._committed)
            raise self.error from error
        return len(data)

    def flush(self) -> None:
        r"""Does nothing, since writes are not buffered."""

    def commit(self) -> None:
        r"""Marks the bytes written so far as a valid state of the file."""
        if self.error is None:
            self._committed = self._position

    def close(self) -> None:
        r"""Closes the file. Does nothing if it is already closed."""
        if not self.closed:
            self.closed = True
            os.close(self._handle)
            self._release()
