import logging

import numpy as np
import pytest
from allegro_files import everything, write

from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.datasets import AllegroUSkin
from torch_geometric_tactile.io import write_recording

LABELS = ["light", "heavy", "hard", "soft", "non-slippery", "slippery"]


@pytest.fixture
def root(tmp_path):
    """Two objects with two trials of two frames."""
    for i, name in enumerate(("sponge_0", "sponge_1", "purse_0", "purse_1")):
        write(tmp_path / "raw" / f"{name}.npz", value=10.0 * i)
    return tmp_path


def test_folder_of_trials_is_a_root(tmp_path):
    write(tmp_path / "sponge_000.npz", synthetic=True)
    (tmp_path / "simulation.json").write_text("{}")
    (tmp_path / "notes.txt").write_text("dry")
    (tmp_path / ".sponge_001.npz").write_text("half")
    (tmp_path / "plots.csv").mkdir()
    dataset = everything(tmp_path)
    assert dataset.trial_names == ["sponge_000"]
    assert dataset.synthetic
    assert sorted(path.name for path in (tmp_path / "processed").iterdir()) == [
        "allegro_uskin.pt",
    ]
    assert not (tmp_path / "raw").exists()


def test_raw_goes_before_the_root(root):
    write(root / "plastic_tube_0.npz")
    assert len(everything(root)) == 8
    assert everything(root).group_names == ["sponge", "purse"]


@pytest.mark.parametrize("suffix", [".npz", ".csv", ".h5", ".hdf5"])
def test_formats(tmp_path, suffix):
    if "h" in suffix:
        pytest.importorskip("h5py")
    write(tmp_path / f"sponge_1{suffix}", value=3.0)
    data = everything(tmp_path).data
    assert data.x.shape == (2, 384, 3)
    assert data.x.eq(3.0).all()
    assert data.joint.shape == (2, 16)


def test_metadata_go_before_the_file_name(tmp_path):
    write(tmp_path / "run.npz", object="purse", trial=7)
    write(tmp_path / "sponge_7.npz", object="purse", trial=8)
    write(tmp_path / "big_cup_7.npz")
    dataset = everything(tmp_path)
    assert dataset.trial_names == ["big_cup_7", "run", "sponge_7"]
    assert dataset.group_names == ["purse", "big_cup"]
    assert dataset.column("group").tolist() == [1, 1, 0, 0, 0, 0]


@pytest.mark.parametrize(
    ("name", "meta"),
    [
        ("sponge", {}),
        ("sponge_a", {}),
        ("_1", {}),
        ("1", {"object": "cup"}),
        ("cup", {"trial": 1}),
        ("cup_1", {"object": 3}),
        ("cup_1", {"object": ""}),
        ("cup_1", {"trial": "first"}),
        ("cup_1", {"trial": True}),
    ],
)
def test_unreadable_name(tmp_path, name, meta):
    write(tmp_path / f"{name}.npz", **meta)
    message = rf"'.*{name}\.npz' must name its object and trial: .* or a file name <object>_<numb"
    with pytest.raises(ValueError, match=message):
        everything(tmp_path)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"taxels": 360}, r"sponge_9\.npz': .*must have 384 taxels \(got 360\)"),
        ({"channels": 1}, r"sponge_9\.npz' must have 3 channels per taxel \(got 1\)"),
        ({"joints": 0}, r"sponge_9\.npz' must have 16 joint angles .*'joint' \(got none\)"),
        ({"joints": 12}, r"sponge_9\.npz' must have 16 joint angles .*'joint' \(got 12\)"),
        ({"frames": 0}, r"sponge_9\.npz' must hold at least one frame \(got none\)"),
        ({"trial": 1}, r"trial 1 of 'sponge' must be in only one file .*_1\.npz' and .*_9\.npz'"),
        ({"labels": [1, 0, 1]}, r"_9\.npz' must have a 0 or 1 in 'labels' .*got \[1, 0, 1\]"),
        ({"labels": [2] + [0] * 5}, r"_9\.npz' must have a 0 or 1 in 'labels' .*got \[2, 0"),
        ({"labels": 1}, r"_9\.npz' must have a 0 or 1 in 'labels' .*got 1"),
        (
            {"phase": np.array([0, 2]), "phase_names": ["reach", "lift"]},
            r"_9\.npz' must hold one index into 'phase_names' per frame in 'phase', 0 to 1",
        ),
        (
            {"phase": np.array([0.0, 1.0]), "phase_names": ["reach", "lift"]},
            r"_9\.npz' must hold .* in 'phase', .* \(got float64 of shape \(2,\)\)",
        ),
    ],
)
def test_one_wrong_file(root, wrong, message):
    write(root / "raw" / "sponge_9.npz", **wrong)
    with pytest.raises(ValueError, match=message):
        AllegroUSkin(root)
    assert not list((root / "processed").iterdir())


def test_newtons_beside_files_that_name_no_unit(root):
    write(root / "raw" / "sponge_2.npz", unit="newton")
    with pytest.raises(ValueError, match=r"'count' in .*purse_0.*'newton' in .*sponge_2"):
        AllegroUSkin(root)


@pytest.mark.parametrize("labels", [[0, 1, 1, 0, 0, 1], [1, 0, 0, 1, 0, 1]])
def test_two_files_that_contradict_each_other_on_an_object(tmp_path, labels):
    write(tmp_path / "cup_0.npz", labels=[1, 0, 0, 1, 1, 0])
    write(tmp_path / "cup_1.npz", labels=labels)
    with pytest.raises(ValueError, match=r"'cup' must have the same labels .*cup_0\.npz'.*cup_1"):
        everything(tmp_path)


def test_labels_that_contradict_the_name_of_the_object(tmp_path):
    write(tmp_path / "sponge_0.npz")
    write(tmp_path / "sponge_1.npz", labels=[0, 1, 1, 0, 0, 1])
    with pytest.raises(ValueError, match=r"'sponge' must have the same labels .*_0.* and .*_1"):
        everything(tmp_path)


def test_object_that_is_light_and_heavy(tmp_path):
    write(tmp_path / "cup_0.npz", labels=[1, 1, 1, 0, 1, 0])
    with pytest.raises(ValueError, match=r"cup_0\.npz' must not be both 'light' and 'heavy'"):
        everything(tmp_path)


@pytest.mark.parametrize(
    ("meta", "message"),
    [
        ({"labels": [[1], 0, 1, 0, 1, 0]}, "must have a 0 or 1 in 'labels'"),
        ({"labels": [0.5, 0, 1, 0, 1, 0]}, "must have a 0 or 1 in 'labels'"),
        ({"labels": [1, 0], "label_names": 5}, "must have different texts in 'label_names'"),
        ({"labels": [1, 0], "label_names": ["a", "a"]}, "must have different texts in 'label_n"),
        ({"labels": [1, 0], "label_names": "ab"}, "must have different texts in 'label_names'"),
        (
            {"synthetic": "no"},
            r"must have true or false as 'synthetic' in its metadata \(got 'no'\)",
        ),
        (
            {"session": [1]},
            r"must have a text or an integer as 'session' in its metadata \(got \[1\]\)",
        ),
    ],
)
def test_metadata_of_another_kind(tmp_path, meta, message):
    write(tmp_path / "cup_0.npz", **meta)
    with pytest.raises(ValueError, match=rf"cup_0\.npz' .*{message}"):
        everything(tmp_path)


def test_link_to_a_recording_that_is_gone(root):
    (root / "raw" / "sponge_2.npz").symlink_to(root / "annex" / "sponge_2.npz")
    with pytest.raises(FileNotFoundError, match=r"sponge_2\.npz' is a link to a file that does"):
        everything(root)


@pytest.mark.parametrize("suffix", [".npz", ".h5"])
def test_cut_file(root, suffix):
    if suffix == ".h5":
        pytest.importorskip("h5py")
    path = root / "raw" / f"sponge_2{suffix}"
    write(path, frames=50)
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(ValueError, match=rf"sponge_2\{suffix}' .*truncated"):
        AllegroUSkin(root)


def test_missing_readings_stay_and_are_counted(root, caplog):
    tactile = np.ones((3, 384, 3))
    tactile[0, 5, 1] = tactile[2, 7] = np.nan
    path = root / "raw" / "cup_0.npz"
    write_recording(Recording([0.0, 0.1, 0.2], tactile, joint=np.zeros((3, 16))), path)
    with caplog.at_level(logging.WARNING):
        dataset = everything(root)
    assert f"2 of {11 * 384} readings of taxels are missing" in caplog.text
    assert dataset.num_missing == 2
    assert everything(root, stride=2).num_missing == 2
    assert dataset[:1].num_missing == dataset[:1].data.x.isnan().any(-1).sum() == 1
    assert dataset[3:].num_missing == 0
    assert dataset.data.x.isnan().sum() == 4


def test_labels_in_the_metadata_win(tmp_path):
    write(tmp_path / "purse_0.npz")
    write(tmp_path / "purse_1.npz", labels=[1, 0], label_names=["full", "empty"])
    write(tmp_path / "sponge_1.npz", labels=[0, 1, 1, 0, 0, 1])
    write(tmp_path / "sponge_2.npz", labels=[1, 0, 0, 1, 1, 0], label_names=LABELS[::-1])
    write(tmp_path / "cup_0.npz", labels=[True, False, True, False, True, False])
    dataset = everything(tmp_path, task="property", stride=2)
    assert dataset.column("y").tolist() == [
        [1, 0, 1, 0, 1, 0],
        [0, 1, 1, 0, 1, 0],
        [0, 1, 1, 0, 1, 0],
        [0, 1, 1, 0, 0, 1],
        [0, 1, 1, 0, 0, 1],
    ]
    assert dataset.property_names == LABELS


def test_property_task_with_an_unknown_object(root):
    write(root / "raw" / "cup_0.npz")
    dataset = everything(root)
    assert "property" not in dataset.data
    assert dataset.class_names == ["sponge", "purse", "cup"]
    with pytest.raises(ValueError, match=r"properties of \['cup'\] are unknown: write 0 or 1 for"):
        everything(root, task="property")
    with pytest.raises(ValueError, match=r"properties of \['cup'\] are unknown"):
        everything(root, task="property", force_reload=True)


def test_one_object_only_is_warned_of(tmp_path, caplog):
    write(tmp_path / "sponge_0.npz")
    with caplog.at_level(logging.WARNING):
        assert len(everything(tmp_path)) == 2
    assert "holds only one object, 'sponge'" in caplog.text
    assert "choose another target with task='property' or" in caplog.text


def test_object_with_one_trial_cannot_be_split_by_trial(root):
    write(root / "raw" / "cup_0.npz", frames=10)
    with pytest.raises(ValueError, match=r"object 'cup' must have at least 2 trials.*\(got 1\)"):
        AllegroUSkin(root)
    assert len(AllegroUSkin(root, split_by="frame")) == 12


def test_phases_of_files_that_name_them_differently(root):
    with pytest.raises(ValueError, match=r"'phases' must be None, since no recording in '.*has"):
        everything(root, phases=["lift"])
    write(root / "raw" / "purse_2.npz", phase=np.array([1, 0]), phase_names=["lift", "hold"])
    write(root / "raw" / "purse_3.npz", phase=np.array([1, 0]), phase_names=["reach", "lift"])
    dataset = everything(root)
    assert dataset.phase_names == ["lift", "hold", "reach"]
    assert dataset.column("phase").tolist() == [-1] * 4 + [1, 0, 0, 2] + [-1] * 4
    assert list(everything(root, phases=["lift"]).indices()) == [5, 6]
    with pytest.raises(ValueError, match=r"phases=\('reach',\) must leave at least one of 12 samp"):
        everything(root, phases=["reach"], stride=2)
