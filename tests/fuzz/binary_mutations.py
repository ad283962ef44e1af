"""Mutations of the parts of npz, HDF5 and PyTorch's files, which then have right checksums."""

import copy
import io
import os
import pickle
import warnings
import zipfile
import zlib
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import torch
from fuzz.laws import JUDGED, REFUSED, REWRITTEN
from fuzz.tree_mutations import mutated_tree

MARKER = "MARKER"  # a file in the working directory of the worker, made by code of a case


class Hostile:
    """Makes the marker when it is unpickled."""

    def __init__(self, draw: Random) -> None:
        self.calls = draw.choice(
            [
                (os.system, (f"touch {MARKER}",)),
                (open, (MARKER, "w")),
                (os.mkdir, (MARKER,)),
                (eval, (f"open('{MARKER}', 'w')",)),
            ]
        )

    def __reduce__(self) -> Any:
        return self.calls


def mutated_npz(data: bytes, draw: Random) -> tuple[bytes, str]:
    with np.load(io.BytesIO(data)) as file:
        content = {name: file[name] for name in file.files}
    required = [name for name in content if name not in ("joint",) and "/" not in name]
    name = draw.choice([*content])
    kind = draw.randrange(9)
    if kind == 0:
        other = draw.choice([name + "_", name[:-1], name.upper(), "../" + name, "x", ""])
        content[other] = content.pop(name)
        kept = name.startswith("privileged/") and other.startswith("privileged/")
        return _npz(content, draw), REWRITTEN if kept else JUDGED
    if kind == 1:
        del content[draw.choice(required)]
        return _npz(content, draw), REFUSED
    if kind == 2:
        name = draw.choice(["time", "tactile", "joint"])
        if name in content:
            content[name] = _other_shape(content[name], draw)
        return _npz(content, draw), JUDGED
    if kind == 3:
        return _other_type(content, draw)
    if kind == 4:
        return _other_text(content, draw)
    if kind == 5:
        content[name] = np.array([Hostile(draw)], dtype=object)
        return _npz(content, draw), REFUSED
    if kind == 6:
        return _claimed(content, draw), REFUSED
    if kind == 7:
        return _repeated_member(data, draw), JUDGED
    return _npz(content, draw), JUDGED


def _npz(content: dict[str, np.ndarray], draw: Random) -> bytes:
    out = io.BytesIO()
    draw.choice([np.savez, np.savez_compressed])(out, **content)
    return out.getvalue()


def _other_shape(array: np.ndarray, draw: Random) -> np.ndarray:
    forms = [array[:-1], array[1:], array[..., None], array[None], array[:0], array.reshape(-1)]
    forms += [np.concatenate([array, array[-1:]]), array[0], np.zeros((0, 0))]
    if array.ndim > 1:
        forms += [array[:, :0]]
    forms = [form for form in forms if form.shape != array.shape]
    return draw.choice(forms)


def _other_type(content: dict[str, np.ndarray], draw: Random) -> tuple[bytes, str]:
    time = content["time"]
    ns = (time * 1e9).astype(np.int64)  # the times of the small files are whole nanoseconds
    forms = {
        "time": [
            *(time.astype(np.int64), time.astype(complex), time.astype(str), time.astype("S")),
            *(ns, ns.view("datetime64[ns]"), ns.view("timedelta64[ns]"), time > 0),
            *((ns // 10**6).astype("timedelta64[ms]"), time.astype(">f8"), time.astype("V8")),
        ],
        "tactile": [
            *(content["tactile"].astype(kind) for kind in (complex, str, "S9", ">f4", np.float64)),
            *(content["tactile"].astype("V4"), np.isnan(content["tactile"])),
            *(np.zeros(content["tactile"].shape, "datetime64[s]"),),
            *(np.zeros(content["tactile"].shape, "f4,f4"),),
        ],
    }
    name = draw.choice([*forms])
    content[name] = draw.choice(forms[name])
    return _npz(content, draw), JUDGED


def _other_text(content: dict[str, np.ndarray], draw: Random) -> tuple[bytes, str]:
    name = draw.choice(["format", "version", "label", "meta"])
    values: list[Any] = ["[" * 100000, "{", "", "NaN", "Infinity", "1e999", "\x00", "é" * 10]
    values += [2, -1, 1.5, True, ["1"], b"bytes", np.nan, 2**63, np.datetime64(0, "s")]
    values += ['{"unit": "furlong"}', "[]", "true", '{"a": NaN}', "3.5", "null"]
    value = draw.choice(values)
    content[name] = np.array(value)
    fine = name == "label" and value == "null"
    return _npz(content, draw), REWRITTEN if fine else JUDGED


def _claimed(content: dict[str, np.ndarray], draw: Random) -> bytes:
    """A member that claims more numbers than it has, or has more than memory."""
    if draw.random() < 0.02:
        return _bomb(content)
    name = draw.choice(["time", "tactile"])
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for key, value in content.items():
            if key != name:
                member = io.BytesIO()
                np.lib.format.write_array(member, value, allow_pickle=False)
                archive.writestr(f"{key}.npy", member.getvalue())
        shape = draw.choice(["(1000000000000,)", "(2000000000, 3, 3)", "(0, 10000000000, 3)"])
        shape = draw.choice([shape, "(9999999999999999999999,)", "(-1,)", "(3.5,)", "(" * 200])
        head = f"{{'descr': '<f4', 'fortran_order': False, 'shape': {shape}, }}\n".encode()
        text = b"\x93NUMPY\x01\x00" + len(head).to_bytes(2, "little") + head
        archive.writestr(f"{name}.npy", text + bytes(draw.choice([0, 4, 4096])))
    return out.getvalue()


def _bomb(content: dict[str, np.ndarray]) -> bytes:
    """Two gigabytes of zeros in a few megabytes, as the last member."""
    packer = zlib.compressobj(9, zlib.DEFLATED, -15)
    head = b"\x93NUMPY\x01\x00v\x00{'descr': '<f4', 'fortran_order': False, "
    head = (head + b"'shape': (536870912, 1, 1), }").ljust(127) + b"\n"
    first = packer.compress(head) + packer.flush(zlib.Z_FULL_FLUSH)
    block = packer.compress(bytes(2**22)) + packer.flush(zlib.Z_FULL_FLUSH)
    packed = first + block * 512 + b"\x03\x00"
    out = io.BytesIO()
    others = {name: value for name, value in content.items() if name != "tactile"}
    np.savez(out, **others)
    with zipfile.ZipFile(out, "a") as archive:
        archive.writestr("tactile.npy", b"")
    return _replaced_last(out.getvalue(), packed, len(head) + 2**31)


def _replaced_last(data: bytes, packed: bytes, size: int) -> bytes:
    """The last, empty member of a zip file with these packed bytes in it."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        start, entry = archive.start_dir, archive.infolist()[-1]
    local = bytearray(data[entry.header_offset : start])
    central = bytearray(data[start:])
    sizes = len(packed).to_bytes(4, "little") + size.to_bytes(4, "little")
    local[8:10] = (8).to_bytes(2, "little")
    local[18:26] = sizes
    place = central.rindex(b"PK\x01\x02")
    central[place + 10 : place + 12] = (8).to_bytes(2, "little")
    central[place + 20 : place + 28] = sizes
    end = central.rindex(b"PK\x05\x06")
    moved = int.from_bytes(central[end + 16 : end + 20], "little") + len(packed)
    central[end + 16 : end + 20] = moved.to_bytes(4, "little")
    return data[: entry.header_offset] + bytes(local) + packed + bytes(central)


def _repeated_member(data: bytes, draw: Random) -> bytes:
    """A zip file with a name twice, a member of another kind, or a password."""
    out = io.BytesIO(data)
    with zipfile.ZipFile(out, "a") as archive:
        names = archive.namelist()
        name = draw.choice([draw.choice(names), "../evil.npy", "x" * 500, "/tmp/a", "readme.txt"])
        content = archive.read(draw.choice(names))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            archive.writestr(name, draw.choice([content, b"", b"text", content[:-3]]))
    return out.getvalue()


# --- PyTorch's zip files


HARMFUL: tuple[dict[str, Any], ...] = (
    {
        "class_path": "torch.fx.graph_module.reduce_graph_module",
        "init_args": {
            "body": {"_code": "def forward(self, x):\n    return x\n"},
            "import_block": f"open('{MARKER}', 'w')",
        },
    },
    {"class_path": "os.system", "init_args": {"command": f"touch {MARKER}"}},
    {"class_path": "os.mkdir", "init_args": {"path": MARKER}},
    {"class_path": "io.open", "init_args": {"file": MARKER, "mode": "w"}},
    {"class_path": "io.FileIO", "init_args": {"file": MARKER, "mode": "w"}},
    {"class_path": "zipfile.ZipFile", "init_args": {"file": MARKER, "mode": "w"}},
    {"class_path": "logging.FileHandler", "init_args": {"filename": MARKER}},
    {"class_path": "subprocess.Popen", "init_args": {"args": ["touch", MARKER]}},
    {"class_path": "subprocess.check_output", "init_args": {"args": ["touch", MARKER]}},
    {"class_path": "builtins.exec", "init_args": {"source": f"open('{MARKER}', 'w')"}},
    {"class_path": "builtins.eval", "init_args": {"source": f"open('{MARKER}', 'w')"}},
    {"class_path": "torch.save", "init_args": {"obj": 1, "f": MARKER}},
    {"class_path": "torch.utils.tensorboard.SummaryWriter", "init_args": {"log_dir": MARKER}},
    {"class_path": "torch.hub.load", "init_args": {"repo_or_dir": ".", "model": "a"}},
    {"class_path": "torch.package.PackageExporter", "init_args": {"f": MARKER}},
    {"class_path": "lightning.pytorch.loggers.CSVLogger", "init_args": {"save_dir": MARKER}},
    {"class_path": "lightning.Trainer", "init_args": {"default_root_dir": MARKER}},
    {"class_path": "torch_geometric.datasets.FakeDataset", "init_args": {}},
    {"class_path": "torch_geometric.data.InMemoryDataset", "init_args": {"root": MARKER}},
    {
        "class_path": "torch_geometric_tactile.datasets.RecordingFrames",
        "init_args": {"root": MARKER, "layout": "biotac"},
    },
    {
        "class_path": "torch.nn.Sequential",
        "init_args": {"args": [{"class_path": "io.FileIO", "init_args": {"file": MARKER}}]},
    },
    {
        "class_path": "torch_geometric_tactile.nn.models.TactileGCN",
        "init_args": {
            "layout": 4,
            "encoder": {"class_path": "io.FileIO", "init_args": {"file": MARKER, "mode": "w"}},
        },
    },
    {"class_path": "torch_geometric_tactile.io.write_npz", "init_args": {"path": MARKER}},
    {"class_path": "torch_geometric_tactile.files.atomic_path", "init_args": {"path": MARKER}},
    {"class_path": "torch.jit.load", "init_args": {"f": MARKER}},
    {"class_path": "no.such.Class", "init_args": {}},
    {"class_path": "torch.nn", "init_args": {}},
    {"class_path": "Linear", "init_args": {"in_features": 1, "out_features": 1}},
    {"class_path": "", "init_args": {}},
)


def harmful(draw: Random) -> Any:
    """What stands for a class and is none, or none of the right kind."""
    content = dict(draw.choice(HARMFUL))
    if draw.random() < 0.2:
        content.pop("init_args")
    if draw.random() < 0.1:
        return content["class_path"]
    return content


def with_harm(tree: Any, draw: Random) -> Any:
    """A configuration in which one class is another, or holds another."""
    tree = copy.deepcopy(tree)
    spots = list(_class_places(tree))
    container, key = draw.choice(spots)
    if draw.random() < 0.3:
        arguments = container[key].setdefault("init_args", {}) or {}
        container[key]["init_args"] = arguments
        name = draw.choice([*arguments, "encoder", "model", "params"])
        arguments[name] = draw.choice([harmful(draw), [harmful(draw)], {"a": harmful(draw)}])
    else:
        container[key] = harmful(draw)
    return tree


def _class_places(tree: Any) -> Any:
    items = list(tree.items() if isinstance(tree, dict) else enumerate(tree))
    for key, value in items:
        if isinstance(value, dict) and "class_path" in value:
            yield tree, key
        if isinstance(value, dict | list):
            yield from _class_places(value)


_TENSORS = (
    lambda t: t.double(),
    lambda t: t.to(torch.complex64),
    lambda t: t.long(),
    lambda t: t[:0],
    lambda t: t[None],
    lambda t: t.flatten()[:1],
    lambda t: t.to_sparse(),
    lambda t: t.to("meta"),
    lambda t: torch.full_like(t, float("nan")),
    lambda t: None,
    lambda t: "text",
    lambda t: [1.0],
    lambda t: t.bool(),
    lambda t: t.expand(1000, *t.shape),
    lambda t: torch.zeros(1).expand(10**6, 10**6),
)


def other_tensor(tree: Any, draw: Random) -> Any:
    """A tree of PyTorch's with another tensor in one place."""
    spots = list(_tensor_places(tree))
    container, key = draw.choice(spots)
    value = container[key]
    kind = draw.randrange(4)
    if kind == 0 and isinstance(container, dict):
        del container[key]
    elif kind == 1 and isinstance(container, dict):
        container[draw.choice([f"{key}_", str(key)[:-1], str(key).upper()])] = container.pop(key)
    elif kind == 2:
        other, place = draw.choice(spots)
        container[key], other[place] = other[place], value
    else:
        try:
            container[key] = draw.choice(_TENSORS)(value)
        except (RuntimeError, IndexError, TypeError):
            container[key] = 0
    return tree


def _tensor_places(tree: Any) -> Any:
    items = list(tree.items() if isinstance(tree, dict) else enumerate(tree))
    for key, value in items:
        if isinstance(value, torch.Tensor):
            yield tree, key
        elif isinstance(value, dict | list):
            yield from _tensor_places(value)


def saved(tree: Any) -> bytes:
    out = io.BytesIO()
    torch.save(tree, out)
    return out.getvalue()


def mutated_torch(data: bytes, draw: Random) -> tuple[bytes, str]:
    """A file of ``torch.save`` with another tree, tensor, pickle or member in it."""
    kind = draw.randrange(6)
    if kind == 0:
        return _other_members(data, draw), JUDGED
    if kind == 1:
        return _other_pickle(data, draw), REFUSED
    tree = torch.load(io.BytesIO(data), weights_only=True)
    if kind == 2:
        return saved(other_tensor(tree, draw)), REWRITTEN
    if kind == 3:
        forms = [None, [], {}, "text", torch.zeros(3), {"a": tree}, [tree], tree and 0]
        return saved(draw.choice(forms)), REFUSED
    if kind == 4 and isinstance(tree, dict) and "hyper_parameters" in tree:
        tree["hyper_parameters"] = with_harm({"x": tree["hyper_parameters"]}, draw)["x"]
        if draw.random() < 0.2:
            tree["hyper_parameters"]["_instantiator"] = draw.choice(
                ["os.system", "builtins.exec", "subprocess.Popen", "io.open", "no.such", 3]
            )
        return saved(tree), REWRITTEN
    return saved(mutated_tree(tree, draw)), REWRITTEN


def _other_members(data: bytes, draw: Random) -> bytes:
    """The members of a zip file in another order, packed, renamed, or one of them gone."""
    out = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = [(entry.filename, archive.read(entry)) for entry in archive.infolist()]
    kind = draw.randrange(6)
    place = draw.randrange(len(members))
    name, content = members[place]
    packing = zipfile.ZIP_STORED
    if kind == 0:
        packing = draw.choice([zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
    elif kind == 1 and "data/" not in name:
        # What PyTorch does not need, such as its serial number, may be gone.
        members[place] = (name + "_", content)
    elif kind == 2:
        draw.shuffle(members)
    elif kind == 3:
        members.append((draw.choice([f"{name.split('/')[0]}/extra", "../x", name + "/x"]), b"text"))
    elif kind == 4 and "data/" in name:
        del members[place]
    elif "data/" in name:
        members[place] = (name, content[:-1] if kind == 5 else content[:0])
    with zipfile.ZipFile(out, "w", packing) as archive:
        for member, text in members:
            archive.writestr(member, text)
    return out.getvalue()


def _other_pickle(data: bytes, draw: Random) -> bytes:
    hostile = pickle.dumps(draw.choice([Hostile(draw), {"state_dict": Hostile(draw)}]), protocol=2)
    if draw.random() < 0.3:
        return hostile
    out = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as archive, zipfile.ZipFile(out, "w") as other:
        for entry in archive.infolist():
            is_pickle = entry.filename.endswith("data.pkl")
            other.writestr(entry.filename, hostile if is_pickle else archive.read(entry))
    return out.getvalue()


# --- HDF5


def mutate_hdf5(path: Path, draw: Random) -> str:
    """Changes an HDF5 file in place."""
    import h5py

    with h5py.File(path, "r+") as file:
        return draw.choice(_HDF5)(file, draw, h5py)


def _arrays(file: Any) -> list[str]:
    names = [name for name in ("time", "tactile", "joint") if name in file]
    return names + [f"privileged/{name}" for name in file.get("privileged", ())]


def _h_rename(file: Any, draw: Random, _: Any) -> str:
    name = draw.choice(_arrays(file))
    file.move(name, draw.choice([name + "_", name.upper(), name[:-1]]))
    # What only a simulator knows may have any name.
    return REWRITTEN if name.startswith("privileged/") else REFUSED


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
    array = file[name][()]
    if array.dtype.kind not in "fiu":
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
    name = draw.choice(["time", "tactile", "joint"])
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
    if kind == 0:
        file["extra"] = np.zeros(3)
    elif kind == 1:
        file.require_group("privileged")["extra"] = draw.choice([np.zeros(1), "text"])
    else:
        file["extra"] = h5py.ExternalLink("none.h5", "/")
    return JUDGED


def _h_attribute(file: Any, draw: Random, h5py: Any) -> str:
    """An attribute of another type or with another content: whatever holds the checksum of the
    attributes, it is not written anew."""
    own = ["format", "version", "label", "meta", "num_frames"]
    name = draw.choice(own)
    before = file.attrs[name]
    values: list[Any] = [3.7, 0, -1, 2**62, "3", "", "{", "[" * 100000, "null", "NaN", b"\xff\xfe"]
    values += [[3], np.array([[1]]), h5py.Empty("f4"), True, np.nan, "other", '{"unit": "furlong"}']
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
