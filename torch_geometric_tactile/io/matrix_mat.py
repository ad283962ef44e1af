r"""Matrices of readings in MAT files, as ``save -v7`` and :func:`scipy.io.savemat` write them.

The reader is our own: :func:`scipy.io.loadmat` ends the process on a type of numbers that it does
not know, and takes memory as a damaged or hostile file says it needs, as :func:`scipy.io.whosmat`
does for the name of a variable. It reads numbers only.
"""

import math
import struct
import zlib
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._files import existing_file
from torch_geometric_tactile._limits import MAT_BYTES, is_absurd
from torch_geometric_tactile._texts import quoted, short_list
from torch_geometric_tactile._typing import PathLike

_HDF5 = b"\x89HDF\r\n\x1a\n"
_START = 128  # bytes of the file's header
_COMPRESSED, _MATRIX, _INT32, _UINT32, _INT8 = 15, 14, 5, 6, 1
# numpy's types of the numbers as they are stored, and as they are in MATLAB, by their codes.
_STORED = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8"}
_STORED |= {12: "i8", 13: "u8"}
_CLASSES = {6: "f8", 7: "f4", 8: "i1", 9: "u1", 10: "i2", 11: "u2", 12: "i4", 13: "u4"}
_CLASSES |= {14: "i8", 15: "u8"}
_COMPLEX, _LOGICAL = 0x08, 0x02
_HEAD = 2**12  # bytes in which class, size and name are found


class _Variable(NamedTuple):
    # `content` begins with the description, once it is unpacked.
    name: str
    kind: int
    flags: int
    shape: tuple[int, ...]
    content: bytes
    is_packed: bool

    @property
    def is_numeric(self) -> bool:
        return self.kind in _CLASSES


def read_matrix_mat(
    path: PathLike, size: Sequence[int] = (32, 32), variable: str | None = None
) -> np.ndarray:
    r"""Reads a matrix, or a stack of matrices of one size, from a MAT file of version 5 to 7. The
    size is checked before memory is taken. Version 7.3, which is HDF5, is not read.

    What is not compressed has no checksum: a number that was changed on the way is not noticed.

    Args:
        path (str or PathLike): The file.
        size (sequence of int): Number of rows and of columns.
        variable (str, optional): Name of the variable. If left out, the file must have one numeric
            array.

    Returns:
        numpy.ndarray: The numbers in the type that they have in MATLAB :math:`(n, rows, columns)`,
        with :math:`n = 1` for a single matrix.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If the file is of another format or version, cut or damaged, would take absurdly
            much memory, does not have the variable, has several numeric ones and none is named, or
            an array of another size or kind, or as many square matrices as they have rows, which
            may be first or last in it. The message names the file.

    Examples:
        >>> import tempfile
        >>> import scipy.io
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     scipy.io.savemat(f"{folder}/presses.mat", {"presses": np.ones((5, 2, 3))})
        ...     read_matrix_mat(f"{folder}/presses.mat", size=(2, 3)).shape
        (5, 2, 3)
    """
    path = existing_file(path, "give the path of a MAT file")
    data = path.read_bytes()
    try:
        order = _byte_order(data)
        found = _chosen(list(_variables(data, order)), variable)
        return _numbers(found, tuple(size), order, len(data))
    except (ValueError, struct.error, zlib.error) as error:
        raise ValueError(f"'{path}' cannot be read as MAT: {error}") from error


def _byte_order(data: bytes) -> str:
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


def _variables(data: bytes, order: str) -> Iterator[_Variable]:
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


def _described(head: bytes, content: bytes, is_packed: bool, order: str) -> _Variable:
    kind, flags, place = _element(head, 0, order)
    need(kind == _UINT32 and len(flags) == 8, "a variable has no description")
    (word,) = struct.unpack(f"{order}I", flags[:4])
    variable_class = word & 0xFF
    if variable_class not in _CLASSES:  # not all of these have a size
        return _Variable("", variable_class, 0, (), content, is_packed)
    kind, sizes, place = _element(head, place, order)
    if kind != _INT32 or len(sizes) % 4 or len(sizes) < 8:
        raise ValueError("a variable has no size")
    shape = struct.unpack(f"{order}{len(sizes) // 4}i", sizes)
    if min(shape) < 0:
        raise ValueError(f"a variable has the size {shape}")
    kind, name, place = _element(head, place, order)
    need(kind == _INT8 and name.isascii(), "a variable has no name")
    return _Variable(name.decode(), variable_class, word >> 8 & 0xFF, shape, content, is_packed)


def _chosen(variables: Sequence[_Variable], name: str | None) -> _Variable:
    names = [variable.name for variable in variables]
    if name is not None:
        found = [variable for variable in variables if variable.name == name]
        if len(found) != 1 or not found[0].is_numeric:
            listed = short_list(names, 10, quoted, rest="")
            raise ValueError(f"it must have one numeric array '{name}' (got {listed})")
        return found[0]
    found = [variable for variable in variables if variable.is_numeric and variable.name]
    if len(found) != 1:
        numeric = short_list([v.name for v in found], 10, quoted, rest="")
        if not found:
            numeric = f"none in {len(names)} variables"
        hint = ": name it by 'variable'" if found else ""
        raise ValueError(f"it must have one numeric array (got {numeric}){hint}")
    return found[0]


def _numbers(variable: _Variable, size: tuple[int, ...], order: str, num_stored: int) -> np.ndarray:
    shape = variable.shape
    if shape != size and (shape[1:] != size or shape[0] == 0):
        wanted = " x ".join(map(str, size))
        hint = ": put the matrices first by permute(x, [3 1 2])" if shape[:2] == size else ""
        raise ValueError(
            f"'{variable.name}' must be a matrix of {wanted} numbers or a stack of them (got shape "
            f"{shape}){hint}"
        )
    if shape[:2] == shape[1:]:
        raise ValueError(
            f"'{variable.name}' must have another number of matrices than of rows and columns (got "
            f"shape {shape}, in which they may be first or last): save two parts of the stack"
        )
    if variable.flags & (_COMPLEX | _LOGICAL):
        raise ValueError(f"'{variable.name}' must hold real numbers (got complex or logical ones)")
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
    return found.reshape(shape, order="F").reshape(-1, *size)


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
