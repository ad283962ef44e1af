r"""Opening of HDF5 files, and conversion of arrays to and from their stored form."""

import io
import os
import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from torch_geometric_tactile._files import locked_error

CHECKSUMMED = ("v110", "v110")  # the oldest HDF5 with checksums in all structures
_INSTALL = 'pip install "torch-geometric-tactile[io]"'
_VALUES_PER_CHUNK = 2**15
_MAX_FRAMES_PER_CHUNK = 512
_GZIP_LEVEL = 1  # compresses counts nearly as well as level 9, and several times faster
_TEXTS_PER_READ = 64  # in version 1, where each string may be as long as the file
_MAGIC = b"tactile journal\n"
_FOOTER = struct.Struct("<16sQQII")  # magic, bytes before it, new file size, two checksums
_ENTRY = struct.Struct("<QI")  # offset and number of bytes


def require_h5py() -> Any:
    r"""Returns :obj:`h5py`, or raises an error with the command that installs it."""
    try:
        import h5py
    except ImportError as error:
        raise ImportError(f"HDF5 files need h5py: {_INSTALL}") from error
    return h5py


@contextmanager
def open_hdf5(path: Path) -> Iterator[Any]:
    r"""Opens a file for reading.

    Raises:
        BlockingIOError: If another process is writing the file.
        ValueError: If the file is damaged.
    """
    h5py = require_h5py()
    journal = _read_journal(path)
    try:
        image = path if journal is None else _apply_journal(path, *journal)
        with h5py.File(image, "r", libver=CHECKSUMMED) as file:
            yield file
    except BlockingIOError as error:
        raise locked_error(path) from error
    except Exception as error:  # h5py raises ten types of errors for damaged files
        names_path = isinstance(error, ValueError | OSError) and f"'{path}'" in str(error)
        if names_path or isinstance(error, PermissionError):
            raise
        raise ValueError(
            f"'{path}' cannot be read as HDF5 ({error}): is it truncated or damaged? Copy or "
            "record it again"
        ) from error


def _read_journal(path: Path) -> tuple[bytes, int] | None:
    # Versions up to 0.2 appended in place. After its end, a file may have a journal of changes that
    # were not applied before the process was killed. Its footer has the new size of the file.
    with path.open("rb") as file:
        start = file.seek(0, os.SEEK_END) - _FOOTER.size
        if start <= 0:
            return None
        file.seek(start)
        footer = file.read()
        if not footer.startswith(_MAGIC):
            return None
        magic, length, size, journal_sum, footer_sum = _FOOTER.unpack(footer)
        if zlib.crc32(_FOOTER.pack(magic, length, size, journal_sum, 0)) != footer_sum:
            return None
        if length + size > start:
            return None
        file.seek(start - length)
        journal = file.read(length)
    return (journal, size) if zlib.crc32(journal) == journal_sum else None


def _apply_journal(path: Path, changes: bytes, size: int) -> io.BytesIO:
    content = bytearray(path.read_bytes())
    position = 0
    while position < len(changes):
        offset, count = _ENTRY.unpack_from(changes, position)
        position += _ENTRY.size + count
        content[offset : offset + count] = changes[position - count : position]
    return io.BytesIO(content[:size])


def encode_texts(array: np.ndarray) -> np.ndarray:
    r"""Returns an array in its stored form, with strings as UTF-8 of a fixed length."""
    if array.dtype.kind != "U":
        return array
    texts: np.ndarray = np.char.encode(array, "utf-8")
    return texts.astype(f"S{max(texts.dtype.itemsize, 1)}")


def decode_texts(array: np.ndarray) -> np.ndarray:
    r"""Decodes an array of UTF-8 strings of a fixed length. Other arrays are returned unchanged."""
    if array.dtype.kind != "S":
        return array
    return np.char.decode(array, "utf-8").astype(str, copy=False)  # NumPy 1.26: floats if empty


def create_dataset(file: Any, name: str, array: np.ndarray) -> Any:
    r"""Writes an array as a data set of compressed chunks with checksums."""
    is_text = array.dtype.kind == "S"
    frames_per_chunk = max(1, _VALUES_PER_CHUNK // max(1, int(np.prod(array.shape[1:]))))
    return file.create_dataset(
        name,
        data=array.astype(require_h5py().string_dtype("utf-8", array.itemsize))
        if is_text
        else array,
        maxshape=(None, *array.shape[1:]),
        chunks=(
            min(frames_per_chunk, _MAX_FRAMES_PER_CHUNK),
            *(max(1, n) for n in array.shape[1:]),
        ),
        fillvalue=np.nan if array.dtype.kind == "f" else None,
        fletcher32=True,
        shuffle=True,
        compression="gzip",
        compression_opts=_GZIP_LEVEL,
    )


def read_rows(dataset: Any, num_frames: int, max_bytes: int) -> np.ndarray:
    r"""Reads the first rows of a data set. Strings of a fixed length stay encoded."""
    if dataset.dtype.kind == "O":
        return _read_long_texts(dataset, num_frames, max_bytes)
    array: np.ndarray = dataset[:num_frames]
    return array


def _read_long_texts(dataset: Any, num_frames: int, max_bytes: int) -> np.ndarray:
    texts_per_frame = int(np.prod(dataset.shape[1:]))
    frames_per_read = max(1, _TEXTS_PER_READ // max(texts_per_frame, 1))
    texts: list[str] = []
    max_length = 0
    for start in range(0, num_frames, frames_per_read):
        part = dataset.asstr()[start : min(start + frames_per_read, num_frames)].ravel().tolist()
        texts += part
        max_length = max(max_length, *map(len, part), 0)
        if 4 * max_length * num_frames * texts_per_frame > max_bytes:
            raise ValueError(f"its strings must take no more than {max_bytes} bytes in memory")
    return np.array(texts, dtype=str).reshape(num_frames, *dataset.shape[1:])
