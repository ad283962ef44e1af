"""Mutations of npz files, whose checksums are right."""

import io
import json
import warnings
import zipfile
import zlib
from random import Random
from typing import Any

import numpy as np
from fuzz.laws import JUDGED, REFUSED, REWRITTEN
from fuzz.torch_mutations import Hostile


def mutated_npz(data: bytes, draw: Random) -> tuple[bytes, str]:
    with np.load(io.BytesIO(data)) as file:
        content = {name: file[name] for name in file.files}
    required = [name for name in content if name not in ("joint", "action") and "/" not in name]
    name = draw.choice([*content])
    kind = draw.randrange(9)
    if kind == 0:
        other = draw.choice([name + "_", name[:-1], name.upper(), "../" + name, "x", ""])
        content[other] = content.pop(name)
        kept = any(name.startswith(g) and other.startswith(g) for g in ("privileged/", "extra/"))
        return _npz(content, draw), REWRITTEN if kept else JUDGED
    if kind == 1:
        name = draw.choice(required)
        del content[name]
        return _npz(content, draw), REWRITTEN if name == "annotations" else JUDGED
    if kind == 2:
        name = draw.choice(["time", "tactile", "joint", "action"])
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


def mutated_samples(data: bytes, draw: Random) -> tuple[bytes, str]:
    """Of files of labelled samples, whose arrays have no list: what is gone was never there."""
    with np.load(io.BytesIO(data)) as file:
        content = {name: file[name] for name in file.files}
    name = draw.choice([*content])
    kind = draw.randrange(6)
    if kind == 0:
        content[draw.choice([name + "_", "labels", "x", "../" + name, "part"])] = content.pop(name)
        return _npz(content, draw), REWRITTEN
    if kind == 1:
        del content[name]
        return _npz(content, draw), REWRITTEN
    if kind == 2:
        content[name] = _other_shape(content[name], draw)
        return _npz(content, draw), REWRITTEN
    if kind == 3:
        forms: list[Any] = [complex, "V4", "f4,f4", "S3", "datetime64[s]"]
        content[name] = np.zeros(content[name].shape, draw.choice(forms))
        return _npz(content, draw), REFUSED
    if kind == 4:
        forms = [bool, np.int8, np.uint64, ">f8", np.float16, "U3", np.longdouble]
        content[name] = np.ones(content[name].shape, draw.choice(forms))
        return _npz(content, draw), REWRITTEN
    content[name] = np.array([Hostile(draw)], dtype=object)
    return _npz(content, draw), REFUSED


def _npz(content: dict[str, np.ndarray], draw: Random) -> bytes:
    out = io.BytesIO()
    draw.choice([np.savez, np.savez_compressed])(out, **content)
    return out.getvalue()


def _other_shape(array: np.ndarray, draw: Random) -> np.ndarray:
    if array.ndim == 0:
        return draw.choice([array[None], array[None][:0], np.stack([array, array])])
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
    name = draw.choice(["format", "version", "label", "meta", "annotations"])
    values: list[Any] = ["[" * 100000, "{", "", "NaN", "Infinity", "1e999", "\x00", "é" * 10]
    values += [2, -1, 1.5, True, ["1"], b"bytes", np.nan, 2**63, np.datetime64(0, "s")]
    values += ['{"unit": "furlong"}', "[]", "true", '{"a": NaN}', "3.5", "null"]
    values += ['[[0, 1, "a"]]', '[[1, 0, "a"]]', '[[0, 1e999, "a"]]', "[[0, 1]]", "[3]"]
    values += [json.dumps([[0, 1, "a"]] * 10_001), '[[0, 1, "\\n"]]']
    value = draw.choice(values)
    content[name] = np.array(value)
    fine = name == "label" and value == "null"
    fine |= name == "annotations" and value in ("[]", '[[0, 1, "a"]]')
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
