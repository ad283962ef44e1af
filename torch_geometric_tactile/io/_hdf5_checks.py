r"""What an HDF5 file must be like before its arrays are read: nothing in it leads to other files,
and no size is taken from it that its own bytes do not bear out.
"""

import math
from pathlib import Path
from typing import Any

import numpy as np

from torch_geometric_tactile._limits import ARRAY_BYTES, HDF5_EXPANSION
from torch_geometric_tactile.io._hdf5_file import require_h5py
from torch_geometric_tactile.io._recording_schema import FORMAT, GROUPS, checked_file, missing_field

_FILTERS = {1: "gzip", 2: "shuffle", 3: "fletcher32"}  # the numbers of HDF5


def checked_datasets(path: Path, file: Any) -> dict[str, Any]:
    r"""Returns the data sets of a recording by their names, after a look at what they are."""
    there = list(file)
    names: list[str] = [name for name in ("time", "tactile", "joint") if name in there]
    for name in ("time", "tactile"):
        if name not in names:
            raise missing_field(path, name)
    for prefix in GROUPS:
        if prefix[:-1] in there:
            check_hard_link(path, file, prefix[:-1])
            group = file[prefix[:-1]]
            if not isinstance(group, type(file["/"])):
                raise ValueError(f"'{path}' must hold a group in '{prefix[:-1]}' (got {group})")
            names += [prefix + name for name in group]
    return {name: checked_dataset(path, file, name) for name in names}


def checked_dataset(path: Path, file: Any, name: str) -> Any:
    r"""Returns a data set after a look at what it is."""
    if name not in file:
        raise missing_field(path, name)
    check_hard_link(path, file, name)
    dataset = file[name]
    if not isinstance(dataset, require_h5py().Dataset) or not dataset.shape:
        raise ValueError(f"'{path}' must hold an array in '{name}' (got {dataset})")
    check_storage(path, dataset, name)
    check_type(path, name, dataset.id.get_type())
    return dataset


def check_type(path: Path, name: str, found: Any) -> None:
    r"""Checks that a type is of numbers of at most 8 bytes, truth values or texts."""
    h5t = require_h5py().h5t
    plain = found.get_class() in (h5t.INTEGER, h5t.FLOAT) and found.get_size() <= 8
    text = found.get_class() == h5t.STRING
    truth = found.get_class() == h5t.ENUM and found.dtype == np.dtype(bool)
    if found.committed() or not (plain or text or truth):
        raise ValueError(
            f"'{path}' must hold numbers, truth values or texts in '{name}' (got "
            f"{'a named type' if found.committed() else found.dtype})"
        )


def check_storage(path: Path, dataset: Any, name: str) -> None:
    r"""Checks that a data set holds its numbers itself, compressed as HDF5 can without more."""
    created = dataset.id.get_create_plist()
    if created.get_layout() == require_h5py().h5d.VIRTUAL or created.get_external_count():
        raise ValueError(
            f"'{path}' must hold '{name}' itself (got a virtual or external array, whose numbers "
            "are in other files): copy the data into the file"
        )
    block = math.prod(dataset.chunks or (0,)) * dataset.dtype.itemsize
    if block > max(ARRAY_BYTES, path.stat().st_size):
        raise ValueError(f"'{path}' must have blocks of at most {ARRAY_BYTES} bytes (got {block})")
    for index in range(created.get_nfilters()):
        code = created.get_filter(index)[0]
        if code not in _FILTERS:
            raise ValueError(
                f"'{path}' must be compressed by gzip or not at all (got the filter {code} in "
                f"'{name}'): write it again without"
            )


def check_dataset_sizes(
    path: Path, datasets: dict[str, Any], num_frames: int, max_bytes: int | None
) -> int:
    r"""Checks that frames were written and that there is a limit to what they take in memory, and
    returns this limit.
    """
    limit = (
        max(ARRAY_BYTES, HDF5_EXPANSION * path.stat().st_size) if max_bytes is None else max_bytes
    )
    total = 0
    for name, dataset in datasets.items():
        if num_frames > len(dataset):
            raise ValueError(
                f"'{path}' must have {num_frames} frames in '{name}', as 'num_frames' says "
                f"(got {len(dataset)}): copy or record it again"
            )
        shape = (num_frames, *dataset.shape[1:])
        width = dataset.dtype.itemsize * (5 if dataset.dtype.kind == "S" else 1)  # UTF-32 as well
        total += _in_whole_blocks(dataset, shape) * width
        if not is_written(dataset, shape):
            raise ValueError(
                f"'{path}' must hold {num_frames} frames in '{name}', as 'num_frames' says (got "
                f"{dataset.id.get_storage_size()} bytes): copy or record it again"
            )
    if total > limit:
        raise ValueError(
            f"'{path}' must take no more than {limit} bytes in memory (got {total}, from a file of "
            f"{path.stat().st_size} bytes): pass 'max_bytes={total}' if this is right"
        )
    return limit


def is_written(dataset: Any, shape: tuple[int, ...]) -> bool:
    r"""Whether the first rows of a data set, of some shape, are in the file, not only claimed."""
    if 0 in shape:
        return True
    if dataset.chunks is None:
        return bool(dataset.id.get_storage_size() >= math.prod(shape) * dataset.dtype.itemsize)
    blocks = _in_whole_blocks(dataset, shape) // math.prod(dataset.chunks)
    return bool(dataset.id.get_num_chunks() >= blocks)


def _in_whole_blocks(dataset: Any, shape: tuple[int, ...]) -> int:
    # The number of values in all blocks that some rows touch.
    blocks = dataset.chunks or (1,) * len(shape)
    return math.prod(-(-n // block) * block for n, block in zip(shape, blocks, strict=True))


def text_attribute(path: Path, attrs: Any, name: str) -> str:
    r"""Returns an attribute that is one text."""
    attribute = _attribute(path, attrs, name)
    found = attribute.get_type()
    if attribute.shape != () or found.get_class() != require_h5py().h5t.STRING:
        raise ValueError(
            f"'{path}' must hold one text in '{name}' (got {attribute.dtype} of shape "
            f"{attribute.shape})"
        )
    if not found.is_variable_str() and found.get_size() > path.stat().st_size:
        raise ValueError(f"'{path}' must hold '{name}' in itself (got {found.get_size()} bytes)")
    value = attrs[name]
    return value.decode() if isinstance(value, bytes) else str(value)


def integer_attribute(path: Path, attrs: Any, name: str) -> int:
    r"""Returns an attribute that is one integer, not negative."""
    attribute = _attribute(path, attrs, name)
    if attribute.shape == () and attribute.get_type().get_class() == require_h5py().h5t.INTEGER:
        value = attrs[name]
    else:
        value = f"{attribute.dtype} of shape {attribute.shape}"
    if isinstance(value, str) or value < 0:
        raise ValueError(
            f"'{path}' must hold an integer in '{name}', not negative (got {value}): copy or "
            "record it again"
        )
    return int(value)


def check_format(path: Path, file: Any) -> None:
    r"""Checks that an HDF5 file says of itself that it is a recording."""
    attrs = file.attrs
    if "format" not in attrs or text_attribute(path, attrs, "format") != FORMAT:
        raise ValueError(
            f"'{path}' must be a recording, with the attribute 'format' = '{FORMAT}' "
            f"(got an HDF5 file with {sorted(file)[:5]})"
        )


def hdf5_file(path: Any) -> Path:
    r"""Returns the path of an HDF5 file that exists."""
    path = checked_file(path)
    if not require_h5py().is_hdf5(path):
        raise ValueError(
            f"'{path}' is no HDF5 file (or its beginning is lost): copy it again, or give a file "
            "that torch_geometric_tactile.io.write_hdf5 wrote"
        )
    return path


def check_hard_link(path: Path, file: Any, name: str) -> None:
    r"""Checks that a name is of something in the file itself."""
    # A link of another kind leads to another place or file.
    link = file.get(name, getlink=True)
    if not isinstance(link, require_h5py().HardLink):
        raise ValueError(
            f"'{path}' must hold '{name}' itself (got a {type(link).__name__}, which may lead to "
            "another file): copy the data into the file"
        )


def _attribute(path: Path, attrs: Any, name: str) -> Any:
    if name not in attrs:
        raise missing_field(path, name)
    return attrs.get_id(name)
