import struct
import zlib
from pathlib import Path

import numpy as np
import pytest

from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io import read_hdf5, write_hdf5

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


# Of version 0.2: appended to three times, and in a fourth append, whose journal is whole, killed.
APPENDED, KILLED = (
    Path(__file__).parent / "files" / f"{name}_0_2.h5" for name in ("appended", "killed_append")
)


def numbered(stop):
    """What the old files hold."""
    values = np.arange(stop)
    return Recording(
        values / 100,
        values[:, None, None] * np.ones((1, 3, 2)),
        label="cup",
        meta={"unit": "count"},
        privileged={"step": np.array([f"s{i}" for i in values])},
    )


@pytest.fixture(params=["written", "appended", "killed"])
def whole(request, tmp_path):
    """A file, and what it holds."""
    path = tmp_path / "a.h5"
    if request.param == "written":
        write_hdf5(WIDE, path)
        return path, WIDE
    old, stop = {"appended": (APPENDED, 12), "killed": (KILLED, 15)}[request.param]
    path.write_bytes(old.read_bytes())
    return path, numbered(stop)


def outcome(path, valid, assert_same):
    try:
        rec = read_hdf5(path)
    except (ValueError, OSError) as error:
        return "refused" if f"'{path}'" in str(error) else f"does not name the file: {error}"
    expected = next((one for one in valid if one.num_frames == rec.num_frames), valid[0])
    assert_same(rec, expected)
    return "same"


@pytest.mark.full
def test_flipped_bits_never_read_as_another_recording(whole, assert_same, tmp_path):
    path, expected = whole
    copy = tmp_path / "b.h5"
    assert outcome(path, [expected], assert_same) == "same"
    content = path.read_bytes()
    assert_same(read_hdf5(path), expected)
    assert path.read_bytes() == content  # reading writes nothing
    # A damaged journal is not followed: the file is as before the append.
    valid = [expected] if content != KILLED.read_bytes() else [expected, numbered(12)]
    draw = np.random.default_rng(0)
    seen = []
    for bit in draw.choice(8 * len(content), 300, replace=False):
        damaged = bytearray(content)
        damaged[bit // 8] ^= 1 << bit % 8
        copy.write_bytes(damaged)
        seen.append(outcome(copy, valid, assert_same))
    assert set(seen) <= {"same", "refused"}
    assert seen.count("refused") > (100 if len(valid) == 1 else 0)


@pytest.mark.full
def test_bits_flipped_all_over_a_small_file(assert_same, tmp_path):
    path, copy = tmp_path / "a.h5", tmp_path / "b.h5"
    write_hdf5(SMALL, path)
    content = path.read_bytes()
    for i in range(0, len(content), 3):
        damaged = bytearray(content)
        damaged[i] ^= 1 << i % 8
        copy.write_bytes(damaged)
        assert outcome(copy, [SMALL], assert_same) in ("same", "refused")


def test_ones_for_zeros_are_noticed_where_fletcher_32_takes_them_for_the_same(tmp_path):
    path = tmp_path / "a.h5"
    path.write_bytes(APPENDED.read_bytes())  # not compressed
    with h5py.File(path) as file:
        offset = file["tactile"].id.get_chunk_info(1).byte_offset
    content = bytearray(path.read_bytes())
    assert content[offset : offset + 2] == b"\0\0"
    content[offset : offset + 2] = b"\xff\xff"
    path.write_bytes(content)
    with h5py.File(path) as file:
        assert file["tactile"][1].tobytes()[:2] == b"\xff\xff"  # HDF5 itself does not notice
    with pytest.raises(ValueError, match=r"a.h5' must hold the frames of its checksums"):
        read_hdf5(path)


@pytest.mark.parametrize("position", [-40, -30, -20, -10, -5, -1, -41, -60, -500])
def test_damaged_journal_is_not_followed(position, assert_same, tmp_path):
    content = bytearray(KILLED.read_bytes())
    content[position] ^= 4
    (tmp_path / "a.h5").write_bytes(content)
    assert_same(read_hdf5(tmp_path / "a.h5"), numbered(12))


def journal_footer(journal, size):
    footer = struct.pack("<16sQQI", b"tactile journal\n", len(journal), size, zlib.crc32(journal))
    return footer + struct.pack("<I", zlib.crc32(footer + bytes(4)))


@pytest.mark.parametrize(("more", "num_frames"), [(0, 15), (1, 12), (2**62, 12)])
def test_journal_of_a_larger_file_than_there_is_is_not_followed(
    more, num_frames, assert_same, tmp_path
):
    content = KILLED.read_bytes()[:-40]
    (length,) = struct.unpack("<Q", KILLED.read_bytes()[-24:-16])
    footer = journal_footer(content[-length:], len(content) - length + more)
    (tmp_path / "a.h5").write_bytes(content + footer)
    assert_same(read_hdf5(tmp_path / "a.h5"), numbered(num_frames))


def test_journal_that_claims_what_it_has_not_is_refused(tmp_path):
    path = tmp_path / "a.h5"
    journal = struct.pack("<QI", 2**63, 2**31) + b"\xff"
    path.write_bytes(APPENDED.read_bytes() + journal + journal_footer(journal, 100))
    with pytest.raises(ValueError, match=r"a.h5' cannot be read as HDF5"):
        read_hdf5(path)


def test_damaged_checksums_are_refused_and_missing_ones_too(tmp_path):
    path = tmp_path / "a.h5"
    write_hdf5(WIDE, path)
    with h5py.File(path, "r+") as file:
        file["checksums"][7] += 1
    with pytest.raises(ValueError, match=r"a.h5' must hold .* from frame 7 on, 1 in total"):
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
    with pytest.raises(ValueError, match=r"a.h5' must hold the label, .* of its checksum"):
        read_hdf5(path)
    with h5py.File(path, "r+") as file:
        del file.attrs["checksum"]
    with pytest.raises(ValueError, match=r"a.h5' must hold 'checksum'"):
        read_hdf5(path)
