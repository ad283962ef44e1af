# ruff: noqa: E402
"""A law of all formats of recordings: what a Recording may hold, they give back."""

import numpy as np
import pytest

for module in ("h5py", "mcap", "google.protobuf", "zstandard", "lz4"):
    pytest.importorskip(module, reason="needs the extras 'io' and 'live'")

from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io import read_recording, write_recording

# What names, texts and numbers are drawn from: parts that some format or another may stumble over.
GOOD = ["a", "B", "..", " ", "\n", "ä", "\U0001f590", "%", ":"]
PARTS = [*GOOD, "", "/", "\0", ".", "\ud800", "x" * 100]
TYPES = [
    "?",
    "i1",
    "u1",
    "<i2",
    ">u4",
    "i8",
    "u8",
    "f2",
    ">f4",
    "f8",
    "longdouble",
    "U3",
    "U",
    "c8",
]
SUFFIXES = ["h5", "npz", "mcap"]


def text(draw):
    kinds = PARTS if draw.random() < 0.2 else GOOD
    return "".join(draw.choice(kinds, size=draw.integers(1, 4)))


def rows(draw, num_frames):
    sizes = draw.choice([0, 1, 2, 3], p=[0.04, 0.32, 0.32, 0.32], size=draw.integers(0, 4))
    shape = (num_frames, *sizes.tolist())
    if draw.random() < 0.05:
        shape = (num_frames,) + (1,) * int(draw.integers(5, 32))  # NumPy 1.26 has 32
    kind = np.dtype(draw.choice(TYPES))
    if kind.kind == "U":
        return np.array([text(draw) for _ in range(np.prod(shape))], dtype=kind).reshape(shape)
    numbers = np.frombuffer(draw.bytes(int(np.prod(shape)) * kind.itemsize), kind)
    return numbers.reshape(shape)


def arguments(draw):
    num_frames = int(draw.integers(1, 6))
    x = draw.normal(size=(num_frames, 2, 3))
    x[draw.random(x.shape) < 0.2] = np.nan
    out = {"time": 1e9 + np.arange(num_frames) / 7, "tactile": x}
    if draw.random() < 0.5:
        out["joint"] = draw.uniform(-3, 3, size=(num_frames, draw.integers(1, 3)))
    if draw.random() < 0.5:
        out["action"] = draw.normal(size=(num_frames, draw.integers(1, 3)))
    if draw.random() < 0.3:
        out["label"] = text(draw) if draw.random() < 0.7 else int(draw.integers(-9, 9)) * 10**30
    if draw.random() < 0.3:
        out["meta"] = {text(draw): [text(draw), None, {"": draw.random()}]}
    for name in ("extra", "privileged"):
        if draw.random() < 0.6:
            out[name] = {text(draw): rows(draw, num_frames) for _ in range(draw.integers(1, 3))}
    return out


def is_same(one, other):
    if one.dtype.kind != other.dtype.kind or one.shape != other.shape:
        return False
    # The length that texts are given does not count, nor the order of bytes.
    same_size = one.dtype.kind == "U" or one.dtype.itemsize == other.dtype.itemsize
    return same_size and np.array_equal(one, other, equal_nan=one.dtype.kind == "f")


@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # of random bytes as numbers
def test_what_a_recording_holds_every_format_gives_back(tmp_path):
    num_refused = num_kept = 0
    for seed in range(100):
        draw = np.random.default_rng(seed)
        given = arguments(draw)
        try:
            recording = Recording(**given)
        except ValueError:
            num_refused += 1
            continue
        num_kept += 1
        for suffix in SUFFIXES:
            path = tmp_path / f"{seed}.{suffix}"
            write_recording(recording, path)
            found = read_recording(path)
            what = f"seed {seed}, {suffix}"
            assert (found.label, found.meta) == (recording.label, recording.meta), what
            for name in ("time", "tactile", "joint", "action"):
                assert (getattr(found, name) is None) == (getattr(recording, name) is None), what
                if getattr(recording, name) is not None:
                    assert is_same(getattr(recording, name), getattr(found, name)), what
            for name in ("extra", "privileged"):
                before, after = getattr(recording, name), getattr(found, name)
                assert before.keys() == after.keys(), what
                assert all(is_same(before[key], after[key]) for key in before), what
    assert min(num_refused, num_kept) > 15  # the law is tested on both


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_everything_comes_back_and_no_other_file_is_left(full, assert_same, suffix, tmp_path):
    write_recording(full, tmp_path / f"a.{suffix}")
    assert_same(read_recording(tmp_path / f"a.{suffix}"), full)
    assert [path.name for path in tmp_path.iterdir()] == [f"a.{suffix}"]


@pytest.mark.parametrize("suffix", ["h5", "npz"])
def test_a_recording_without_frames_comes_back(assert_same, suffix, tmp_path):
    phase = {"phase": np.zeros(0, dtype=str)}
    empty = Recording([], np.zeros((0, 1, 1)), label=0, privileged=phase)
    write_recording(empty, tmp_path / f"a.{suffix}")
    assert_same(read_recording(tmp_path / f"a.{suffix}"), empty)
