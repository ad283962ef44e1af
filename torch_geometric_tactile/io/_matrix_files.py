r"""Readers of matrices of readings in CSV, npy, PNG and MAT files."""

import struct
from collections.abc import Callable, Sequence
from io import BytesIO
from pathlib import Path

import numpy as np

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._files import UNREADABLE, existing_file, unreadable_error
from torch_geometric_tactile._limits import PNG_BYTES
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.io._csv_table import csv_numbers, csv_rows
from torch_geometric_tactile.io._matrix_mat import read_matrix_mat
from torch_geometric_tactile.io._npz_arrays import read_array_header

_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_GREY = 0
_COLOR_TYPES = {2: "RGB", 3: "a palette", 4: "grey with transparency", 6: "RGB with transparency"}
_BIT_DEPTHS = (8, 16)
_MODES = ("L", "I;16", "I")  # older versions of Pillow read 16 bits as the last mode


def read_matrix_csv(path: PathLike, size: Sequence[int] = (32, 32)) -> np.ndarray:
    r"""Reads a matrix from a CSV file without a header, as written by
    ``numpy.savetxt(path, matrix, delimiter=",")``. Empty cells are NaN.

    Args:
        path (str or PathLike): The file.
        size (sequence of int): Number of rows and of columns.

    Returns:
        numpy.ndarray: The numbers :math:`(1, rows, columns)`, in double precision.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If the file does not have the number of lines and cells of :obj:`size`, a cell
            is not a finite number, or the file is truncated. The message names file, line and
            column.

    Examples:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     np.savetxt(f"{folder}/press.csv", [[1, 2], [3, 4]], delimiter=",")
        ...     read_matrix_csv(f"{folder}/press.csv", size=(2, 2))
        array([[[1., 2.],
                [3., 4.]]])
    """
    path = existing_file(path, "give the path of a CSV file")
    num_rows, num_columns = size
    names = [f"column {i + 1}" for i in range(num_columns)]
    rows_read: list[np.ndarray] = []
    for line, row in csv_rows(path):
        if len(rows_read) == num_rows:
            raise ValueError(f"'{path}' must have {num_rows} lines (got more)")
        rows_read.append(csv_numbers(path, line, row, names))
    if len(rows_read) < num_rows:
        raise ValueError(
            f"'{path}' must have {num_rows} lines (got {len(rows_read)}): is the file truncated?"
        )
    return np.stack(rows_read)[None]


def read_matrix_npy(path: PathLike, size: Sequence[int] = (32, 32)) -> np.ndarray:
    r"""Reads a matrix, or a stack of matrices of equal size, from an npy file. The size is checked
    before memory is allocated, and nothing is unpickled.

    The format has no checksum, so damaged numbers are not detected.

    Args:
        path (str or PathLike): The file.
        size (sequence of int): The size of a matrix, such as rows and columns, or one number for
            rows of readings.

    Returns:
        numpy.ndarray: The numbers in their stored type :math:`(n, \ldots)`, with :math:`n = 1` for
        a single matrix.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If the file is not an npy file, is truncated or damaged, or does not hold real
            numbers of this size. The message names the file.

    Examples:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     np.save(f"{folder}/press.npy", np.ones((2, 3)))
        ...     read_matrix_npy(f"{folder}/press.npy", size=(2, 3)).shape
        (1, 2, 3)
    """
    path, size = existing_file(path, "give the path of an npy file"), tuple(size)
    with path.open("rb") as file:
        try:
            header, start = read_array_header(file, path.stem)
        except UNREADABLE as error:
            raise unreadable_error(path, "npy", error) from error
        need(header.dtype.kind in "iuf", f"'{path}' must hold numbers (got type {header.dtype})")
        shape = header.shape
        if shape != size and (shape[1:] != size or shape[0] == 0):
            expected = " x ".join(map(str, size))
            raise ValueError(
                f"'{path}' must hold a matrix of {expected} numbers or a stack of them (got shape "
                f"{shape})"
            )
        if start + header.num_bytes != path.stat().st_size:
            raise ValueError(
                f"'{path}' must have {start + header.num_bytes} bytes for the shape {shape} (got "
                f"{path.stat().st_size}): is it truncated? Copy or write it again"
            )
        numbers = np.fromfile(file, dtype=header.dtype)
    numbers = numbers.astype(header.dtype.newbyteorder("="), copy=False)
    return numbers.reshape(shape, order="F" if header.fortran_order else "C").reshape(-1, *size)


def read_matrix_png(path: PathLike, size: Sequence[int] = (32, 32)) -> np.ndarray:
    r"""Reads a grey PNG image with 8 or 16 bits. The size is checked before the image is
    decompressed, and all checksums are compared. Colour images are errors, since their conversion
    to grey is ambiguous.

    Args:
        path (str or PathLike): The file.
        size (sequence of int): Number of rows and of columns.

    Returns:
        numpy.ndarray: The grey values :math:`(1, rows, columns)`, of type uint8 or uint16.

    Raises:
        FileNotFoundError: If there is no such file.
        ImportError: If Pillow is missing.
        ValueError: If the file is not a PNG image, is truncated, damaged or too large, or is not a
            single grey image of this size. The message names the file.

    Examples:
        >>> import tempfile
        >>> from PIL import Image
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     Image.fromarray(np.uint8([[0, 128, 255]])).save(f"{folder}/press.png")
        ...     read_matrix_png(f"{folder}/press.png", size=(1, 3))
        array([[[  0, 128, 255]]], dtype=uint8)
    """
    path = existing_file(path, "give the path of a PNG file")
    if path.stat().st_size > PNG_BYTES:
        raise ValueError(
            f"'{path}' must have at most {PNG_BYTES} bytes, as a small image (got "
            f"{path.stat().st_size})"
        )
    data = path.read_bytes()
    depth = _read_depth(path, data, tuple(size))
    try:
        pixels = _read_pixels(data, tuple(size))
    except UNREADABLE as error:
        raise unreadable_error(path, "PNG", error) from error
    return pixels.astype(np.uint8 if depth == 8 else np.uint16)[None]


def _read_depth(path: Path, data: bytes, size: tuple[int, ...]) -> int:
    # The header is the first part of a PNG file, at a fixed position.
    if data[:8] != _PNG_SIGNATURE or data[8:16] != b"\x00\x00\x00\rIHDR" or len(data) < 33:
        raise ValueError(f"'{path}' must be a PNG image (got another format, or a truncated file)")
    num_columns, num_rows, depth, color_type = struct.unpack(">IIBB", data[16:26])
    if (num_rows, num_columns) != size:
        expected = " x ".join(map(str, size))
        raise ValueError(f"'{path}' must have {expected} pixels (got {num_rows} x {num_columns})")
    if color_type != _GREY:
        raise ValueError(
            f"'{path}' must be a grey image (got "
            f"{_COLOR_TYPES.get(color_type, f'colours of type {color_type}')}): save it in grey"
        )
    need(depth in _BIT_DEPTHS, f"'{path}' must have 8 or 16 bits per pixel", depth)
    return int(depth)


def _read_pixels(data: bytes, size: tuple[int, ...]) -> np.ndarray:
    try:
        from PIL import Image
    except ImportError as error:
        raise ImportError(
            'PNG images need Pillow: pip install "torch-geometric-tactile[io]"'
        ) from error

    try:
        with Image.open(BytesIO(data), formats=["PNG"]) as image:
            image.verify()  # decoding alone does not compare the checksums of the pixels
        with Image.open(BytesIO(data), formats=["PNG"]) as image:
            if image.size != size[::-1]:  # of a second header
                raise ValueError(f"it must declare one size (got also {image.size[::-1]})")
            if getattr(image, "n_frames", 1) > 1:
                raise ValueError("it must hold one image (got an animation)")
            need(image.mode in _MODES, f"it must be a grey image (got mode {image.mode})")
            return np.asarray(image)
    except Image.DecompressionBombError as error:
        raise ValueError(str(error)) from error


_READERS: dict[str, Callable[..., np.ndarray]] = {
    ".csv": read_matrix_csv,
    ".mat": read_matrix_mat,
    ".npy": read_matrix_npy,
    ".png": read_matrix_png,
}
_ROW_SUFFIXES = (".npy",)
#: The suffixes of files with matrices.
_MATRIX_SUFFIXES = tuple(sorted(_READERS))


def read_matrices(
    path: PathLike, size: Sequence[int] = (32, 32), variable: str | None = None
) -> np.ndarray:
    r"""Reads the matrices in a CSV, MAT, npy or PNG file, according to its suffix.

    Args:
        path (str or PathLike): The file.
        size (sequence of int): The number of rows and columns of a matrix, or one number for rows
            of readings (npy files only).
        variable (str, optional): Name of the variable in a MAT file.

    Returns:
        numpy.ndarray: The numbers in their stored type :math:`(n, \ldots)`.

    Raises:
        FileNotFoundError: If there is no such file.
        ImportError: If it is a PNG image, and Pillow is missing.
        ValueError: If the suffix is unknown, or the file cannot be read. The message names the
            file.

    Examples:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     np.save(f"{folder}/presses.npy", np.ones((5, 32, 32)))
        ...     read_matrices(f"{folder}/presses.npy").shape
        (5, 32, 32)
    """
    suffix = Path(path).suffix.lower()
    valid_suffixes = _MATRIX_SUFFIXES if len(size) == 2 else _ROW_SUFFIXES
    if suffix not in valid_suffixes:
        raise ValueError(f"'{path}' must have one of the suffixes {', '.join(valid_suffixes)}")
    if suffix == ".mat":
        return read_matrix_mat(path, size, variable)
    return _READERS[suffix](path, size=size)
