import numpy as np
import pytest

from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io import read_npz, write_npz


def test_npz_round_trip_of_everything(full, assert_same, tmp_path):
    write_npz(full, tmp_path / "a.npz")
    assert_same(read_npz(tmp_path / "a.npz"), full)
    assert [path.name for path in tmp_path.iterdir()] == ["a.npz"]


@pytest.mark.parametrize("num_frames", [0, 1])
def test_npz_round_trip_of_no_frame_and_one_taxel(num_frames, assert_same, tmp_path):
    rec = Recording(np.zeros(num_frames), np.zeros((num_frames, 1, 1)), label=0)
    write_npz(rec, tmp_path / "a.npz")
    assert_same(read_npz(tmp_path / "a.npz"), rec)


def test_npz_names_by_hand(tmp_path):
    rec = Recording([0.5], [[[7.0]]], label="cup", privileged={"phase": [2]})
    write_npz(rec, tmp_path / "a.npz")
    with np.load(tmp_path / "a.npz", allow_pickle=False) as file:
        content = {name: file[name].tolist() for name in file.files}
    assert content == {
        "format": "tactile recording",
        "version": 1,
        "time": [0.5],
        "tactile": [[[7.0]]],
        "privileged/phase": [2],
        "label": '"cup"',
        "meta": "{}",
    }


def changed(path, drop=(), **fields):
    with np.load(path) as file:
        content = {name: file[name] for name in file.files if name not in drop}
    np.savez(path, **{**content, **fields})


def test_npz_missing_file(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"gone.npz' does not exist"):
        read_npz(tmp_path / "gone.npz")


@pytest.mark.parametrize("share", [0.0, 0.3, 0.6, 0.99])
def test_npz_cut(full, share, tmp_path):
    path = tmp_path / "a.npz"
    write_npz(full, path)
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    with pytest.raises(ValueError, match=r"a.npz' is no whole npz file \(is it cut\?\)"):
        read_npz(path)


def test_npz_damaged(full, tmp_path):
    path = tmp_path / "a.npz"
    write_npz(full, path)
    content = bytearray(path.read_bytes())
    start = content.index(b"tactile.npy") + 60
    content[start : start + 40] = bytes(40)
    path.write_bytes(content)
    with pytest.raises(ValueError, match=r"a.npz' cannot be read as npz: .* write it again"):
        read_npz(path)


def test_npz_with_pickled_objects_is_refused(full, tmp_path):
    path = tmp_path / "a.npz"
    write_npz(full, path)
    changed(path, joint=np.array([{"a": 1}], dtype=object))
    with pytest.raises(ValueError, match=r"a.npz' cannot be read as npz: .*allow_pickle"):
        read_npz(path)


@pytest.mark.parametrize("name", ["time", "tactile", "label", "meta"])
def test_npz_missing_field(full, name, tmp_path):
    write_npz(full, tmp_path / "a.npz")
    changed(tmp_path / "a.npz", drop=[name])
    with pytest.raises(ValueError, match=rf"a.npz' must hold '{name}', as every recording"):
        read_npz(tmp_path / "a.npz")


def test_npz_of_something_else(tmp_path):
    np.savez(tmp_path / "a.npz", weights=np.zeros(3))
    with pytest.raises(ValueError, match=r"must be a recording, .*npz file with \['weights'\]"):
        read_npz(tmp_path / "a.npz")


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"version": np.array(2)}, r"a.npz' must be of format version 1 \(got 2\)"),
        ({"tactile": np.zeros((20, 5))}, r"no consistent recording: 'tactile' must have shape"),
        ({"joint": np.zeros((3, 5))}, r"'joint' must have 20 frames, as 'time' has \(got 3\)"),
        ({"meta": np.array("{")}, r"a.npz' must hold JSON in 'meta'"),
        ({"meta": np.array("[1]")}, r"'meta' must be a mapping \(got list\)"),
        ({"label": np.array(3)}, r"a.npz' must hold JSON in 'label'"),
        ({"format": np.array("x")}, r"must be a recording, with 'format'"),
    ],
)
def test_npz_wrong_field(full, fields, message, tmp_path):
    write_npz(full, tmp_path / "a.npz")
    changed(tmp_path / "a.npz", **fields)
    with pytest.raises(ValueError, match=message):
        read_npz(tmp_path / "a.npz")
