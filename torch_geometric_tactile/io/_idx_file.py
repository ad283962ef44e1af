r"""Reader of arrays of bytes in IDX files, the format of MNIST, with or without gzip."""

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

_GZIP_SIGNATURE = b"\x1f\x8b"
_MAX_DIMENSIONS = 4
_UNSIGNED_BYTE = 0x08  # type code of the format


def read_idx(path: PathLike) -> np.ndarray:
    r"""Reads the array of unsigned bytes in an IDX file. The declared size is checked before memory
    is allocated. For a gzip file, the checksum is compared.

    Args:
        path (str or PathLike): The file, such as :obj:`train-images-idx3-ubyte.gz`.

    Returns:
        numpy.ndarray: The numbers, of type uint8, in the shape declared by the file.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If the file is not an IDX file of bytes, is truncated or damaged, does not have
            the number of bytes that its header declares, or would take far more memory than its
            size. The message names the file.

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
        if data[:2] == _GZIP_SIGNATURE:
            with gzip.open(BytesIO(data)) as file:
                return _read_array(file.read, len(data))
        return _read_array(BytesIO(data).read, len(data))
    except (EOFError, OSError, ValueError, struct.error, zlib.error) as error:
        raise ValueError(
            f"'{path}' cannot be read as IDX: {error}; copy or download it again"
        ) from error


def _read_array(read: Callable[[int], bytes], file_size: int) -> np.ndarray:
    header = read(4)
    if len(header) < 4 or header[:2] != b"\0\0" or header[2] != _UNSIGNED_BYTE:
        raise ValueError("it must hold an array of unsigned bytes (got another header)")
    if not 1 <= header[3] <= _MAX_DIMENSIONS:
        raise ValueError(f"it must have 1 to {_MAX_DIMENSIONS} dimensions (got {header[3]})")
    shape = struct.unpack(f">{header[3]}I", read(4 * header[3]))
    count = math.prod(shape)
    if is_absurd(count, file_size, IDX_BYTES):
        raise ValueError(f"it would take {count} bytes, {count // file_size} times the file")
    numbers = read(count + 1)  # one extra byte reads to the end, where gzip compares the checksum
    if len(numbers) != count:
        num_read = "more" if len(numbers) > count else len(numbers)
        raise ValueError(f"it must hold {count} numbers for the shape {shape} (got {num_read})")
    return np.frombuffer(numbers, dtype=np.uint8).reshape(shape)
