import numpy as np
import pytest

from torch_geometric_tactile.data import Recording


def make_recording(num_frames=20, num_taxels=5, seed=0):
    draw = np.random.default_rng(seed)
    tactile = draw.normal(0, 1e3, (num_frames, num_taxels, 3)).astype(np.float32)
    tactile[:, 1] = np.nan
    tactile[2:4, 0, 1] = np.nan
    return Recording(
        time=1.78e9 + np.cumsum(draw.uniform(0.005, 0.015, num_frames)),
        tactile=tactile,
        joint=draw.normal(size=(num_frames, 4)),
        label="mug é",
        meta={"unit": "newton", "object": "mug", "taxels": [2, 3], "synthetic": True, "tare": None},
        privileged={
            "phase": np.arange(num_frames) // 7,
            "object_pose": draw.normal(size=(num_frames, 7)),
            "touches": draw.random((num_frames, num_taxels)) > 0.5,
            "step": np.array([f"schritt ü{i}" for i in range(num_frames)], dtype=str),
        },
        extra={
            "pac": draw.integers(0, 4096, (num_frames, 3, 22)).astype(np.int16),
            "pressure": np.where(draw.random((num_frames, 3)) > 0.1, 2100.5, np.nan),
            "state": np.array([f"tür {i}" for i in range(num_frames)], dtype=str),
        },
        action=np.where(
            draw.random((num_frames, 3)) > 0.1, draw.normal(size=(num_frames, 3)), np.nan
        ),
    )


@pytest.fixture
def full():
    """A recording that has everything: joints, actions, missing readings, texts, metadata."""
    return make_recording()


@pytest.fixture
def assert_same():
    """Asserts that two recordings are equal in all that they hold."""

    def check(a, b):
        assert np.array_equal(a.time, b.time)
        assert np.array_equal(a.tactile, b.tactile, equal_nan=True)
        assert a.tactile.shape == b.tactile.shape
        for one, other in ((a.joint, b.joint), (a.action, b.action)):
            assert (one is None) == (other is None)
            if one is not None:
                assert np.array_equal(one, other, equal_nan=True)
        assert (a.label, a.meta) == (b.label, b.meta)
        for one, other in ((a.privileged, b.privileged), (a.extra, b.extra)):
            assert one.keys() == other.keys()
            for name, value in one.items():
                assert value.shape == other[name].shape
                assert value.dtype == other[name].dtype or value.dtype.kind == "U"
                assert value.dtype.kind == other[name].dtype.kind
                assert ((value == other[name]) | (value != value)).all()
                assert ((value != value) == (other[name] != other[name])).all()

    return check


@pytest.fixture
def write(tmp_path):
    """Writes lines, of cells or texts, as a file, and returns its path."""

    def write(*lines, end="\n", mark=""):
        texts = [line if isinstance(line, str) else ",".join(line) for line in lines]
        (tmp_path / "hand.csv").write_bytes((mark + "".join(t + end for t in texts)).encode())
        return tmp_path / "hand.csv"

    return write
