import subprocess
import sys
import zlib

import numpy as np
import pytest

pytest.importorskip("h5py", reason="needs the extra 'io'")

import h5py

from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io import read_hdf5, write_hdf5
from torch_geometric_tactile.io._recording_schema import recording_to_arrays, recording_to_texts


def test_hdf5_names_by_hand(tmp_path):
    more = {"privileged": {"phase": [2]}, "extra": {"pac": [[[3.5, 4.5]]]}}
    rec = Recording([0.5], [[[7.0]]], label="cup", **more)
    write_hdf5(rec, tmp_path / "a.h5")
    with h5py.File(tmp_path / "a.h5") as file:
        assert dict(file.attrs) == {
            "format": b"tactile recording",
            "version": 2,
            "num_frames": 1,
            "label": b'"cup"',
            "meta": b"{}",
            "checksum": zlib.crc32(
                b'["tactile recording", 2, 1, "\\"cup\\"", "{}", [["extra/pac", "<f8", 1, 2], '
                b'["privileged/phase", "<i8"], ["tactile", "<f4", 1, 1], ["time", "<f8"]]]'
            ),
        }
        assert file["time"][:].tolist() == [0.5]
        assert file["tactile"][:].tolist() == [[[7.0]]]
        assert file["privileged/phase"][:].tolist() == [2]
        assert file["extra/pac"][:].tolist() == [[[3.5, 4.5]]]
        assert file["tactile"].compression == "gzip"
        assert file["tactile"].shuffle
        assert file["tactile"].maxshape == (None, 1, 1)
        assert all(file[n].fletcher32 for n in ("time", "tactile", "privileged/phase", "extra/pac"))
    assert (tmp_path / "a.h5").read_bytes()[8] == 3  # superblock with a checksum


def test_frames_in_a_block_of_a_compressed_file(tmp_path):
    path = tmp_path / "a.h5"
    arrays = {"wide": np.zeros((3, 40_000)), "some": np.zeros((3, 1000)), "few": np.zeros((3, 2))}
    write_hdf5(Recording([0.0, 0.1, 0.2], np.zeros((3, 1, 1)), privileged=arrays), path)
    with h5py.File(path) as file:
        chunks = {name: file[f"privileged/{name}"].chunks for name in arrays}
    assert chunks == {"wide": (1, 40_000), "some": (32, 1000), "few": (512, 2)}


def write_version_1(recording, path):
    """Writes a file as version 0.1 did."""
    with h5py.File(path, "w") as file:
        for name, array in recording_to_arrays(recording).items():
            stored = array.astype(h5py.string_dtype()) if array.dtype.kind == "U" else array
            file.create_dataset(
                name, data=stored, maxshape=(None, *array.shape[1:]), chunks=(8, *array.shape[1:])
            )
        file.attrs["format"] = "tactile recording"
        file.attrs["version"] = 1
        file.attrs["num_frames"] = recording.num_frames
        for name, text in recording_to_texts(recording).items():
            file.attrs[name] = text


def test_version_1_is_read(full, assert_same, tmp_path):
    path = tmp_path / "a.h5"
    write_version_1(full.select(slice(0, 9)), path)
    assert_same(read_hdf5(path), full.select(slice(0, 9)))


def test_version_1_with_rows_of_an_interrupted_append_is_read_without_them(
    full, assert_same, tmp_path
):
    path = tmp_path / "a.h5"
    write_version_1(full.select(slice(0, 10)), path)
    with h5py.File(path, "r+") as file:  # rows are written, their number is not
        file["time"].resize(15, axis=0)
        file["tactile"].resize(13, axis=0)
        file["tactile"][10:13] = 99.0
    assert_same(read_hdf5(path), full.select(slice(0, 10)))


def test_metadata_of_any_length(tmp_path):
    rec = Recording([0.5], [[[7.0]]], meta={"note": "ü" * 200_000, "nul": "a\0b"})
    write_hdf5(rec, tmp_path / "a.h5")
    assert read_hdf5(tmp_path / "a.h5").meta == rec.meta


def test_hdf5_of_something_else(tmp_path):
    (tmp_path / "a.h5").write_bytes(b"time,taxel_0_x\n")
    with pytest.raises(ValueError, match=r"a.h5' is not an HDF5 file"):
        read_hdf5(tmp_path / "a.h5")


def test_hdf5_cut(full, tmp_path):
    path = tmp_path / "a.h5"
    write_hdf5(full, path)
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    with pytest.raises(ValueError, match=r"a.h5' cannot be read as HDF5 .*: is it truncated"):
        read_hdf5(path)


def edit(path, change):
    with h5py.File(path, "r+") as file:
        change(file)


def replace(name, array):
    def change(file):
        del file[name]
        file[name] = array

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda f: f.__delitem__("time"), r"a.h5' must hold 'time' to be a recording"),
        (lambda f: f.__delitem__("tactile"), r"a.h5' must hold 'tactile' to be a recording"),
        (lambda f: f.attrs.__delitem__("num_frames"), r"a.h5' must hold 'num_frames'"),
        (lambda f: f.attrs.__delitem__("meta"), r"a.h5' must hold 'meta'"),
        (lambda f: f.attrs.__setitem__("version", 3), r"format version 1 or 2 \(got 3\)"),
        (lambda f: f.attrs.__setitem__("version", 2), r"a.h5' must hold 'checksum'"),
        (lambda f: f.attrs.__setitem__("format", "x"), r"must be a recording, with the attribute"),
        (lambda f: f.attrs.__setitem__("meta", "{"), r"a.h5' must hold JSON in 'meta'"),
        (
            lambda f: f.attrs.__setitem__("num_frames", 21),
            r"must have 21 frames in 'time', as 'num_frames' declares \(got 20\)",
        ),
        (replace("joint", np.zeros((3, 4))), r"20 frames in 'joint', .* \(got 3\)"),
        (
            replace("joint", np.zeros(20)),
            r"not hold a consistent recording: 'joint' must have shape",
        ),
        (replace("joint", 3.0), r"must hold an array in 'joint'"),
        (replace("time", np.zeros(20)), r"not hold a consistent recording: 'time' must increase"),
        (
            replace("tactile", np.zeros((20, 5))),
            r"not hold a consistent recording: 'tactile' must have",
        ),
    ],
)
def test_hdf5_wrong_content(full, change, message, tmp_path):
    write_version_1(full, tmp_path / "a.h5")
    edit(tmp_path / "a.h5", change)
    with pytest.raises(ValueError, match=message):
        read_hdf5(tmp_path / "a.h5")


def test_hdf5_that_another_process_writes_says_so(full, tmp_path):
    path = tmp_path / "a.h5"
    write_hdf5(full, path)
    code = f"import h5py; f = h5py.File({str(path)!r}, 'r+'); print('open', flush=True); input()"
    with subprocess.Popen(
        [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout.readline() == "open\n"
        with pytest.raises(BlockingIOError, match=r"a.h5' is locked by another process"):
            read_hdf5(path)
        process.communicate("\n")


def test_hdf5_names_the_missing_extra(full, monkeypatch, tmp_path):
    write_hdf5(full, tmp_path / "a.h5")
    monkeypatch.setitem(sys.modules, "h5py", None)
    for call in (
        lambda: write_hdf5(full, tmp_path / "b.h5"),
        lambda: read_hdf5(tmp_path / "a.h5"),
    ):
        with pytest.raises(ImportError, match=r'pip install "torch-geometric-tactile\[io\]"'):
            call()
    assert [path.name for path in tmp_path.iterdir()] == ["a.h5"]
