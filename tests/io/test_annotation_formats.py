# ruff: noqa: E402
"""A law of all formats: the annotations that are written are those that are read."""

import numpy as np
import pytest

for module in ("h5py", "mcap", "google.protobuf", "zstandard"):
    pytest.importorskip(module, reason="needs the extras 'io' and 'live'")

from recordings import counting_recording

from torch_geometric_tactile.cli import main
from torch_geometric_tactile.data import LiveFrame
from torch_geometric_tactile.io import (
    McapWriter,
    read_lerobot,
    read_mcap,
    read_recording,
    repair_mcap,
    write_recording,
)
from torch_geometric_tactile.io.recording_hdf5 import read_hdf5_head

SUFFIXES = ["npz", "h5", "mcap", "csv"]
LABELS = ["slip", "=1+1", "'=1", "-3", 'a, "b"', "é 手", "x" * 255, "nan", "none"]


def recording(annotations, num_frames=40, start=0.0):
    return counting_recording(num_frames, 2, rate=7, start=start, annotations=annotations)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_annotations_come_back(tmp_path, suffix):
    for seed in range(30):
        draw = np.random.default_rng(seed)
        start = draw.choice([0.0, -3.0, 1.7e9])
        ends = start + draw.normal(2, 3, size=(draw.integers(0, 9), 2))
        if seed % 2:  # also points, and some of one label inside of others
            ends = ends.round(0)
        spans = [(*sorted(pair), str(draw.choice(LABELS))) for pair in ends.tolist()]
        before = recording(spans, start=start)
        write_recording(before, tmp_path / f"a{seed % 3}.{suffix}")
        found = read_recording(tmp_path / f"a{seed % 3}.{suffix}")
        assert found.annotations == before.annotations, seed
        assert found.meta == {}


@pytest.mark.parametrize("start", [0.0, 1.7e9])
@pytest.mark.parametrize("source", SUFFIXES)
@pytest.mark.parametrize("target", [*SUFFIXES, "lerobot"])
def test_annotations_are_converted_between_all_formats(tmp_path, source, target, start):
    if target == "lerobot":
        pytest.importorskip("pyarrow", reason="needs the extra 'lerobot'")
    spans = [
        (start + 1, start + 2.5, "slip"),
        (start + 2.5, start + 3, "é 手"),
        (start, start, "x"),
    ]
    before = recording(spans, start=start)
    write_recording(before, tmp_path / f"a.{source}")
    files = [str(tmp_path / f"a.{source}"), str(tmp_path / f"b.{target}")]
    assert main(["convert", *files, *(["--fps", "7"] if target == "lerobot" else [])]) == 0
    if target == "lerobot":
        (found,) = read_lerobot(files[1])
        shift = start  # an episode begins at 0
    else:
        found, shift = read_recording(files[1]), 0.0
    assert found.num_frames == before.num_frames
    assert [(a.start + shift, a.end + shift, a.label) for a in found.annotations] == [
        *before.annotations
    ]


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_as_many_as_there_may_be_come_back(tmp_path, suffix):
    before = recording([(i / 3, i / 3 + 1, "slip") for i in range(10_000)])
    write_recording(before, tmp_path / f"a.{suffix}")
    assert read_recording(tmp_path / f"a.{suffix}").annotations == before.annotations


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_without_annotations_a_file_holds_nothing_of_them(tmp_path, suffix):
    write_recording(recording([]), tmp_path / f"a.{suffix}")
    assert [path.name for path in tmp_path.iterdir()] == [f"a.{suffix}"]
    assert b"annotation" not in (tmp_path / f"a.{suffix}").read_bytes()


def test_the_head_of_an_hdf5_file_has_them(tmp_path):
    write_recording(recording([(1, 2, "slip")]), tmp_path / "a.h5")
    assert read_hdf5_head(tmp_path / "a.h5").annotations == ((1, 2, "slip"),)


def test_an_hdf5_file_whose_annotations_are_changed_is_refused(tmp_path):
    import h5py

    write_recording(recording([(1, 2, "slip")]), tmp_path / "a.h5")
    for change in ("other", "gone"):
        with h5py.File(tmp_path / "a.h5", "r+") as file:
            if change == "gone":
                del file.attrs["annotations"]
            else:
                file.attrs["annotations"] = '[[1, 3, "slip"]]'
        with pytest.raises(ValueError, match="must match its checksum"):
            read_recording(tmp_path / "a.h5")


@pytest.mark.parametrize("text", ["[[1]]", '[[2, 1, "a"]]', "["])
def test_an_npz_file_with_something_else_is_refused(tmp_path, text):
    write_recording(recording([(1, 2, "slip")]), tmp_path / "a.npz")
    with np.load(tmp_path / "a.npz") as file:
        content = dict(file)
    np.savez(tmp_path / "a.npz", **{**content, "annotations": np.array(text)})
    with pytest.raises(ValueError, match=r"a\.npz'.*annotations"):
        read_recording(tmp_path / "a.npz")


def crashed(path, events, num_frames=100):
    """A file of a stream whose process was killed: it was not closed."""
    writer = McapWriter(path, anchor=(10**18, 5 * 10**9))
    for i in range(num_frames):
        time = 5 + i / 100
        for kind, label in events.get(i, ()):
            writer.write_event(time, kind, label)
        frame = LiveFrame(i, time, round(time * 1e9), None, np.ones((2, 1), np.float32))
        writer.write_frame(frame)
    return writer


def test_an_annotation_that_was_not_ended_lasts_to_the_last_frame(tmp_path):
    events = {
        10: [("annotation_start", "hold")],
        20: [("annotation_end", "hold"), ("annotation_start", "slip"), ("mark", "")],
        99: [("annotation_start", "late")],
    }
    writer = crashed(tmp_path / "a.mcap", events)
    found = read_mcap(tmp_path / "a.mcap")
    last = found.time[-1]
    assert 0.5 < last < 0.9  # what came later was in the chunk that is lost
    assert [a.label for a in found.annotations] == ["hold", "slip"]
    np.testing.assert_allclose([a[:2] for a in found.annotations], [[0.1, 0.2], [0.2, last]])
    assert [event["kind"] for event in found.meta["events"]] == ["mark"]
    repair_mcap(tmp_path / "a.mcap", tmp_path / "b.mcap")
    assert read_mcap(tmp_path / "b.mcap", recover=False).annotations == found.annotations
    writer.close()
    whole = read_mcap(tmp_path / "a.mcap")
    assert whole.annotations[2] == (whole.time[-1], whole.time[-1], "late")


def test_events_that_are_no_annotations_are_left_out(tmp_path):
    events = {
        1: [
            ("annotation_end", "never begun"),
            ("annotation_start", ""),
            ("annotation_start", "\n"),
        ],
        2: [("annotation_start", "slip")],
        3: [
            ("annotation_end", "slip"),
            ("annotation_end", "slip"),
            ("annotation_start", "a" * 9000),
        ],
    }
    with crashed(tmp_path / "a.mcap", events, 10):
        pass
    found = read_mcap(tmp_path / "a.mcap")
    assert [a.label for a in found.annotations] == ["slip"]
    assert "events" not in found.meta


def test_an_end_is_of_the_last_one_of_its_label_that_is_open(tmp_path):
    start, end = ("annotation_start", "slip"), ("annotation_end", "slip")
    with crashed(tmp_path / "a.mcap", {1: [start], 2: [start], 3: [end], 5: [end]}, 10):
        pass
    found = [a[:2] for a in read_mcap(tmp_path / "a.mcap").annotations]
    np.testing.assert_allclose(found, [[0.01, 0.05], [0.02, 0.03]])


def test_other_tools_see_annotations_as_messages(tmp_path):
    from mcap.reader import make_reader

    from torch_geometric_tactile.io._mcap_schemas import decode

    write_recording(recording([(1, 2, "slip")]), tmp_path / "a.mcap")
    with (tmp_path / "a.mcap").open("rb") as file:
        found = [
            (message.log_time, decode("tactile.Event", message.data).kind)
            for _, channel, message in make_reader(file).iter_messages(topics=["tactile.Event"])
        ]
    assert found == [(10**9, "annotation_start"), (2 * 10**9, "annotation_end")]
