import zipfile

import numpy as np
import pytest

from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io._recording_npz import read_npz, write_npz


def test_npz_names_by_hand(tmp_path):
    more = {"privileged": {"phase": [2]}, "extra": {"pac": [[[3.5, 4.5]]]}}
    rec = Recording([0.5], [[[7.0]]], label="cup", **more)
    write_npz(rec, tmp_path / "a.npz")
    with np.load(tmp_path / "a.npz", allow_pickle=False) as file:
        content = {name: file[name].tolist() for name in file.files}
    assert content == {
        "format": "tactile recording",
        "version": 1,
        "arrays": '["extra/pac", "privileged/phase", "tactile", "time"]',
        "time": [0.5],
        "tactile": [[[7.0]]],
        "privileged/phase": [2],
        "extra/pac": [[[3.5, 4.5]]],
        "label": '"cup"',
        "meta": "{}",
    }


def small():
    return Recording(
        [0.0, 0.5],
        [[[1.0, 2.0]], [[4.0, np.nan]]],
        joint=[[0.5], [0.25]],
        label="mug é",
        meta={"unit": "count"},
        privileged={"phase": [1, 2], "ü": ["a", "bé"]},
        extra={"pac": [[3, 4], [5, 6]]},
    )


@pytest.fixture
def path(tmp_path):
    """A small recording that has everything."""
    write_npz(small(), tmp_path / "a.npz")
    return tmp_path / "a.npz"


def changed(path, drop=(), **fields):
    with np.load(path) as file:
        content = {name: file[name] for name in file.files if name not in drop}
    np.savez(path, **{**content, **fields})


def test_npz_cut(full, tmp_path):
    path = tmp_path / "a.npz"
    write_npz(full, path)
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    with pytest.raises(
        ValueError, match=r"a.npz' is not a complete npz file \(is it truncated\?\)"
    ):
        read_npz(path)


@pytest.mark.parametrize("name", ["time", "tactile", "label", "meta"])
def test_npz_missing_field(path, name):
    changed(path, drop=[name, "arrays"])
    with pytest.raises(ValueError, match=rf"a.npz' must hold '{name}' to be a recording"):
        read_npz(path)


def test_npz_of_something_else(tmp_path):
    np.savez(tmp_path / "a.npz", weights=np.zeros(3))
    with pytest.raises(ValueError, match=r"must be a recording, .*npz file with \['weights'\]"):
        read_npz(tmp_path / "a.npz")


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        *(({"version": np.array(v)}, r"of format version 1 \(got ") for v in (2, True, 1.0, "1")),
        (
            {"tactile": np.zeros((2, 5))},
            r"not hold a consistent recording: 'tactile' must have shape",
        ),
        ({"tactile": np.ones((2, 1, 2), bool)}, r"must hold numbers in 'tactile' \(got booleans"),
        ({"joint": np.zeros((3, 5))}, r"'joint' must have 2 frames, as 'time' has \(got 3\)"),
        ({"meta": np.array("{")}, r"must hold JSON in 'meta'"),
        ({"label": np.array(3)}, r"must hold JSON in 'label'"),
        ({"format": np.array("x")}, r"must be a recording, with 'format'"),
        ({"time": np.array([1, 2])}, r"'time' must be an array of numbers \(floats in seconds"),
        ({"extra": np.zeros(2)}, r"must hold only .* 'privileged/...' and 'extra/...' .*'extra'\)"),
        ({"extra/pac": np.zeros((3, 2))}, r"'extra/pac' must have 2 frames, as 'time' has \(got 3"),
    ],
)
def test_npz_wrong_field(path, fields, message):
    changed(path, **fields)
    with pytest.raises(ValueError, match=rf"a.npz'.* {message}"):
        read_npz(path)


def test_npz_whose_table_hides_an_array(path):
    damaged = bytearray(path.read_bytes())
    entry = damaged.rindex(b"PK\x01\x02", 0, damaged.rindex(b"tactile.npy"))
    damaged[entry + 32] = 46 + len("joint.npy")  # a comment as long as the next entry
    path.write_bytes(damaged)
    with pytest.raises(ValueError, match=r"a.npz' cannot be read .* it holds 11 parts \(got 10"):
        read_npz(path)


def test_npz_that_would_fill_the_memory(path):
    bomb = bytearray(path.read_bytes())
    entry = bomb.rindex(b"PK\x01\x02", 0, bomb.rindex(b"tactile.npy"))
    bomb[entry + 24 : entry + 28] = (2**32 - 2).to_bytes(4, "little")
    path.write_bytes(bomb)
    with pytest.raises(ValueError, match=r"would take 4.0 GiB, \d+ times the file, .*allow_large"):
        read_npz(path)
    with pytest.raises(ValueError, match=r"'tactile' must take 144 bytes .*\(got 4294967294\)"):
        read_npz(path, allow_large=True)


def rewritten(path, parts):
    with zipfile.ZipFile(path) as file:
        content = {name: file.read(name) for name in file.namelist()} | parts
    with zipfile.ZipFile(path, "w") as file:
        for name, part in content.items():
            file.writestr(name, part)


def npy(header):
    text = f"{header}\n".encode()
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        (
            {"joint.npy": npy("{'descr':'<f4','fortran_order':False,'shape':(999999999,4)}")},
            r"'joint' must take 16000000\d+ bytes for the shape \(999999999, 4\) \(got \d+\)",
        ),
        (
            {"joint.npy": npy("{'descr':'<U0','fortran_order':False,'shape':(999999999999,)}")},
            r"its array 'joint' must hold numbers or strings",
        ),
        ({"joint.npy": npy("{'descr':'<c8','fortran_order':False,'shape':()}")}, r"complex64"),
        ({"joint.npy": b"\x93NUMPY\x09\x00"}, r"version \(9, 0\) of NumPy's format"),
        ({"joint.npy": b"text"}, r"cannot be read as npz: .* write it again"),
        ({"jount.npy": npy("{'descr':'<f4','fortran_order':False,'shape':(2,0)}")}, r"'jount'"),
        ({"notes.txt": b"text"}, r"its part 'notes.txt' is not an array"),
        ({"joint": b"text"}, r"its part 'joint' is not an array"),
    ],
)
def test_npz_with_strange_parts(parts, message, path):
    rewritten(path, parts)
    with pytest.raises(ValueError, match=rf"a.npz' .*{message}"):
        read_npz(path)


def test_npz_with_a_part_twice(path):
    with zipfile.ZipFile(path, "a") as file, pytest.warns(UserWarning, match="Dupl"):
        file.writestr("joint.npy", file.read("joint.npy"))
    with pytest.raises(ValueError, match=r"its part 'joint.npy' is not an array, or is repeated"):
        read_npz(path)


def test_npz_with_characters_that_do_not_exist(path):
    header = npy("{'descr':'<U1','fortran_order':False,'shape':()}")
    rewritten(path, {"label.npy": header + b"\xff\xff\xff\x7f"})
    with pytest.raises(ValueError, match=r"its array 'label' does not hold valid text"):
        read_npz(path)


def test_npz_in_other_orders_of_bytes_and_axes(assert_same, path):
    order = np.asfortranarray(small().tactile).astype(">f4")
    changed(
        path,
        tactile=order,
        **{
            "privileged/ü": small().privileged["ü"].astype(">U2"),
            "time": np.array([0, 0.5], ">f8"),
        },
    )
    assert_same(read_npz(path), small())
    assert read_npz(path).privileged["ü"].dtype.isnative


def test_npz_arrays_may_be_written_to(path):
    assert read_npz(path).tactile.flags.writeable


@pytest.mark.parametrize("name", ["joint", "privileged/phase", "extra/pac"])
def test_npz_that_lost_an_array(name, assert_same, path):
    changed(path, drop=[name])
    with pytest.raises(
        ValueError, match=r"a.npz' .* must hold the arrays '\[\"extra/pac\", \"joint\", \"priv"
    ):
        read_npz(path)


def test_npz_of_an_earlier_version_lists_no_arrays(assert_same, path):
    changed(path, drop=["arrays"])
    assert_same(read_npz(path), small())


def test_npz_behind_another_one(tmp_path):
    write_npz(Recording([0.5], [[[7.0]]]), tmp_path / "a.npz")
    write_npz(small(), tmp_path / "b.npz")
    joined = (tmp_path / "a.npz").read_bytes() + (tmp_path / "b.npz").read_bytes()
    (tmp_path / "a.npz").write_bytes(joined)
    with pytest.raises(ValueError, match=r"a.npz' .* there are bytes before its first part"):
        read_npz(tmp_path / "a.npz")


@pytest.mark.parametrize("method", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_arrays_that_cannot_be_unpacked_in_pieces_are_refused(tmp_path, method):
    with zipfile.ZipFile(tmp_path / "a.npz", "w", method) as file:
        file.writestr("tactile.npy", bytes(2**20))
    with pytest.raises(ValueError, match=r"a\.npz' .*'tactile\.npy' must be stored or deflated"):
        read_npz(tmp_path / "a.npz")
