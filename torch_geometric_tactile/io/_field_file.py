r"""Named arrays of other people's HDF5 and npz files, with nothing known but their names.

Nothing that a file refers to outside of itself is read, nothing is unpickled, and sizes are checked
before memory is taken.
"""

import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from torch_geometric_tactile._files import existing_file
from torch_geometric_tactile._limits import ARRAY_BYTES, HDF5_EXPANSION, TEXT_BYTES
from torch_geometric_tactile.io._hdf5_checks import (
    check_hard_link,
    check_storage,
    check_type,
    hdf5_file,
    is_written,
)
from torch_geometric_tactile.io._hdf5_file import opened, read_rows, require_h5py
from torch_geometric_tactile.io._npz_arrays import opened_npz

_MOST_LISTED = 12
_SIGNATURES = {b"\x89HDF\r\n\x1a\n": "HDF5", b"PK\x03\x04": "npz"}


class Fields(NamedTuple):
    r"""What a file holds."""

    arrays: dict[str, np.ndarray]
    names: list[str]


def read_fields(path: Path, wanted: Iterable[str]) -> Fields:
    r"""Reads arrays by their names. A name with an :obj:`"@"` is an attribute of an HDF5 file:
    :obj:`"grasp@success"` of the group or array :obj:`grasp`, :obj:`"@success"` of the file.
    """
    existing_file(path, "give the path of an HDF5 or npz file")
    with path.open("rb") as file:
        head = file.read(8)
    kinds = [kind for start, kind in _SIGNATURES.items() if head.startswith(start)]
    if kinds == ["HDF5"]:
        return _hdf5_fields(path, wanted)
    if kinds == ["npz"]:
        with opened_npz(path, allow_large=False) as arrays:
            there = [*arrays.shapes]
            found = {name: arrays.read(name) for name in dict.fromkeys(wanted) if name in there}
        return Fields(found, sorted(there)[:_MOST_LISTED])
    what = f"one that begins with {head!r}" if head else "an empty file"
    raise ValueError(f"'{path}' must be an HDF5 or npz file (got {what}): copy or record it again")


def _hdf5_fields(path: Path, wanted: Iterable[str]) -> Fields:
    require_h5py()
    found: dict[str, np.ndarray] = {}
    left = max(ARRAY_BYTES, HDF5_EXPANSION * path.stat().st_size)
    with opened(hdf5_file(path)) as file:
        for name in dict.fromkeys(wanted):
            place, is_attribute, attribute = name.partition("@")
            owner = _object(path, file, place)
            if is_attribute and owner is not None and attribute in owner.attrs:
                found[name] = _attribute(path, owner.attrs, name, attribute)
            elif not is_attribute and owner is not None:
                found[name] = _dataset(path, owner, name, left)
                left -= found[name].nbytes
        return Fields(found, _names(file))


def _object(path: Path, file: Any, place: str) -> Any | None:
    # Each group on the way, since a link of another kind leads to another place or file.
    parts = [part for part in place.split("/") if part]
    for depth in range(1, len(parts) + 1):
        name = "/".join(parts[:depth])
        if file.get(name, getlink=True) is None:
            return None
        check_hard_link(path, file, name)
        if depth < len(parts) and not hasattr(file[name], "keys"):
            return None
    return file["/".join(parts)] if parts else file


def _attribute(path: Path, attrs: Any, name: str, attribute: str) -> np.ndarray:
    stored = attrs.get_id(attribute)
    check_type(path, name, stored.get_type())
    size = stored.get_type().get_size() * math.prod(stored.shape or ())
    if stored.shape is None or size > TEXT_BYTES:
        raise ValueError(f"'{path}' must hold one value in '{name}' (got {size} bytes)")
    return _plain(path, name, attrs[attribute])


def _dataset(path: Path, dataset: Any, name: str, left: int) -> np.ndarray:
    if getattr(dataset, "shape", None) is None:
        raise ValueError(f"'{path}' must hold an array in '{name}' (got {dataset})")
    check_storage(path, dataset, name)
    check_type(path, name, dataset.id.get_type())
    is_text = dataset.dtype.kind == "O"
    width = 8 if is_text else dataset.dtype.itemsize * (5 if dataset.dtype.kind == "S" else 1)
    size = math.prod(dataset.shape) * width
    if size > left:
        raise ValueError(
            f"'{path}' must hold arrays of at most {left} bytes in memory (got {size} in '{name}')"
        )
    if not is_written(dataset, dataset.shape):
        raise ValueError(
            f"'{path}' must hold all of '{name}', of shape {dataset.shape} (got "
            f"{dataset.id.get_storage_size()} bytes): is the file truncated? Copy or record it "
            "again"
        )
    if is_text and dataset.ndim:
        return read_rows(dataset, len(dataset), left)
    return _plain(path, name, dataset[()])


def _plain(path: Path, name: str, value: Any) -> np.ndarray:
    # Texts come as bytes, one by one.
    array = np.asarray(value)
    if array.dtype.kind not in "SO":
        return array
    texts = [item.decode() if isinstance(item, bytes) else item for item in array.ravel().tolist()]
    longest = max((len(text) for text in texts if isinstance(text, str)), default=0)
    if not all(isinstance(text, str) for text in texts) or longest * len(texts) * 4 > ARRAY_BYTES:
        raise ValueError(f"'{path}' must hold short texts in '{name}' (got others)")
    return np.array(texts, dtype=str).reshape(array.shape)


def _names(file: Any) -> list[str]:
    names: list[str] = [f"@{name}" for name in list(file.attrs)[:_MOST_LISTED]]

    def note(name: str, item: Any) -> bool | None:
        if hasattr(item, "shape"):
            names.append(name)
        return True if len(names) >= _MOST_LISTED else None

    file.visititems(note)
    return names[:_MOST_LISTED]
