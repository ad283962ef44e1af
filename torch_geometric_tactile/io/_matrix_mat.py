r"""Readers of MAT files, as written by ``save -v7`` and :func:`scipy.io.savemat`: matrices of
readings, and arrays by name.
"""

from collections.abc import Sequence

import numpy as np

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._files import existing_file
from torch_geometric_tactile._texts import quoted, short_list
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.io._mat_file import (
    MAT_ERRORS,
    MatVariable,
    byte_order,
    mat_numbers,
    mat_texts,
    mat_variables,
)


def read_matrix_mat(
    path: PathLike, size: Sequence[int] = (32, 32), variable: str | None = None
) -> np.ndarray:
    r"""Reads a matrix, or a stack of matrices of equal size, from a MAT file of versions 5 to 7.
    The size is checked before memory is allocated. Version 7.3, which is HDF5, is not supported.

    Uncompressed variables have no checksum, so damaged numbers are not detected.

    Args:
        path (str or PathLike): The file.
        size (sequence of int): Number of rows and of columns.
        variable (str, optional): Name of the variable. By default, the file must have a single
            numeric array.

    Returns:
        numpy.ndarray: The numbers in their type in MATLAB :math:`(n, rows, columns)`,
        with :math:`n = 1` for a single matrix.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If the file is of another format or version, is truncated or damaged, would take
            far more memory than its size, or does not have the variable; if it has several numeric
            variables and :obj:`variable` names none; if the array has the wrong size or type; or if
            its first and last axis cannot be told apart, since there are as many square matrices as
            rows. The message names the file.

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
        order = byte_order(data)
        matrix = _select_variable(list(mat_variables(data, order)), variable)
        _check_size(matrix, tuple(size))
        return mat_numbers(matrix, order, len(data)).reshape(-1, *size)
    except MAT_ERRORS as error:
        raise ValueError(f"'{path}' cannot be read as MAT: {error}") from error


def read_mat_variables(path: PathLike, names: Sequence[str]) -> dict[str, np.ndarray | list[str]]:
    r"""Reads variables from a MAT file of versions 5 to 7 by name: full arrays of real numbers, and
    cell arrays of strings in one row or column. Sizes are checked before memory is allocated, and
    other variables are not unpacked. Version 7.3, which is HDF5, is not supported.

    Uncompressed variables have no checksum, so damaged numbers are not detected.

    Args:
        path (str or PathLike): The file.
        names (sequence of str): The names of the variables.

    Returns:
        dict: The variables by name: numbers in their shape and type in MATLAB (logical values as
        integers), and strings as lists.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If the file is of another format or version, is truncated or damaged, would take
            far more memory than its size, or does not have a variable exactly once, as numbers or
            strings. The message names the file.

    Examples:
        >>> import tempfile
        >>> import scipy.io
        >>> content = {"id": [[0, 1, 1]], "objects": np.array(["mug", "ball"], dtype=object)}
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     scipy.io.savemat(f"{folder}/metadata.mat", content)
        ...     variables = read_mat_variables(f"{folder}/metadata.mat", ["id", "objects"])
        >>> variables["id"].tolist(), variables["objects"]
        ([[0, 1, 1]], ['mug', 'ball'])
    """
    path = existing_file(path, "give the path of a MAT file")
    data = path.read_bytes()
    try:
        order = byte_order(data)
        variables = list(mat_variables(data, order))
        content: dict[str, np.ndarray | list[str]] = {}
        for name in names:
            matches = [variable for variable in variables if variable.name == name]
            if len(matches) != 1 or not (matches[0].is_numeric or matches[0].is_cell):
                names_in_file = short_list([v.name for v in variables], 10, quoted, ending="")
                raise ValueError(
                    f"it must have one array '{name}' of numbers or strings (got {names_in_file})"
                )
            if matches[0].is_cell:
                content[name] = mat_texts(matches[0], order)
            else:
                content[name] = mat_numbers(matches[0], order, len(data))
        return content
    except MAT_ERRORS as error:
        raise ValueError(f"'{path}' cannot be read as MAT: {error}") from error


def _select_variable(variables: Sequence[MatVariable], name: str | None) -> MatVariable:
    names = [variable.name for variable in variables]
    if name is not None:
        matches = [variable for variable in variables if variable.name == name]
        if len(matches) != 1 or not matches[0].is_numeric:
            names_in_file = short_list(names, 10, quoted, ending="")
            raise ValueError(f"it must have one numeric array '{name}' (got {names_in_file})")
        return matches[0]
    matches = [variable for variable in variables if variable.is_numeric and variable.name]
    if len(matches) != 1:
        numeric_names = short_list([v.name for v in matches], 10, quoted, ending="")
        if not matches:
            numeric_names = f"none in {len(names)} variables"
        hint = ": name it by 'variable'" if matches else ""
        raise ValueError(f"it must have one numeric array (got {numeric_names}){hint}")
    return matches[0]


def _check_size(variable: MatVariable, size: tuple[int, ...]) -> None:
    shape = variable.shape
    if shape != size and (shape[1:] != size or shape[0] == 0):
        expected = " x ".join(map(str, size))
        # MATLAB usually stacks matrices along the last axis.
        hint = ": put the matrices first by permute(x, [3 1 2])" if shape[:2] == size else ""
        raise ValueError(
            f"'{variable.name}' must be a matrix of {expected} numbers or a stack of them (got "
            f"shape {shape}){hint}"
        )
    if shape[:2] == shape[1:]:
        raise ValueError(
            f"'{variable.name}' must not have as many matrices as rows and columns (got shape "
            f"{shape}, in which the matrices may be first or last): save the stack in two parts"
        )
    need(
        variable.is_real,
        f"'{variable.name}' must hold real numbers (got complex or logical numbers)",
    )
