import numpy as np
import pytest

from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io import write_recording
from torch_geometric_tactile.io._folder_recordings import RECORDING_SUFFIXES, list_recordings


@pytest.fixture
def folder(tmp_path):
    names = ("b.npz", "a.CSV", "labels.csv", "annotations.csv", ".c.npz", "notes.txt", "in/d.npz")
    for name in (*names, "processed/e.npz", "run/sensor.csv", "run/states.csv"):
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.touch()
    return tmp_path


def listed(folder, recursive=False):
    return [path.relative_to(folder).as_posix() for path in list_recordings(folder, recursive)]


def test_recordings_of_a_folder_are_files_and_probe_runs(folder):
    assert listed(folder) == ["a.CSV", "b.npz", "run"]
    assert listed(folder, recursive=True) == ["a.CSV", "b.npz", "in/d.npz", "run"]


def test_a_probe_run_is_one_recording(folder):
    assert list_recordings(folder / "run") == [folder / "run"]


def test_links_without_a_file_are_listed(folder):
    (folder / "z.npz").symlink_to(folder / "gone.npz")
    assert listed(folder)[-1] == "z.npz"  # the reader reports it


def test_the_suffixes_are_those_of_the_writer():
    with pytest.raises(ValueError, match=f"one of {', '.join(RECORDING_SUFFIXES)} "):
        write_recording(Recording([0.0], np.ones((1, 1, 1))), "a.xyz")
