import json

import numpy as np
import pytest

from torch_geometric_tactile.cli import main
from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io._recording_npz import write_npz

FRAMES = 40


def grasp(seed, rate=100, num_taxels=4, **more):
    tactile = np.random.default_rng(seed).uniform(1, 1000, size=(FRAMES, num_taxels, 1))
    return Recording(np.arange(FRAMES) / rate, tactile.round(), **more)


@pytest.fixture
def folder(tmp_path):
    """Three grasps of two objects that are alike, without faults."""
    for i, name in enumerate(("mug_000", "mug_001", "cup_000")):
        write_npz(grasp(i, meta={"unit": "count"}), tmp_path / f"grasps/{name}.npz")
    return tmp_path / "grasps"


def rows(text):
    """The lines of each row of a summary by its name."""
    lines: dict[str, list[str]] = {}
    name = ""
    for line in text.splitlines():
        name = line[:13].strip() or name
        lines.setdefault(name, []).append(line[13:])
    return lines


def inspect(folder, capsys, *options, status=0):
    assert main(["inspect", str(folder), *options]) == status
    output = capsys.readouterr()
    assert ("must hold files that can be read (got " in output.err) == (status == 1)
    return rows(output.out)


def change(path, **signals):
    from torch_geometric_tactile.io import read_recording

    recording = read_recording(path)
    tactile = recording.tactile.copy()
    for taxel, values in signals.items():
        index = int(taxel.removeprefix("taxel_"))
        tactile[:, index, 0] = tactile[:, values, 0] if isinstance(values, int) else values
    path.unlink()
    write_npz(Recording(recording.time, tactile, meta=recording.meta), path)


def test_recordings_that_are_alike(folder, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert inspect(folder, capsys) == {
        "folder": [str(folder)],
        "files": ["3: npz 3"],
        "frames": ["120 in 1.17 s"],
        "rate": ["100 per second"],
        "gaps": ["none"],
        "taxels": ["4 of 1 channels"],
        "readings": ["4 to 997"],
        "unit": ["counts"],
        "joints": ["none"],
        "missing": ["none"],
        "label": ["none"],
        "object": ["mug 2, cup 1"],
        "trial": ["000 2, 001 1"],
        "dead taxels": ["none"],
        "constant": ["none"],
        "saturated": ["none"],
        "equal": ["none"],
    }
    assert [path.name for path in tmp_path.iterdir()] == ["grasps"]  # no picture


def test_differences_name_their_files(folder, capsys):
    write_npz(grasp(3, rate=50, num_taxels=6), folder / "cup_001.npz")
    write_npz(grasp(4, rate=102, meta={"unit": "count"}), folder / "cup_002.npz")
    found = inspect(folder, capsys)
    assert found["rate"] == [
        "100 to 102 per second in 4 of 5 files",
        "50 per second in 1 of 5 files: cup_001.npz",
    ]
    assert found["taxels"] == [
        "4 of 1 channels in 4 of 5 files",
        "6 of 1 channels in 1 of 5 files: cup_001.npz",
    ]
    assert found["unit"][1] == "(unit unknown) in 1 of 5 files: cup_001.npz"


def test_taxels_that_do_not_measure_name_their_files(folder, capsys):
    for path in folder.iterdir():
        change(path, taxel_3=np.full(FRAMES, 7.0))
    change(folder / "mug_001.npz", taxel_2=1, taxel_3=np.full(FRAMES, np.nan))
    frames = np.arange(FRAMES)
    limited = np.where(frames < 15, 1023.0, frames)
    change(folder / "cup_000.npz", taxel_0=limited)
    found = inspect(folder, capsys)
    assert found["dead taxels"] == ["3 in 1 of 3 files: mug_001.npz"]
    assert found["constant"] == ["3 in 2 of 3 files: cup_000.npz, mug_000.npz"]
    assert found["saturated"] == ["0 in 1 of 3 files: cup_000.npz"]
    assert found["equal"] == ["1 = 2 in 1 of 3 files: mug_001.npz"]
    percent = "(8.33 %)"
    assert found["missing"] == [
        f"40 of 480 readings of a taxel in a frame {percent}, in 1 of 3 files: mug_001.npz"
    ]
    (folder / "mug_001.npz").unlink()
    assert inspect(folder, capsys)["constant"] == ["3 in all files"]


def test_a_file_shows_its_taxels_that_do_not_measure(folder, capsys):
    change(folder / "mug_000.npz", taxel_3=np.full(FRAMES, 7.0), taxel_2=1)
    found = inspect(folder / "mug_000.npz", capsys, "--no-picture")
    assert found["constant"] == ["1: 3"]
    assert found["saturated"] == ["none"]
    assert found["equal"] == ["1: 1 = 2"]


def test_recordings_of_a_frame_or_none_have_no_rate(folder, capsys):
    write_npz(Recording([0.0], np.ones((1, 4, 1))), folder / "pen_000.npz")
    write_npz(Recording([], np.ones((0, 4, 1))), folder / "pen_001.npz")
    assert inspect(folder, capsys)["rate"] == [
        "100 per second in 3 of 5 files",
        "unknown in 2 of 5 files: pen_000.npz, pen_001.npz",
    ]
    assert main(["inspect", str(folder), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["recordings"][4]["range"] is None


def test_gaps_are_added(folder, capsys):
    time = np.arange(FRAMES) / 100 + 2.0 * (np.arange(FRAMES) > 20)
    write_npz(Recording(time, np.ones((FRAMES, 4, 1))), folder / "pen_000.npz")
    assert inspect(folder, capsys)["gaps"] == [
        "1, 2.01 s without frames, in 1 of 4 files: pen_000.npz"
    ]


def test_labels_come_from_recordings_names_and_tables(folder, capsys):
    write_npz(grasp(5, label="firm"), folder / "pen_007.npz")
    (folder / "labels.csv").write_text("recording,label,person\nmug_000,soft,ann\ncup_000,firm,\n")
    (folder / "annotations.csv").write_text(
        "recording,start,end,label\nmug_000,0,0.1,slip\nmug_000,0.2,0.3,slip\nmug_001,0,0.1,roll\n"
    )
    found = inspect(folder, capsys)
    assert found["label"] == ["firm 2, soft 1; none in 1"]
    assert found["object"] == ["mug 2, cup 1, pen 1"]
    assert found["person"] == ["ann 1; none in 3"]
    assert found["annotations"] == ["slip 2, roll 1, in 2 of 4 files: mug_000.npz, mug_001.npz"]


def test_a_pattern_names_the_groups(folder, capsys):
    found = inspect(folder, capsys, "--pattern", r"(?P<label>mug)_(?P<session>\d+)")
    assert found["label"] == ["mug 2; none in 1"]
    assert found["session"] == ["000 1, 001 1; none in 1"]
    assert "object" not in found
    assert main(["inspect", str(folder), "--pattern", "("]) == 1
    assert "'--pattern' must be a regular expression" in capsys.readouterr().err
    found = inspect(folder, capsys, "--pattern", "{label}_{session}")
    assert found["label"] == ["mug 2, cup 1"]


def test_subfolders_are_read_with_a_slash_in_the_pattern(folder, tmp_path, capsys):
    assert main(["inspect", str(tmp_path)]) == 1
    assert (
        "(got none): to search subfolders, give a '--pattern' with a '/'" in capsys.readouterr().err
    )
    write_npz(grasp(8), tmp_path / "processed/x.npz")
    write_npz(grasp(8), tmp_path / "grasps/.hidden.npz")
    found = inspect(tmp_path, capsys, "--pattern", r"(?P<place>[a-z]+)/.*")
    assert found["place"] == ["grasps 3"]
    folder.rename(tmp_path / "raw")  # where data sets look first
    assert inspect(tmp_path, capsys)["object"] == ["mug 2, cup 1"]


def test_files_that_cannot_be_read_are_listed_and_the_others_summarised(folder, capsys):
    (folder / "bad.npz").write_bytes(b"PK\x03\x04abc")
    (folder / "bad.csv").write_text("time,a\n0,1\n0.1,x\n")
    (folder / "labels.csv").write_text("recording,label\ngone,soft\n")
    (folder / "notes.txt").write_text("no recording")
    found = inspect(folder, capsys, status=1)
    assert found["files"] == ["3: npz 3"]
    count, *lines = found["unreadable"]
    assert count == "3"
    assert [line.partition(": ")[0] for line in lines] == ["labels.csv", "bad.csv", "bad.npz"]
    assert "must name recordings in" in lines[0]
    assert "bad.csv', line 3" in lines[1]
    assert "is not a complete npz file" in lines[2]


def test_a_folder_of_unreadable_files_is_listed(tmp_path, capsys):
    (tmp_path / "bad.npz").write_bytes(b"PK\x03\x04abc")
    assert [*inspect(tmp_path, capsys, status=1)] == ["folder", "files", "unreadable"]


def test_reading_options_hold_for_all_files(tmp_path, capsys):
    for i in range(2):
        path = tmp_path / f"glove_{i}.csv"
        path.write_text("time,pad_0,pad_1,bend,grasp\n0,3,4,0.5,pinch\n1,5,6,0.5,open\n")
    options = ["--tactile", r"pad_\d", "--joint", "bend", "--label", "grasp"]
    found = inspect(tmp_path, capsys, *options)
    assert found["taxels"] == ["2 of 1 channels"]
    assert found["joints"] == ["1"]
    assert found["grasp"] == ["open 2, pinch 2"]  # frame by frame
    assert inspect(tmp_path, capsys, status=1)["unreadable"][0] == "2"


def test_json_has_each_recording(folder, capsys):
    (folder / "bad.npz").write_bytes(b"PK\x03\x04abc")
    change(folder / "cup_000.npz", taxel_2=1)
    assert main(["inspect", str(folder), "--json"]) == 1
    facts = json.loads(capsys.readouterr().out)
    assert [*facts] == ["folder", "recordings", "unreadable"]
    assert [*facts["unreadable"]] == ["bad.npz"]
    cup = facts["recordings"][0]
    assert (cup["file"], cup["num_frames"], cup["unit"]) == ("cup_000.npz", 40, "count")
    assert cup["rate"] == pytest.approx(100)
    assert cup["groups"] == {"label": [], "object": ["cup"], "trial": ["000"]}
    assert cup["faults"] == {"dead": [], "constant": [], "saturated": [], "equal": [[1, 2]]}


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["grasps", "--out", "a.png"], "'FILE' must be a recording with '--out' (got the folder"),
        (["grasps/mug_000.npz", "--json"], "'FILE' must be a folder with '--json' (got 'grasps/"),
        (["grasps/mug_000.npz", "--pattern", "."], "'FILE' must be a folder with '--pattern'"),
        (["empty"], "'empty' must hold recordings with one of .h5, .hdf5, .npz, .mcap, .csv, "),
    ],
)
def test_options_that_do_not_apply_are_explained(
    folder, tmp_path, capsys, monkeypatch, options, message
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty").mkdir()
    assert main(["inspect", *options]) == 1
    assert message in capsys.readouterr().err


def test_long_lists_are_cut(tmp_path, capsys):
    for i in range(14):
        write_npz(grasp(i, num_taxels=i + 1), tmp_path / f"mug_{i}.npz")
    found = inspect(tmp_path, capsys)
    assert found["trial"] == ["14 different, each once"]
    assert len(found["taxels"]) == 13
    assert found["taxels"][-1] == "and 2 more lines"


@pytest.fixture
def dataset(tmp_path):
    """A LeRobot data set of two episodes."""
    pytest.importorskip("pyarrow", reason="needs the extra 'lerobot'")
    from torch_geometric_tactile.io import write_lerobot

    episodes = [grasp(0, label="mug"), grasp(1, label="cup")]
    write_lerobot(episodes, tmp_path / "set", fps=100, key="observation.tactile.left")
    return tmp_path / "set"


def test_episodes_of_a_lerobot_data_set_are_recordings(dataset, capsys):
    (dataset / "meta/tactile.json").unlink()
    found = inspect(dataset, capsys, "--tactile", "observation.tactile.*")
    assert found["files"] == ["2: LeRobot episode 2"]
    assert found["taxels"] == ["4 of 1 channels"]
    assert found["label"] == ["cup 1, mug 1"]
    assert main(["inspect", str(dataset)]) == 1
    assert "for all of 'observation.tactile.*', pass this as '--tactile'" in capsys.readouterr().err


@pytest.mark.parametrize("option", ["--time", "--pattern"])
def test_options_of_other_formats_are_refused_for_a_lerobot_data_set(dataset, capsys, option):
    assert main(["inspect", str(dataset), option, "a"]) == 1
    message = f"'{option}' must be an option of a LeRobot data set: tactile, num_channels, al"
    assert message in capsys.readouterr().err
