"""All invalid recordings of a folder are listed at once."""

import re

import pytest

from torch_geometric_tactile.datasets import RecordingFrames, recording_frames
from torch_geometric_tactile.sensors import grid

LINES = ["time,thumb,index,palm", "0,1,2,3", "0.01,4,5,6", "0.02,7,8,9"]


def write_folder(tmp_path, **changed):
    for i in range(6):
        lines = changed.get(f"cup_{i}", LINES)
        (tmp_path / f"cup_{i}.csv").write_text("\n".join(lines) + "\n")
    return tmp_path


def load(folder):
    return RecordingFrames(folder, layout=grid(1, 3, 0.01), read_options={"unit": "count"})


def listed_files(error):
    return re.findall(r"cup_\d", str(error.value))


BAD = {
    "cup_0": ["time,thumb,palm", "0,1,3"],
    "cup_2": [line.replace(",", ";").replace(".", ",") for line in LINES],
    "cup_4": [*LINES[:3], "0.02,7"],
}


def test_one_list_of_all_invalid_files(tmp_path):
    with pytest.raises(ValueError, match=r"^3 of 6 recordings cannot be used: 1\. '") as error:
        load(write_folder(tmp_path, **BAD))
    assert listed_files(error) == ["cup_0", "cup_2", "cup_4"]
    assert "place of 'index'" in str(error.value)
    assert "line 3, column 1: 'time' must be a number" in str(error.value)
    assert "line 4 must have 4 cells (got 2)" in str(error.value)


def test_long_files_are_not_read_after_wrong_headers(tmp_path, monkeypatch):
    monkeypatch.setattr(recording_frames, "_MAX_BYTES_TO_LIST_ALL_ERRORS", 100)
    with pytest.raises(ValueError, match=r"cup_0\.csv': its columns") as error:
        load(write_folder(tmp_path, **BAD))
    assert listed_files(error) == ["cup_0"]


def test_one_invalid_file_keeps_its_message(tmp_path):
    with pytest.raises(ValueError, match=r"^'.*cup_4.csv', line 4 must have 4 cells"):
        load(write_folder(tmp_path, cup_4=BAD["cup_4"]))


def test_valid_files_in_another_order_of_columns_are_no_error(tmp_path):
    shuffled = [",".join([line.split(",")[i] for i in (0, 3, 1, 2)]) for line in LINES]
    frames = load(write_folder(tmp_path, cup_3=shuffled))
    assert frames.data.x[9].view(-1).tolist() == [1, 2, 3]


def test_an_invalid_option_is_one_error(tmp_path):
    with pytest.raises(ValueError, match=r"^'decimal' must be '.' or ',' \(got x\)$"):
        RecordingFrames(
            write_folder(tmp_path), layout=grid(1, 3, 0.01), read_options={"decimal": "x"}
        )
