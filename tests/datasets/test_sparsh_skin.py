import numpy as np
import pytest
import torch
from published_files import pickled, sparsh_episode, sparsh_joints, sparsh_skin, sparsh_touch
from torch_geometric.transforms import Compose

from torch_geometric_tactile.data import Protocol, Trials
from torch_geometric_tactile.datasets import SparshSkin
from torch_geometric_tactile.io import read_sparsh_skin
from torch_geometric_tactile.transforms import GeometricEdgeAttr, TaxelPose


@pytest.mark.parametrize(
    "inner",
    ["pretraining", "raw/pretraining", "xela/pretraining/extracted", "raw", "."],
)
def test_episodes_by_hand(tmp_path, inner):
    folder = sparsh_skin(tmp_path / inner, episodes=11)
    (folder / "urdf" / "0").mkdir(parents=True)  # no touch
    sparsh_episode(folder / "mug" / "notes")  # no number
    dataset = SparshSkin(tmp_path)
    assert repr(dataset) == "SparshSkin(66)"
    assert dataset.class_names == dataset.group_names == ["corn", "cup"]
    assert dataset.trial_names == [f"{name}/{i}" for name in ("corn", "cup") for i in range(11)]
    assert torch.equal(dataset.y, dataset.group)
    assert dataset.trial.bincount().tolist() == 22 * [3]
    assert dataset.y.bincount().tolist() == [33, 33]
    # Frames 0, 10 and 20 of 30, above the mean of the frames 0, 1 and 2 at rest.
    assert dataset.time[:3].tolist() == pytest.approx([0, 0.1, 0.2])
    assert dataset.x[:3].view(3, -1).unique(dim=1).flatten().tolist() == [99, 109, 119]
    assert dataset.x[33].unique().tolist() == [-1]  # the cup
    sample = dataset[1]
    assert sample.joint[0] == pytest.approx(0.1 + 0.01 * np.arange(16), abs=1e-6)
    assert sample.edge_index.shape == (2, 1272)


def test_all_frames_in_counts_are_those_of_the_reader(tmp_path):
    folder = sparsh_skin(tmp_path, episodes=1)
    dataset = SparshSkin(tmp_path, rate=None, tare=None)
    recording = read_sparsh_skin(folder / "corn" / "0")
    assert len(dataset) == 60
    assert np.array_equal(dataset.x[:30], recording.tactile)
    assert np.array_equal(dataset.joint[:30], recording.joint)
    assert Trials(dataset)[0].x.shape == (368, 90)


def test_settings_have_files_of_their_own(tmp_path):
    sparsh_skin(tmp_path, episodes=1)
    assert len(SparshSkin(tmp_path, rate=20.0)) == 12
    dense = SparshSkin(tmp_path, adjacency="dense")
    assert dense[0].edge_index.shape == (2, 2376)
    SparshSkin(tmp_path, tare=None)
    names = {path.name for path in (tmp_path / "processed").glob("*.pt")}
    assert names >= {
        "sparsh_skin_20_baseline_original.pt",
        "sparsh_skin_10_baseline_dense.pt",
        "sparsh_skin_10_counts_original.pt",
    }


def test_taxels_are_placed_by_the_joints(tmp_path):
    sparsh_skin(tmp_path)
    transform = Compose([TaxelPose("allegro_uskin_368"), GeometricEdgeAttr()])
    dataset = SparshSkin(tmp_path, transform=transform)
    sample, batch = dataset[1], dataset.batch([0, 1])
    assert sample.pos.shape == (368, 3)
    assert sample.edge_attr.shape == (1272, 4)
    torch.testing.assert_close(batch.pos[1], sample.pos)
    assert not torch.equal(batch.pos[0], batch.pos[1])  # the joints have moved


def test_episodes_are_held_out_object_by_object(tmp_path):
    dataset = SparshSkin(sparsh_skin(tmp_path))
    protocol = Protocol("trial", val=0.1, test=0.2, stratify="group")
    parts = protocol.split(dataset)
    trials = [set(dataset.trial[part].tolist()) for part in parts]
    assert sorted(map(len, trials)) == [2, 2, 4]
    assert len(set.union(*trials)) == 8


@pytest.mark.parametrize(
    ("settings", "match"),
    [
        ({"tare": "hover"}, r"'tare' must be 'baseline' or None \(got 'hover'\)"),
        ({"tare": 0.5}, r"'tare' must be 'baseline' or None \(got 0.5\)"),
        ({"rate": 0}, r"'rate' must be a number of frames per second above 0, or None \(got 0\)"),
        ({"adjacency": "own"}, r"'sparse', 'slanted', 'original', 'dense' \(got 'own'\)"),
    ],
)
def test_unknown_settings(tmp_path, settings, match):
    with pytest.raises(ValueError, match=match):
        SparshSkin(tmp_path, **settings)


def test_missing_baseline_is_named_with_the_next_step(tmp_path):
    folder = sparsh_skin(tmp_path / "pretraining", episodes=1)
    (folder / "baseline" / "xela" / "data.pkl").unlink()
    with pytest.raises(
        FileNotFoundError, match=r"(?s)baseline/xela/data.pkl' does.*or pass 'tare="
    ):
        SparshSkin(tmp_path)
    assert len(SparshSkin(tmp_path, tare=None)) == 6


def test_an_episode_that_lacks_its_joints_is_named_and_nothing_is_kept(tmp_path):
    folder = sparsh_skin(tmp_path)
    (folder / "cup" / "2" / "allegro" / "data.pkl").unlink()
    with pytest.raises(FileNotFoundError, match=r"cup/2/allegro/data.pkl' does not exist"):
        SparshSkin(tmp_path)
    assert not list((tmp_path / "processed").glob("*.pt"))


@pytest.mark.parametrize("name", ["cup/0/xela", "baseline/xela"])
def test_anew_when_a_file_changes(tmp_path, name):
    folder = sparsh_skin(tmp_path, episodes=1)
    before = SparshSkin(tmp_path).x
    pickled(folder / name / "data.pkl", sparsh_touch(30, base=20000.0))
    assert not torch.equal(SparshSkin(tmp_path).x, before)


def test_frames_beyond_the_joints_are_no_samples(tmp_path):
    folder = sparsh_skin(tmp_path, objects=("cup",), episodes=1)
    sparsh_episode(folder / "cup" / "0", sparsh_touch(30), sparsh_joints(5, start=0.1))
    assert SparshSkin(tmp_path).time.tolist() == pytest.approx([0.1])
