from pathlib import Path

import numpy as np
import pytest
from bigs_files import write_npz

from torch_geometric_tactile.io._field_file import read_fields

h5py = pytest.importorskip("h5py", reason="needs the extra 'io'")


@pytest.fixture
def file(tmp_path):
    """An open HDF5 file with arrays, texts and attributes."""
    with h5py.File(tmp_path / "a.h5", "w") as opened:
        opened["g/numbers"] = np.arange(6).reshape(2, 3)
        opened["g/texts"] = ["a", "bé"]
        opened["one"] = "text"
        opened.attrs["done"] = True
        opened["g"].attrs["name"] = np.bytes_("cup")
        yield opened


def read(file, *names):
    path = Path(file.filename)
    file.close()
    return read_fields(path, names)


def test_arrays_texts_and_attributes(file):
    found, names = read(file, "g/numbers", "/g/texts", "one", "@done", "g@name", "none", "g/a@b")
    assert found["g/numbers"].tolist() == [[0, 1, 2], [3, 4, 5]]
    assert found["/g/texts"].tolist() == ["a", "bé"]
    assert found["one"].item() == "text"
    assert found["@done"].item() is True
    assert found["g@name"].item() == "cup"
    assert {*found} == {"g/numbers", "/g/texts", "one", "@done", "g@name"}
    assert names == ["@done", "g/numbers", "g/texts", "one"]


def test_texts_of_an_attribute_take_no_more_memory_than_arrays(file, monkeypatch):
    file.attrs["words"] = ["a" * 10, "b", "c"]
    path = Path(file.filename)
    file.close()
    monkeypatch.setattr("torch_geometric_tactile.io._field_file.ARRAY_BYTES", 4 * 10 * 3)
    assert read_fields(path, ["@words"]).arrays["@words"].tolist() == ["a" * 10, "b", "c"]
    monkeypatch.setattr("torch_geometric_tactile.io._field_file.ARRAY_BYTES", 4 * 10 * 3 - 1)
    with pytest.raises(ValueError, match=r"a.h5' must hold short strings in '@words'"):
        read_fields(path, ["@words"])


@pytest.mark.parametrize("num_attributes", [0, 3, 13])
def test_twelve_names_are_listed_attributes_first(file, num_attributes):
    del file.attrs["done"]
    for number in range(num_attributes):
        file.attrs[f"a{number:02}"] = 1
    for number in range(13):
        file[f"b{number:02}"] = np.zeros(1)
    names = [f"@a{number:02}" for number in range(num_attributes)]
    assert read(file).names == [*names, *(f"b{number:02}" for number in range(13))][:12]


def test_twelve_names_of_an_npz_file_are_listed(tmp_path):
    write_npz(tmp_path / "a.npz", {letter: np.zeros(1) for letter in "abcdefghijklm"})
    assert read_fields(tmp_path / "a.npz", []).names == [*"abcdefghijkl"]


def test_nothing_but_what_is_asked_for_is_looked_at(file):
    file["outside"] = h5py.ExternalLink("/etc/passwd", "/")
    file["odd"] = np.zeros(2, "f4,f4")
    assert [*read(file, "one").arrays] == ["one"]


def link_group(file, tmp_path):
    with h5py.File(tmp_path / "other.h5", "w") as other:
        other["deep/x"] = np.zeros(3)
    file["bad"] = h5py.ExternalLink("other.h5", "/deep")
    return "bad/x"


def put(value):
    def change(file, tmp_path):
        file["bad"] = value

    return change


def huge(file, tmp_path):
    file.create_dataset("bad", shape=(10**10,), dtype="f8", chunks=(1000,), compression="gzip")


def unwritten(file, tmp_path):
    file.create_dataset("bad", shape=(1000,), dtype="f8", chunks=(10,))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (link_group, r"must hold 'bad' itself \(got a ExternalLink"),
        (
            lambda f, _: f.create_group("bad") and None,
            r"must hold an array in 'bad' \(got <HDF5 gr",
        ),
        (
            huge,
            r"must hold arrays of at most 1073741824 bytes in memory \(got 80000000000 in 'bad'",
        ),
        (unwritten, r"must hold all of 'bad', of shape \(1000,\).*is the file truncated"),
    ],
)
def test_hostile_hdf5(change, message, file, tmp_path):
    name = change(file, tmp_path) or "bad"
    with pytest.raises(ValueError, match=message) as caught:
        read(file, name)
    assert "a.h5'" in str(caught.value)


def test_other_files(tmp_path):
    (tmp_path / "a.h5").write_bytes(b"")
    with pytest.raises(ValueError, match=r"a.h5' must be an HDF5 or npz file \(got an empty file"):
        read_fields(tmp_path / "a.h5", ["a"])
    for content in (b"a,b\n1,2\n", b"\x80\x04K\x01."):
        (tmp_path / "a.h5").write_bytes(content)
        with pytest.raises(
            ValueError, match=r"a.h5' must be an HDF5 or npz file \(got a file that be"
        ):
            read_fields(tmp_path / "a.h5", ["a"])
