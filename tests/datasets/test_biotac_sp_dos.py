import logging

import numpy as np
import pytest

from torch_geometric_tactile.data import Protocol
from torch_geometric_tactile.datasets import BioTacSPDoS

FOLDERS = ("n", "e", "s", "w", "cw", "aw", "t")
DIRECTIONS = ["north", "east", "south", "west", "clockwise", "anticlockwise", "touch"]


def sequence(path, start=0, frames=4):
    path.parent.mkdir(parents=True, exist_ok=True)
    table = 2000 + start + np.arange(frames * 24).reshape(frames, 24)
    names = ",".join(f"ff_e{i}" for i in range(1, 25))
    np.savetxt(path, table, fmt="%d", delimiter=",", header=names, comments="")


def make(folder, folders=FOLDERS):
    for i, name in enumerate(folders):
        for j, item in enumerate(("pen9", "pen10", "hd2")):
            sequence(folder / name / f"{item}.csv", 100 * i + 10 * j, frames=3 + j)
    return folder


@pytest.mark.parametrize("inner", ["raw", "csvs", "."])
def test_sequences_by_hand(inner, tmp_path):
    make(tmp_path / inner)
    dataset = BioTacSPDoS(tmp_path)
    assert repr(dataset) == "BioTacSPDoS(84)"
    assert dataset.class_names == DIRECTIONS
    assert dataset.num_classes == 7
    assert dataset.group_names == ["hd", "pen"]
    assert dataset.trial_names[:4] == ["n/hd2", "n/pen9", "n/pen10", "e/hd2"]
    assert dataset.x.shape == (84, 24, 1)
    assert dataset.y.tolist() == [i for i in range(7) for _ in range(12)]
    assert dataset.trial[:13].tolist() == [0] * 5 + [1] * 3 + [2] * 4 + [3]
    assert dataset.group[:12].tolist() == [0] * 5 + [1] * 7
    assert dataset.time[:6].tolist() == [0, 0.01, 0.02, 0.03, 0.04, 0]
    assert dataset.x[5:7, 0, 0].tolist() == [2000, 2024]  # n/pen9
    assert dataset[0].edge_index is None
    assert dataset[0].pos.shape == (24, 3)


def test_sets_of_the_authors_are_parts(tmp_path):
    for name in FOLDERS:
        for item in ("pen0", "cardboard4", "screw8", "plate12", "mug16"):
            sequence(tmp_path / name / f"{item}.csv")
    dataset = BioTacSPDoS(tmp_path)
    assert dataset.set.unique().tolist() == [0, 1, 2, 3, 4]
    split = Protocol("given").split(dataset)
    groups = [{dataset.group_names[i] for i in dataset.group[part]} for part in split]
    assert groups == [{"pen"}, set(), {"cardboard", "screw", "plate", "mug"}]


def test_misspelt_file_of_the_authors_is_of_its_object(tmp_path):
    for name in FOLDERS:
        sequence(tmp_path / name / "striped290.csv")
    sequence(tmp_path / "s" / "strippes305.csv")
    dataset = BioTacSPDoS(tmp_path)
    assert dataset.group_names == ["striped"]
    assert "s/strippes305" in dataset.trial_names
    assert dataset.set.unique().tolist() == [3]


def test_folders_and_suffixes_in_capitals(tmp_path):
    make(tmp_path, [name.upper() for name in FOLDERS])
    sequence(tmp_path / "CW" / "hd3.CSV")
    dataset = BioTacSPDoS(tmp_path)
    assert dataset.y.bincount().tolist() == [12, 12, 12, 12, 16, 12, 12]
    assert "cw/hd3" in dataset.trial_names


def test_processed_once_and_anew_when_a_file_changes(tmp_path, caplog):
    make(tmp_path)
    BioTacSPDoS(tmp_path)
    with caplog.at_level(logging.WARNING):
        BioTacSPDoS(tmp_path)
        assert not caplog.text
        sequence(tmp_path / "n" / "hd2.csv", 7)
        assert int(BioTacSPDoS(tmp_path).x[0, 0, 0]) == 2007
    assert "processing" in caplog.text


@pytest.mark.parametrize("missing", ["cw", "t"])
@pytest.mark.parametrize("empty", [True, False])
def test_missing_or_empty_folder(missing, empty, tmp_path):
    make(tmp_path / "csvs", [name for name in FOLDERS if name != missing])
    if empty:
        (tmp_path / "csvs" / missing).mkdir()
        (tmp_path / "csvs" / missing / "notes.txt").touch()
    with pytest.raises(FileNotFoundError, match=rf"csvs' must have .* \(got none in '{missing}'\)"):
        BioTacSPDoS(tmp_path)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("n/pen.csv", r"pen.csv' must be named <object><number>.csv, like 'bottle0.csv'"),
        ("n/12.csv", r"12.csv' must be named"),
        (
            "n/pen010.csv",
            r"sequence 10 of 'pen' must be in only one file \(got '.*pen0?10.csv' and '.*",
        ),
        (
            "N/pen10.csv",
            r"sequence 10 of 'pen' must be in only one file \(got '.*pen10.csv' and '.*",
        ),
    ],
)
def test_wrong_and_repeated_names(name, message, tmp_path):
    make(tmp_path)
    sequence(tmp_path / name)
    if name[0] == "N" and (tmp_path / "n").samefile(tmp_path / "N"):
        pytest.skip("needs a file system that tells capitals apart")
    with pytest.raises(ValueError, match=message):
        BioTacSPDoS(tmp_path)


def test_a_damaged_file_is_named_and_nothing_is_kept(tmp_path):
    make(tmp_path)
    content = (tmp_path / "s" / "pen9.csv").read_text()
    (tmp_path / "s" / "pen9.csv").write_text(content[:-1])
    with pytest.raises(ValueError, match=r"s/pen9.csv', line [45] must end with a line break"):
        BioTacSPDoS(tmp_path)
    assert not list((tmp_path / "processed").glob("*.pt"))
