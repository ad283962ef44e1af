import zipfile

import numpy as np
import pytest
from mat_files import checksums, mat_files, write_mat

from torch_geometric_tactile.io import pressure_mat_hash, read_pressure_mat_zip


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
        ("experiment-i/S1/1.txt", b"1 2 3\n", "S1/1.txt' must have 2048 readings a line"),
        ("experiment-i/S1/1.txt", b"", "must have 2048 readings a line"),
        ("experiment-i/S1/1.txt", b"1 2\n1\n", "must hold whole numbers in equal lines"),
        ("experiment-i/S1/1.txt", b"1.5 " * 2048 + b"\n", "must hold whole numbers"),
        ("experiment-i/S1/1.txt", b"-1 " * 2048 + b"\n", r"whole numbers only \(got '-+'\)"),
        ("experiment-i/S1/1.txt", b"99999999999 " * 2048 + b"\n", "whole numbers in equal lines"),
        ("experiment-ii/S1/Air_Mat/Matrix_Air_B1.txt", b"1 " * 27 + b"\n", "64 rows"),
    ],
)
def test_other_files_are_refused(tmp_path, name, data, match):
    path = write_mat(tmp_path / "mat.zip", mat_files() | {name: data})
    with pytest.raises(ValueError, match=match):
        read_pressure_mat_zip(path, "ii" if "-ii" in name else "i")


def test_large_file_is_refused_before_it_is_read(tmp_path):
    path = write_mat(tmp_path / "mat.zip", {"experiment-i/S1/1.txt": bytes(2**24 + 1)})
    with pytest.raises(ValueError, match=r"must have 16 MiB at most \(got 16777217\)"):
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
