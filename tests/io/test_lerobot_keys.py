"""Features of LeRobot data sets by the policies that read them: readings, actions and numbers for
missing readings.
"""

import json
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("pyarrow", reason="needs the extra 'lerobot'")

import pyarrow.parquet as pq
from lerobot_sets import write_without_touch

from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io import add_to_lerobot, read_lerobot, write_lerobot

ENVIRONMENT, STATE = "observation.environment_state", "observation.state"
KEYS = ["observation.tactile", ENVIRONMENT, STATE, "observation.skin"]
NAMES = ["taxel_0_x", "taxel_0_y", "taxel_1_x", "taxel_1_y"]


def demonstration(frames=9, rate=10, seed=0, joints=2, **more):
    draw = np.random.default_rng(seed)
    tactile = draw.normal(size=(frames, 2, 2)).astype(np.float32)
    tactile[1, 1, 0] = np.nan
    joint = draw.normal(size=(frames, joints)).astype(np.float32) if joints else None
    action = np.arange(3.0 * frames).reshape(frames, 3)
    meta = {"joint_names": ["a", "b"], "action_names": ["grip", "lift", "turn"]}
    more = {"joint": joint, "action": action, "meta": meta, **more}
    return Recording(7 + np.arange(frames) / rate, tactile, **more)


def two(**more):
    return [demonstration(seed=1, **more), demonstration(6, seed=2, **more)]


def description(root):
    return json.loads((root / "meta/info.json").read_text())["features"]


def table(root):
    return pq.read_table(root / "data/chunk-000/file-000.parquet")


def values(root, name):
    return np.array(table(root)[name].to_pylist(), dtype=np.float32)


def same(one, other):
    return np.array_equal(one, other, equal_nan=True)


@pytest.mark.parametrize("joints", [0, 2])
@pytest.mark.parametrize("every_frame", [False, True])
@pytest.mark.parametrize("key", KEYS)
def test_recordings_come_back_from_each_feature(tmp_path, key, every_frame, joints):
    given = two(joints=joints, extra={})
    write_lerobot(given, tmp_path / "a", 10, key=key, every_frame=every_frame)
    for found, recording in zip(
        read_lerobot(tmp_path / "a", every_frame=every_frame), given, strict=True
    ):
        assert same(found.tactile, recording.tactile)
        assert same(found.action, recording.action)
        assert (found.joint is None) == (recording.joint is None)
        assert joints == 0 or same(found.joint, recording.joint)
        assert found.meta["action_names"] == ["grip", "lift", "turn"]


def test_the_default_key_is_that_of_earlier_versions(tmp_path):
    write_lerobot(two(action=None), tmp_path / "a", 10)
    write_lerobot(two(action=None), tmp_path / "b", 10, key="observation.tactile", fill=None)
    for path in (tmp_path / "a").rglob("*.*"):
        assert path.read_bytes() == (tmp_path / "b" / path.relative_to(tmp_path / "a")).read_bytes()
    content = json.loads((tmp_path / "a/meta/tactile.json").read_text())
    assert [*content] == ["version", "feature", "shape", "episodes"]


def test_readings_are_joined_to_the_joint_angles(tmp_path):
    given = two()
    write_lerobot(given, tmp_path / "a", 10, key=STATE, every_frame=True)
    features = description(tmp_path / "a")
    assert features[STATE] == {"dtype": "float32", "shape": [6], "names": ["a", "b", *NAMES]}
    assert {name for name in features if name.startswith("observation")} == {
        STATE,
        "observation.state_frames",
        "observation.tactile_frames",
        "observation.tactile_frames_time",
    }
    expected = np.concatenate([r.tactile.reshape(-1, 4) for r in given])
    assert same(values(tmp_path / "a", STATE)[:, 2:], expected)
    assert same(values(tmp_path / "a", STATE)[:, :2], np.concatenate([r.joint for r in given]))
    stats = json.loads((tmp_path / "a/meta/stats.json").read_text())[STATE]
    assert stats["mean"][2:] == pytest.approx(np.nanmean(expected, axis=0), abs=0.02)
    assert stats["max"][2:] == pytest.approx(np.nanmax(expected, axis=0))
    content = json.loads((tmp_path / "a/meta/tactile.json").read_text())
    assert (content["feature"], content["columns"]) == (STATE, [2, 6])


@pytest.mark.parametrize("key", [ENVIRONMENT, STATE])
def test_features_are_known_by_their_names_where_another_program_left_out_our_file(tmp_path, key):
    given = two()
    write_lerobot(given, tmp_path / "a", 10, key=key)
    (tmp_path / "a/meta/tactile.json").unlink()
    with pytest.raises(ValueError, match=r"must have the feature 'observation.tactile'"):
        read_lerobot(tmp_path / "a")
    found = read_lerobot(tmp_path / "a", tactile=key)
    assert same(found[1].tactile, given[1].tactile)
    assert same(found[1].joint, given[1].joint)


@pytest.mark.parametrize("nearest", [False, True])
def test_the_action_of_a_step_is_the_last_command_up_to_it(tmp_path, nearest):
    time = np.array([0.0, 0.08, 0.11, 0.19, 0.26])
    recording = Recording(time, np.zeros((5, 1, 1)), action=np.arange(5.0)[:, None])
    write_lerobot([recording], tmp_path / "a", 10, nearest=nearest)
    assert read_lerobot(tmp_path / "a")[0].action.ravel().tolist() == [0, 1, 3]
    assert description(tmp_path / "a")["action"]["names"] == ["action_0"]
    assert "action_names" not in read_lerobot(tmp_path / "a")[0].meta


def test_all_frames_have_the_action_of_the_last_step(tmp_path):
    recording = Recording(np.arange(9) / 40, np.zeros((9, 1, 1)), action=np.arange(9.0)[:, None])
    write_lerobot([recording], tmp_path / "a", 10, every_frame=True)
    assert not any("frames" in name for name in description(tmp_path / "a") if "action" in name)
    found = read_lerobot(tmp_path / "a", every_frame=True)[0]
    assert found.time == pytest.approx(recording.time, abs=1e-6)
    assert found.action.ravel().tolist() == [0, 0, 0, 0, 4, 4, 4, 4, 8]


def test_all_recordings_have_actions_or_none(tmp_path):
    with pytest.raises(ValueError, match=r"recording 1 must have .* and 3 actions.*\(2, 2, 2, 0\)"):
        write_lerobot([demonstration(), demonstration(action=None)], tmp_path / "a", 10)
    assert not (tmp_path / "a").exists()


@pytest.mark.parametrize("key", KEYS)
@pytest.mark.parametrize("every_frame", [False, True])
def test_no_number_is_missing_with_fill(tmp_path, caplog, key, every_frame):
    pac = np.where(np.arange(8) < 3, np.nan, 1.0)
    whole = demonstration()
    time = np.r_[0:4, 5:9] / 20  # steps with one frame and with two
    frames = Recording(
        time,
        whole.tactile[:8],
        joint=whole.joint[:8],
        action=whole.action[:8],
        extra={"pac": pac, "pac_frames_time": pac},  # whose name is not that of times
    )
    write_lerobot([frames], tmp_path / "a", 10, key=key, every_frame=every_frame, fill=-0.5)
    for column in table(tmp_path / "a").column_names:
        numbers = values(tmp_path / "a", column)
        assert not np.isnan(numbers).any(), column
    stats = json.loads((tmp_path / "a/meta/stats.json").read_text())
    stored = values(tmp_path / "a", key)
    assert stats[key]["mean"] == pytest.approx(stored.mean(axis=0), abs=1e-6)
    assert stats[key]["min"] == pytest.approx(stored.min(axis=0), abs=1e-6)
    found = read_lerobot(tmp_path / "a", every_frame=every_frame)[0]
    expected = frames.tactile if every_frame else frames.tactile[[0, 2, 3, 5, 7]][: len(found.time)]
    assert np.array_equal(found.tactile, np.nan_to_num(expected, nan=-0.5))
    assert found.extra["pac_frames_time"][0] == -0.5
    if every_frame:
        assert found.time == pytest.approx(time, abs=1e-6)
        assert same(found.joint, frames.joint)
        prefix = "observation.tactile" if key == STATE else key
        times = values(tmp_path / "a", f"{prefix}_frames_time")
        rows = values(tmp_path / "a", f"{prefix}_frames").reshape(*times.shape, 4)
        assert times[0].tolist() == [np.float32(-0.2), 0]
        assert (rows[0, 0] == -0.5).all()


def test_readings_in_a_gap_are_filled_and_joint_angles_and_actions_are_not(tmp_path, caplog):
    whole = demonstration(30, rate=20)
    gap = np.r_[0:8, 20:30]
    given = Recording(whole.time[gap], whole.tactile[gap])
    write_lerobot([given], tmp_path / "a", 10, fill=0)
    assert "where readings are 0" in caplog.text
    found = read_lerobot(tmp_path / "a")[0].tactile
    assert (found[7:10] == 0).all()
    assert not np.isnan(found).any()
    for name in ("joint", "action"):
        with pytest.raises(ValueError, match=rf"recording 0 must have '{name}' at .*none 0.\d s"):
            write_lerobot(
                [replace(given, **{name: getattr(whole, name)[gap]})], tmp_path / "b", 10, fill=0
            )
    joint = whole.joint.copy()
    joint[3] = np.nan  # between two steps
    given = replace(whole, joint=joint)
    write_lerobot([given], tmp_path / "c", 10, fill=0)
    with pytest.raises(ValueError, match="recording 0 must have 'joint' at all steps"):
        write_lerobot([given], tmp_path / "b", 10, fill=0, every_frame=True)
    assert not (tmp_path / "b").exists()


@pytest.mark.parametrize(
    ("settings", "match"),
    [
        ({"key": "tactile"}, r"'key' must be .*observation.environment_state.*got 'tactile'"),
        ({"key": "observation."}, "'key' must be"),
        ({"key": "observation.a/b"}, "'key' must be"),
        ({"key": "observation.extra.pac"}, "'key' must be"),
        ({"key": "observation.state_frames"}, "'key' must be"),
        ({"key": None}, "'key' must be"),
        ({"fill": np.nan}, r"'fill' must be a finite number, or None for NaN \(got nan\)"),
        ({"fill": 1e39}, "'fill' must be a finite number"),
        ({"fill": True}, "'fill' must be a finite number"),
        ({"fill": "last"}, "'fill' must be a finite number"),
    ],
)
def test_wrong_keys_and_numbers_are_refused(tmp_path, settings, match):
    with pytest.raises(ValueError, match=match):
        write_lerobot(two(), tmp_path / "a", 10, **settings)
    with pytest.raises(ValueError, match=match):
        add_to_lerobot(tmp_path / "none", two(), tmp_path / "a", **settings)
    assert not (tmp_path / "a").exists()


@pytest.fixture
def source(tmp_path):
    """A data set of joints and actions alone."""
    write_without_touch(two(), tmp_path / "arm", fps=10)
    return tmp_path / "arm"


@pytest.mark.parametrize("every_frame", [False, True])
@pytest.mark.parametrize("key", KEYS)
def test_touch_is_added_under_each_key(source, tmp_path, key, every_frame):
    touch = [demonstration(99, 100, seed=5), demonstration(88, 100, seed=6)]
    settings = {"key": key, "every_frame": every_frame, "fill": 0.0}
    add_to_lerobot(source, touch, tmp_path / "new", **settings)
    for found, arm, skin in zip(read_lerobot(tmp_path / "new"), two(), touch, strict=True):
        frames = slice(0, 10 * found.num_frames, 10)
        assert np.array_equal(found.tactile, np.nan_to_num(skin.tactile[frames]))
        assert same(found.joint, arm.joint)  # of the data set, not of the touch
        assert same(found.action, arm.action)
    stats = json.loads((tmp_path / "new/meta/stats.json").read_text())
    stored = values(tmp_path / "new", key)
    assert stats[key]["max"] == pytest.approx(np.nanmax(stored, axis=0))
    assert stats[key]["std"] == pytest.approx(np.nanstd(stored, axis=0), rel=1e-4)
    if every_frame:
        found = read_lerobot(tmp_path / "new", every_frame=True)[0]
        assert np.array_equal(found.tactile, np.nan_to_num(touch[0].tactile[: found.num_frames]))


def test_touch_is_joined_to_the_state_of_a_data_set(source, tmp_path):
    before = description(source)
    info = json.loads((source / "meta/info.json").read_text())
    info["features"][STATE]["names"] = {"motors": ["wrist", "gripper"]}  # as of version 2.1
    info["features"][STATE]["fps"] = 10.0
    (source / "meta/info.json").write_text(json.dumps(info))
    touch = [demonstration(99, 100, seed=5), demonstration(88, 100, seed=6)]
    add_to_lerobot(source, touch, tmp_path / "new", key=STATE)
    features = description(tmp_path / "new")
    names = ["wrist", "gripper", *NAMES]
    assert features[STATE] == {"dtype": "float32", "shape": [6], "names": names, "fps": 10.0}
    content = json.loads((tmp_path / "new/meta/tactile.json").read_text())
    assert content["columns"] == [2, 6]
    assert {name: f for name, f in features.items() if name != STATE} == {
        name: f for name, f in before.items() if name != STATE
    }
    stored = values(tmp_path / "new", STATE)
    assert same(stored[:, :2], values(source, STATE))
    assert table(tmp_path / "new").column_names == table(source).column_names
    described = json.loads(table(tmp_path / "new").schema.metadata[b"huggingface"])
    assert described["info"]["features"][STATE]["length"] == 6
    episodes = pq.read_table(tmp_path / "new/meta/episodes")
    assert len(set(episodes.column_names)) == len(episodes.column_names)
    assert episodes[f"stats/{STATE}/max"].to_pylist()[1] == pytest.approx(
        np.nanmax(stored[9:], axis=0)
    )
    old = json.loads((source / "meta/stats.json").read_text())
    new = json.loads((tmp_path / "new/meta/stats.json").read_text())
    assert new[STATE]["std"][:2] == pytest.approx(old[STATE]["std"])
    assert new["action"] == old["action"]


def test_touch_is_joined_to_a_state_that_is_there_only(tmp_path):
    write_without_touch(two(joints=0), tmp_path / "arm", fps=10)
    touch = [demonstration(99, 100), demonstration(88, 100)]
    with pytest.raises(ValueError, match=r"must have 'observation.state' of float32 .*got None"):
        add_to_lerobot(tmp_path / "arm", touch, tmp_path / "new", key=STATE)
    assert not (tmp_path / "new").exists()


def test_touch_is_joined_to_a_state_once(source, tmp_path):
    touch = [demonstration(99, 100), demonstration(88, 100)]
    add_to_lerobot(source, touch, tmp_path / "one", key=STATE)
    with pytest.raises(ValueError, match=r"must not have readings in 'observation.state' already"):
        add_to_lerobot(tmp_path / "one", touch, tmp_path / "two", key=STATE)
    assert not (tmp_path / "two").exists()


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"columns": [0, 3]}, "must hold in 'columns' 4 columns, as many as its 'shape'"),
        ({"columns": [3, 7]}, "must have 7 values, as declared in its tactile.json .got 6"),
        ({"columns": [2, 6, 7]}, "must hold in 'columns' the first column of the readings"),
        ({"columns": [-1, 3]}, "must hold in 'columns' the first column of the readings"),
        ({"columns": "all"}, "must hold in 'columns' the first column of the readings"),
        ({"feature": 5}, "must name in 'feature' the feature of the readings .got 5"),
        ({"feature": "observation.none"}, "must have the feature 'observation.none'"),
    ],
)
def test_descriptions_of_touch_that_do_not_fit_are_refused(tmp_path, change, match):
    write_lerobot(two(), tmp_path / "a", 10, key=STATE)
    path = tmp_path / "a/meta/tactile.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **change}))
    with pytest.raises(ValueError, match=match):
        read_lerobot(tmp_path / "a")


def test_sizes_of_a_joined_feature_are_checked_before_memory_is_taken(tmp_path):
    write_lerobot(two(), tmp_path / "a", 10, key=STATE)
    path = tmp_path / "a/meta/info.json"
    info = json.loads(path.read_text())
    info["features"][STATE] = {"dtype": "float32", "shape": [2**31 - 1], "names": None}
    path.write_text(json.dumps(info))
    tracemalloc.start()
    with pytest.raises(ValueError, match=r"it must hold 2147483647 numbers in 'observation.state'"):
        read_lerobot(tmp_path / "a")
    assert tracemalloc.get_traced_memory()[1] < 2**24
    touch = [demonstration(99, 100), demonstration(88, 100)]
    with pytest.raises(ValueError, match=r"it must hold 2147483647 numbers in 'observation.state'"):
        add_to_lerobot(tmp_path / "a", touch, tmp_path / "b", key=STATE)
    assert tracemalloc.get_traced_memory()[1] < 2**24
    tracemalloc.stop()


def test_actions_of_others_are_read_if_they_are_lists_of_numbers(tmp_path, caplog):
    write_lerobot(two(meta={}), tmp_path / "a", 10)
    assert "action_names" not in read_lerobot(tmp_path / "a")[0].meta
    path = tmp_path / "a/meta/info.json"
    info = json.loads(path.read_text())
    info["features"]["action"]["names"] = {"motors": ["x", "y", "z"]}
    path.write_text(json.dumps(info))
    assert read_lerobot(tmp_path / "a")[0].meta["action_names"] == ["x", "y", "z"]
    assert read_lerobot(tmp_path / "a", action="none")[0].action is None
    with pytest.raises(ValueError, match="'action' must not be the feature of readings, state"):
        read_lerobot(tmp_path / "a", action="observation.tactile")
    info["features"]["action"]["shape"] = [3, 1]
    path.write_text(json.dumps(info))
    assert read_lerobot(tmp_path / "a")[0].action is None
    assert "left out 'action', which is not a list of numbers" in caplog.text
