import json
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pyarrow", reason="needs the extra 'lerobot'")

from lerobot_sets import write_without_touch

from torch_geometric_tactile.cli import main
from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io import read_lerobot
from torch_geometric_tactile.io._recording_npz import write_npz


@pytest.fixture
def trials(tmp_path, monkeypatch):
    """A folder with two recordings; the current folder is the one above."""
    monkeypatch.chdir(tmp_path)
    for number, label in enumerate(("mug", "cup")):
        tactile = np.arange(240.0).reshape(40, 2, 3) + number
        recording = Recording(np.arange(40) / 100, tactile, label=label)
        write_npz(recording, tmp_path / f"trials/{label}.npz")
    (tmp_path / "trials/notes.txt").write_text("two trials")
    return tmp_path / "trials"


def test_recordings_become_a_data_set(trials, capsys):
    assert main(["convert", "trials", "a.lerobot", "--fps", "50", "--robot-type", "hand"]) == 0
    assert capsys.readouterr().out == "a.lerobot: 2 episodes, 50 steps per second\n"
    assert [(one.label, one.num_frames) for one in read_lerobot("a.lerobot")] == [
        ("cup", 20),
        ("mug", 20),
    ]


def test_a_rate_may_be_a_fraction(trials, capsys):
    assert main(["convert", "trials", "a.lerobot", "--fps", "29.97"]) == 0
    assert capsys.readouterr().out == "a.lerobot: 2 episodes, 29.97 steps per second\n"
    assert [one.meta["rate"] for one in read_lerobot("a.lerobot")] == [29.97, 29.97]


def test_files_keep_their_order_and_all_frames(trials):
    files = ["trials/mug.npz", "trials/cup.npz"]
    assert main(["convert", *files, "a.lerobot", "--every-frame", "--task", "pick"]) == 0
    found = read_lerobot("a.lerobot", every_frame=True)
    assert [(one.label, one.num_frames) for one in found] == [("mug", 40), ("cup", 40)]
    assert [one.num_frames for one in read_lerobot("a.lerobot")] == [13, 13]  # 30 steps a second


def test_gaps_are_refused_or_said(trials, capsys, caplog):
    time = np.arange(40) / 100 + (np.arange(40) >= 20)
    write_npz(Recording(time, np.ones((40, 2, 3)), label="pen"), trials / "pen.npz")
    assert main(["convert", "trials", "a.lerobot", "--gaps", "error"]) == 1
    assert "recording 2 has no frame within" in capsys.readouterr().err
    assert main(["convert", "trials", "b.lerobot", "--gaps", "error", "--max-gap", "2"]) == 0
    assert caplog.text == ""
    assert main(["convert", "trials", "c.lerobot"]) == 0
    assert "recording 2 has no frame within" in caplog.text
    missing = [bool(np.isnan(one.tactile).any()) for one in read_lerobot("c.lerobot")]
    assert missing == [False, False, True]


@pytest.mark.parametrize("given", [[], ["--start", "0.1", "--start", "0.1"], ["--every-frame"]])
def test_touch_is_added_to_a_data_set(trials, capsys, given):
    arms = [Recording(np.arange(8) / 25, np.ones((8, 1, 1)), np.ones((8, 3)))] * 2
    write_without_touch(arms, Path("arm"), fps=25)
    assert main(["convert", "trials", "a.lerobot", "--add-to", "arm", *given]) == 0
    assert capsys.readouterr().out == "a.lerobot: 2 episodes, touch added to 'arm'\n"
    found = read_lerobot("a.lerobot")[1]
    first = 10 if "--start" in given else 0
    assert found.tactile[0].tolist() == (np.arange(6.0).reshape(2, 3) + 6 * first).tolist()
    assert found.joint.shape == (8, 3)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            ["trials", "a.npz", "--fps", "3"],
            "'OUT' must end in .lerobot with '--fps' (got 'a.npz')",
        ),
        (["trials", "trials", "a.npz"], "'IN' must be one recording unless 'OUT' ends in .lerobot"),
        (["trials", "a.lerobot", "--start", "1"], "'--start' must be given with '--add-to' (got"),
        (
            ["trials", "a.lerobot", "--add-to", "b", "--fps", "9"],
            "'--fps' must not be given with '--add-to' (got 9.0)",
        ),
        (["trials", "a.lerobot", "--add-to", "b"], "b/meta/info.json' does not exist"),
        (["empty", "a.lerobot"], "'empty' must hold recordings with one of .h5, "),
        (["gone.npz", "a.lerobot"], "gone.npz' does not exist"),
        (["trials", "full.lerobot"], "'full.lerobot' must be a new or empty folder"),
    ],
)
def test_errors_are_explained(trials, tmp_path, capsys, words, message):
    (tmp_path / "empty").mkdir()
    (tmp_path / "full.lerobot").mkdir()
    (tmp_path / "full.lerobot/a.txt").write_text("a")
    assert main(["convert", *words]) == 1
    assert message in capsys.readouterr().err
    assert not (tmp_path / "a.lerobot").exists()


def test_touch_gets_the_feature_and_the_numbers_that_a_policy_needs(trials):
    tactile = np.full((40, 2, 3), np.nan)
    write_npz(Recording(np.arange(40) / 100, tactile, label="pen"), trials / "pen.npz")
    options = ["--key", "observation.environment_state", "--fill", "0.5"]
    assert main(["convert", "trials", "a.lerobot", "--fps", "50", *options]) == 0
    content = json.loads(Path("a.lerobot/meta/tactile.json").read_text())
    assert (content["feature"], content["fill"]) == ("observation.environment_state", 0.5)
    assert (read_lerobot("a.lerobot")[2].tactile == 0.5).all()
    arms = [Recording(np.arange(8) / 25, np.ones((8, 1, 1)), np.ones((8, 3)))] * 3
    write_without_touch(arms, Path("arm"), fps=25)
    options = ["--add-to", "arm", "--key", "observation.state", "--fill", "0.5"]
    assert main(["convert", "trials", "b.lerobot", *options]) == 0
    info = json.loads(Path("b.lerobot/meta/info.json").read_text())
    assert info["features"]["observation.state"]["shape"] == [9]
    assert (read_lerobot("b.lerobot")[2].tactile == 0.5).all()


def test_a_wrong_key_or_number_is_refused(trials, capsys):
    assert main(["convert", "trials", "a.lerobot", "--key", "touch"]) == 1
    assert "'key' must be 'observation.tactile'" in capsys.readouterr().err
    assert main(["convert", "trials", "a.lerobot", "--fill", "nan"]) == 1
    assert "'fill' must be a finite number" in capsys.readouterr().err
    assert not Path("a.lerobot").exists()
