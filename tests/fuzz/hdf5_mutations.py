"""Mutations of HDF5 files by the library that writes them."""

from pathlib import Path
from random import Random
from typing import Any

import numpy as np
from fuzz.laws import JUDGED, REFUSED, REWRITTEN


def mutate_hdf5(path: Path, draw: Random) -> str:
    """Changes an HDF5 file in place."""
    import h5py

    with h5py.File(path, "r+") as file:
        return draw.choice(_HDF5)(file, draw, h5py)


def mutate_fields(path: Path, draw: Random) -> str:
    """Changes a file of named arrays, in which nothing but the names is known, in place."""
    import h5py

    kind = draw.choice([*(_h_rename, _h_delete, _h_link, _h_link, _h_storage, _h_texts, _h_group)])
    with h5py.File(path, "r+") as file:
        allowed = kind(file, draw, h5py)
    return allowed if kind in (_h_link, _h_storage) else REWRITTEN


def _arrays(file: Any) -> list[str]:
    if "elec" in file:
        return [*file]
    names = [name for name in ("time", "tactile", "joint", "action", "checksums") if name in file]
    groups = ("privileged", "extra")
    return names + [f"{group}/{name}" for group in groups for name in file.get(group, ())]


def _h_rename(file: Any, draw: Random, _: Any) -> str:
    name = draw.choice(_arrays(file))
    file.move(name, draw.choice([name + "_", name.upper(), name[:-1]]))
    # What only a simulator knows may have any name.
    return REWRITTEN if "/" in name else REFUSED


def _h_delete(file: Any, draw: Random, _: Any) -> str:
    name = draw.choice(_arrays(file))
    del file[name]
    return REFUSED if name in ("time", "tactile") else REWRITTEN


def _h_link(file: Any, draw: Random, h5py: Any) -> str:
    """A data set that is a link, out of the file or to nothing."""
    name = draw.choice(_arrays(file))
    kind = draw.randrange(3)
    if kind == 0:
        other = Path(file.filename).with_name("other.h5")
        with h5py.File(other, "w") as target:
            target["a"] = file[name][()]
        del file[name]
        file[name] = h5py.ExternalLink(draw.choice([other.name, str(other), "none.h5"]), "/a")
    elif kind == 1:
        del file[name]
        file[name] = h5py.SoftLink(draw.choice(["/nothing", f"/{name}", "/"]))
    else:
        del file[name]
        file[name] = file["/"]
    return REFUSED


def _h_storage(file: Any, draw: Random, h5py: Any) -> str:
    """A data set whose numbers are in other files."""
    name = draw.choice(_arrays(file))
    array = np.asarray(file[name][()])
    if array.dtype.kind not in "fiu" or array.ndim == 0:
        return JUDGED
    del file[name]
    if draw.random() < 0.5:
        layout = h5py.VirtualLayout(shape=array.shape, dtype=array.dtype)
        source = draw.choice(["none.h5", Path(file.filename).name, "."])
        layout[:] = h5py.VirtualSource(source, "/a", shape=array.shape)
        file.create_virtual_dataset(name, layout)
    else:
        raw = Path(file.filename).with_name("raw.bin")
        raw.write_bytes(array.tobytes())
        where = draw.choice([raw.name, str(raw), "/etc/hostname"])
        file.create_dataset(
            name, shape=array.shape, dtype=array.dtype, external=[(where, 0, h5py.h5f.UNLIMITED)]
        )
    return REFUSED


def _h_type(file: Any, draw: Random, h5py: Any) -> str:
    """A data set of another type, with the same numbers where it can hold them."""
    name = draw.choice(["time", "tactile", "joint", "action"])
    if name not in file:
        return JUDGED
    array = file[name][()]
    del file[name]
    whole = np.nan_to_num(array).astype(np.int64)
    form = draw.choice(
        [
            *(whole, whole.astype(np.uint8), whole > 0, array.astype(complex)),
            *(np.zeros(array.shape, "f4,f4"), array.astype("S8"), h5py.Empty("f4"), array.sum()),
            np.zeros(array.shape, h5py.special_dtype(enum=("i", {"A": 0}))),
            np.zeros(array.shape, "V3"),
        ]
    )
    file[name] = form
    return JUDGED


def _h_texts(file: Any, draw: Random, h5py: Any) -> str:
    name = draw.choice(_arrays(file))
    shape = file[name].shape
    del file[name]
    form = draw.choice([h5py.string_dtype(), h5py.ref_dtype, h5py.vlen_dtype(np.float32)])
    file.create_dataset(name, shape=shape, dtype=form)
    return JUDGED


def _h_size(file: Any, draw: Random, _: Any) -> str:
    """A data set that claims more rows than it has, or has fewer than it must."""
    frames = int(file.attrs["num_frames"])
    rows = draw.choice([10**12, 2**40, 10**8, frames - 1, 0])
    for name in _arrays(file) if draw.random() < 0.5 else [draw.choice(_arrays(file))]:
        if file[name].maxshape[0] is None:
            file[name].resize(rows, axis=0)
    if rows > frames:
        file.attrs["num_frames"] = rows
    return JUDGED


def _h_group(file: Any, draw: Random, _: Any) -> str:
    name = draw.choice(_arrays(file))
    del file[name]
    file.create_group(name)["a"] = 1
    return JUDGED


def _h_extra(file: Any, draw: Random, h5py: Any) -> str:
    """Something more, which no reader asked for."""
    kind = draw.randrange(3)
    name = draw.choice(["more", "extra"])
    if kind == 1:
        file.require_group(draw.choice(["privileged", "extra"]))["more"] = draw.choice(
            [np.zeros(1), "text"]
        )
    else:
        if name in file:
            del file[name]
        file[name] = np.zeros(3) if kind == 0 else h5py.ExternalLink("none.h5", "/")
    return JUDGED


def _h_attribute(file: Any, draw: Random, h5py: Any) -> str:
    """An attribute of another type or with another content: whatever holds the checksum of the
    attributes, it is not written anew."""
    own = ["format", "version", "label", "meta", "num_frames"]
    own += ["annotations"] if "annotations" in file.attrs else []
    name = draw.choice(own)
    before = file.attrs[name]
    values: list[Any] = [3.7, 0, -1, 2**62, "3", "", "{", "[" * 100000, "null", "NaN", b"\xff\xfe"]
    values += [[3], np.array([[1]]), h5py.Empty("f4"), True, np.nan, "other", '{"unit": "furlong"}']
    values += ['[[0, 1, "a"]]', "[[0, 1]]", "[]"]
    values += [before] if draw.random() < 0.05 else []
    value = draw.choice(values)
    if draw.random() < 0.2:
        del file.attrs[name]
        return JUDGED
    if name == "num_frames" and draw.random() < 0.5:
        value = before + draw.choice([-1, 1, 0.5])
    if isinstance(value, type(before)) and not isinstance(value, np.ndarray) and value == before:
        return JUDGED
    try:
        file.attrs[name] = value
    except (OSError, RuntimeError, ValueError):  # too large for an attribute
        file.attrs[name] = "["
    return JUDGED


_HDF5 = (
    *(_h_rename, _h_delete, _h_link, _h_link, _h_storage, _h_type, _h_texts, _h_size, _h_group),
    *(_h_extra, _h_attribute, _h_attribute, _h_attribute),
)
