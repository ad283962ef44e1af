r"""Files of matrices: the formats by suffix."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.io.matrix_csv import read_matrix_csv
from torch_geometric_tactile.io.matrix_mat import read_matrix_mat
from torch_geometric_tactile.io.matrix_npy import read_matrix_npy
from torch_geometric_tactile.io.matrix_png import read_matrix_png

_READERS: dict[str, Callable[..., np.ndarray]] = {
    ".csv": read_matrix_csv,
    ".mat": read_matrix_mat,
    ".npy": read_matrix_npy,
    ".png": read_matrix_png,
}
_ROW_SUFFIXES = (".npy",)
#: The suffixes of files of matrices.
_MATRIX_SUFFIXES = tuple(sorted(_READERS))


def read_matrices(
    path: PathLike, size: Sequence[int] = (32, 32), variable: str | None = None
) -> np.ndarray:
    r"""Reads the matrices of a file, by its suffix.

    Args:
        path (str or PathLike): The file.
        size (sequence of int): The size of a matrix, rows and columns; one number for rows of
            readings, which are read from npy files only.
        variable (str, optional): Name of the variable of MAT files.

    Returns:
        numpy.ndarray: The numbers as they are stored :math:`(n, \ldots)`.

    Raises:
        FileNotFoundError: If there is no such file.
        ImportError: If it is a PNG image, and Pillow is missing.
        ValueError: If the suffix is of no known format, or the file cannot be read. The message
            names the file.

    Examples:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     np.save(f"{folder}/presses.npy", np.ones((5, 32, 32)))
        ...     read_matrices(f"{folder}/presses.npy").shape
        (5, 32, 32)
    """
    suffix = Path(path).suffix.lower()
    known = _MATRIX_SUFFIXES if len(size) == 2 else _ROW_SUFFIXES
    if suffix not in known:
        raise ValueError(f"'{path}' must have one of the suffixes {', '.join(known)}")
    if suffix == ".mat":
        return read_matrix_mat(path, size, variable)
    return _READERS[suffix](path, size=size)
