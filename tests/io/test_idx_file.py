import gzip
import struct

import numpy as np
import pytest

from torch_geometric_tactile.io._idx_file import read_idx

ARRAY = np.arange(24, dtype=np.uint8).reshape(2, 3, 4)
DATA = b"\0\0\x08\x03" + struct.pack(">3I", 2, 3, 4) + ARRAY.tobytes()


@pytest.mark.parametrize("packed", [gzip.compress, bytes])
def test_arrays(tmp_path, packed):
    path = tmp_path / "a.gz"
    path.write_bytes(packed(DATA))
    found = read_idx(path)
    assert found.dtype == np.uint8
    assert np.array_equal(found, ARRAY)
    path.write_bytes(packed(b"\0\0\x08\x01" + struct.pack(">I", 0)))
    assert read_idx(path).shape == (0,)


@pytest.mark.parametrize(
    ("data", "match"),
    [
        (b"\0\0\x0d\x01" + DATA[4:], "array of unsigned bytes"),
        (b"\0\0\x08\x00", r"1 to 4 dimensions \(got 0\)"),
        (DATA[:-1], r"24 numbers for the shape \(2, 3, 4\) \(got 23\)"),
        (gzip.compress(DATA + bytes(9), mtime=0), r"\(got more\)"),
        (b"\0\0\x08\x03" + struct.pack(">3I", 2**31, 28, 28), "it would take 1683627180032 bytes"),
    ],
    ids=["doubles", "no dimension", "cut", "more in gzip", "huge"],
)
def test_bad_files(tmp_path, data, match):
    path = tmp_path / "a.gz"
    path.write_bytes(data)
    with pytest.raises(ValueError, match=match) as error:
        read_idx(path)
    assert str(path) in str(error.value)
