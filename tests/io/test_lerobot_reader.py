import json
import re

import numpy as np
import pytest

pytest.importorskip("pyarrow", reason="needs the extra 'lerobot'")

import pyarrow as pa
import pyarrow.parquet as pq

from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io import read_lerobot, write_lerobot
from torch_geometric_tactile.io._lerobot_content import step_times

DATA = "data/chunk-000/file-000.parquet"
TIME = np.arange(6) / 10
MUG = Recording(TIME, np.arange(36.0).reshape(6, 2, 3), np.ones((6, 2)), "mug")
CUP = Recording(TIME[:4], 100 + np.arange(24.0).reshape(4, 2, 3), np.ones((4, 2)), "cup")


@pytest.fixture
def root(tmp_path):
    write_lerobot([MUG, CUP], tmp_path / "set", fps=10)
    return tmp_path / "set"


def change_own(root, change):
    path = root / "meta/tactile.json"
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))


def change_info(root, **values):
    path = root / "meta/info.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **values}))


def put(path, name, values):
    table = pq.read_table(path)
    index = table.schema.get_field_index(name)
    pq.write_table(table.set_column(index, name, pa.array(values)), path)


def as_of_0_2_0(root):
    """Rewrites a data set in the form of 0.2.0: two dimensions, and labels by position."""
    rows = pq.read_table(root / DATA)["observation.tactile"].to_pylist()
    put(root / DATA, "observation.tactile", np.reshape(rows, (-1, 2, 3)).tolist())
    features = json.loads((root / "meta/info.json").read_text())["features"]
    feature = {"dtype": "float32", "shape": [2, 3], "names": ["taxels", "channels"]}
    change_info(root, features={**features, "observation.tactile": feature})
    change_own(root, _without_numbers)


def _without_numbers(content):
    episodes = [{"label": e["label"], "meta": e["meta"]} for e in content["episodes"]]
    content.clear()
    content.update(version=1, episodes=episodes)


def test_sets_of_0_2_0_are_still_read(root):
    as_of_0_2_0(root)
    for found, recording in zip(read_lerobot(root), (MUG, CUP), strict=True):
        assert np.array_equal(found.tactile, recording.tactile)
        assert found.label == recording.label
    change_own(root, lambda content: content["episodes"].reverse())
    with pytest.raises(ValueError, match=r"must have the task mug of episode 0 .got cup"):
        read_lerobot(root)


@pytest.mark.parametrize("old", [False, True])
def test_a_missing_label_is_not_that_of_another_episode(root, old):
    if old:
        as_of_0_2_0(root)
    change_own(root, lambda content: content["episodes"].pop(0))
    with pytest.raises(ValueError, match=r"must hold each of 2 episodes once .got 1.*remove it if"):
        read_lerobot(root)


def test_labels_go_by_the_number_of_the_episode(root):
    change_own(root, lambda content: content["episodes"].reverse())
    assert [found.label for found in read_lerobot(root)] == ["mug", "cup"]


@pytest.mark.parametrize(
    ("change", "match"),
    [
        (lambda c: c.update(version=99), "must have version 1 or 2 .got 99"),
        (lambda c: c.update(shape=[3, 2]), r"the shape of its names, .2, 3. .got .3, 2."),
        (lambda c: c.update(shape=[2, 2]), "must have 4 values, as declared in its .*json .got 6"),
        (lambda c: c.update(episodes={}), "must hold 'episodes'"),
        (lambda c: c["episodes"][0].pop("meta"), "each with 'meta'"),
        (lambda c: c["episodes"][0].update(episode_index=1), r"each of 2 episodes once .*\[1, 1\]"),
        (lambda c: c["episodes"][0].update(length=4), "the length 6 of episode 0 .got 4"),
        (lambda c: c["episodes"][0].update(task="cup"), "the task mug of episode 0 .got cup"),
    ],
)
def test_labels_that_are_not_of_these_episodes_are_refused(root, change, match):
    change_own(root, change)
    with pytest.raises(ValueError, match=match):
        read_lerobot(root)


def test_twenty_features_are_listed_for_one_that_is_missing(root):
    features = {letter: {} for letter in "abcdefghijklmnopqrstuvw"}
    change_info(root, features=features)
    with pytest.raises(ValueError, match=rf"got {', '.join([*features][:20])}\)"):
        read_lerobot(root)


def test_names_have_the_shape_where_another_program_left_out_our_file(root):
    (root / "meta/tactile.json").unlink()
    assert read_lerobot(root)[0].tactile.shape == (6, 2, 3)


@pytest.mark.parametrize(
    ("name", "values", "match"),
    [
        ("frame_index", [0, 2, 1, 3, 4, 5, 0, 1, 2, 3], "'frame_index' must be 1 .got 2"),
        ("frame_index", [float(i % 6) for i in range(10)], "integers in 'frame_index' .got double"),
        ("episode_index", [1] * 6 + [0] * 4, "the length 6 of episode 1 .got 4"),
        ("episode_index", [0] * 6 + [5] * 4, r"must hold episode 5 .got 0, 1.: remove it if"),
        ("episode_index", [0] * 10, "'frame_index' must be 6 .got 0"),
        ("task_index", [7] * 10, "tasks in 'meta/tasks.parquet' .got 7"),
        ("timestamp", [100.0 * (i % 6) for i in range(10)], "advance by 0.1 s .got 100"),
        ("observation.state", [["a", "b"]] * 10, "must hold numbers in 'observation.state'"),
    ],
)
def test_rows_that_contradict_the_data_set_are_refused(root, name, values, match):
    put(root / DATA, name, values)
    with pytest.raises(ValueError, match=match):
        read_lerobot(root)


def test_episodes_come_in_their_order_and_times_may_jitter_by_a_tenth_of_a_millisecond(root):
    table = pq.read_table(root / DATA)
    (root / "data/chunk-1000").mkdir()
    pq.write_table(table.slice(0, 6), root / "data/chunk-1000/file-000.parquet")
    pq.write_table(table.slice(6), root / DATA)
    jitter = [0.0, 0.10004, 0.19996, 0.3]
    put(root / DATA, "timestamp", jitter)
    found = read_lerobot(root)
    assert [one.label for one in found] == ["mug", "cup"]
    assert found[1].time.tolist() == jitter


@pytest.mark.parametrize(
    ("time", "message"),
    [
        ([0, 1.00009, 2], None),
        ([7], None),
        ([7, 8], None),
        ([0, 1.0002], "1.0002 s in step 1 after 0 s"),
        ([0, 1, 2.02, 3], "2.02 s in step 2 after 1 s"),
        ([0, 1, 5, 6], "5 s in step 2 after 1 s"),
        ([0, 1, 1, 2], "1 s in step 2 after 1 s"),
        ([0, 0.5, 1.0], "0.5 s in step 1 after 0 s"),
    ],
)
def test_steps_are_a_step_apart(time, message):
    table = pa.table({"frame_index": range(len(time)), "timestamp": np.array(time, float)})
    if message is None:
        assert step_times(DATA, table, 1.0).tolist() == time
    else:
        with pytest.raises(ValueError, match=rf"'timestamp' must advance by 1 s \(got {message}\)"):
            step_times(DATA, table, 1.0)


@pytest.mark.parametrize("fps", [30, 29.97])
def test_times_of_long_episodes_may_be_single_precision(fps):
    count = 600_000  # more than five hours
    for start in (0.0, 3.0):
        time = (start + np.arange(count) / fps).astype(np.float32)
        table = pa.table({"frame_index": np.arange(count), "timestamp": time})
        found = step_times(DATA, table, fps)
        np.testing.assert_allclose(found, start + np.arange(count) / fps, atol=2e-3)
    time[count // 2 :] += 0.02
    table = pa.table({"frame_index": np.arange(count), "timestamp": time})
    with pytest.raises(ValueError, match="in step 300000 after"):
        step_times(DATA, table, fps)


def test_an_episode_in_two_files_is_refused(root):
    table = pq.read_table(root / DATA)
    pq.write_table(table.slice(0, 3), root / DATA)
    pq.write_table(table.slice(3), root / "data/chunk-000/file-001.parquet")
    (root / "meta/tactile.json").unlink()
    with pytest.raises(ValueError, match="all steps of an episode in order"):
        read_lerobot(root)


@pytest.mark.parametrize(
    ("tasks", "match"),
    [
        ({"task_index": [0, 0], "task": ["mug", "cup"]}, "each 'task_index' once"),
        ({"task_index": [0.0, 1.0], "task": ["mug", "cup"]}, "integers in 'task_index'"),
        ({"task_index": [0, 1], "task": ["mug", None]}, "with a name"),
        ({"task_index": [0, 1], "a": ["x", "y"], "b": ["mug", "cup"]}, "hold names in 'task'"),
        ({"task": ["mug", "cup"]}, "must have the column 'task_index'"),
    ],
)
def test_tasks_that_are_none_are_refused(root, tasks, match):
    pq.write_table(pa.table(tasks), root / "meta/tasks.parquet")
    with pytest.raises(ValueError, match=match):
        read_lerobot(root)


def test_the_column_of_tasks_goes_by_its_name(root):
    tasks = {"note": ["x", "y"], "task": ["mug", "cup"], "task_index": [0, 1]}
    pq.write_table(pa.table(tasks), root / "meta/tasks.parquet")
    assert [found.label for found in read_lerobot(root)] == ["mug", "cup"]


@pytest.mark.parametrize("name", [DATA, "meta/tasks.parquet"])
def test_a_column_that_is_there_twice_is_refused(root, name):
    table = pq.read_table(root / name)
    for column in table.column_names[:2]:
        pq.write_table(table.append_column(column, table[column]), root / name)
        with pytest.raises(ValueError, match=f"must have the column '{column}' once"):
            read_lerobot(root)


def test_every_frame_needs_a_set_that_has_them(root):
    with pytest.raises(
        ValueError, match=r"must have the feature 'observation.tactile_frames_time'"
    ):
        read_lerobot(root, every_frame=True)


@pytest.fixture
def unread(monkeypatch):
    """Fails where frames are read."""
    read = pq.ParquetFile.read

    def refused(self, columns, **settings):
        assert "timestamp" not in columns, "was read"
        return read(self, columns, **settings)

    monkeypatch.setattr(pq.ParquetFile, "read", refused)


@pytest.mark.full
def test_data_that_unpack_to_far_more_are_refused_before_memory(root, unread):
    path = root / DATA
    rows = 500_000
    table = pq.read_table(path).slice(0, 1).take(np.zeros(rows, dtype=np.int32))
    with pq.ParquetWriter(path, table.schema, compression="zstd") as writer:
        for _ in range(30):
            writer.write_table(table)
    assert path.stat().st_size < 2**20
    with pytest.raises(ValueError, match=f"must hold 10 frames.*got {30 * rows}"):
        read_lerobot(root)
    change_info(root, total_frames=30 * rows)
    with pytest.raises(ValueError, match=r"take 1\.3 GiB: pass allow_large=True if you trust"):
        read_lerobot(root)
    with pytest.raises(AssertionError, match="was read"):
        read_lerobot(root, allow_large=True)


def test_lists_of_other_lengths_are_counted_before_memory(root, unread):
    put(root / DATA, "observation.tactile", [[0.0] * 1_000_000] + [[0.0] * 6] * 9)
    with pytest.raises(ValueError, match=r"6 numbers in 'observation.tactile' per row.*1000054"):
        read_lerobot(root)


def test_equal_names_of_tasks_are_held_once(root):
    text = "a" * 100_000
    path = root / "meta/tasks.parquet"
    tasks = pa.table({"task_index": range(1000), "task": [text] * 1000})
    pq.write_table(tasks, path, compression="zstd")
    (root / "meta/tactile.json").unlink()
    whole, counted = pa.default_memory_pool(), pa.proxy_memory_pool(pa.default_memory_pool())
    pa.set_memory_pool(counted)
    try:
        assert {found.label for found in read_lerobot(root)} == {text}
    finally:
        pa.set_memory_pool(whole)
    assert counted.max_memory() < 5_000_000 < len(text) * 1000


def test_more_than_a_million_tasks_are_refused(root):
    tasks = pa.table({"task_index": np.zeros(1_000_001, dtype=np.int64), "task": ["a"] * 1_000_001})
    pq.write_table(tasks, root / "meta/tasks.parquet", compression="zstd")
    with pytest.raises(ValueError, match=re.escape("at most 1000000 tasks (got 1000001)")):
        read_lerobot(root)


def write_grid(root, shape, names=None):
    """Readings of two dimensions, as other programs write them."""
    values = np.arange(10.0 * np.prod(shape)).reshape(10, *shape)
    put(root / DATA, "observation.tactile", values.tolist())
    features = json.loads((root / "meta/info.json").read_text())["features"]
    feature = {"dtype": "float32", "shape": [*shape], "names": names}
    change_info(root, features={**features, "observation.tactile": feature})
    (root / "meta/tactile.json").unlink()
    return values


@pytest.mark.parametrize(
    ("shape", "num_channels", "expected"),
    [
        ((12, 32), None, (384, 1)),  # a grid, row by row
        ((4, 7), None, (28, 1)),
        ((4, 6), None, (4, 6)),
        ((16, 3), None, (16, 3)),
        ((4, 8), 8, (4, 8)),
        ((4, 6), 1, (24, 1)),
        ((24,), None, (24, 1)),
        ((24,), 3, (8, 3)),
    ],
)
def test_two_dimensions_are_taxels_and_channels_or_a_grid(root, shape, num_channels, expected):
    values = write_grid(root, shape)
    found = read_lerobot(root, num_channels=num_channels)[0]
    assert found.tactile.shape[1:] == expected
    assert np.array_equal(found.tactile.ravel(), values[:6].ravel())


@pytest.mark.parametrize(
    ("shape", "names", "expected"),
    [
        ((3, 16), ["channels", "taxels"], (16, 3)),
        ((3, 16), ["Axes", "Taxel"], (16, 3)),
        ((16, 3), ["taxels", "channels"], (16, 3)),
        ((12, 8), ["taxels", "channels"], (12, 8)),  # no grid, since the names say so
        ((2, 3), ["channel", "taxel"], (3, 2)),
        ((16, 3), ["rows", "columns"], (16, 3)),
    ],
)
def test_names_of_two_dimensions_say_which_are_taxels(root, shape, names, expected):
    values = write_grid(root, shape, names=names)
    found = read_lerobot(root)[0].tactile
    assert found.shape[1:] == expected
    rows = values[:6].reshape(6, *shape)
    assert np.array_equal(found, rows if shape == expected else rows.swapaxes(1, 2))


@pytest.mark.parametrize(
    "names", [["taxels", "taxels"], ["channels", "axes"], ["channels", "x"], ["x", "taxel"]]
)
def test_names_of_two_dimensions_that_contradict_are_refused(root, names):
    write_grid(root, (16, 3), names=names)
    with pytest.raises(
        ValueError, match=r"names of 'observation\.tactile' .* must name taxels and channels"
    ):
        read_lerobot(root)


def test_channels_that_the_names_contradict_are_refused(root):
    write_grid(root, (3, 16), names=["channels", "taxels"])
    with pytest.raises(ValueError, match=r"'num_channels' must match .*\[16, 3\] \(got 16\)"):
        read_lerobot(root, num_channels=16)


def test_our_file_says_that_taxels_have_many_channels(tmp_path):
    many = Recording(TIME, np.arange(96.0).reshape(6, 2, 8))
    write_lerobot([many], tmp_path / "set", fps=10)
    assert np.array_equal(read_lerobot(tmp_path / "set")[0].tactile, many.tactile)


@pytest.mark.parametrize("num_channels", [0, 2, 4])
def test_other_channels_than_the_files_say_are_refused(root, num_channels):
    with pytest.raises(ValueError, match=rf"'num_channels' must .*\(got {num_channels}\)"):
        read_lerobot(root, num_channels=num_channels)


@pytest.mark.parametrize("wrong", [3, {"a": 3}, {"a": {"shape": [0], "dtype": "int8"}}])
def test_further_signals_that_are_none_are_refused(root, wrong):
    change_own(root, lambda content: content.update(extra=wrong))
    with pytest.raises(ValueError, match="must hold in 'extra' a shape and a type"):
        read_lerobot(root)


@pytest.mark.parametrize("wrong", [3, [[1, 0, "a"]], [["a", 1, "b"]], {}])
def test_annotations_that_are_none_are_refused(root, wrong):
    change_own(root, lambda content: content["episodes"][0].update(annotations=wrong))
    with pytest.raises(ValueError, match="'annotations' must"):
        read_lerobot(root)


def test_sets_without_annotations_are_still_read(root):
    change_own(root, lambda content: [e.pop("annotations") for e in content["episodes"]])
    assert [found.annotations for found in read_lerobot(root)] == [(), ()]
