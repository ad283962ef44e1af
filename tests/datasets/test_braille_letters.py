import inspect
import pickle
import textwrap

import numpy as np
import pytest
from hostile_pickle import Touch
from published_files import LETTERS, braille_npz, braille_table

from torch_geometric_tactile.data import Protocol, Trials
from torch_geometric_tactile.datasets import BrailleLetters
from torch_geometric_tactile.datasets.braille_letters import _SCRIPT

FILE = "braille_letters.npz"


@pytest.mark.parametrize("inner", [".", "raw"])
def test_slides_by_hand(tmp_path, inner):
    braille_npz(tmp_path / inner / FILE)
    dataset = BrailleLetters(tmp_path)
    assert repr(dataset) == "BrailleLetters(27)"
    assert dataset.class_names == ["Space", "A", "B"]
    assert dataset.y.tolist() == [1] * 9 + [2] * 9 + [0] * 9
    assert dataset.trial[:10].tolist() == [0] * 4 + [1] * 5 + [2]
    assert dataset.time[3:6].tolist() == pytest.approx([0.075, 0, 0.025])
    assert dataset.x.shape == (27, 12, 1)
    assert dataset.x[4, :, 0].tolist() == [*range(201, 213)]
    assert dataset[0].edge_index.shape == (2, 38)
    assert Trials(dataset, ragged="pad").valid_frames.tolist() == [4, 5] * 3
    split = Protocol("trial", folds=2, stratify="y").split(dataset)
    assert set(dataset.y[split.test].tolist()) == {0, 1, 2}


def test_time_of_the_file_and_all_letters(tmp_path):
    rows = braille_table(LETTERS, 1, frames=2)
    braille_npz(tmp_path / FILE, rows, time=100 + 0.01 * np.arange(54))
    dataset = BrailleLetters(tmp_path)
    assert dataset.class_names == list(LETTERS)
    assert dataset.time[:4].tolist() == pytest.approx([0, 0.01, 0, 0.01])


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"trial": None}, r"must hold an array 'trial' \(got none\)"),
        ({"y": None}, r"must hold labelled samples: an array 'y' is missing"),
        ({"y": np.repeat(["A", "a", "1"], 9)}, r"the letters Space and A to Z \(got \['1', 'a'\]"),
        ({"y": np.repeat(["A", "B"], [2, 25])}, "of one letter"),
        ({"trial": np.arange(27) % 6}, "must have consecutive frames of one letter in each trial"),
        ({"x": np.full((27, 12, 1), np.nan)}, r"must hold finite readings 'x' of 12 taxels"),
        ({"x": np.zeros((27, 11, 1))}, r"'x' of 12 taxels \(got float64 of shape \(27, 11, 1\)"),
    ],
)
def test_refused(tmp_path, more, message):
    braille_npz(tmp_path / FILE, **more)
    with pytest.raises(ValueError, match=rf"{FILE}' {message}|{FILE}' .*{message}"):
        BrailleLetters(tmp_path)


def test_nothing_is_unpickled(tmp_path):
    marker = tmp_path / "ran"
    x = np.array([Touch(marker)] * 27, dtype=object)
    braille_npz(tmp_path / FILE, x=x)
    with pytest.raises(ValueError, match=FILE):
        BrailleLetters(tmp_path)
    (tmp_path / "data_braille_letters_raw").write_bytes(pickle.dumps(Touch(marker)))
    (tmp_path / FILE).unlink()
    with pytest.raises(FileNotFoundError, match="this package does not open"):
        BrailleLetters(tmp_path)
    assert not marker.exists()


def test_lines_of_the_message_are_those_of_the_page():
    doc = inspect.getdoc(BrailleLetters)
    assert textwrap.indent(_SCRIPT.strip(), "    ") in doc


@pytest.mark.parametrize("as_table", [False, True])
def test_lines_convert_a_pickle(tmp_path, monkeypatch, as_table):
    pandas = pytest.importorskip("pandas")
    rows = braille_table()
    content = pandas.DataFrame(rows) if as_table else rows
    (tmp_path / "data_braille_letters_raw").write_bytes(pickle.dumps(content))
    monkeypatch.chdir(tmp_path)
    exec(_SCRIPT, {})
    found = BrailleLetters(tmp_path)
    braille_npz(tmp_path / "other" / FILE, rows)
    expected = BrailleLetters(tmp_path / "other")
    for key in ("x", "y", "trial", "time"):
        assert found[:].data[key].equal(expected[:].data[key])
