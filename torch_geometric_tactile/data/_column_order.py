r"""The order of the columns in a file from which readings and joint angles were read."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from torch_geometric_tactile._texts import short_list
from torch_geometric_tactile.data.recording import Recording

_KEYS = ("tactile", "joint")
_MAX_LISTED_NAMES = 6


def column_names(recording: Recording) -> dict[str, list[str]]:
    r"""Returns the column names of :obj:`"tactile"` and :obj:`"joint"` in
    :obj:`meta["column_names"]` of a recording. The columns of :obj:`"tactile"` are in the order of
    the taxels, where all channels of a taxel follow each other.

    Raises:
        ValueError: If the names are not a list, or do not name each column once.
    """
    meta_names = recording.meta.get("column_names", {})
    sizes = (recording.num_taxels * recording.num_channels, recording.num_joints)
    out = {}
    for key, size in zip(_KEYS, sizes, strict=True):
        names = meta_names.get(key) if isinstance(meta_names, Mapping) else meta_names
        if names is None:
            continue
        is_list = isinstance(names, list) and all(isinstance(name, str) for name in names)
        if not is_list or len({*names}) != size or len(names) != size:
            raise ValueError(
                f"'column_names' in 'meta' must name each of the {size} columns of '{key}' once "
                f"(got {str(names)[:80]}): remove it if the columns have changed since"
            )
        out[key] = names
    return out


def in_column_order(recording: Recording, columns: Mapping[str, Sequence[str]]) -> Recording:
    r"""Returns a recording with the columns of its readings and angles in the given order.

    Args:
        recording (Recording): The recording.
        columns (Mapping of str to sequence of str): Column names of :obj:`"tactile"` and
            :obj:`"joint"`, in the order of the output.

    Raises:
        ValueError: If the recording has columns with different names.

    Examples:
        >>> columns = {"tactile": ["thumb", "index"]}
        >>> recording = Recording([0.0], [[[1.0], [2.0]]], meta={"column_names": columns})
        >>> in_column_order(recording, {"tactile": ["index", "thumb"]}).tactile.tolist()
        [[[2.0], [1.0]]]
    """
    names = column_names(recording)
    reordered = {}
    for key, order in column_places(names, columns).items():
        array = getattr(recording, key)
        reordered[key] = array.reshape(len(array), -1)[:, order].reshape(array.shape)
        names[key] = list(columns[key])
    if not reordered:
        return recording
    meta: dict[str, Any] = {**recording.meta, "column_names": names}
    return replace(recording, **reordered, meta=meta)


def column_places(
    names: Mapping[str, Sequence[str]], target_names: Mapping[str, Sequence[str]]
) -> dict[str, list[int]]:
    r"""Returns the indices that reorder the columns of :obj:`"tactile"` and :obj:`"joint"`, for
    each of the two whose order differs.

    Args:
        names (Mapping of str to sequence of str): The names of the columns in their present order.
        target_names (Mapping of str to sequence of str): The same names in the new order.

    Raises:
        ValueError: If the two have different names.

    Examples:
        >>> column_places({"joint": ["a", "b"]}, {"joint": ["b", "a"]})
        {'joint': [1, 0]}
    """
    places = {}
    for key in names.keys() & target_names.keys():
        if list(names[key]) == list(target_names[key]):
            continue
        place = {name: i for i, name in enumerate(names[key])}
        missing_names = [name for name in target_names[key] if name not in place]
        extra_names = [*place.keys() - {*target_names[key]}]
        if missing_names or extra_names:
            raise ValueError(
                f"its columns of '{key}' must have the expected names, in any order (got "
                f"{_list_names(sorted(extra_names))} in place of {_list_names(missing_names)})"
            )
        places[key] = [place[name] for name in target_names[key]]
    return places


def _list_names(names: Sequence[str]) -> str:
    return short_list(names, _MAX_LISTED_NAMES, lambda name: repr(name[:60]))
