r"""Labelled samples as npz files of plain arrays, as :func:`numpy.savez` writes them."""

import logging

import numpy as np

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._files import existing_file
from torch_geometric_tactile._texts import quoted, short_list
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.io._npz_arrays import open_npz

#: The arrays of a file, and the names by which each is found.
_SAMPLE_ARRAYS: dict[str, tuple[str, ...]] = {
    "x": ("x", "X", "data", "readings", "tactile"),
    "y": ("y", "Y", "label", "labels", "target", "targets"),
    "trial": ("trial", "trials", "trial_id"),
    "group": ("group", "groups", "group_id", "object", "objects"),
    "set": ("set", "sets", "test_set"),
    "session": ("session", "sessions", "session_id"),
    "joint": ("joint", "joints"),
    "time": ("time", "t"),
    "part": ("part", "split"),
    "class_names": ("class_names", "label_names"),
    "pos": ("pos", "positions"),
    "normal": ("normal", "normals"),
    "edge_index": ("edge_index", "edges"),
}
# Groups, unless there is an array with a name of these above.
_PERSONS = tuple(
    f"{name}{end}" for name in ("person", "subject", "participant") for end in ("", "s", "_id")
)
_BY_NAME = {name: key for key, names in _SAMPLE_ARRAYS.items() for name in names}
_ROWS = ("y", "trial", "group", "session", "set", "joint", "time", "part")
_TEXTS = ("y", "trial", "group", "session", "set", "class_names", "part")
_logger = logging.getLogger(__name__)


def read_samples_npz(path: PathLike, allow_large: bool = False) -> dict[str, np.ndarray]:
    r"""Reads the arrays of an npz file with labelled samples. Sizes are checked before memory is
    taken, every array is compared with its checksum, and nothing is unpickled.

    The file holds the readings :obj:`x` :math:`(S, \ldots)` and the labels :obj:`y`
    :math:`(S, \ldots)`, and may hold :obj:`trial`, :obj:`group`, :obj:`session`, :obj:`set`,
    :obj:`joint`, :obj:`time` and :obj:`part` with a row for each sample, the :obj:`class_names`,
    and of the taxels :obj:`pos`, :obj:`normal` and :obj:`edge_index`. Other usual names, such as
    :obj:`labels`, are found as well (:obj:`SAMPLE_ARRAYS`), and a :obj:`person`, :obj:`subject` or
    :obj:`participant` is the group if there is no other; arrays with any other name are not
    read, and a warning is logged that names them.

    Args:
        path (str or PathLike): The file.
        allow_large (bool): Whether to read a file whose arrays take more than 1 GiB and more than
            200 times its own size, as a hostile one does.

    Returns:
        dict: The arrays by their names here, such as :obj:`"x"`.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If the file is no npz file, cut or damaged, holds pickled objects, would take
            absurdly much memory, has no readings or no labels, an array twice, texts in place of
            numbers, or different numbers of samples. The message names the file.

    Examples:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     np.savez(f"{folder}/touches.npz", x=np.ones((6, 16, 3)), labels=[0, 1, 0, 1, 0, 1])
        ...     arrays = read_samples_npz(f"{folder}/touches.npz")
        >>> {name: array.shape for name, array in arrays.items()}
        {'x': (6, 16, 3), 'y': (6,)}
    """
    path = existing_file(path, "give the path of an npz file")
    with open_npz(path, allow_large) as arrays:
        shapes = arrays.shapes
        found: dict[str, list[str]] = {}
        for name in shapes:
            if name in _BY_NAME:
                found.setdefault(_BY_NAME[name], []).append(name)
        persons = [name for name in _PERSONS if name in shapes]
        if persons:
            found.setdefault("group", persons[:1])
        problem = _problem(found, shapes)
        content = {}
        if not problem:
            content = {key: arrays.read(names[0]) for key, names in found.items()}
            problem = next(filter(None, map(_kind_problem, content, content.values())), "")
    need(not problem, f"'{path}' must hold labelled samples: {problem}")
    unknown = sorted(set(shapes) - set(_BY_NAME) - set(found.get("group", ())))
    if unknown:
        _logger.warning("'%s': not used: %s", path, short_list(unknown, 10, quoted, ending=""))
    return content


def _problem(found: dict[str, list[str]], shapes: dict[str, tuple[int, ...]]) -> str:
    for key in ("x", "y"):
        if key not in found:
            names = short_list(sorted(shapes), 10, quoted, ending="") if shapes else "no arrays"
            hint = " (a recording is not a data set: give its folder)" if "format" in shapes else ""
            return f"an array '{key}' is missing (got {names}){hint}"
    for key, same in found.items():
        if len(same) > 1:
            return f"only one of {same} may be there, since each is '{key}'"
    shape = shapes[found["x"][0]]
    if len(shape) < 2 or 0 in shape:
        return f"'x' must have shape (num_samples, num_taxels, ...), all positive (got {shape})"
    for key in _ROWS:
        rows = shapes[found[key][0]][:1] if key in found else shape[:1]
        if rows != shape[:1]:
            return f"'{key}' must have {shape[0]} rows, one for each of 'x' (got {rows})"
    return ""


def _kind_problem(key: str, array: np.ndarray) -> str:
    if array.dtype.kind == "U" and key not in _TEXTS:
        return f"'{key}' must hold numbers (got texts)"
    return ""
