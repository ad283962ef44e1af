r"""The order of the columns that readings and angles were read from, where it is that of a file."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from torch_geometric_tactile._texts import short_list
from torch_geometric_tactile.data.recording import Recording

_KEYS = ("tactile", "joint")
_MOST_NAMES = 6


def column_names(recording: Recording) -> dict[str, list[str]]:
    r"""Returns the names of columns in :obj:`meta["column_names"]`: those of :obj:`"tactile"`,
    taxel by taxel each with its channels, and those of :obj:`"joint"`, as far as they are known.
    """
    known = recording.meta.get("column_names", {})
    sizes = (recording.num_taxels * recording.num_channels, recording.num_joints)
    out = {}
    for key, size in zip(_KEYS, sizes, strict=True):
        names = known.get(key) if isinstance(known, Mapping) else known
        if names is None:
            continue
        is_list = isinstance(names, list) and all(isinstance(name, str) for name in names)
        if not is_list or len({*names}) != size or len(names) != size:
            raise ValueError(
                f"'column_names' in 'meta' must name each of the {size} columns of '{key}' once "
                f"(got {str(names)[:80]}): leave it out if others were chosen since"
            )
        out[key] = names
    return out


def in_column_order(recording: Recording, columns: Mapping[str, Sequence[str]]) -> Recording:
    r"""Returns a recording with its readings and angles in the order of some names.

    Examples:
        >>> columns = {"tactile": ["thumb", "index"]}
        >>> recording = Recording([0.0], [[[1.0], [2.0]]], meta={"column_names": columns})
        >>> in_column_order(recording, {"tactile": ["index", "thumb"]}).tactile.tolist()
        [[[2.0], [1.0]]]
    """
    own = column_names(recording)
    changed = {}
    for key, order in column_places(own, columns).items():
        array = getattr(recording, key)
        changed[key] = array.reshape(len(array), -1)[:, order].reshape(array.shape)
        own[key] = list(columns[key])
    if not changed:
        return recording
    meta: dict[str, Any] = {**recording.meta, "column_names": own}
    return replace(recording, **changed, meta=meta)


def column_places(
    names: Mapping[str, Sequence[str]], wanted: Mapping[str, Sequence[str]]
) -> dict[str, list[int]]:
    r"""Returns where the columns of :obj:`"tactile"` and :obj:`"joint"` are that are wanted, for
    those that come in another order.

    Examples:
        >>> column_places({"joint": ["a", "b"]}, {"joint": ["b", "a"]})
        {'joint': [1, 0]}
    """
    places = {}
    for key in names.keys() & wanted.keys():
        if list(names[key]) == list(wanted[key]):
            continue
        place = {name: i for i, name in enumerate(names[key])}
        lacks = [name for name in wanted[key] if name not in place]
        more = [*place.keys() - {*wanted[key]}]
        if lacks or more:
            raise ValueError(
                f"its columns of '{key}' must have the names of the others, in any order (got "
                f"{_listed(sorted(more))} in place of {_listed(lacks)})"
            )
        places[key] = [place[name] for name in wanted[key]]
    return places


def _listed(names: Sequence[str]) -> str:
    return short_list(names, _MOST_NAMES, lambda name: repr(name[:60]))
