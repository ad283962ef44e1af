import logging
import os

import numpy as np
import pytest

from torch_geometric_tactile import datasets
from torch_geometric_tactile.data import Recording, StaticDataset
from torch_geometric_tactile.datasets import (
    AllegroUSkin,
    BiGS,
    BioTacSlide,
    BioTacSP,
    BioTacSPDoS,
    BrailleLetters,
    DigitImages,
    EFleshSlip,
    FakeTactileDataset,
    ICubGrasp,
    LetterShape,
    PressureMat,
    RecordingFrames,
    SamplesFile,
    SparshSkin,
    TactileGlove,
    USkinPick,
)
from torch_geometric_tactile.datasets import _raw_files as raw_files
from torch_geometric_tactile.datasets._raw_files import file_state
from torch_geometric_tactile.io._recording_npz import write_npz
from torch_geometric_tactile.sensors import grid

KIB = 1024
NEXT_STEPS = {
    AllegroUSkin: r"no trials in '.*raw' or .* simulate some: tactile simulate --out",
    BiGS: r"no grasps in '.*raw' or .* with: tactile convert bigs IN",
    BioTacSPDoS: r"raw' must have files .* put the folder 'csvs' of https",
    BioTacSlide: r"no slides in '.*raw' or .*dexrob/BioTac_slide_20_50 there",
    BrailleLetters: r"no 'braille_letters.npz' in '.*raw' or .*record/7050094[^$]*savez_compressed",
    ICubGrasp: r"no trials in '.*raw' or .*haroldsoh\.com",
    TactileGlove: r"no 'metadata.mat' in '.*raw' or .*classification_lite.zip \(https://stag",
    SparshSkin: r"(?s)no episodes in .*the licence .*huggingface-cli download .*baseline/xela/data",
    USkinPick: r"no trials in '.*raw' or .*git clone; .* commit ed8c1a0",
    LetterShape: r"no letters in .*simulate --objects letters",
    RecordingFrames: r"no trials in '.*raw' or '.*': put recordings",
}


def test_every_data_set_without_files_is_tested():
    others = {BioTacSP, DigitImages, EFleshSlip, PressureMat}  # which are downloaded
    others |= {FakeTactileDataset, SamplesFile}  # without a folder
    kinds = {kind for kind in vars(datasets).values() if isinstance(kind, type)}
    assert {kind for kind in kinds if issubclass(kind, StaticDataset)} - others == {*NEXT_STEPS}


@pytest.mark.parametrize("root", [None, "empty", "empty raw"])
@pytest.mark.parametrize("kind", NEXT_STEPS)
def test_without_files_the_folder_and_the_next_step_are_named(kind, root, monkeypatch, tmp_path):
    monkeypatch.setenv("TACTILE_DATA", str(tmp_path))
    options = {"layout": grid(2, 3, 0.01)} if kind is RecordingFrames else {}
    folder = tmp_path / kind.__name__
    if root is not None or kind is RecordingFrames:  # which has no default
        options["root"] = folder = tmp_path / "mine"
        (folder / "raw" if root == "empty raw" else folder).mkdir(parents=True)
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(FileNotFoundError, match=NEXT_STEPS[kind]) as error:
        kind(**options)
    assert str(folder) in str(error.value)
    assert sorted(tmp_path.rglob("*")) == before


def test_a_long_first_reading_is_told_once(monkeypatch, tmp_path, caplog):
    (tmp_path / "raw").mkdir()
    for name in ("mug_1", "mug_2"):
        write_npz(
            Recording(time=[0.0, 0.1], tactile=np.zeros((2, 6, 1))),
            tmp_path / "raw" / f"{name}.npz",
        )
    size = sum(path.stat().st_size for path in tmp_path.glob("raw/*.npz"))
    caplog.set_level(logging.INFO, logger="torch_geometric_tactile.datasets")
    told = f"reading 2 files (0 MB) of '{tmp_path / 'raw'}' for the first time; later runs read '"
    for limit, expected in ((size + 1, 0), (size, 1), (size, 1)):
        monkeypatch.setattr(raw_files, "_LONG_READING_BYTES", limit)
        RecordingFrames(tmp_path, layout=grid(2, 3, 0.01))
        assert sum(told in message for message in caplog.messages) == expected
        if limit > size:
            next(tmp_path.glob("processed/*.pt")).unlink()


def changed(path, edit, time=None):
    """Whether the state changes with an edit, at a time if one is given."""
    before = file_state(path)
    edit(path)
    if time is not None:
        os.utime(path, ns=(time, time))
    return file_state(path) != before


def put(offset, byte):
    def edit(path):
        with path.open("r+b") as file:
            file.seek(offset)
            file.write(byte)

    return edit


@pytest.fixture
def raw(tmp_path):
    def make(size):
        path = tmp_path / "raw.bin"
        path.write_bytes(bytes(size))
        os.utime(path, ns=(10**9, 10**9))
        return path

    return make


@pytest.mark.parametrize("size", [1, 64 * KIB, 64 * KIB + 1, 128 * KIB, 128 * KIB + 1, 300 * KIB])
@pytest.mark.parametrize("place", ["first", "last"])
def test_ends_are_known_by_their_content(raw, size, place):
    offset = 0 if place == "first" else size - 1
    assert changed(raw(size), put(offset, b"x"), time=10**9)


@pytest.mark.parametrize("size", [64 * KIB + 1, 100 * KIB, 128 * KIB])
def test_middle_of_a_short_file_is_known_by_its_content(raw, size):
    assert changed(raw(size), put(64 * KIB, b"x"), time=10**9)


def test_middle_of_a_long_file_is_known_by_its_time(raw):
    path = raw(200 * KIB)
    assert changed(path, put(100 * KIB, b"x"), time=2 * 10**9)
    assert not changed(path, put(100 * KIB, b"y"), time=2 * 10**9)  # which the docstring tells


def test_short_file_that_was_touched_is_the_same(raw):
    assert not changed(raw(128 * KIB), lambda path: None, time=2 * 10**9)


def test_size_is_known(raw):
    assert changed(raw(10), lambda path: path.write_bytes(bytes(11)), time=10**9)


def test_state_is_one_value_of_a_line(raw):
    assert "=" not in file_state(raw(300 * KIB))
    assert "\n" not in file_state(raw(300 * KIB))
