r"""Named arrays in HDF5 and npz files that any program wrote.

Links to other files are not followed, nothing is unpickled, and sizes are checked before memory is
allocated.
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
    hdf5_path,
    is_stored,
)
from torch_geometric_tactile.io._hdf5_file import open_hdf5, read_rows, require_h5py
from torch_geometric_tactile.io._npz_arrays import open_npz

_MAX_LISTED = 12
_SIGNATURES = {b"\x89HDF\r\n\x1a\n": "HDF5", b"PK\x03\x04": "npz"}


class Fields(NamedTuple):
    r"""The content of a file.

    Args:
        arrays (dict): The requested arrays that the file holds, by name.
        names (list of str): Names in the file, at most twelve, for messages.
    """

    arrays: dict[str, np.ndarray]
    names: list[str]


def read_fields(path: Path, names: Iterable[str]) -> Fields:
    r"""Reads arrays by name. Names that are not in the file are left out.

    A name with an :obj:`"@"` is an attribute in an HDF5 file: :obj:`"grasp@success"` belongs to the
    group or array :obj:`grasp`, :obj:`"@success"` to the file.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is not an HDF5 or npz file, or is damaged or too large.
    """
    existing_file(path, "give the path of an HDF5 or npz file")
    with path.open("rb") as file:
        head = file.read(8)
    kinds = [kind for start, kind in _SIGNATURES.items() if head.startswith(start)]
    if kinds == ["HDF5"]:
        return _hdf5_fields(path, names)
    if kinds == ["npz"]:
        with open_npz(path, allow_large=False) as npz:
            stored_names = [*npz.shapes]
            arrays = {name: npz.read(name) for name in dict.fromkeys(names) if name in stored_names}
        return Fields(arrays, sorted(stored_names)[:_MAX_LISTED])
    content = f"a file that begins with {head!r}" if head else "an empty file"
    raise ValueError(
        f"'{path}' must be an HDF5 or npz file (got {content}): copy or record it again"
    )


def _hdf5_fields(path: Path, names: Iterable[str]) -> Fields:
    require_h5py()
    arrays: dict[str, np.ndarray] = {}
    max_bytes = max(ARRAY_BYTES, HDF5_EXPANSION * path.stat().st_size)
    with open_hdf5(hdf5_path(path)) as file:
        for name in dict.fromkeys(names):
            owner_name, is_attribute, attribute = name.partition("@")
            owner = _find_object(path, file, owner_name)
            if is_attribute and owner is not None and attribute in owner.attrs:
                arrays[name] = _read_attribute(path, owner.attrs, name, attribute)
            elif not is_attribute and owner is not None:
                arrays[name] = _read_dataset(path, owner, name, max_bytes)
                max_bytes -= arrays[name].nbytes
        return Fields(arrays, _list_names(file))


def _find_object(path: Path, file: Any, object_name: str) -> Any | None:
    # Checks each group of the path, since a soft or external link leads to another place or file.
    parts = [part for part in object_name.split("/") if part]
    for depth in range(1, len(parts) + 1):
        prefix = "/".join(parts[:depth])
        if file.get(prefix, getlink=True) is None:
            return None
        check_hard_link(path, file, prefix)
        if depth < len(parts) and not hasattr(file[prefix], "keys"):
            return None
    return file["/".join(parts)] if parts else file


def _read_attribute(path: Path, attrs: Any, name: str, attribute: str) -> np.ndarray:
    attribute_id = attrs.get_id(attribute)
    check_type(path, name, attribute_id.get_type())
    size = attribute_id.get_type().get_size() * math.prod(attribute_id.shape or ())
    if attribute_id.shape is None or size > TEXT_BYTES:
        raise ValueError(f"'{path}' must hold one value in '{name}' (got {size} bytes)")
    return _to_array(path, name, attrs[attribute])


def _read_dataset(path: Path, dataset: Any, name: str, max_bytes: int) -> np.ndarray:
    if getattr(dataset, "shape", None) is None:
        raise ValueError(f"'{path}' must hold an array in '{name}' (got {dataset})")
    check_storage(path, dataset, name)
    check_type(path, name, dataset.id.get_type())
    # Strings of variable length take a pointer each; fixed ones are copied from UTF-8 to UTF-32.
    is_text = dataset.dtype.kind == "O"
    width = 8 if is_text else dataset.dtype.itemsize * (5 if dataset.dtype.kind == "S" else 1)
    size = math.prod(dataset.shape) * width
    if size > max_bytes:
        raise ValueError(
            f"'{path}' must hold arrays of at most {max_bytes} bytes in memory (got {size} in "
            f"'{name}')"
        )
    if not is_stored(dataset, dataset.shape):
        raise ValueError(
            f"'{path}' must hold all of '{name}', of shape {dataset.shape} (got "
            f"{dataset.id.get_storage_size()} bytes): is the file truncated? Copy or record it "
            "again"
        )
    if is_text and dataset.ndim:
        return read_rows(dataset, len(dataset), max_bytes)
    return _to_array(path, name, dataset[()])


def _to_array(path: Path, name: str, value: Any) -> np.ndarray:
    # h5py returns strings as objects of bytes or str.
    array = np.asarray(value)
    if array.dtype.kind not in "SO":
        return array
    texts = [item.decode() if isinstance(item, bytes) else item for item in array.ravel().tolist()]
    max_length = max((len(text) for text in texts if isinstance(text, str)), default=0)
    if (
        not all(isinstance(text, str) for text in texts)
        or max_length * len(texts) * 4 > ARRAY_BYTES
    ):
        raise ValueError(f"'{path}' must hold short strings in '{name}' (got other values)")
    return np.array(texts, dtype=str).reshape(array.shape)


def _list_names(file: Any) -> list[str]:
    names: list[str] = [f"@{name}" for name in list(file.attrs)[:_MAX_LISTED]]

    def add_name(name: str, item: Any) -> bool | None:
        if hasattr(item, "shape"):
            names.append(name)
        return True if len(names) >= _MAX_LISTED else None

    file.visititems(add_name)
    return names[:_MAX_LISTED]
