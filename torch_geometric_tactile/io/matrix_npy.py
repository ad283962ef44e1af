r"""Matrices of readings in npy files, as :func:`numpy.save` writes them."""

from collections.abc import Sequence

import numpy as np

from torch_geometric_tactile._files import UNREADABLE, existing_file, unreadable
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.io._npz_arrays import read_array_header


def read_matrix_npy(path: PathLike, size: Sequence[int] = (32, 32)) -> np.ndarray:
    r"""Reads a matrix, or a stack of matrices of one size. The size is checked before memory is
    taken, and nothing is unpickled.

    The format has no checksum: a number that was changed on the way is not noticed.

    Args:
        path (str or PathLike): The file.
        size (sequence of int): The size of a matrix, such as rows and columns; one number for rows
            of readings.

    Returns:
        numpy.ndarray: The numbers as they are stored :math:`(n, \ldots)`, with :math:`n = 1` for a
        single matrix.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If the file is no npy file, cut or damaged, holds anything else than real
            numbers, or an array of another size. The message names the file.

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
            raise unreadable(path, "npy", error) from error
        if header.dtype.kind not in "iuf":
            raise ValueError(f"'{path}' must hold numbers (got type {header.dtype})")
        shape = header.shape
        if shape != size and (shape[1:] != size or shape[0] == 0):
            wanted = " x ".join(map(str, size))
            raise ValueError(
                f"'{path}' must hold a matrix of {wanted} numbers or a stack of them (got shape "
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
