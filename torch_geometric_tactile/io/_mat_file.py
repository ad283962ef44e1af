r"""The variables of MAT files of versions 5 to 7.

This module does not use SciPy. :func:`scipy.io.loadmat` crashes on an unknown type of numbers, and
allocates as much memory as a damaged or hostile file declares, and :func:`scipy.io.whosmat` does
the same for the name of a variable.
"""

import math
import struct
import zlib
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._limits import MAT_BYTES, MAT_TEXT_BYTES, is_absurd

_HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_HEADER_BYTES = 128  # of the file
_COMPRESSED, _MATRIX, _INT32, _UINT32, _INT8 = 15, 14, 5, 6, 1
_CELL_CLASS, _TEXT_CLASS = 1, 4  # classes
# NumPy's types for the codes of stored numbers, and for the classes of MATLAB.
_STORED_DTYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8"}
_STORED_DTYPES |= {12: "i8", 13: "u8"}
_CLASS_DTYPES = {6: "f8", 7: "f4", 8: "i1", 9: "u1", 10: "i2", 11: "u2", 12: "i4", 13: "u4"}
_CLASS_DTYPES |= {14: "i8", 15: "u8"}
_COMPLEX, _LOGICAL = 0x08, 0x02
_TEXT_ENCODINGS = {1: "ascii", 2: "latin-1", 4: "utf-16", 16: "utf-8", 17: "utf-16"}  # of strings
_MAX_HEADER_BYTES = 2**12  # of a variable: class, size and name


#: Errors that the functions below raise for a damaged file.
MAT_ERRORS = (ValueError, struct.error, zlib.error)


class MatVariable(NamedTuple):
    r"""A variable of a file. Its unpacked :obj:`content` begins with its header."""

    name: str
    kind: int
    flags: int
    shape: tuple[int, ...]
    content: bytes
    is_packed: bool

    @property
    def is_numeric(self) -> bool:
        r"""Whether the variable is a full array of numbers."""
        return self.kind in _CLASS_DTYPES

    @property
    def is_real(self) -> bool:
        r"""Whether the numbers are neither complex nor logical."""
        return not self.flags & (_COMPLEX | _LOGICAL)

    @property
    def is_cell(self) -> bool:
        r"""Whether the variable is a cell array."""
        return self.kind == _CELL_CLASS


def byte_order(data: bytes) -> str:
    r"""Returns the byte order of the numbers in a file, :obj:`"<"` or :obj:`">"`.

    Raises:
        ValueError: If it is not a MAT file of version 5 to 7.
    """
    if _HDF5_SIGNATURE in (data[:8], data[512:520]):
        raise ValueError("it has version 7.3 (HDF5): write it with save(..., '-v7')")
    if len(data) < _HEADER_BYTES:
        raise ValueError(
            "it is truncated, or not a MAT file of versions 5 to 7: try save(..., '-v7')"
        )
    order = {b"IM": "<", b"MI": ">"}.get(data[126:128])
    if order is None or 0 in data[:4]:
        raise ValueError(
            "it is truncated, or not a MAT file of versions 5 to 7: try save(..., '-v7')"
        )
    (version,) = struct.unpack(f"{order}H", data[124:126])
    need(version == 256, f"it has version {version:#x}: write it with save(..., '-v7')")
    return order


def mat_variables(data: bytes, order: str) -> Iterator[MatVariable]:
    r"""Yields the variables of a file without unpacking them."""
    position = _HEADER_BYTES
    while position < len(data):
        kind, count, position = _read_tag(data, position, order)
        content = data[position : position + count]
        if len(content) < count:
            raise ValueError(
                f"it is truncated: a variable must have {count} bytes (got {len(content)})"
            )
        position += count
        is_packed = kind == _COMPRESSED
        if is_packed:
            header = _unpack_start(content, _MAX_HEADER_BYTES)
            kind, count, start = _read_tag(header, 0, order)
            header = header[start:]
        else:
            header = content[:_MAX_HEADER_BYTES]
        if kind != _MATRIX:
            raise ValueError(f"it holds a part of type {kind} instead of a variable")
        yield _parse_header(header, content, is_packed, order)


def _read_tag(data: bytes, position: int, order: str) -> tuple[int, int, int]:
    # Returns the type and number of bytes of an element, and the position of its bytes.
    need(len(data) >= position + 8, "it is truncated")
    kind, count = struct.unpack_from(f"{order}II", data, position)
    if kind >> 16:  # a small element has both in one integer
        return kind & 0xFFFF, kind >> 16, position + 4
    return kind, count, position + 8


def _read_element(data: bytes, position: int, order: str) -> tuple[int, bytes, int]:
    # Returns the type and the bytes of an element, and the position of the next element.
    kind, count, start = _read_tag(data, position, order)
    is_small = start == position + 4
    need(not is_small or count <= 4, "a small part must have at most 4 bytes", count)
    content = data[start : start + count]
    need(len(content) >= count, f"it is truncated: a part must have {count} bytes", len(content))
    return kind, content, position + 8 if is_small else start + -(-count // 8) * 8


def _parse_header(header: bytes, content: bytes, is_packed: bool, order: str) -> MatVariable:
    kind, flags, position = _read_element(header, 0, order)
    need(kind == _UINT32 and len(flags) == 8, "a variable has no header")
    (word,) = struct.unpack(f"{order}I", flags[:4])
    variable_class = word & 0xFF
    if variable_class not in (
        *_CLASS_DTYPES,
        _CELL_CLASS,
        _TEXT_CLASS,
    ):  # other classes may have no size
        return MatVariable("", variable_class, 0, (), content, is_packed)
    kind, sizes, position = _read_element(header, position, order)
    if kind != _INT32 or len(sizes) % 4 or len(sizes) < 8:
        raise ValueError("a variable has no size")
    shape = struct.unpack(f"{order}{len(sizes) // 4}i", sizes)
    if min(shape) < 0:
        raise ValueError(f"a variable has the size {shape}")
    kind, name, position = _read_element(header, position, order)
    need(kind == _INT8 and name.isascii(), "a variable has no name")
    return MatVariable(name.decode(), variable_class, word >> 8 & 0xFF, shape, content, is_packed)


def mat_numbers(variable: MatVariable, order: str, num_stored: int) -> np.ndarray:
    r"""Returns the numbers of an array, with logical values as integers."""
    shape = variable.shape
    need(not variable.flags & _COMPLEX, f"'{variable.name}' must hold real numbers (got complex)")
    count = math.prod(shape)
    max_bytes = 2 * _MAX_HEADER_BYTES + 8 * count
    if is_absurd(max_bytes, num_stored, MAT_BYTES):
        raise ValueError(f"'{variable.name}' would take {max_bytes} bytes, far more than the file")
    content = variable.content
    if variable.is_packed:
        content = _unpack(content, max_bytes, order)
    position = 0
    for _ in range(3):  # flags, size and name
        _, _, position = _read_element(content, position, order)
    stored_type, numbers, position = _read_element(content, position, order)
    need(
        stored_type in _STORED_DTYPES,
        f"'{variable.name}' has numbers of the unknown type {stored_type}",
    )
    dtype = np.dtype(f"{order}{_STORED_DTYPES[stored_type]}")
    if len(numbers) != count * dtype.itemsize or position < len(content):
        raise ValueError(
            f"'{variable.name}' must have {count * dtype.itemsize} bytes of numbers (got "
            f"{len(numbers)}, and {max(0, len(content) - position)} after them)"
        )
    stored_numbers = np.frombuffer(numbers, dtype=dtype)
    with np.errstate(all="ignore"):
        array = stored_numbers.astype(_CLASS_DTYPES[variable.kind])
    if not np.array_equal(array, stored_numbers, equal_nan=stored_numbers.dtype.kind == "f"):
        raise ValueError(f"'{variable.name}' has numbers that do not fit its type {array.dtype}")
    return array.reshape(shape, order="F")


def mat_texts(variable: MatVariable, order: str) -> list[str]:
    r"""Returns the strings of a cell array, which must be one row or column."""
    need(
        sum(size != 1 for size in variable.shape) <= 1,
        f"'{variable.name}' must be one row or column of strings (got shape {variable.shape})",
    )
    content = variable.content
    if variable.is_packed:
        content = _unpack(content, MAT_TEXT_BYTES, order)
    need(len(content) <= MAT_TEXT_BYTES, f"'{variable.name}' has too many strings", len(content))
    position = 0
    for _ in range(3):  # flags, size and name
        _, _, position = _read_element(content, position, order)
    texts = []
    for _ in range(math.prod(variable.shape)):
        kind, element, position = _read_element(content, position, order)
        need(
            kind == _MATRIX, f"'{variable.name}' must hold strings (got an element of type {kind})"
        )
        texts.append(_read_text(element, variable.name, order) if element else "")
    need(position >= len(content), f"'{variable.name}' has bytes after its strings")
    return texts


def _read_text(element: bytes, name: str, order: str) -> str:
    header = _parse_header(element, element, False, order)
    need(
        header.kind == _TEXT_CLASS,
        f"'{name}' must hold strings (got an array of class {header.kind})",
    )
    position = 0
    for _ in range(3):
        _, _, position = _read_element(element, position, order)
    kind, codes, _ = _read_element(element, position, order)
    need(kind in _TEXT_ENCODINGS, f"'{name}' has a string of the unknown type {kind}")
    encoding = _TEXT_ENCODINGS[kind] + ({"<": "-le", ">": "-be"}[order] if kind in (4, 17) else "")
    text = codes.decode(encoding)
    if len(text) != math.prod(header.shape) or header.shape[0] > 1:
        raise ValueError(
            f"'{name}' has a string of {len(text)} characters for the size {header.shape}"
        )
    return text


def _unpack_start(content: bytes, max_bytes: int) -> bytes:
    return zlib.decompressobj().decompress(content, max_bytes)


def _unpack(content: bytes, max_bytes: int, order: str) -> bytes:
    # Unpacks to the end, where zlib compares the checksum.
    decompressor = zlib.decompressobj()
    data = decompressor.decompress(content, max_bytes)
    if not decompressor.eof or decompressor.unused_data:
        raise ValueError("the size of a variable differs from its header")
    _, count, start = _read_tag(data, 0, order)
    need(len(data) == start + count, f"a variable must have {count} bytes", len(data) - start)
    return data[start:]
