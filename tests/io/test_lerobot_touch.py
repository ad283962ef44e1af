import json

import numpy as np
import pytest

pytest.importorskip("pyarrow", reason="needs the extra 'lerobot'")

import pyarrow.parquet as pq
from lerobot_sets import write_without_touch

from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io import add_to_lerobot, lerobot_touch, read_lerobot

TOUCH = "observation.tactile"


def skin(frames, rate, seed, start=0.0, **more):
    draw = np.random.default_rng(seed)
    tactile = draw.normal(size=(frames, 2, 3)).astype(np.float32)
    return Recording(start + np.arange(frames) / rate, tactile, **more)


@pytest.fixture
def source(tmp_path):
    """A data set of joints alone, with a file of others."""
    arms = [skin(12, 10, 0, joint=np.ones((12, 2))), skin(7, 10, 1, joint=np.ones((7, 2)))]
    root = tmp_path / "arm"
    write_without_touch(arms, root, fps=10)
    (root / "README.md").unlink()
    (root / "videos/front").mkdir(parents=True)
    (root / "videos/front/file-000.mp4").write_bytes(b"video")
    return root


def contents(root):
    return {str(p.relative_to(root)): p.read_bytes() for p in root.rglob("*") if p.is_file()}


@pytest.mark.parametrize("every_frame", [False, True])
def test_touch_is_added_to_a_copy(source, tmp_path, every_frame):
    before = contents(source)
    touch = [skin(170, 150, 2, 1.7e9, label="mug"), skin(95, 150, 3, 7, label="cup")]
    add_to_lerobot(source, touch, tmp_path / "new", every_frame=every_frame)
    assert contents(source) == before
    assert {path.name for path in tmp_path.iterdir()} == {"arm", "new"}
    assert (tmp_path / "new/videos/front/file-000.mp4").read_bytes() == b"video"
    for found, recording in zip(read_lerobot(tmp_path / "new"), touch, strict=True):
        frames = 15 * np.arange(found.num_frames)  # the last ones up to the steps
        assert np.array_equal(found.tactile, recording.tactile[frames])
        assert found.joint.tolist() == [[1, 1]] * found.num_frames
        assert found.label == recording.label
    if every_frame:
        for found, recording in zip(
            read_lerobot(tmp_path / "new", every_frame=True), touch, strict=True
        ):
            assert np.array_equal(found.tactile, recording.tactile[: found.num_frames])
            time = recording.time[: found.num_frames] - recording.time[0]
            assert found.time == pytest.approx(time, abs=1e-6)
            assert len(recording.time) - found.num_frames < 15


def test_a_copy_is_as_if_written_at_once(source, tmp_path):
    touch = [skin(170, 150, 2), skin(95, 150, 3)]
    add_to_lerobot(source, touch, tmp_path / "new")
    info = json.loads((tmp_path / "new/meta/info.json").read_text())
    assert info["features"][TOUCH]["shape"] == [6]
    table = pq.read_table(next(tmp_path.glob("new/data/*/*")))
    described = json.loads(table.schema.metadata[b"huggingface"])["info"]["features"]
    assert [*described] == table.column_names
    assert described[TOUCH]["length"] == 6
    assert "data_files: data/*/*.parquet" in (tmp_path / "new/README.md").read_text()
    readings = np.array(table[TOUCH].to_pylist())
    stats = json.loads((tmp_path / "new/meta/stats.json").read_text())
    assert stats[TOUCH]["mean"] == pytest.approx(readings.mean(axis=0), abs=1e-6)
    assert "observation.state" in stats
    second = pq.read_table(tmp_path / "new/meta/episodes").to_pylist()[1]
    assert second[f"stats/{TOUCH}/max"] == pytest.approx(readings[12:].max(axis=0))


def test_recordings_may_begin_before_the_episodes(source, tmp_path):
    touch = [skin(400, 100, 2, 50), skin(300, 100, 3, 50)]
    add_to_lerobot(source, touch, tmp_path / "new", starts=[51.0, 51.5], every_frame=True)
    first, second = read_lerobot(tmp_path / "new")
    assert np.array_equal(first.tactile, touch[0].tactile[100:220:10])
    assert np.array_equal(second.tactile, touch[1].tactile[150:220:10])
    # Frames of the step before the first one belong to it; earlier ones to none.
    whole = read_lerobot(tmp_path / "new", every_frame=True)[0]
    assert whole.time[0] == pytest.approx(-0.09)


def test_annotations_and_further_signals_are_added_on_the_clock_of_the_episode(source, tmp_path):
    touch = [
        skin(400, 100, 2, 50, annotations=[(51.5, 51.75, "slip")], extra={"a": np.arange(400)}),
        skin(300, 100, 3, 50, annotations=[(51, 60, "hold")], extra={"a": np.arange(300)}),
    ]
    add_to_lerobot(source, touch, tmp_path / "new", starts=[51.0, 51.5])
    first, second = read_lerobot(tmp_path / "new")
    assert (first.annotations, second.annotations) == (
        ((0.5, 0.75, "slip"),),
        ((-0.5, 8.5, "hold"),),
    )
    assert first.extra["a"].tolist() == [*range(100, 220, 10)]
    assert second.extra["a"].tolist() == [*range(150, 220, 10)]
    assert (first.extra["a"].dtype, second.extra["a"].dtype) == (np.int64, np.int64)


def test_steps_in_a_gap_of_the_touch_are_missing(source, tmp_path, caplog):
    whole, gappy = skin(170, 150, 2), skin(170, 150, 2)
    keep = np.r_[0:30, 100:170]
    gappy = Recording(gappy.time[keep], gappy.tactile[keep], privileged={"pose": keep})
    with pytest.raises(ValueError, match=r"recording 0 has no frame within .* of 4 of 12 steps"):
        add_to_lerobot(source, [gappy, whole], tmp_path / "new", gaps="error")
    assert not (tmp_path / "new").exists()
    add_to_lerobot(source, [gappy, gappy], tmp_path / "new")
    assert "recording 1 has no frame within" in caplog.text
    assert "cannot store privileged 'pose'" in caplog.text
    found = read_lerobot(tmp_path / "new")[0]
    missing = np.isnan(found.tactile).all(axis=(1, 2))
    assert missing.nonzero()[0].tolist() == [3, 4, 5, 6]
    assert not np.isnan(found.joint).any()


@pytest.mark.parametrize(
    ("touch", "settings", "match"),
    [
        ([skin(170, 150, 2)], {}, "one recording for each of 2 episodes of '.*' .got 1"),
        ([skin(170, 150, 2), skin(9, 150, 3)], {}, "recording 1 must cover 0 to 0.6 s .*0.05"),
        ([skin(170, 150, 2), skin(95, 150, 3)], {"starts": [0]}, "'starts' must hold one time"),
        (
            [skin(170, 150, 2), skin(95, 150, 3)],
            {"starts": [-0.2, 0]},
            r"recording 0 must cover 0 to 1.1 s after its start.*got 0.2 to 1.3",
        ),
        ([], {}, "at least one recording"),
    ],
)
def test_recordings_that_do_not_fit_are_refused(source, tmp_path, touch, settings, match):
    with pytest.raises(ValueError, match=match):
        add_to_lerobot(source, touch, tmp_path / "new", **settings)
    assert {path.name for path in tmp_path.iterdir()} == {"arm"}


def test_touch_is_not_added_twice_nor_in_place(source, tmp_path):
    touch = [skin(170, 150, 2), skin(95, 150, 3)]
    with pytest.raises(FileExistsError, match="must be a new or empty folder"):
        add_to_lerobot(source, touch, source)
    with pytest.raises(ValueError, match="the copy must be outside of"):
        add_to_lerobot(source, touch, source / "new")
    add_to_lerobot(source, touch, tmp_path / "new")
    with pytest.raises(ValueError, match=r"must not have the feature 'observation.tactile'"):
        add_to_lerobot(tmp_path / "new", touch, tmp_path / "more")


def test_nothing_is_left_of_a_copy_that_fails(source, tmp_path, monkeypatch):
    def full(*arguments):
        raise OSError("disk full")

    monkeypatch.setattr(lerobot_touch, "write_parquet", full)
    with pytest.raises(OSError, match="disk full"):
        add_to_lerobot(source, [skin(170, 150, 2), skin(95, 150, 3)], tmp_path / "new")
    assert {path.name for path in tmp_path.iterdir()} == {"arm"}


def test_links_out_of_the_data_set_are_not_followed(source, tmp_path):
    touch = [skin(170, 150, 2), skin(95, 150, 3)]
    (tmp_path / "secret").write_text("secret")
    (source / "videos/front/file-001.mp4").symlink_to(tmp_path / "secret")
    with pytest.raises(
        ValueError, match=r"file-001.mp4' must not be a link to a file outside of the data set"
    ):
        add_to_lerobot(source, touch, tmp_path / "new")
    assert not (tmp_path / "new").exists()
