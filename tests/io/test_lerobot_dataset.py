import json
import re
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("pyarrow", reason="needs the extra 'lerobot'")

import pyarrow as pa
import pyarrow.parquet as pq

from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io import lerobot_dataset, read_lerobot, write_lerobot

# The keys of version 3.0, as lerobot 0.4.4 writes them (`create_empty_dataset_info`).
INFO_KEYS = {
    "codebase_version": str,
    "robot_type": str | None,
    "total_episodes": int,
    "total_frames": int,
    "total_tasks": int,
    "chunks_size": int,
    "data_files_size_in_mb": int,
    "video_files_size_in_mb": int,
    "fps": int,
    "splits": dict,
    "data_path": str,
    "video_path": None,
    "features": dict,
}
DEFAULT_FEATURES = {
    "timestamp": {"dtype": "float32", "shape": [1], "names": None},
    "frame_index": {"dtype": "int64", "shape": [1], "names": None},
    "episode_index": {"dtype": "int64", "shape": [1], "names": None},
    "index": {"dtype": "int64", "shape": [1], "names": None},
    "task_index": {"dtype": "int64", "shape": [1], "names": None},
}


def a_recording(frames=6, rate=10, seed=0, joints=2, **more):
    draw = np.random.default_rng(seed)
    tactile = draw.normal(size=(frames, 4, 3)).astype(np.float32)
    tactile[1, 2, 0] = np.nan
    tactile[:, 3, :] = np.nan
    joint = draw.normal(size=(frames, joints)).astype(np.float32) / 9 if joints else None
    return Recording(5 + np.arange(frames) / rate, tactile, joint, **more)


def three(**more):
    meta = {"unit": "count", "joint_names": ["a", "b"]}
    return [
        a_recording(6, seed=1, label="mug", meta=meta, **more),
        a_recording(4, seed=2, label="box é", meta=meta, **more),
        a_recording(5, seed=3, label="mug", meta=meta, **more),
    ]


@pytest.fixture
def root(tmp_path):
    write_lerobot(three(), tmp_path / "set", fps=10, robot_type="allegro")
    return tmp_path / "set"


def test_recordings_come_back(root):
    for found, recording in zip(read_lerobot(root), three(), strict=True):
        assert found.time == pytest.approx(recording.time - 5, abs=1e-9)
        assert np.array_equal(found.tactile, recording.tactile, equal_nan=True)
        assert np.array_equal(found.joint, recording.joint)
        assert found.label == recording.label
        assert found.meta == {**recording.meta, "rate": 10}


@pytest.mark.parametrize(("fps", "written"), [(29.97, 29.97), (30.0, 30)])
def test_a_rate_may_be_a_fraction(tmp_path, fps, written):
    recording = Recording(np.arange(3000) / 29.97, np.arange(3000.0)[:, None, None])
    write_lerobot([recording], tmp_path / "set", fps=fps)
    info = json.loads((tmp_path / "set/meta/info.json").read_text())
    assert info["fps"] == written
    assert type(info["fps"]) is type(written)
    found = read_lerobot(tmp_path / "set")[0]
    assert found.time.tolist() == (np.arange(found.num_frames) / fps).tolist()
    if fps == 29.97:  # each step has the frame that was recorded at it
        assert np.array_equal(found.tactile, recording.tactile)


def test_without_joints_and_with_labels_of_other_types(tmp_path):
    recordings = [a_recording(joints=0, label=3), a_recording(joints=0)]
    write_lerobot(recordings, tmp_path / "set", fps=10)
    assert [found.label for found in read_lerobot(tmp_path / "set")] == [3, None]
    (tmp_path / "set/meta/tactile.json").unlink()
    found = read_lerobot(tmp_path / "set")
    assert [one.label for one in found] == ["3", "touch"]
    assert [one.meta for one in found] == [{"episode": i, "rate": 10} for i in range(2)]
    assert found[0].joint is None


def test_info_has_the_documented_keys(root):
    info = json.loads((root / "meta/info.json").read_text())
    assert [*info] == [*INFO_KEYS]
    for key, kind in INFO_KEYS.items():
        assert info[key] is None if kind is None else isinstance(info[key], kind)
    features = info.pop("features")
    assert info == {
        "codebase_version": "v3.0",
        "robot_type": "allegro",
        "total_episodes": 3,
        "total_frames": 15,
        "total_tasks": 2,
        "chunks_size": 1000,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": 10,
        "splits": {"train": "0:3"},
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": None,
    }
    assert features.pop("observation.tactile") == {
        "dtype": "float32",
        "shape": [12],
        "names": [f"taxel_{taxel}_{axis}" for taxel in range(4) for axis in "xyz"],
    }
    assert features.pop("observation.state") == {
        "dtype": "float32",
        "shape": [2],
        "names": ["a", "b"],
    }
    assert features == DEFAULT_FEATURES


def test_files_are_where_the_format_has_them(root):
    files = sorted(str(path.relative_to(root)) for path in root.rglob("*") if path.is_file())
    assert files == [
        "README.md",
        "data/chunk-000/file-000.parquet",
        "meta/episodes/chunk-000/file-000.parquet",
        "meta/info.json",
        "meta/stats.json",
        "meta/tactile.json",
        "meta/tasks.parquet",
    ]


def test_frames_have_the_documented_columns(root):
    table = pq.read_table(root / "data/chunk-000/file-000.parquet")
    types = {field.name: str(field.type) for field in table.schema}
    types = {name: re.sub("element|item", "x", text) for name, text in types.items()}
    assert types == {
        "observation.tactile": "fixed_size_list<x: float>[12]",
        "observation.state": "fixed_size_list<x: float>[2]",
        "timestamp": "float",
        "frame_index": "int64",
        "episode_index": "int64",
        "index": "int64",
        "task_index": "int64",
    }
    assert table["index"].to_pylist() == list(range(15))
    assert table["episode_index"].to_pylist() == [0] * 6 + [1] * 4 + [2] * 5
    assert table["task_index"].to_pylist() == [0] * 6 + [1] * 4 + [0] * 5
    assert table["frame_index"].to_pylist() == [*range(6), *range(4), *range(5)]
    assert table["timestamp"].to_numpy() == pytest.approx(table["frame_index"].to_numpy() / 10)


def test_episodes_have_the_documented_columns(root):
    (first, second, _) = pq.read_table(root / "meta/episodes").to_pylist()
    keys = ("min", "max", "mean", "std", "q01", "q10", "q50", "q90", "q99", "count")
    names = ("observation.tactile", "observation.state", *DEFAULT_FEATURES)
    assert set(first) == {
        *("episode_index", "tasks", "length", "dataset_from_index", "dataset_to_index"),
        *("data/chunk_index", "data/file_index"),
        *("meta/episodes/chunk_index", "meta/episodes/file_index"),
        *(f"stats/{name}/{key}" for name in names for key in keys),
    }
    assert (second["episode_index"], second["tasks"], second["length"]) == (1, ["box é"], 4)
    assert (second["dataset_from_index"], second["dataset_to_index"]) == (6, 10)
    assert second["stats/index/min"] == [6.0]
    assert second["stats/observation.state/count"] == [4]


def test_tasks_are_an_index_for_pandas(root):
    table = pq.read_table(root / "meta/tasks.parquet")
    assert table.to_pydict() == {"task_index": [0, 1], "__index_level_0__": ["mug", "box é"]}
    assert json.loads(table.schema.metadata[b"pandas"])["index_columns"] == ["__index_level_0__"]


def test_statistics_leave_out_what_is_missing(root):
    stats = json.loads((root / "meta/stats.json").read_text())
    readings = np.concatenate([r.tactile for r in three()]).reshape(-1, 12)[:, :9]
    found = stats["observation.tactile"]
    assert found["count"] == [15]
    assert found["min"][:9] == pytest.approx(np.nanmin(readings, axis=0))
    assert found["max"][:9] == pytest.approx(np.nanmax(readings, axis=0))
    assert found["mean"][9:] == found["q50"][9:] == [0, 0, 0]  # the dead taxel
    # Episodes count by their frames, as LeRobot joins them, whatever is missing in them.
    means = [np.nanmean(r.tactile.reshape(-1, 12)[:, :9], axis=0) for r in three()]
    mean = np.average(means, axis=0, weights=[6, 4, 5])
    assert found["mean"][:9] == pytest.approx(mean, rel=1e-5)
    assert stats["observation.state"]["mean"] == pytest.approx(
        np.concatenate([r.joint for r in three()]).mean(axis=0), rel=1e-5
    )
    assert stats["observation.state"]["std"] == pytest.approx(
        np.concatenate([r.joint for r in three()]).std(axis=0), rel=1e-5
    )
    assert stats["frame_index"]["max"] == [5.0]


def test_feature_without_any_reading_has_zeros(tmp_path):
    write_lerobot([Recording([0.0], np.full((1, 2, 1), np.nan))], tmp_path / "set", fps=5)
    stats = json.loads((tmp_path / "set/meta/stats.json").read_text())["observation.tactile"]
    assert stats["mean"] == stats["min"] == stats["q50"] == [0.0, 0.0]
    assert np.isnan(read_lerobot(tmp_path / "set")[0].tactile).all()


def test_flat_columns_are_described_for_datasets(root):
    metadata = pq.read_schema(root / "data/chunk-000/file-000.parquet").metadata
    features = json.loads(metadata[b"huggingface"])["info"]["features"]
    value = {"dtype": "float32", "_type": "Value"}
    assert features["observation.tactile"] == {
        "feature": value,
        "length": 12,
        "_type": "Sequence",
    }
    assert features["timestamp"] == value
    assert [*features] == pq.read_schema(root / "data/chunk-000/file-000.parquet").names
    assert "data_files: data/*/*.parquet" in (root / "README.md").read_text()


def test_one_value_a_step_is_no_list(tmp_path):
    recording = Recording([0.0, 0.1], [[[1.0]], [[2.0]]], [[0.5], [0.25]])
    write_lerobot([recording], tmp_path / "set", fps=10)
    types = {f.name: str(f.type) for f in pq.read_schema(next(tmp_path.rglob("data/*/*")))}
    assert types["observation.tactile"] == types["observation.state"] == "float"
    (found,) = read_lerobot(tmp_path / "set")
    assert found.tactile.ravel().tolist() == [1, 2]
    assert found.joint.ravel().tolist() == [0.5, 0.25]


@pytest.mark.parametrize("rate", [150, 997.3])
def test_every_frame_comes_back_with_its_time(tmp_path, rate):
    draw = np.random.default_rng(0)
    recordings = []
    for frames in (200, 1, 83):
        time = 1.7e9 + np.cumsum(draw.uniform(0.2, 1.8, frames)) / rate
        tactile = draw.normal(size=(frames, 2, 3)).astype(np.float32)
        tactile[draw.random(tactile.shape) < 0.1] = np.nan
        joint = draw.normal(size=(frames, 2)).astype(np.float32) / 9
        recordings.append(Recording(time, tactile, joint, meta={"rate": rate}))
    write_lerobot(recordings, tmp_path / "set", fps=30, every_frame=True)
    for found, recording in zip(
        read_lerobot(tmp_path / "set", every_frame=True), recordings, strict=True
    ):
        assert found.time == pytest.approx(recording.time - recording.time[0], abs=1e-6)
        assert np.array_equal(found.tactile, recording.tactile, equal_nan=True)
        assert np.array_equal(found.joint, recording.joint)
        assert found.meta == {"rate": rate}
    # The other features are those of the last frame up to each step.
    for found, recording in zip(read_lerobot(tmp_path / "set"), recordings, strict=True):
        assert np.array_equal(found.tactile[-1], recording.tactile[-1], equal_nan=True)
        assert found.meta["rate"] == 30


def test_frames_since_the_last_step_come_before_it_and_the_newest_last(tmp_path):
    time = np.array([0.0, 0.04, 0.1, 0.32])  # steps at 0, 0.1, 0.2, 0.3 and 0.4
    recording = Recording(time, np.arange(1.0, 5).reshape(4, 1, 1).repeat(2, 1))
    write_lerobot([recording], tmp_path / "set", fps=10, every_frame=True)
    table = pq.read_table(next(tmp_path.rglob("data/*/*")))
    nan = np.nan
    rows = np.array(table["observation.tactile_frames"].to_pylist())
    expected = [[nan, nan, 1, 1], [2, 2, 3, 3], [nan] * 4, [nan] * 4, [nan, nan, 4, 4]]
    assert np.array_equal(rows, expected, equal_nan=True)
    times = np.array(table["observation.tactile_frames_time"].to_pylist())
    expected = [[nan, 0], [-0.06, 0], [nan, nan], [nan, nan], [nan, -0.08]]
    assert times == pytest.approx(np.array(expected), nan_ok=True, abs=1e-8)
    own = json.loads((tmp_path / "set/meta/tactile.json").read_text())
    assert own["shape"] == [2, 1]
    assert own["every_frame"] == {
        "feature": "observation.tactile_frames",
        "shape": [2, 2, 1],
        "time": "observation.tactile_frames_time",
        "missing": "NaN, before the others",
    }
    stats = json.loads((tmp_path / "set/meta/stats.json").read_text())
    assert stats["observation.tactile_frames"]["max"] == [4] * 4


@pytest.mark.parametrize(
    ("most_bytes", "files"),
    [
        (680, [(0, 0), (0, 0), (0, 1)]),  # 6 + 4 frames of 68 bytes
        (679, [(0, 0), (0, 1), (0, 1)]),
        (1, [(0, 0), (0, 1), (1, 0)]),
    ],
)
def test_long_sets_have_several_files(tmp_path, monkeypatch, most_bytes, files):
    monkeypatch.setattr(lerobot_dataset, "_DATA_MB", most_bytes / 2**20)
    monkeypatch.setattr(lerobot_dataset, "_FILES_PER_CHUNK", 2)
    write_lerobot(three(), tmp_path / "set", fps=10)
    found = sorted(str(p.relative_to(tmp_path / "set/data")) for p in tmp_path.rglob("data/*/*"))
    assert found == [
        f"chunk-{chunk:03d}/file-{file:03d}.parquet" for chunk, file in sorted(set(files))
    ]
    rows = pq.read_table(tmp_path / "set/meta/episodes").to_pylist()
    assert [(row["data/chunk_index"], row["data/file_index"]) for row in rows] == files
    assert [found.num_frames for found in read_lerobot(tmp_path / "set")] == [6, 4, 5]


def change(path, **values):
    content = json.loads(path.read_text())
    path.write_text(json.dumps({**content, **values}))


def test_sets_of_others_have_other_features(root):
    path = root / "data/chunk-000/file-000.parquet"
    table = pq.read_table(path)
    skin = pa.array(np.arange(30.0).reshape(15, 2).tolist())
    table = table.append_column("skin", skin).append_column("one", pa.array(range(15)))
    pq.write_table(table, path)
    features = json.loads((root / "meta/info.json").read_text())["features"]
    skin = {"dtype": "float64", "shape": [2], "names": None}
    one = {"dtype": "int64", "shape": [1], "names": None}
    change(root / "meta/info.json", features={**features, "skin": skin, "one": one})
    found = read_lerobot(root, tactile="skin", state="none")
    assert found[1].tactile[:, :, 0].tolist() == [[12, 13], [14, 15], [16, 17], [18, 19]]
    assert found[1].joint is None
    found = read_lerobot(root, tactile="one", state="one")
    assert found[1].tactile.ravel().tolist() == [6, 7, 8, 9]
    assert found[2].joint.ravel().tolist() == [10, 11, 12, 13, 14]


@pytest.mark.parametrize(
    ("values", "match"),
    [
        ({"codebase_version": "v2.1"}, "must be a LeRobot data set of version 3 .*got v2.1"),
        ({"fps": 0}, "positive 'fps'"),
        ({"total_episodes": 4}, "each of 4 episodes once .got 3"),
        ({"features": {"action": {}}}, "must have the feature 'observation.tactile' .*got action"),
        ({"features": {"observation.tactile": {"shape": [2, 2, 2]}}}, "one or two dimensions"),
        ({"features": {"observation.tactile": {"shape": [3, 5]}}}, "15 numbers in 'obs.*got 180"),
        ({"features": {"observation.tactile": {"shape": [4]}}}, "must have 12 values.*got 4"),
        ({"fps": 20}, "must hold 20 steps per second.*advance by 0.05 s .got 0.1"),
    ],
)
def test_what_does_not_fit_together_is_refused(root, values, match):
    change(root / "meta/info.json", **values)
    with pytest.raises(ValueError, match=match):
        read_lerobot(root)


@pytest.mark.parametrize(
    "name", ["data/chunk-000/file-000.parquet", "meta/tasks.parquet", "meta/info.json"]
)
def test_damaged_files_are_named(root, name):
    path = root / name
    whole = path.read_bytes()
    for content in (whole[: len(whole) // 2], b"", b"no such file"):
        path.write_bytes(content)
        with pytest.raises(ValueError, match=re.escape(str(path))):
            read_lerobot(root)
    path.unlink()
    with pytest.raises(FileNotFoundError, match="set"):
        read_lerobot(root)


@pytest.mark.parametrize(
    ("recordings", "settings", "error", "match"),
    [
        ([], {}, ValueError, "at least one recording"),
        ([a_recording(), a_recording(joints=0)], {}, ValueError, "recording 1 must have 4 taxels"),
        ([a_recording().select(slice(0, 0))], {}, ValueError, "recording 0 must hold at least one"),
        (
            [a_recording(meta={"unit": "count"}), a_recording(meta={"unit": "newton"})],
            {},
            ValueError,
            "must have one unit",
        ),
        ([a_recording()], {"fps": 0}, ValueError, "'fps' must be a positive number"),
        ([a_recording()], {"fps": True}, ValueError, "'fps' must be a positive number"),
        ([a_recording()], {"nearest": True, "every_frame": True}, ValueError, "'nearest' must be"),
    ],
    ids=["none", "joints", "empty", "units", "zero", "fraction", "nearest"],
)
def test_bad_arguments(tmp_path, recordings, settings, error, match):
    with pytest.raises(error, match=match):
        write_lerobot(recordings, tmp_path / "set", **{"fps": 10, **settings})
    assert not (tmp_path / "set").exists()


def test_folder_with_files_is_not_touched(root):
    with pytest.raises(FileExistsError, match="new or empty folder"):
        write_lerobot(three(), root, fps=10)
    with pytest.raises(FileNotFoundError, match=r"info.json' does not exist"):
        read_lerobot(root.parent)


def test_missing_library_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "pyarrow", None)
    with pytest.raises(ImportError, match=r"pip install 'torch-geometric-tactile\[lerobot\]'"):
        write_lerobot(three(), tmp_path, fps=10)


def full(frames=40, rate=20, start=0.0, **more):
    draw = np.random.default_rng(frames)
    return Recording(
        start + np.arange(frames) / rate,
        draw.normal(size=(frames, 2, 3)),
        draw.normal(size=(frames, 2)) / 9,
        extra={
            "pressure": draw.normal(size=(frames, 3)),
            "pac": draw.normal(size=(frames, 3, 22)).astype(np.float32),
            "count": np.arange(frames) + 2**40,
            "button": draw.random(frames) < 0.5,
            "level": draw.integers(0, 9, (frames, 1), dtype=np.uint8),
            "half": draw.normal(size=frames).astype(np.float16),
        },
        annotations=[(start + 0.25, start + 0.5, "slip"), (start + 1.5, start + 99.0, "é 手")],
        **more,
    )


def assert_equal(found, recording, start):
    assert found.extra.keys() == recording.extra.keys()
    for name, value in recording.extra.items():
        assert found.extra[name].dtype == value.dtype, name
        assert np.array_equal(found.extra[name], value), name
    assert [a.label for a in found.annotations] == [a.label for a in recording.annotations]
    times = [(a.start - start, a.end - start) for a in recording.annotations]
    np.testing.assert_array_equal([a[:2] for a in found.annotations], times)


@pytest.mark.parametrize("every_frame", [False, True])
@pytest.mark.parametrize("start", [0.0, 1.7e9])
def test_annotations_and_further_signals_come_back(tmp_path, caplog, every_frame, start):
    recordings = [full(start=start), full(31, start=start)]
    write_lerobot(recordings, tmp_path / "set", fps=20, every_frame=every_frame)
    assert caplog.text == ""
    for found, recording in zip(
        read_lerobot(tmp_path / "set", every_frame=every_frame), recordings, strict=True
    ):
        assert_equal(found, recording, start)
    features = json.loads((tmp_path / "set/meta/info.json").read_text())["features"]
    names = features["observation.extra.pac"].pop("names")
    assert (names[0], names[-1]) == ("pac_0_0", "pac_2_21")
    assert features["observation.extra.pac"] == {"dtype": "float32", "shape": [66]}
    assert features["observation.extra.count"] == {"dtype": "float64", "shape": [1], "names": None}
    (tmp_path / "set/meta/tactile.json").unlink()  # as LeRobot's tools do
    found = read_lerobot(tmp_path / "set")[1]
    assert {name: value.shape[1:] for name, value in found.extra.items()} == {
        "pressure": (3,),
        "pac": (3, 22),
        "count": (),
        "button": (),
        "level": (),
        "half": (),
    }
    assert np.array_equal(found.extra["count"], recordings[1].extra["count"])


def test_signals_that_a_data_set_cannot_hold_are_named(tmp_path, caplog):
    first = full(
        5,
        privileged={"pose": np.ones((5, 7))},
    )
    extra = {**first.extra, "note": np.array(["a"] * 5), "id": np.full(5, 2**60 + 1)}
    first = replace(first, extra={**extra, "alone": np.ones(5)})
    second = replace(first, extra={**extra, "pac": np.ones((5, 3))})
    write_lerobot([first, second], tmp_path / "set", fps=20)
    (record,) = caplog.records
    assert record.levelname == "WARNING"
    assert (
        "cannot store extra 'alone', extra 'id', extra 'note', extra 'pac', privileged 'pose'"
        in (record.getMessage())
    )
    assert sorted(read_lerobot(tmp_path / "set")[0].extra) == [
        *("button", "count", "half", "level", "pressure")
    ]


def gappy(rate=100, gap=3.0):
    time = np.arange(80) / rate
    time[40:] += gap
    tactile = 1 + np.arange(80.0)[:, None, None] * np.ones((1, 2, 1))
    extra = {"a": np.arange(80)}
    return Recording(time, tactile, np.arange(80)[:, None] / 80, extra=extra)


@pytest.mark.parametrize("nearest", [False, True])
def test_steps_in_a_gap_are_missing_and_said(tmp_path, caplog, nearest):
    recording = gappy()
    write_lerobot([recording], tmp_path / "set", fps=30, nearest=nearest)
    (record,) = caplog.records
    assert "recording 0 has no frame within 0.05003 s of 8" in record.getMessage()
    assert "of 114 steps, from 0.4667 to " in record.getMessage()
    (found,) = read_lerobot(tmp_path / "set")
    frame = np.searchsorted(recording.time, found.time + 1e-5, side="right") - 1
    distance = found.time - recording.time[frame]
    if nearest:
        distance = np.minimum(
            distance, np.abs(recording.time[np.minimum(frame + 1, 79)] - found.time)
        )
    missing = np.isnan(found.tactile).all(axis=(1, 2))
    assert missing.tolist() == (distance > 0.0501).tolist()
    assert np.isnan(found.joint).all(axis=1).tolist() == missing.tolist()
    assert np.isnan(found.extra["a"]).tolist() == missing.tolist()
    if not nearest:
        assert np.array_equal(found.tactile[~missing], recording.tactile[frame[~missing]])
    stats = json.loads((tmp_path / "set/meta/stats.json").read_text())
    for name in ("observation.tactile", "observation.state", "observation.extra.a"):
        for values in stats[name].values():
            assert np.isfinite(values).all()
    assert stats["observation.tactile"]["max"] == np.nanmax(found.tactile, axis=(0, 2)).tolist()
    assert stats["observation.extra.a"]["mean"][0] == pytest.approx(
        float(np.nanmean(found.extra["a"]))
    )


def test_steps_in_a_gap_may_be_refused_before_anything_is_written(tmp_path):
    write_lerobot([gappy()], tmp_path / "set", fps=30, gaps="error", max_gap=9)
    assert not np.isnan(read_lerobot(tmp_path / "set")[0].tactile).any()
    with pytest.raises(ValueError, match=r"recording 1 has no frame within .* gaps='nan'"):
        write_lerobot([gappy(gap=0), gappy()], tmp_path / "none", fps=30, gaps="error")
    assert not (tmp_path / "none").exists()
    for wrong, message in [
        ({"gaps": "fill"}, "'gaps' must be"),
        ({"max_gap": 0}, "'max_gap' must"),
    ]:
        with pytest.raises(ValueError, match=message):
            write_lerobot([gappy()], tmp_path / "none", fps=30, **wrong)


def burst_times(count=300):
    return np.arange(count) // 3 * 0.016 + np.arange(count) % 3 * 1e-6


@pytest.mark.parametrize(
    ("time", "fps"),
    [
        (np.arange(50) / 10, 30),  # more steps than frames
        (np.arange(500) / 100, 1),  # few steps
        (burst_times(), 30),  # frames that came at once
        (burst_times(), 200),
        (np.cumsum(np.random.default_rng(0).uniform(0.2, 1.8, 500)) / 100, 30),
        (np.array([0.0]), 30),
        (np.array([0.0, 1.0]), 30),
    ],
)
@pytest.mark.parametrize("every_frame", [False, True])
def test_without_a_gap_no_step_is_missing(tmp_path, caplog, time, fps, every_frame):
    recording = Recording(time, np.ones((len(time), 1, 1)))
    write_lerobot([recording], tmp_path / "set", fps=fps, every_frame=every_frame)
    assert caplog.text == ""
    (found,) = read_lerobot(tmp_path / "set")
    assert (found.tactile == 1).all()
    if every_frame:
        assert read_lerobot(tmp_path / "set", every_frame=True)[0].num_frames == len(time)


def test_a_gap_keeps_all_frames_at_their_own_times(tmp_path):
    recording = gappy()
    write_lerobot([recording], tmp_path / "set", fps=30, every_frame=True)
    (found,) = read_lerobot(tmp_path / "set", every_frame=True)
    assert found.time == pytest.approx(recording.time, abs=1e-6)
    assert np.array_equal(found.tactile, recording.tactile)
    assert np.array_equal(found.extra["a"], recording.extra["a"])
