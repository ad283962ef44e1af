r"""The variables of MAT files of version 5 to 7.

The reader is our own: :func:`scipy.io.loadmat` ends the process on a type of numbers that it does
not know, and takes memory as a damaged or hostile file says it needs, as :func:`scipy.io.whosmat`
does for the name of a variable.
"""

import math
import struct
import zlib
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._limits import MAT_BYTES, MAT_TEXT_BYTES, is_absurd

_HDF5 = b"\x89HDF\r\n\x1a\n"
_START = 128  # bytes of the file's header
_COMPRESSED, _MATRIX, _INT32, _UINT32, _INT8 = 15, 14, 5, 6, 1
_CELL, _TEXT = 1, 4  # classes
# numpy's types of the numbers as they are stored, and as they are in MATLAB, by their codes.
_STORED = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8"}
_STORED |= {12: "i8", 13: "u8"}
_CLASSES = {6: "f8", 7: "f4", 8: "i1", 9: "u1", 10: "i2", 11: "u2", 12: "i4", 13: "u4"}
_CLASSES |= {14: "i8", 15: "u8"}
_COMPLEX, _LOGICAL = 0x08, 0x02
_CODES = {1: "ascii", 2: "latin-1", 4: "utf-16", 16: "utf-8", 17: "utf-16"}  # of texts
_HEAD = 2**12  # bytes in which class, size and name are found


#: What reading a damaged file raises.
MAT_ERRORS = (ValueError, struct.error, zlib.error)


class MatVariable(NamedTuple):
    r"""A variable, whose :obj:`content` begins with its description once it is unpacked."""

    name: str
    kind: int
    flags: int
    shape: tuple[int, ...]
    content: bytes
    is_packed: bool

    @property
    def is_numeric(self) -> bool:
        r"""Whether it is a full array of numbers."""
        return self.kind in _CLASSES

    @property
    def is_real(self) -> bool:
        r"""Whether its numbers are neither complex nor logical."""
        return not self.flags & (_COMPLEX | _LOGICAL)

    @property
    def is_cell(self) -> bool:
        r"""Whether it is a cell array."""
        return self.kind == _CELL


def byte_order(data: bytes) -> str:
    r"""Returns how numbers are stored in a file, and checks that it is a MAT file."""
    if _HDF5 in (data[:8], data[512:520]):
        raise ValueError("it is of version 7.3 (HDF5): write it by save(..., '-v7')")
    if len(data) < _START:
        raise ValueError("it is no MAT file of version 5 to 7, or truncated: try save(..., '-v7')")
    order = {b"IM": "<", b"MI": ">"}.get(data[126:128])
    if order is None or 0 in data[:4]:
        raise ValueError("it is no MAT file of version 5 to 7, or truncated: try save(..., '-v7')")
    (version,) = struct.unpack(f"{order}H", data[124:126])
    need(version == 256, f"it is of version {version:#x}: write it by save(..., '-v7')")
    return order


def mat_variables(data: bytes, order: str) -> Iterator[MatVariable]:
    r"""Yields the variables of a file, not yet unpacked."""
    place = _START
    while place < len(data):
        kind, count, place = _tag(data, place, order)
        content = data[place : place + count]
        if len(content) < count:
            raise ValueError(
                f"it is truncated: a variable must have {count} bytes (got {len(content)})"
            )
        place += count
        is_packed = kind == _COMPRESSED
        if is_packed:
            head = _unpacked(content, _HEAD)
            kind, count, start = _tag(head, 0, order)
            head = head[start:]
        else:
            head = content[:_HEAD]
        if kind != _MATRIX:
            raise ValueError(f"it holds a part of type {kind} in place of a variable")
        yield _described(head, content, is_packed, order)


def _tag(data: bytes, place: int, order: str) -> tuple[int, int, int]:
    # Type and number of bytes of an element, and where they begin.
    need(len(data) >= place + 8, "it is truncated")
    kind, count = struct.unpack_from(f"{order}II", data, place)
    if kind >> 16:  # a small element has both in one number
        return kind & 0xFFFF, kind >> 16, place + 4
    return kind, count, place + 8


def _element(data: bytes, place: int, order: str) -> tuple[int, bytes, int]:
    # Type and bytes of an element, and where the next one begins.
    kind, count, start = _tag(data, place, order)
    is_small = start == place + 4
    need(not is_small or count <= 4, "a small part must have 4 bytes at most", count)
    content = data[start : start + count]
    need(len(content) >= count, f"it is truncated: a part must have {count} bytes", len(content))
    return kind, content, place + 8 if is_small else start + -(-count // 8) * 8


def _described(head: bytes, content: bytes, is_packed: bool, order: str) -> MatVariable:
    kind, flags, place = _element(head, 0, order)
    need(kind == _UINT32 and len(flags) == 8, "a variable has no description")
    (word,) = struct.unpack(f"{order}I", flags[:4])
    variable_class = word & 0xFF
    if variable_class not in (*_CLASSES, _CELL, _TEXT):  # not all of these have a size
        return MatVariable("", variable_class, 0, (), content, is_packed)
    kind, sizes, place = _element(head, place, order)
    if kind != _INT32 or len(sizes) % 4 or len(sizes) < 8:
        raise ValueError("a variable has no size")
    shape = struct.unpack(f"{order}{len(sizes) // 4}i", sizes)
    if min(shape) < 0:
        raise ValueError(f"a variable has the size {shape}")
    kind, name, place = _element(head, place, order)
    need(kind == _INT8 and name.isascii(), "a variable has no name")
    return MatVariable(name.decode(), variable_class, word >> 8 & 0xFF, shape, content, is_packed)


def mat_numbers(variable: MatVariable, order: str, num_stored: int) -> np.ndarray:
    r"""Returns the numbers of an array, logical ones as integers."""
    shape = variable.shape
    need(not variable.flags & _COMPLEX, f"'{variable.name}' must hold real numbers (got complex)")
    count = math.prod(shape)
    most = 2 * _HEAD + 8 * count
    if is_absurd(most, num_stored, MAT_BYTES):
        raise ValueError(f"'{variable.name}' would take {most} bytes, far more than the file")
    content = variable.content
    if variable.is_packed:
        content = _whole(content, most, order)
    place = 0
    for _ in range(3):  # description, size and name
        _, _, place = _element(content, place, order)
    stored, numbers, place = _element(content, place, order)
    need(stored in _STORED, f"'{variable.name}' has numbers of the unknown type {stored}")
    dtype = np.dtype(f"{order}{_STORED[stored]}")
    if len(numbers) != count * dtype.itemsize or place < len(content):
        raise ValueError(
            f"'{variable.name}' must have {count * dtype.itemsize} bytes of numbers (got "
            f"{len(numbers)}, and {max(0, len(content) - place)} behind them)"
        )
    given = np.frombuffer(numbers, dtype=dtype)
    with np.errstate(all="ignore"):
        found = given.astype(_CLASSES[variable.kind])
    if not np.array_equal(found, given, equal_nan=given.dtype.kind == "f"):
        raise ValueError(f"'{variable.name}' has numbers that do not fit its type {found.dtype}")
    return found.reshape(shape, order="F")


def mat_texts(variable: MatVariable, order: str) -> list[str]:
    r"""Returns the texts of a cell array in one row or column."""
    need(
        sum(size != 1 for size in variable.shape) <= 1,
        f"'{variable.name}' must be one row or column of texts (got shape {variable.shape})",
    )
    content = variable.content
    if variable.is_packed:
        content = _whole(content, MAT_TEXT_BYTES, order)
    need(len(content) <= MAT_TEXT_BYTES, f"'{variable.name}' has too many texts", len(content))
    place = 0
    for _ in range(3):  # description, size and name
        _, _, place = _element(content, place, order)
    texts = []
    for _ in range(math.prod(variable.shape)):
        kind, part, place = _element(content, place, order)
        need(kind == _MATRIX, f"'{variable.name}' must hold texts (got a part of type {kind})")
        texts.append(_text(part, variable.name, order) if part else "")
    need(place >= len(content), f"'{variable.name}' has more than its texts")
    return texts


def _text(part: bytes, name: str, order: str) -> str:
    found = _described(part, part, False, order)
    need(found.kind == _TEXT, f"'{name}' must hold texts (got an array of class {found.kind})")
    place = 0
    for _ in range(3):
        _, _, place = _element(part, place, order)
    kind, codes, _ = _element(part, place, order)
    need(kind in _CODES, f"'{name}' has a text of the unknown type {kind}")
    code = _CODES[kind] + ({"<": "-le", ">": "-be"}[order] if kind in (4, 17) else "")
    text = codes.decode(code)
    if len(text) != math.prod(found.shape) or found.shape[0] > 1:
        raise ValueError(
            f"'{name}' has a text of {len(text)} characters for the size {found.shape}"
        )
    return text


def _unpacked(content: bytes, most: int) -> bytes:
    return zlib.decompressobj().decompress(content, most)


def _whole(content: bytes, most: int, order: str) -> bytes:
    # To the end, where the checksum is compared.
    packer = zlib.decompressobj()
    data = packer.decompress(content, most)
    if not packer.eof or packer.unused_data:
        raise ValueError("a variable has other bytes than its description says")
    _, count, start = _tag(data, 0, order)
    need(len(data) == start + count, f"a variable must have {count} bytes", len(data) - start)
    return data[start:]
