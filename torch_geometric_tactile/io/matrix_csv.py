r"""A matrix of readings as lines of numbers."""

from collections.abc import Sequence

import numpy as np

from torch_geometric_tactile._files import existing_file
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.io._csv_table import csv_numbers, csv_rows


def read_matrix_csv(path: PathLike, size: Sequence[int] = (32, 32)) -> np.ndarray:
    r"""Reads a matrix from a CSV file without a header: a line for each row, with commas between
    the numbers, as ``numpy.savetxt(path, matrix, delimiter=",")`` writes it. Empty cells are NaN.

    Args:
        path (str or PathLike): The file.
        size (sequence of int): Number of rows and of columns.

    Returns:
        numpy.ndarray: The numbers :math:`(1, rows, columns)`, in double precision.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If the file has another number of lines or of cells in a line, a cell is no
            finite number, or the last line has no end, as in a file that was cut. The message names
            file, line and column.

    Examples:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     np.savetxt(f"{folder}/press.csv", [[1, 2], [3, 4]], delimiter=",")
        ...     read_matrix_csv(f"{folder}/press.csv", size=(2, 2))
        array([[[1., 2.],
                [3., 4.]]])
    """
    path = existing_file(path, "give the path of a CSV file")
    rows, columns = size
    names = [f"column {i + 1}" for i in range(columns)]
    found: list[np.ndarray] = []
    for line, row in csv_rows(path):
        if len(found) == rows:
            raise ValueError(f"'{path}' must have {rows} lines (got more)")
        found.append(csv_numbers(path, line, row, names))
    if len(found) < rows:
        raise ValueError(
            f"'{path}' must have {rows} lines (got {len(found)}): is the file truncated?"
        )
    return np.stack(found)[None]
