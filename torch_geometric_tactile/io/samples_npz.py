r"""Reader of labelled samples in npz files written by :func:`numpy.savez`."""

import logging

import numpy as np

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._files import existing_file
from torch_geometric_tactile._texts import quoted, short_list
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.io._npz_arrays import open_npz

#: The arrays of a file, and their accepted names.
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
# Further names of the groups, used if there is no array with one of the names above.
_PERSON_NAMES = tuple(
    f"{name}{end}" for name in ("person", "subject", "participant") for end in ("", "s", "_id")
)
_KEY_OF_NAME = {name: key for key, names in _SAMPLE_ARRAYS.items() for name in names}
_SAMPLE_KEYS = ("y", "trial", "group", "session", "set", "joint", "time", "part")
_TEXT_KEYS = ("y", "trial", "group", "session", "set", "class_names", "part")
_logger = logging.getLogger(__name__)


def read_samples_npz(path: PathLike, allow_large: bool = False) -> dict[str, np.ndarray]:
    r"""Reads the arrays of an npz file with labelled samples. Sizes are checked before memory is
    allocated, all checksums are compared, and nothing is unpickled.

    The file holds the readings :obj:`x` :math:`(S, \ldots)` and the labels :obj:`y`
    :math:`(S, \ldots)`. It may hold :obj:`trial`, :obj:`group`, :obj:`session`, :obj:`set`,
    :obj:`joint`, :obj:`time` and :obj:`part` with one row per sample, the :obj:`class_names`, and
    :obj:`pos`, :obj:`normal` and :obj:`edge_index` of the taxels. Other common names, such as
    :obj:`labels`, are accepted as well. An array :obj:`person`, :obj:`subject` or
    :obj:`participant` is the group if there is no other group. Other arrays :math:`(S,)` of strings
    or integers, such as :obj:`person` beside a :obj:`group`, are read under their names, and
    samples can be split by them. The remaining arrays are ignored, and a warning names them.

    Args:
        path (str or PathLike): The file.
        allow_large (bool): Whether to read a file whose arrays take more than 1 GiB and more than
            200 times its size, as in a hostile file.

    Returns:
        dict: The arrays by the names above, such as :obj:`"x"`.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If the file is not an npz file, is truncated or damaged, holds pickled objects,
            would take far more memory than its size, has no readings or no labels, has two names
            for the same array, has strings instead of numbers, or has different numbers of samples.
            The message names the file.

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
        names_of_key: dict[str, list[str]] = {}
        for name in shapes:
            if name in _KEY_OF_NAME:
                names_of_key.setdefault(_KEY_OF_NAME[name], []).append(name)
        person_names = [name for name in _PERSON_NAMES if name in shapes]
        if person_names:
            names_of_key.setdefault("group", person_names[:1])
        problem = _find_problem(names_of_key, shapes)
        content = {}
        if not problem:
            content = {key: arrays.read(names[0]) for key, names in names_of_key.items()}
            problem = next(filter(None, map(_find_dtype_problem, content, content.values())), "")
        need(not problem, f"'{path}' must hold labelled samples: {problem}")
        units = {
            name: arrays.read(name)
            for name in sorted(set(shapes) - set(_KEY_OF_NAME))
            if shapes[name] == content["x"].shape[:1]
        }
    content |= {name: array for name, array in units.items() if array.dtype.kind in "iuU"}
    used = {*_KEY_OF_NAME, *content, *names_of_key.get("group", ())}
    unknown = sorted(set(shapes) - used)
    if unknown:
        _logger.warning(
            "'%s': ignored the arrays %s", path, short_list(unknown, 10, quoted, ending="")
        )
    return content


def _find_problem(names_of_key: dict[str, list[str]], shapes: dict[str, tuple[int, ...]]) -> str:
    for key in ("x", "y"):
        if key not in names_of_key:
            names = short_list(sorted(shapes), 10, quoted, ending="") if shapes else "no arrays"
            hint = " (a recording is not a data set: pass its folder)" if "format" in shapes else ""
            return f"an array '{key}' is missing (got {names}){hint}"
    for key, aliases in names_of_key.items():
        if len(aliases) > 1:
            return f"it must have only one of {aliases}, since each of them means '{key}'"
    shape = shapes[names_of_key["x"][0]]
    if len(shape) < 2 or 0 in shape:
        return f"'x' must have shape (num_samples, num_taxels, ...), all positive (got {shape})"
    for key in _SAMPLE_KEYS:
        num_rows = shapes[names_of_key[key][0]][:1] if key in names_of_key else shape[:1]
        if num_rows != shape[:1]:
            return f"'{key}' must have {shape[0]} rows, one for each of 'x' (got {num_rows})"
    return ""


def _find_dtype_problem(key: str, array: np.ndarray) -> str:
    if array.dtype.kind == "U" and key not in _TEXT_KEYS:
        return f"'{key}' must hold numbers (got strings)"
    return ""
