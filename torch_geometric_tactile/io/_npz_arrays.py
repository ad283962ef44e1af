r"""Arrays of npz files. Their sizes are checked before memory is allocated, and their checksums are
compared.
"""

import math
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, NamedTuple

import numpy as np

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._files import UNREADABLE, check_packing, unreadable_error
from torch_geometric_tactile._limits import ARRAY_BYTES, is_absurd

_MAX_CODE_POINT = 0x10FFFF
_SUFFIX = ".npy"
_UTF8_NAME = 0x800
_END_SIGNATURE = b"PK\x05\x06"
_MAX_END_BYTES = 22 + 2**16  # of the end record of a zip file, with the longest comment


class ArrayHeader(NamedTuple):
    r"""The header of an array. :obj:`num_bytes` is the size of its numbers."""

    shape: tuple[int, ...]
    fortran_order: bool
    dtype: np.dtype
    num_bytes: int


class NpzArrays:
    r"""The arrays of an open npz file.

    Raises:
        ValueError: If an entry is not an array, or the arrays are far larger than the file.
    """

    def __init__(self, path: Path, archive: zipfile.ZipFile, allow_large: bool = False) -> None:
        self._archive = archive
        self._entries: dict[str, zipfile.ZipInfo] = {}
        for entry in archive.infolist():
            name = entry.filename.removesuffix(_SUFFIX)
            if not entry.filename.isascii() and not entry.flag_bits & _UTF8_NAME:
                raise ValueError(f"the name {entry.filename!r} has an unknown encoding")
            if name == entry.filename or name in self._entries:
                raise ValueError(f"its part {entry.filename!r} is not an array, or is repeated")
            check_packing(entry)
            self._entries[name] = entry
        # A wrong length in the table of contents hides the next entry.
        if len(self._entries) != _stated_num_entries(path):
            raise ValueError(
                f"it holds {_stated_num_entries(path)} parts (got {len(self._entries)})"
            )
        if self._entries and min(entry.header_offset for entry in self._entries.values()):
            raise ValueError("there are bytes before its first part, as if two files were joined")
        num_bytes = sum(entry.file_size for entry in self._entries.values())
        file_size = path.stat().st_size
        if not allow_large and is_absurd(num_bytes, file_size, ARRAY_BYTES):
            raise ValueError(
                f"its arrays would take {num_bytes / 2**30:.1f} GiB, {num_bytes // file_size} "
                "times the file, as in a file made to exhaust the memory: pass allow_large=True if "
                "you trust it"
            )
        self._headers = {name: self._read_header(name) for name in self._entries}

    @property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        r"""The shapes of the arrays by name."""
        return {name: header.shape for name, header in self._headers.items()}

    def _read_header(self, name: str) -> ArrayHeader:
        entry = self._entries[name]
        with self._archive.open(entry) as file:
            header, start = read_array_header(file, name)
        if start + header.num_bytes != entry.file_size:
            raise ValueError(
                f"its array '{name}' must take {start + header.num_bytes} bytes for the shape "
                f"{header.shape} (got {entry.file_size})"
            )
        return header

    def read(self, name: str) -> np.ndarray:
        r"""Returns an array, and compares its checksum."""
        with self._archive.open(self._entries[name]) as file:
            numbers = np.lib.format.read_array(file, allow_pickle=False)
            file.read(1)  # at the end of the entry, zipfile compares the checksum
        if numbers.dtype.kind == "U" and numbers.size:
            codes = np.ascontiguousarray(numbers).reshape(-1).view(numbers.dtype.str[0] + "u4")
            if codes.max() > _MAX_CODE_POINT:
                raise ValueError(f"its array '{name}' does not hold valid text")
        return numbers.astype(numbers.dtype.newbyteorder("="), copy=False)


def _stated_num_entries(path: Path) -> int:
    with path.open("rb") as file:
        file.seek(-min(path.stat().st_size, _MAX_END_BYTES), 2)
        tail = file.read()
    return int.from_bytes(tail[tail.rindex(_END_SIGNATURE) + 10 :][:2], "little")


def read_array_header(file: IO[bytes], name: str) -> tuple[ArrayHeader, int]:
    r"""Returns the header of an array in NumPy's format, and the position of its numbers."""
    version = np.lib.format.read_magic(file)
    if version == (1, 0):
        shape, fortran_order, dtype = np.lib.format.read_array_header_1_0(file)
    elif version == (2, 0):
        shape, fortran_order, dtype = np.lib.format.read_array_header_2_0(file)
    else:
        raise ValueError(
            f"its array '{name}' is in the unknown version {version} of NumPy's format"
        )
    if dtype.kind not in "biufU" or not dtype.itemsize:
        raise ValueError(f"its array '{name}' must hold numbers or strings (got {dtype})")
    need(not any(size < 0 for size in shape), f"its array '{name}' has the shape {shape}")
    num_bytes = math.prod(shape) * dtype.itemsize
    return ArrayHeader(shape, fortran_order, dtype, num_bytes), file.tell()


@contextmanager
def open_npz(path: Path, allow_large: bool) -> Iterator[NpzArrays]:
    r"""Opens an npz file, and yields its arrays.

    Raises:
        ValueError: If the file is damaged, truncated or not an npz file.
    """
    if not zipfile.is_zipfile(path):
        raise ValueError(
            f"'{path}' is not a complete npz file (is it truncated?): copy or write it again"
        )
    try:
        with zipfile.ZipFile(path) as archive:
            yield NpzArrays(path, archive, allow_large)
    except PermissionError:
        raise
    except UNREADABLE as error:
        raise unreadable_error(path, "npz", error) from error
