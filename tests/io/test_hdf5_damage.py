import struct
import zlib
from pathlib import Path

import numpy as np
import pytest

from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io import read_hdf5, write_hdf5

h5py = pytest.importorskip("h5py", reason="needs the extra 'io'")

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
    with pytest.raises(ValueError, match=r"a.h5' must match the checksums of its frames"):
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
    with pytest.raises(ValueError, match=r"a.h5' must match .* from frame 7 on, 1 in total"):
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
    with pytest.raises(ValueError, match=r"a.h5' must match its checksum \(got another label"):
        read_hdf5(path)
    with h5py.File(path, "r+") as file:
        del file.attrs["checksum"]
    with pytest.raises(ValueError, match=r"a.h5' must hold 'checksum'"):
        read_hdf5(path)
