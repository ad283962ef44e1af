r"""Checks of an HDF5 file before its arrays are read: it must not refer to other files, and its
declared sizes must match the bytes in it.
"""

import math
from pathlib import Path
from typing import Any

import numpy as np

from torch_geometric_tactile._limits import ARRAY_BYTES, HDF5_EXPANSION
from torch_geometric_tactile.io._hdf5_file import require_h5py
from torch_geometric_tactile.io._recording_schema import (
    FORMAT,
    GROUPS,
    missing_field,
    recording_path,
)

_FILTERS = {1: "gzip", 2: "shuffle", 3: "fletcher32"}  # the numbers of HDF5


def find_datasets(path: Path, file: Any) -> dict[str, Any]:
    r"""Returns the data sets of a recording by name.

    Raises:
        ValueError: If a data set is missing or invalid.
    """
    stored_names = list(file)
    fields = ("time", "tactile", "joint", "action")
    names: list[str] = [name for name in fields if name in stored_names]
    for name in ("time", "tactile"):
        if name not in names:
            raise missing_field(path, name)
    for prefix in GROUPS:
        if prefix[:-1] in stored_names:
            check_hard_link(path, file, prefix[:-1])
            group = file[prefix[:-1]]
            if not isinstance(group, type(file["/"])):
                raise ValueError(f"'{path}' must hold a group in '{prefix[:-1]}' (got {group})")
            names += [prefix + name for name in group]
    return {name: find_dataset(path, file, name) for name in names}


def find_dataset(path: Path, file: Any, name: str) -> Any:
    r"""Returns a data set.

    Raises:
        ValueError: If it is missing, in another file, or has an unsupported type.
    """
    if name not in file:
        raise missing_field(path, name)
    check_hard_link(path, file, name)
    dataset = file[name]
    if not isinstance(dataset, require_h5py().Dataset) or not dataset.shape:
        raise ValueError(f"'{path}' must hold an array in '{name}' (got {dataset})")
    check_storage(path, dataset, name)
    check_type(path, name, dataset.id.get_type())
    return dataset


def check_type(path: Path, name: str, hdf5_type: Any) -> None:
    r"""Raises an error unless a type is a number of at most 8 bytes, a boolean or a string."""
    h5t = require_h5py().h5t
    is_number = hdf5_type.get_class() in (h5t.INTEGER, h5t.FLOAT) and hdf5_type.get_size() <= 8
    is_text = hdf5_type.get_class() == h5t.STRING
    is_bool = hdf5_type.get_class() == h5t.ENUM and hdf5_type.dtype == np.dtype(bool)
    if hdf5_type.committed() or not (is_number or is_text or is_bool):
        raise ValueError(
            f"'{path}' must hold numbers, booleans or strings in '{name}' (got "
            f"{'a named type' if hdf5_type.committed() else hdf5_type.dtype})"
        )


def check_storage(path: Path, dataset: Any, name: str) -> None:
    r"""Raises an error unless a data set is stored in the file itself, uncompressed or by gzip."""
    properties = dataset.id.get_create_plist()
    if properties.get_layout() == require_h5py().h5d.VIRTUAL or properties.get_external_count():
        raise ValueError(
            f"'{path}' must hold '{name}' itself (got a virtual or external array, whose numbers "
            "are in other files): copy the data into the file"
        )
    chunk_bytes = math.prod(dataset.chunks or (0,)) * dataset.dtype.itemsize
    if chunk_bytes > max(ARRAY_BYTES, path.stat().st_size):
        raise ValueError(
            f"'{path}' must have chunks of at most {ARRAY_BYTES} bytes (got {chunk_bytes})"
        )
    for index in range(properties.get_nfilters()):
        filter_code = properties.get_filter(index)[0]
        if filter_code not in _FILTERS:
            raise ValueError(
                f"'{path}' must be compressed by gzip or not at all (got the filter {filter_code} "
                f"in '{name}'): write it again without this filter"
            )


def check_dataset_sizes(
    path: Path, datasets: dict[str, Any], num_frames: int, max_bytes: int | None
) -> int:
    r"""Raises an error unless all frames are in the file and fit into the memory limit, and returns
    the limit in bytes.
    """
    limit = (
        max(ARRAY_BYTES, HDF5_EXPANSION * path.stat().st_size) if max_bytes is None else max_bytes
    )
    total = 0
    for name, dataset in datasets.items():
        if num_frames > len(dataset):
            raise ValueError(
                f"'{path}' must have {num_frames} frames in '{name}', as 'num_frames' declares "
                f"(got {len(dataset)}): copy or record it again"
            )
        shape = (num_frames, *dataset.shape[1:])
        # Strings take memory as UTF-8 and as their copy in UTF-32.
        width = dataset.dtype.itemsize * (5 if dataset.dtype.kind == "S" else 1)
        total += _num_chunk_values(dataset, shape) * width
        if not is_stored(dataset, shape):
            raise ValueError(
                f"'{path}' must hold {num_frames} frames in '{name}', as 'num_frames' declares "
                f"(got {dataset.id.get_storage_size()} bytes): copy or record it again"
            )
    if total > limit:
        raise ValueError(
            f"'{path}' must take no more than {limit} bytes in memory (got {total}, from a file of "
            f"{path.stat().st_size} bytes): pass 'max_bytes={total}' if you trust the file"
        )
    return limit


def is_stored(dataset: Any, shape: tuple[int, ...]) -> bool:
    r"""Returns whether the file holds the bytes of the first rows of a data set."""
    if 0 in shape:
        return True
    if dataset.chunks is None:
        return bool(dataset.id.get_storage_size() >= math.prod(shape) * dataset.dtype.itemsize)
    num_chunks = _num_chunk_values(dataset, shape) // math.prod(dataset.chunks)
    return bool(dataset.id.get_num_chunks() >= num_chunks)


def _num_chunk_values(dataset: Any, shape: tuple[int, ...]) -> int:
    # The number of values in all chunks that hold these rows.
    chunk_shape = dataset.chunks or (1,) * len(shape)
    return math.prod(
        -(-n // chunk_size) * chunk_size for n, chunk_size in zip(shape, chunk_shape, strict=True)
    )


def text_attribute(path: Path, attrs: Any, name: str) -> str:
    r"""Returns an attribute, which must be one string."""
    attribute = _find_attribute(path, attrs, name)
    hdf5_type = attribute.get_type()
    if attribute.shape != () or hdf5_type.get_class() != require_h5py().h5t.STRING:
        raise ValueError(
            f"'{path}' must hold one string in '{name}' (got {attribute.dtype} of shape "
            f"{attribute.shape})"
        )
    if not hdf5_type.is_variable_str() and hdf5_type.get_size() > path.stat().st_size:
        raise ValueError(f"'{path}' must hold '{name}' itself (got {hdf5_type.get_size()} bytes)")
    value = attrs[name]
    return value.decode() if isinstance(value, bytes) else str(value)


def integer_attribute(path: Path, attrs: Any, name: str) -> int:
    r"""Returns an attribute, which must be an integer of at least 0."""
    attribute = _find_attribute(path, attrs, name)
    if attribute.shape == () and attribute.get_type().get_class() == require_h5py().h5t.INTEGER:
        value = attrs[name]
    else:
        value = f"{attribute.dtype} of shape {attribute.shape}"
    if isinstance(value, str) or value < 0:
        raise ValueError(
            f"'{path}' must hold an integer of at least 0 in '{name}' (got {value}): copy or "
            "record it again"
        )
    return int(value)


def check_format(path: Path, file: Any) -> None:
    r"""Raises an error unless the attributes of an HDF5 file declare a recording."""
    attrs = file.attrs
    if "format" not in attrs or text_attribute(path, attrs, "format") != FORMAT:
        raise ValueError(
            f"'{path}' must be a recording, with the attribute 'format' = '{FORMAT}' "
            f"(got an HDF5 file with {sorted(file)[:5]})"
        )


def hdf5_path(path: Any) -> Path:
    r"""Returns the path of an existing HDF5 file."""
    path = recording_path(path)
    if not require_h5py().is_hdf5(path):
        raise ValueError(
            f"'{path}' is not an HDF5 file (or its beginning is lost): copy it again, or give a "
            "file that torch_geometric_tactile.io.write_hdf5 wrote"
        )
    return path


def check_hard_link(path: Path, file: Any, name: str) -> None:
    r"""Raises an error if a name is a link to another name or file."""
    link = file.get(name, getlink=True)
    if not isinstance(link, require_h5py().HardLink):
        raise ValueError(
            f"'{path}' must hold '{name}' itself (got a {type(link).__name__}, which may lead to "
            "another file): copy the data into the file"
        )


def _find_attribute(path: Path, attrs: Any, name: str) -> Any:
    if name not in attrs:
        raise missing_field(path, name)
    return attrs.get_id(name)
