"""Touch in several features, and data sets from which episodes were deleted."""

import json

import numpy as np
import pytest

pytest.importorskip("pyarrow", reason="needs the extra 'lerobot'")

import pyarrow as pa
import pyarrow.parquet as pq
from lerobot_sets import write_without_touch

from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io import add_to_lerobot, read_lerobot, write_lerobot
from torch_geometric_tactile.sensors import TaxelLayout, grid

DATA = "data/chunk-000/file-000.parquet"
LEFT, RIGHT = "observation.tactile.left", "observation.tactile.right"


def write_features(root, shapes):
    """Three steps whose features begin at 0, 100, ..., as other programs write them."""
    write_lerobot([Recording(np.arange(3) / 10, np.ones((3, 1, 1)))], root, fps=10)
    (root / "meta/tactile.json").unlink()
    info = json.loads((root / "meta/info.json").read_text())
    table = pq.read_table(root / DATA).drop_columns(["observation.tactile"])
    del info["features"]["observation.tactile"]
    for i, (name, shape) in enumerate(shapes.items()):
        values = 100 * i + np.arange(3.0 * np.prod(shape, dtype=int)).reshape(3, *shape)
        table = table.append_column(name, pa.array(values.tolist()))
        info["features"][name] = {"dtype": "float32", "shape": [*shape], "names": None}
    pq.write_table(table, root / DATA)
    (root / "meta/info.json").write_text(json.dumps(info))
    return root


@pytest.mark.parametrize(
    ("tactile", "first"),
    [
        ([LEFT, RIGHT], [0, 1, 100, 101, 102, 103]),
        ([RIGHT, LEFT], [100, 101, 102, 103, 0, 1]),
        ("observation.tactile.*", [0, 1, 100, 101, 102, 103]),  # in the order of info.json
        (["*.right", LEFT], [100, 101, 102, 103, 0, 1]),
    ],
)
def test_features_become_one_recording_in_their_order(tmp_path, tactile, first):
    root = write_features(tmp_path / "set", {LEFT: (2,), RIGHT: (2, 2), "observation.skin": (9,)})
    (recording,) = read_lerobot(root, tactile=tactile, num_channels=1)
    assert recording.tactile[0, :, 0].tolist() == first
    sizes = {LEFT: 2, RIGHT: 4} if first[0] == 0 else {RIGHT: 4, LEFT: 2}
    assert [*recording.meta["tactile_features"].items()] == [*sizes.items()]
    pads = [grid(1, size, 0.01) for size in recording.meta["tactile_features"].values()]
    recording.check(TaxelLayout.join(pads, [*recording.meta["tactile_features"]]))


def test_channels_stay_with_their_taxel(tmp_path):
    root = write_features(tmp_path / "set", {RIGHT: (1, 3), LEFT: (2, 3)})
    (recording,) = read_lerobot(root, tactile="observation.tactile.*")
    assert recording.tactile[1].tolist() == [[3, 4, 5], [106, 107, 108], [109, 110, 111]]
    assert recording.meta["tactile_features"] == {RIGHT: 1, LEFT: 2}


def test_one_feature_is_read_as_before(tmp_path):
    root = write_features(tmp_path / "set", {LEFT: (12, 32)})
    for tactile in (LEFT, [LEFT], "observation.tactile.*"):
        (recording,) = read_lerobot(root, tactile=tactile)
        assert recording.tactile.shape == (3, 384, 1)
        assert "tactile_features" not in recording.meta


def test_a_wildcard_leaves_out_stored_frames(tmp_path):
    recording = Recording(np.arange(20) / 100, np.ones((20, 4, 3)))
    write_lerobot([recording], tmp_path / "set", fps=10, every_frame=True, key=LEFT)
    every_frame = read_lerobot(tmp_path / "set", tactile="observation.tactile.*", every_frame=True)
    assert every_frame[0].tactile.shape == (20, 4, 3)


@pytest.mark.parametrize(
    ("options", "match"),
    [
        (
            {},
            r"must have the feature 'observation.tactile' .got .*: for all of",
        ),
        ({"tactile": "*.thumb"}, r"must have the feature '\*.thumb' .got timestamp, .*right\)$"),
        ({"tactile": []}, "'tactile' must name at least one feature .got none"),
        ({"tactile": [LEFT, LEFT]}, "'tactile' must name each feature once .got .*left"),
        ({"tactile": [LEFT, "*.left"]}, "'tactile' must name each feature once .got .*left"),
        (
            {"tactile": [LEFT, RIGHT]},
            f"'{LEFT}' and '{RIGHT}' of .* same number of channels .* .got 1 and 3.: name one of",
        ),
        ({"tactile": [LEFT, RIGHT], "state": RIGHT}, "must not include the joint angles .got"),
        (
            {"tactile": [LEFT, RIGHT], "every_frame": True},
            r"'tactile' must be one feature with every_frame \(got 2\)$",
        ),
        (
            {"tactile": [LEFT, RIGHT], "action": LEFT, "num_channels": 1},
            "'action' must not be the feature of readings",
        ),
    ],
)
def test_features_that_are_no_recording_are_refused(tmp_path, options, match):
    root = write_features(tmp_path / "set", {LEFT: (3,), RIGHT: (2, 3)})
    with pytest.raises(ValueError, match=match):
        read_lerobot(root, **options)


def delete_episode(root, number):
    """Removes an episode; the others keep their indices."""
    table = pq.read_table(root / DATA)
    rows = table.filter(pa.compute.not_equal(table["episode_index"], number))
    pq.write_table(rows, root / DATA)
    path = root / "meta/episodes/chunk-000/file-000.parquet"
    episodes = pq.read_table(path)
    pq.write_table(episodes.filter(pa.compute.not_equal(episodes["episode_index"], number)), path)
    info = json.loads((root / "meta/info.json").read_text())
    info |= {"total_episodes": info["total_episodes"] - 1, "total_frames": len(rows)}
    (root / "meta/info.json").write_text(json.dumps(info))


def ramps(**options):
    return [
        Recording(np.arange(4 + i) / 10, 10.0 * i + np.arange(4.0 + i)[:, None, None], **options)
        for i in range(3)
    ]


def test_episodes_keep_their_indices_where_one_was_deleted(tmp_path):
    write_without_touch(ramps(), tmp_path / "set", fps=10)
    delete_episode(tmp_path / "set", 1)
    recordings = read_lerobot(tmp_path / "set", tactile="observation.other")
    assert [(r.meta["episode"], r.tactile[0, 0, 0]) for r in recordings] == [(0, 0), (2, 20)]


def test_touch_is_added_where_an_episode_was_deleted(tmp_path):
    write_without_touch(ramps(), tmp_path / "set", fps=10)
    delete_episode(tmp_path / "set", 1)
    short, long = ramps(label="mug")[::2]
    with pytest.raises(ValueError, match=r"recording 1 must cover .*, as episode 2 does"):
        add_to_lerobot(tmp_path / "set", [long, short], tmp_path / "copy")
    add_to_lerobot(tmp_path / "set", [short, long], tmp_path / "copy")
    found = read_lerobot(tmp_path / "copy")
    assert [(r.label, r.tactile[0, 0, 0], r.num_frames) for r in found] == [
        ("mug", 0, 4),
        ("mug", 20, 6),
    ]
    path = tmp_path / "copy/meta/episodes/chunk-000/file-000.parquet"
    assert pq.read_table(path)["stats/observation.tactile/min"].to_pylist() == [[0], [20]]
    assert [e["episode_index"] for e in _tactile_json(tmp_path / "copy")["episodes"]] == [0, 2]


def test_our_file_of_other_episodes_is_refused_where_one_was_deleted(tmp_path):
    write_lerobot(ramps(), tmp_path / "set", fps=10)
    delete_episode(tmp_path / "set", 1)
    with pytest.raises(ValueError, match=r"hold each of 2 episodes once .got 3.*: remove it if"):
        read_lerobot(tmp_path / "set")
    content = _tactile_json(tmp_path / "set")
    del content["episodes"][2]  # now as many as there are, but of others
    (tmp_path / "set/meta/tactile.json").write_text(json.dumps(content))
    with pytest.raises(ValueError, match=r"must hold episode 2 \(got 0, 1\): remove it if"):
        read_lerobot(tmp_path / "set")


def test_statistics_of_episodes_without_data_are_refused(tmp_path):
    write_without_touch(ramps(), tmp_path / "set", fps=10)
    episodes = pq.read_table(tmp_path / "set/meta/episodes/chunk-000/file-000.parquet")
    delete_episode(tmp_path / "set", 1)
    pq.write_table(episodes, tmp_path / "set/meta/episodes/chunk-000/file-000.parquet")
    with pytest.raises(ValueError, match=r"must list only episodes in the data files \(got 1\)"):
        add_to_lerobot(tmp_path / "set", ramps()[::2], tmp_path / "copy")


def _tactile_json(root):
    return json.loads((root / "meta/tactile.json").read_text())
