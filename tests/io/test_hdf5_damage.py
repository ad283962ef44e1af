import numpy as np
import pytest

from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io import append_hdf5, read_hdf5, write_hdf5

h5py = pytest.importorskip("h5py", reason="needs the extra 'io'")

SMALL = Recording([0.5, 0.6], [[[7.0]], [[8.0]]], label="cup", meta={"unit": "count", "trial": 3})
WIDE = Recording(
    np.arange(40) / 100,
    np.arange(40 * 12 * 3).reshape(40, 12, 3),
    joint=np.linspace(-1, 1, 160).reshape(40, 4),
    label="mug",
    meta={"unit": "count", "note": "n" * 300},
    privileged={"phase": np.arange(40) // 9, "step": np.array([f"s{i}" for i in range(40)])},
    extra={"pac": np.arange(40 * 3 * 22).reshape(40, 3, 22)},
)


def grown(recording, path):
    for start in range(0, recording.num_frames, 5):
        append_hdf5(recording.select(slice(start, start + 5)), path)


def outcome(path, expected, assert_same):
    try:
        rec = read_hdf5(path)
    except (ValueError, OSError) as error:
        return "refused" if f"'{path}'" in str(error) else f"does not name the file: {error}"
    assert_same(rec, expected)
    return "same"


@pytest.mark.parametrize("write", [write_hdf5, grown])
def test_flipped_bits_never_read_as_another_recording(write, assert_same, tmp_path):
    path, copy = tmp_path / "a.h5", tmp_path / "b.h5"
    write(WIDE, path)
    assert outcome(path, WIDE, assert_same) == "same"
    content = path.read_bytes()
    draw = np.random.default_rng(0)
    seen = []
    for bit in draw.choice(8 * len(content), 300, replace=False):
        damaged = bytearray(content)
        damaged[bit // 8] ^= 1 << bit % 8
        copy.write_bytes(damaged)
        seen.append(outcome(copy, WIDE, assert_same))
    assert set(seen) <= {"same", "refused"}
    assert seen.count("refused") > 100


@pytest.mark.parametrize("write", [write_hdf5, grown])
def test_bits_flipped_all_over_a_small_file(write, assert_same, tmp_path):
    path, copy = tmp_path / "a.h5", tmp_path / "b.h5"
    write(SMALL, path)
    content = path.read_bytes()
    for i in range(0, len(content), 5):
        damaged = bytearray(content)
        damaged[i] ^= 1 << i % 8
        copy.write_bytes(damaged)
        assert outcome(copy, SMALL, assert_same) in ("same", "refused")


@pytest.mark.parametrize("name", ["tactile", "joint"])
def test_ones_for_zeros_are_noticed_where_fletcher_32_takes_them_for_the_same(
    name, assert_same, tmp_path
):
    path = tmp_path / "a.h5"
    grown(WIDE, path)
    with h5py.File(path) as file:
        offset = file[name].id.get_chunk_info(0).byte_offset
        assert file[name].id.get_chunk_info(0).size >= 8
    content = bytearray(path.read_bytes())
    assert content[offset : offset + 2] == b"\0\0"
    content[offset : offset + 2] = b"\xff\xff"
    path.write_bytes(content)
    with h5py.File(path) as file:
        assert file[name][0].tobytes()[:2] == b"\xff\xff"  # HDF5 itself does not notice
    with pytest.raises(ValueError, match=r"a.h5' must hold the frames that its checksums are of"):
        read_hdf5(path)


def test_damaged_checksums_are_refused_and_missing_ones_too(tmp_path):
    path = tmp_path / "a.h5"
    write_hdf5(WIDE, path)
    with h5py.File(path, "r+") as file:
        file["checksums"][7] += 1
    with pytest.raises(ValueError, match=r"a.h5' must hold .* from frame 7 on, 1 in all"):
        read_hdf5(path)
    with h5py.File(path, "r+") as file:
        del file["checksums"]
        file["checksums"] = np.zeros((40, 1), dtype=np.uint32)
    with pytest.raises(ValueError, match=r"a.h5' must hold an unsigned integer of 4 bytes"):
        read_hdf5(path)
    with h5py.File(path, "r+") as file:
        del file["checksums"]
        file["checksums"] = np.zeros(39, dtype=np.uint32)
    with pytest.raises(ValueError, match=r"a.h5' must have 40 frames in 'checksums'"):
        read_hdf5(path)
    with h5py.File(path, "r+") as file:
        del file["checksums"]
    with pytest.raises(ValueError, match=r"a.h5' must hold 'checksums'"):
        read_hdf5(path)


def test_checksums_are_compared_whatever_the_version_says(tmp_path):
    path = tmp_path / "a.h5"
    write_hdf5(WIDE, path)
    with h5py.File(path, "r+") as file:
        file.attrs["version"] = 1
    with pytest.raises(ValueError, match=r"a.h5' must hold the label, .* that its checksum is of"):
        read_hdf5(path)
    with h5py.File(path, "r+") as file:
        del file.attrs["checksum"]
    with pytest.raises(ValueError, match=r"a.h5' must hold 'checksum'"):
        read_hdf5(path)
