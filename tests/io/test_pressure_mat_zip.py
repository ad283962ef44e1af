import hashlib
import struct
import tracemalloc
import warnings
import zipfile

import numpy as np
import pytest
from mat_files import checksums, mat_files, write_mat

from torch_geometric_tactile.io._pressure_mat_zip import pressure_mat_hash, read_pressure_mat_zip


def test_experiment_i_by_hand(tmp_path):
    found = read_pressure_mat_zip(write_mat(tmp_path / "mat.zip"))
    assert [(f.person, f.posture) for f in found[:4]] == [
        ("S1", "1"),
        ("S1", "3"),
        ("S1", "13"),
        ("S2", "1"),
    ]
    assert found[-1].person == "S10"
    assert found[1].mattress is None
    assert found[1].reading.shape == (5, 64, 32)
    assert found[1].reading[4, 0, :5].tolist() == [1, 3, 4, 0, 1]
    assert found[1].reading[4, 1, 0] == 29


def test_experiment_ii_by_hand(tmp_path):
    found = read_pressure_mat_zip(write_mat(tmp_path / "mat.zip"), "ii")
    assert [(f.mattress, f.posture) for f in found[:6]] == [
        ("air", "B1"),
        ("air", "B10"),
        ("air", "C2"),
        ("air", "E3"),
        ("air", "G1"),
        ("sponge", "B1"),
    ]
    assert found[0].reading.shape == (1, 64, 27)
    assert found[0].reading[0, 7, :4].tolist() == [1, 3, 7, 0]


@pytest.mark.parametrize(
    ("name", "data", "match"),
    [
        ("experiment-i/S1/1.txt", b"1 2 3\n", "S1/1.txt' must have 2048 readings per line"),
        ("experiment-i/S1/1.txt", b"", "must have 2048 readings per line"),
        ("experiment-i/S1/1.txt", b"1 2\n1\n", "must hold integers in lines of equal length"),
        ("experiment-i/S1/1.txt", b"1.5 " * 2048 + b"\n", "must hold only integers"),
        ("experiment-i/S1/1.txt", b"-1 " * 2048 + b"\n", r"only integers \(got '-+'\)"),
        ("experiment-i/S1/1.txt", b"9999999999 " * 2048 + b"\n", "at most nine digits"),
        ("experiment-ii/S1/Air_Mat/Matrix_Air_B1.txt", b"1 " * 27 + b"\n", "64 rows"),
    ],
    ids=["short", "empty", "unequal", "fractions", "negative", "long", "rows"],
)
def test_other_files_are_refused(tmp_path, name, data, match):
    path = write_mat(tmp_path / "mat.zip", mat_files() | {name: data})
    with pytest.raises(ValueError, match=match):
        read_pressure_mat_zip(path, "ii" if "-ii" in name else "i")


def test_large_file_is_refused_before_it_is_read(tmp_path):
    path = write_mat(tmp_path / "mat.zip", {"experiment-i/S1/1.txt": bytes(2**24 + 1)})
    with pytest.raises(ValueError, match=r"must have at most 16 MiB \(got 16777217\)"):
        read_pressure_mat_zip(path)


def test_other_archives_are_refused(tmp_path):
    path = tmp_path / "mat.zip"
    with pytest.raises(FileNotFoundError, match="physionet"):
        read_pressure_mat_zip(path)
    path.write_bytes(write_mat(tmp_path / "whole.zip").read_bytes()[:5000])
    with pytest.raises(ValueError, match=r"mat\.zip' cannot be read .*download it again"):
        read_pressure_mat_zip(path)
    write_mat(path, {"README.txt": b""})
    with pytest.raises(ValueError, match=r"must hold files of experiment II \(got none\)"):
        read_pressure_mat_zip(path, "ii")
    with pytest.raises(ValueError, match="'experiment' must be 'i' or 'ii' \\(got 'iii'\\)"):
        read_pressure_mat_zip(path, "iii")


def test_hash_is_that_of_the_contents_not_of_the_archive(tmp_path):
    files = mat_files()
    first = write_mat(tmp_path / "a.zip")
    with zipfile.ZipFile(tmp_path / "b.zip", "w") as archive:  # not compressed, another folder
        for name, data in [*files.items(), ("SHA256SUMS.txt", checksums(files))]:
            archive.writestr(f"other/{name}", data)
    assert first.read_bytes() != (tmp_path / "b.zip").read_bytes()
    assert pressure_mat_hash(first) == pressure_mat_hash(tmp_path / "b.zip")
    same = [
        np.array_equal(a.reading, b.reading)
        for a, b in zip(
            *(read_pressure_mat_zip(tmp_path / name) for name in ("a.zip", "b.zip")), strict=True
        )
    ]
    assert all(same)


@pytest.mark.parametrize("changed", [b"7\n", None])
def test_hash_of_changed_or_missing_files(tmp_path, changed):
    files = mat_files()
    sums = checksums(files)
    name = "experiment-i/S2/3.txt"
    if changed is None:
        del files[name]
    else:
        files[name] = changed
    path = write_mat(tmp_path / "mat.zip", files, sums)
    with pytest.raises(ValueError, match=f"must hold '{name}' with the SHA-256 checksum"):
        pressure_mat_hash(path)


def test_unlisted_readings_are_refused(tmp_path):
    files = mat_files()
    added = "experiment-i/S99/4.txt"
    path = write_mat(tmp_path / "mat.zip", files | {added: b"1 " * 2048}, checksums(files))
    with pytest.raises(ValueError, match=rf"SHA256SUMS\.txt \(got '{added}'\)"):
        pressure_mat_hash(path)


def test_other_unlisted_files_are_never_read(tmp_path):
    files = mat_files()
    expected = pressure_mat_hash(write_mat(tmp_path / "a.zip"))
    more = {"__MACOSX/experiment-i/S1/._1.txt": b"\0", ".DS_Store": b"\0", "notes.txt": b"text"}
    path = write_mat(tmp_path / "mat.zip", files | more, checksums(files))
    assert pressure_mat_hash(path) == expected
    assert len(read_pressure_mat_zip(path)) == 9


@pytest.mark.parametrize("name", ["experiment-i/S1/1.txt", "SHA256SUMS.txt"])
@pytest.mark.parametrize("folder", ["other", "pmd-1.0.0"])
@pytest.mark.parametrize("read", [pressure_mat_hash, read_pressure_mat_zip])
def test_second_file_of_a_name_is_refused(tmp_path, name, folder, read):
    path = write_mat(tmp_path / "mat.zip")
    with zipfile.ZipFile(path, "a") as archive, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        archive.writestr(f"{folder}/{name}", b"1 " * 2048)
    with pytest.raises(ValueError, match=rf"mat\.zip' must hold '{name}' once \(got '"):
        read(path)


def test_name_that_is_listed_twice_is_compared_once(tmp_path):
    files = mat_files()
    sums = checksums(files)
    path = write_mat(tmp_path / "mat.zip", files, sums + sums.splitlines(keepends=True)[0])
    with pytest.raises(ValueError, match=r"must hold 'experiment-i/S1/1\.txt' with"):
        pressure_mat_hash(path)


def peak_of(call, path):
    """The largest size of Python's memory while a file is refused, and the error."""
    tracemalloc.start()
    try:
        with pytest.raises(ValueError, match="mat") as caught:
            call(path)
        return tracemalloc.get_traced_memory()[1], str(caught.value)
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("read", [pressure_mat_hash, read_pressure_mat_zip])
def test_archive_that_unpacks_to_gibibytes_is_refused(tmp_path, monkeypatch, read):
    monkeypatch.setattr("torch_geometric_tactile.io._pressure_mat_zip.ARRAY_BYTES", 2**25)
    monkeypatch.setattr("torch_geometric_tactile._limits.EXPANSION", 10)
    files = {f"experiment-i/S1/{i}.txt": bytes(2**23) for i in range(8)}
    path = write_mat(tmp_path / "mat.zip", files)
    peak, text = peak_of(read, path)
    assert "would take" in text or "must take" in text
    assert peak < 2**22


@pytest.mark.parametrize("method", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA, zipfile.ZIP_DEFLATED])
@pytest.mark.parametrize("read", [pressure_mat_hash, read_pressure_mat_zip])
def test_declared_size_is_not_trusted(tmp_path, method, read):
    name, content = "experiment-i/S1/1.txt", bytes(2**24)
    path = tmp_path / "mat.zip"
    with zipfile.ZipFile(path, "w", method) as archive:
        archive.writestr(f"pmd/{name}", content)
        sums = f"{hashlib.sha256(content).hexdigest()} {name}\n"
        archive.writestr("pmd/SHA256SUMS.txt", sums, zipfile.ZIP_STORED)
    data = path.read_bytes()
    assert data.count(struct.pack("<I", 2**24)) == 2  # in the header of the file, and the table
    path.write_bytes(data.replace(struct.pack("<I", 2**24), struct.pack("<I", 10)))
    peak, text = peak_of(read, path)
    assert "S1/1.txt' cannot be read" in text
    assert peak < 2**23


def test_encrypted_entry_is_named(tmp_path):
    path = write_mat(tmp_path / "mat.zip", {"experiment-i/S1/4.txt": b"5 " * 2048 + b"\n"})
    data = bytearray(path.read_bytes())
    for magic, place in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        data[data.rindex(magic) + place] |= 1
    path.write_bytes(data)
    for read in (pressure_mat_hash, read_pressure_mat_zip):
        with pytest.raises(ValueError, match=r"S1/4\.txt' cannot be read \(.*encrypted"):
            read(path)
