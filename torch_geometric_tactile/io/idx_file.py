r"""Arrays of bytes in IDX files, the format of MNIST, packed by gzip or not."""

import gzip
import math
import struct
import zlib
from collections.abc import Callable
from io import BytesIO

import numpy as np

from torch_geometric_tactile._files import existing_file
from torch_geometric_tactile._limits import IDX_BYTES, is_absurd
from torch_geometric_tactile._typing import PathLike

_GZIP = b"\x1f\x8b"
_MOST_DIMENSIONS = 4
_BYTES = 0x08  # the code of unsigned bytes


def read_idx(path: PathLike) -> np.ndarray:
    r"""Reads the array of unsigned bytes in an IDX file. Its size is checked before memory is
    taken, and against the file. If the file is packed, its checksum is compared.

    Args:
        path (str or PathLike): The file, such as :obj:`train-images-idx3-ubyte.gz`.

    Returns:
        numpy.ndarray: The numbers, of type uint8, in the shape that the file says.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If the file is no IDX file of bytes, cut or damaged, has another number of bytes
            than its header says, or would take absurdly much memory. The message names the file.

    Examples:
        >>> import tempfile
        >>> from pathlib import Path
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = Path(folder) / "labels-idx1-ubyte"
        ...     _ = path.write_bytes(bytes([0, 0, 8, 1, 0, 0, 0, 3, 5, 0, 4]))
        ...     read_idx(path)
        array([5, 0, 4], dtype=uint8)
    """
    path = existing_file(path, "give the path of an IDX file")
    data = path.read_bytes()
    try:
        if data[:2] == _GZIP:
            with gzip.open(BytesIO(data)) as file:
                return _array(file.read, len(data))
        return _array(BytesIO(data).read, len(data))
    except (EOFError, OSError, ValueError, struct.error, zlib.error) as error:
        raise ValueError(
            f"'{path}' cannot be read as IDX: {error}; copy or download it again"
        ) from error


def _array(read: Callable[[int], bytes], num_stored: int) -> np.ndarray:
    magic = read(4)
    if len(magic) < 4 or magic[:2] != b"\0\0" or magic[2] != _BYTES:
        raise ValueError("it must hold an array of unsigned bytes (got another header)")
    if not 1 <= magic[3] <= _MOST_DIMENSIONS:
        raise ValueError(f"it must have 1 to {_MOST_DIMENSIONS} dimensions (got {magic[3]})")
    shape = struct.unpack(f">{magic[3]}I", read(4 * magic[3]))
    count = math.prod(shape)
    if is_absurd(count, num_stored, IDX_BYTES):
        raise ValueError(f"it would take {count} bytes, {count // num_stored} times the file")
    numbers = read(count + 1)  # one more: to the end, where the checksum is compared
    if len(numbers) != count:
        more = "more" if len(numbers) > count else len(numbers)
        raise ValueError(f"it must hold {count} numbers for the shape {shape} (got {more})")
    return np.frombuffer(numbers, dtype=np.uint8).reshape(shape)
