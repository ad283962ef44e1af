import re

import numpy as np
import pytest

from torch_geometric_tactile.data import Recording, Windows
from torch_geometric_tactile.datasets import RecordingFrames
from torch_geometric_tactile.io._recording_npz import write_npz
from torch_geometric_tactile.io._wide_csv import write_wide_csv
from torch_geometric_tactile.sensors import grid

LAYOUT = grid(2, 3, 0.01)
SPANS = [(0.2, 0.5, "slip"), (0.5, 0.6, "hold")]
LABELS = "nnsssshhnn"  # of ten frames, 0.1 s apart: the frame at 0.5 s is of the next
HEAD = "recording,start,end,label\n"


def trial(annotations=(), num_frames=10, **more):
    x = np.random.default_rng(0).normal(size=(num_frames, 6, 1))
    return Recording(np.arange(num_frames) / 10, x, annotations=annotations, **more)


def frames(*recordings, **more):
    return RecordingFrames(layout=LAYOUT, recordings=recordings, target="annotation", **more)


def letters(dataset, y):
    return "".join(dataset.class_names[i][0] for i in y.tolist())


def test_a_frame_has_the_label_of_its_annotation_and_none_outside_of_all():
    dataset = frames(trial(SPANS), trial([(0.8, 5, "slip")]))
    assert dataset.class_names == ["hold", "none", "slip"]
    assert letters(dataset, dataset.data.y) == "nnssshhnnn" + "nnnnnnnnss"


def test_a_window_has_the_label_of_its_last_frame():
    dataset = frames(trial(SPANS), trial([(0.8, 5, "slip")]))
    for target in ("annotation", "y"):
        windows = Windows(dataset, 3, hop=2, target=target)
        assert letters(windows, windows.y) == "sshn" + "nnns"
    ahead = Windows(dataset, 3, hop=2, label="ahead", horizon=1)
    assert letters(ahead, ahead.y) == "shnn" + "nnns"
    # Those that are to be left out are, with their whole past in the others.
    known = windows[(windows.y != windows.class_names.index("none")).nonzero().view(-1)]
    assert letters(known, known.y) == "sshs"


def test_a_recording_without_annotations_is_refused():
    with pytest.raises(ValueError, match=r"recording 1 must have annotations .* \(got none\)"):
        frames(trial(SPANS), trial())
    with pytest.raises(ValueError, match=r"recording 0 must have annotations .* \(got none\)"):
        frames(trial([(0.2, 0.5, "gap")]))  # was written by the recorder, and not by a person
    whole = frames(trial(SPANS), trial([(0, 1, "none")]))
    assert letters(whole, whole.data.y)[10:] == "n" * 10


def test_different_labels_on_a_frame_are_refused_as_a_target_only():
    both = trial([(0.2, 0.5, "slip"), (0.4, 0.6, "hold")], label="mug")
    message = r"recording 0: .* \(got 'slip' and 'hold' in frame 4, at 0.4 s\)"
    with pytest.raises(ValueError, match=message):
        frames(both)
    RecordingFrames(layout=LAYOUT, recordings=[both], target="label")


def test_a_span_of_another_clock_is_refused_with_the_name_of_its_recording():
    message = "recording 1: the annotation 'slip' must be within the recording, from 0.0 to 0.9 s"
    with pytest.raises(ValueError, match=message):
        frames(trial(SPANS), trial([(200, 500, "slip")]))


def test_metadata_of_that_name_are_still_a_target():
    dataset = frames(trial(meta={"annotation": "a"}), trial(meta={"annotation": "b"}))
    assert dataset.class_names == ["a", "b"]


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "raw").mkdir()
    write_npz(trial([(0, 0.1, "open")]), tmp_path / "raw" / "mug_1.npz")
    write_wide_csv(trial(), tmp_path / "raw" / "cup_2.csv")
    return tmp_path


@pytest.mark.parametrize("place", ["raw", "."])
def test_tables_tell_of_the_recordings_in_a_folder(folder, place):
    (folder / place / "annotations.csv").write_text(
        HEAD + "mug_1,0.8,0.9,slip\ncup_2.csv,0,0.3,slip\nmug_1,0,0.1,open\n"
    )
    (folder / place / "labels.csv").write_text("recording,label,session\nmug_1,x,3\ncup_2,y,4\n")
    dataset = RecordingFrames(folder, LAYOUT, target="annotation")
    assert dataset.trial_names == ["cup_2", "mug_1"]
    assert letters(dataset, dataset.data.y) == "ssssnnnnnn" + "oonnnnnnss"
    dataset = RecordingFrames(folder, LAYOUT, target="label")
    assert (dataset.class_names, dataset.session_names) == (["x", "y"], ["3", "4"])
    assert dataset.data.y[::10].tolist() == [1, 0]


def test_a_changed_table_is_read_anew(folder):
    table = folder / "raw" / "annotations.csv"
    table.write_text(HEAD + "cup_2,0,0.3,slip\n")
    assert RecordingFrames(folder, LAYOUT, target="annotation").class_names[-1] == "slip"
    table.write_text(HEAD + "cup_2,0,0.3,hold\n")
    assert "slip" not in RecordingFrames(folder, LAYOUT, target="annotation").class_names


def test_names_in_subfolders_are_of_the_folder_that_a_table_is_in(tmp_path):
    (tmp_path / "raw" / "day").mkdir(parents=True)
    write_npz(trial(), tmp_path / "raw" / "day" / "mug_1.npz")
    write_npz(trial(), tmp_path / "raw" / "mug_1.npz")
    (tmp_path / "raw" / "day" / "annotations.csv").write_text(HEAD + "mug_1,0,0.1,a\n")
    (tmp_path / "raw" / "annotations.csv").write_text(HEAD + "mug_1,0,0.1,b\nday/mug_1,0.3,0.4,c\n")
    dataset = RecordingFrames(tmp_path, LAYOUT, target="annotation", pattern=r"(day/)?mug_(\d+)")
    assert letters(dataset, dataset.data.y) == "aanccnnnnn" + "bbnnnnnnnn"


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("annotations.csv", HEAD + "mug_9,0,1,a\n", "must name recordings in .* (got 'mug_9')"),
        ("labels.csv", "recording,label\nMUG_1,a\n", "must name recordings in .* (got 'MUG_1')"),
        ("labels.csv", "recording,unit\nmug_1,kg\n", "'unit' in 'meta' must be one of"),
        ("labels.csv", ",recording\n0,mug_1\n", "line 1 must name column 1"),
    ],
)
def test_a_table_that_does_not_fit_is_refused(folder, name, text, message):
    (folder / name).write_text(text)
    with pytest.raises(ValueError, match=re.escape(message).replace(r"\.\*", ".*")):
        RecordingFrames(folder, LAYOUT, target="label")


def test_a_table_must_not_contradict_a_file(folder):
    write_npz(trial(label="mug", meta={"object": "mug"}), folder / "raw" / "mug_1.npz")
    for column, value in (("label", "cup"), ("object", "cup")):
        (folder / "labels.csv").write_text(f"recording,{column}\nmug_1,{value}\n")
        with pytest.raises(ValueError, match=f"'{column}' as .*labels.csv', 'cup' .got 'mug'"):
            RecordingFrames(folder, LAYOUT)
    (folder / "labels.csv").write_text("recording,label,object\nmug_1,mug,mug\ncup_2,cup,\n")
    assert RecordingFrames(folder, LAYOUT, target="label").class_names == ["cup", "mug"]
