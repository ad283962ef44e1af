r"""The file under an MCAP writer: what was written stays whole whatever happens after it."""

import os
from contextlib import suppress
from pathlib import Path
from typing import Any

from torch_geometric_tactile._files import lock_file

_INSTALL = "pip install 'torch-geometric-tactile[live]'"


def require_mcap() -> Any:
    r"""Returns the writer's module of the library of MCAP."""
    try:
        import mcap.writer
        import zstandard  # noqa: F401 - the compression of chunks
    except ImportError as error:
        raise ImportError(f"MCAP recordings need mcap: {_INSTALL}") from error
    return mcap.writer


class McapOutput:
    r"""A new file that is written from its beginning to its end. When that fails, it is cut back to
    what was whole.
    """

    def __init__(self, path: Path, overwrite: bool, lock: bool) -> None:
        self.path = path
        self.error: OSError | None = None
        self.closed = False
        self._place = self._whole = 0
        flags = os.O_RDWR | os.O_CREAT | getattr(os, "O_BINARY", 0)
        try:
            self._handle = os.open(path, flags | (0 if overwrite else os.O_EXCL), 0o666)
        except FileExistsError as error:
            raise FileExistsError(
                f"'{path}' exists: give another name, or overwrite it (--overwrite)"
            ) from error
        try:
            self._release = lock_file(self._handle, path) if lock else lambda: None
            os.ftruncate(self._handle, 0)
        except BaseException:
            os.close(self._handle)
            raise

    def tell(self) -> int:
        r"""Returns how many bytes were written."""
        return self._place

    def write(self, data: bytes | memoryview) -> int:
        r"""Writes bytes."""
        if self.error is not None:
            raise self.error
        view = memoryview(data)
        try:
            while view:
                count = os.write(self._handle, view)
                view, self._place = view[count:], self._place + count
        except OSError as error:
            self.error = OSError(error.errno, os.strerror(error.errno or 0), str(self.path))
            with suppress(OSError):
                os.ftruncate(self._handle, self._whole)
            raise self.error from error
        return len(data)

    def flush(self) -> None:
        r"""Does nothing: nothing is kept back."""

    def commit(self) -> None:
        r"""Says that all that was written is whole."""
        if self.error is None:
            self._whole = self._place

    def close(self) -> None:
        r"""Closes it; does nothing if it is closed."""
        if not self.closed:
            self.closed = True
            os.close(self._handle)
            self._release()
