r"""Variables of MAT files, as ``save -v7`` and :func:`scipy.io.savemat` write them: matrices of
readings, and arrays by their names.
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
        order = byte_order(data)
        found = _chosen(list(mat_variables(data, order)), variable)
        _checked_size(found, tuple(size))
        return mat_numbers(found, order, len(data)).reshape(-1, *size)
    except MAT_ERRORS as error:
        raise ValueError(f"'{path}' cannot be read as MAT: {error}") from error


def read_mat_variables(path: PathLike, names: Sequence[str]) -> dict[str, np.ndarray | list[str]]:
    r"""Reads variables of a MAT file of version 5 to 7 by their names: full arrays of real numbers,
    and cell arrays of texts in one row or column. Sizes are checked before memory is taken; other
    variables are not unpacked. Version 7.3, which is HDF5, is not read.

    What is not compressed has no checksum: a number that was changed on the way is not noticed.

    Args:
        path (str or PathLike): The file.
        names (sequence of str): The names of the variables.

    Returns:
        dict: The numbers in the shape and type that they have in MATLAB, logical ones as integers,
        and the texts as lists, by the names of the variables.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If the file is of another format or version, cut or damaged, would take absurdly
            much memory, or does not have a variable once, as numbers or texts. The message names
            the file.

    Examples:
        >>> import tempfile
        >>> import scipy.io
        >>> content = {"id": [[0, 1, 1]], "objects": np.array(["mug", "ball"], dtype=object)}
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     scipy.io.savemat(f"{folder}/metadata.mat", content)
        ...     found = read_mat_variables(f"{folder}/metadata.mat", ["id", "objects"])
        >>> found["id"].tolist(), found["objects"]
        ([[0, 1, 1]], ['mug', 'ball'])
    """
    path = existing_file(path, "give the path of a MAT file")
    data = path.read_bytes()
    try:
        order = byte_order(data)
        variables = list(mat_variables(data, order))
        content: dict[str, np.ndarray | list[str]] = {}
        for name in names:
            found = [variable for variable in variables if variable.name == name]
            if len(found) != 1 or not (found[0].is_numeric or found[0].is_cell):
                listed = short_list([v.name for v in variables], 10, quoted, ending="")
                raise ValueError(
                    f"it must have one array '{name}' of numbers or texts (got {listed})"
                )
            if found[0].is_cell:
                content[name] = mat_texts(found[0], order)
            else:
                content[name] = mat_numbers(found[0], order, len(data))
        return content
    except MAT_ERRORS as error:
        raise ValueError(f"'{path}' cannot be read as MAT: {error}") from error


def _chosen(variables: Sequence[MatVariable], name: str | None) -> MatVariable:
    names = [variable.name for variable in variables]
    if name is not None:
        found = [variable for variable in variables if variable.name == name]
        if len(found) != 1 or not found[0].is_numeric:
            listed = short_list(names, 10, quoted, ending="")
            raise ValueError(f"it must have one numeric array '{name}' (got {listed})")
        return found[0]
    found = [variable for variable in variables if variable.is_numeric and variable.name]
    if len(found) != 1:
        numeric = short_list([v.name for v in found], 10, quoted, ending="")
        if not found:
            numeric = f"none in {len(names)} variables"
        hint = ": name it by 'variable'" if found else ""
        raise ValueError(f"it must have one numeric array (got {numeric}){hint}")
    return found[0]


def _checked_size(variable: MatVariable, size: tuple[int, ...]) -> None:
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
    need(
        variable.is_real,
        f"'{variable.name}' must hold real numbers (got complex or logical ones)",
    )
