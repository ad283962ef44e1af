from pathlib import Path

import pooch
import pytest
import torch

from torch_geometric_tactile.datasets import BioTacSP
from torch_geometric_tactile.datasets._root import default_root


@pytest.fixture
def root(write_bts3, tmp_path):
    """A root with six small files: 4 objects in training, 2 others in the test."""
    write_bts3(tmp_path / "raw")
    return tmp_path


def test_small_files_by_hand(root):
    dataset = BioTacSP(root, checksum=False)
    assert repr(dataset) == "BioTacSP(24)"
    assert dataset.data.y.tolist() == [0, 1] * 12
    assert dataset.class_names == ["stable", "slip"]
    assert dataset.group_names == [f"test_{i}" for i in (0, 1)] + [f"train_{i}" for i in range(4)]
    assert dataset.data.group.tolist() == [2, 3, 4, 5] * 6
    assert dataset.data.session.tolist() == [0] * 8 + [1] * 8 + [2] * 8
    palms = ["palm_down", "palm_side", "palm_45"]
    assert dataset.session_names == [*palms, *(f"{palm}_test" for palm in palms)]


@pytest.mark.parametrize(
    ("split", "palm", "sessions"),
    [
        ("train", None, [0, 1, 2]),
        ("test", None, [3, 4, 5]),
        (None, None, [0, 1, 2, 3, 4, 5]),
        ("train", "side", [1]),
        ("test", "45", [5]),
        (None, "down", [0, 3]),
    ],
)
def test_split_and_palm_choose_sessions(root, split, palm, sessions):
    dataset = BioTacSP(root, split=split, palm=palm, checksum=False)
    assert dataset.data.session.unique().tolist() == sessions
    assert len(dataset) == 8 * len(sessions)


def test_all_splits_come_from_one_processed_file(root):
    for split in ("train", "test", None):
        BioTacSP(root, split=split, checksum=False)
    names = sorted(path.name for path in (root / "processed").iterdir())
    assert names == ["biotac_sp_unverified.pt"]


def test_unverified_files_do_not_pass_for_verified_ones_later(root):
    BioTacSP(root, checksum=False)
    with pytest.raises(ValueError, match="must have the SHA-256 checksum"):
        BioTacSP(root)


def test_pre_filter_that_leaves_nothing_of_a_split(root):
    dataset = BioTacSP(root, "test", pre_filter=lambda data: int(data.session) < 3, checksum=False)
    assert len(dataset) == 0
    assert dataset.num_classes == 0
    assert dataset.data.x.shape == (0, 24, 3)


@pytest.mark.parametrize("split", ["val", "", "All"])
def test_unknown_split(root, split):
    with pytest.raises(ValueError, match=r"'split' must be 'train', 'test' or None \(got '"):
        BioTacSP(root, split=split)


@pytest.mark.parametrize("palm", ["up", 45])
def test_unknown_palm(root, palm):
    with pytest.raises(ValueError, match=rf"'palm' must be 'down', .* or None \(got '{palm}'\)"):
        BioTacSP(root, palm=palm)


def test_wrong_checksum(root):
    with pytest.raises(
        ValueError, match=r"palm_down\.csv' must have the SHA-256 checksum 7abe.*'checksum=False'"
    ):
        BioTacSP(root)
    assert not list(root.glob("processed/*"))


@pytest.mark.parametrize(
    ("keep", "message"),
    [(-20, "line 9 must have 74 cells"), (0, "got an empty file"), (100, "column")],
)
def test_cut_file(root, keep, message):
    path = root / "raw" / "bts3v2_palm_45_test.csv"
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(ValueError, match=rf"bts3v2_palm_45_test\.csv'.*{message}"):
        BioTacSP(root, checksum=False)
    assert not list(root.glob("processed/*"))


@pytest.mark.parametrize("inner", [".", "raw", "BioTacSP/raw", "biotacsp"])
def test_import_raw(write_bts3, tmp_path, inner):
    write_bts3(tmp_path / "disk" / inner)
    assert BioTacSP.import_raw(tmp_path / "disk", tmp_path / "root")
    assert len(BioTacSP(tmp_path / "root", checksum=False)) == 24
    assert len(list((tmp_path / "root" / "raw").iterdir())) == 6


def test_import_raw_keeps_what_is_there_and_takes_what_it_finds(write_bts3, tmp_path):
    name = "bts3v2_palm_45.csv"
    disk = write_bts3(tmp_path / "disk", seed=1)
    (disk / "bts3v2_palm_down.csv").unlink()
    target = tmp_path / "raw" / name
    target.parent.mkdir()
    target.write_text("mine")
    assert BioTacSP.import_raw(disk, tmp_path)
    assert target.read_text() == "mine"
    assert len(list(target.parent.iterdir())) == 5


def test_import_raw_finds_nothing(tmp_path):
    assert not BioTacSP.import_raw(tmp_path / "disk", tmp_path / "root")
    assert not (tmp_path / "root").exists()


@pytest.mark.parametrize("place", ["root", "biotacsp"])
def test_files_in_the_root_or_beside_it_are_taken_before_a_download(write_bts3, tmp_path, place):
    write_bts3(tmp_path / place)
    assert len(BioTacSP(tmp_path / "root", checksum=False)) == 24


def test_import_raw_takes_the_home_folder(write_bts3, tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    write_bts3(tmp_path / "disk")
    assert BioTacSP.import_raw("~/disk", "~/root")
    assert len(BioTacSP("~/root", checksum=False)) == 24


def test_home_of_nobody_is_a_folder_of_that_name(monkeypatch):
    monkeypatch.setenv("TACTILE_DATA", "~nobody_of_this_name/touch")
    assert default_root("a") == Path("~nobody_of_this_name/touch/a")


def test_default_root_follows_the_environment(monkeypatch, tmp_path, write_bts3):
    monkeypatch.setenv("TACTILE_DATA", str(tmp_path))
    assert default_root("BioTacSP") == tmp_path / "BioTacSP"
    write_bts3(tmp_path / "BioTacSP" / "raw")
    assert Path(BioTacSP(checksum=False).root) == tmp_path / "BioTacSP"
    monkeypatch.setenv("TACTILE_DATA", "~/touch")
    assert default_root("a") == Path.home() / "touch" / "a"


@pytest.mark.parametrize("spelling", ["pressure_mat", "PRESSURE-MAT", "pressuremat"])
def test_default_root_takes_other_spellings(monkeypatch, tmp_path, spelling):
    monkeypatch.setenv("TACTILE_DATA", str(tmp_path))
    (tmp_path / "pressure_mats").mkdir()
    (tmp_path / "pressure_mat.zip").touch()
    assert default_root("PressureMat") == tmp_path / "PressureMat"
    (tmp_path / spelling).mkdir()
    assert default_root("PressureMat") == tmp_path / spelling
    (tmp_path / "Pressure_Mat").mkdir()
    with pytest.raises(ValueError, match=r"must have only one folder of the data set 'Press"):
        default_root("PressureMat")
    (tmp_path / "PressureMat").mkdir()
    assert default_root("PressureMat") == tmp_path / "PressureMat"
    assert default_root("other") == tmp_path / "other"


@pytest.mark.parametrize("value", [None, ""])
def test_default_root_without_the_environment_is_the_users_cache(monkeypatch, value):
    monkeypatch.delenv("TACTILE_DATA")
    if value is not None:
        monkeypatch.setenv("TACTILE_DATA", value)
    assert default_root("a") == Path(pooch.os_cache("torch_geometric_tactile")) / "a"


def test_readings_are_those_of_the_columns(root):
    lines = (root / "raw" / "bts3v2_palm_side.csv").read_text().splitlines()
    first = torch.tensor([float(cell) for cell in lines[1].split(",")[2:]])
    sample = BioTacSP(root, palm="side", checksum=False)[0]
    assert sample.x.t().reshape(-1).equal(first)
