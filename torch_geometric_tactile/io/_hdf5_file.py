r"""An HDF5 file that is opened: locked, and changed as a whole or not at all."""

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from torch_geometric_tactile._files import hold_file, is_held
from torch_geometric_tactile.io._hdf5_journal import PatchedFile, ends_in_journal

_INSTALL = 'pip install "torch-geometric-tactile[io]"'
CHECKSUMMED = ("v110", "v110")  # the oldest HDF5 with checksums in all structures


def require_h5py() -> Any:
    r"""Returns the library of HDF5."""
    try:
        import h5py
    except ImportError as error:
        raise ImportError(f"HDF5 files need h5py: {_INSTALL}") from error
    return h5py


@contextmanager
def opened(path: Path, mode: str) -> Iterator[Any]:
    r"""Opens a file, locked against other processes; what is changed in it is written as a
    whole.
    """
    h5py = require_h5py()
    handle, release = _locked(path, exclusive=mode == "r+")
    try:
        with _errors_of_reading(path):
            in_memory = mode == "r+" or ends_in_journal(path)
            patched = PatchedFile(handle) if in_memory else None
            with h5py.File(patched or path, mode, libver=CHECKSUMMED) as file:
                yield file
        if patched is not None and mode == "r+":
            try:
                patched.commit()
            except OSError as error:
                raise OSError(error.errno, os.strerror(error.errno or 0), str(path)) from error
    finally:
        os.close(handle)
        release()


@contextmanager
def _errors_of_reading(path: Path) -> Iterator[None]:
    try:
        yield
    except BlockingIOError as error:
        raise is_held(path) from error
    except Exception as error:  # h5py raises ten kinds for a damaged file
        ours = isinstance(error, ValueError | OSError) and f"'{path}'" in str(error)
        if ours or isinstance(error, PermissionError):
            raise
        raise ValueError(
            f"'{path}' cannot be read as HDF5, is it truncated or damaged? {error}; copy or record "
            "it again"
        ) from error


def _locked(path: Path, exclusive: bool) -> tuple[int, Callable[[], None]]:
    while True:
        flags = (os.O_RDWR if exclusive else os.O_RDONLY) | getattr(os, "O_BINARY", 0)
        handle = os.open(path, flags)
        try:
            release = hold_file(handle, path, exclusive=exclusive)
        except BlockingIOError:
            os.close(handle)
            raise
        if os.path.samestat(os.fstat(handle), path.stat()):
            return handle, release
        os.close(handle)  # replaced by a new file meanwhile
