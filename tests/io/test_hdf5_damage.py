import numpy as np
import pytest

pytest.importorskip("h5py", reason="needs the extra 'io'")


from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io import append_hdf5, read_hdf5, write_hdf5

SMALL = Recording([0.5, 0.6], [[[7.0]], [[8.0]]], label="cup", meta={"unit": "count", "trial": 3})
WIDE = Recording(
    np.arange(40) / 100,
    np.arange(40 * 12 * 3).reshape(40, 12, 3),
    joint=np.linspace(-1, 1, 160).reshape(40, 4),
    label="mug",
    meta={"unit": "count", "note": "n" * 300},
    privileged={"phase": np.arange(40) // 9, "step": np.array([f"s{i}" for i in range(40)])},
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
