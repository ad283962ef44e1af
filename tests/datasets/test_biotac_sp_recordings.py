import numpy as np
import pytest
import torch
from torch_geometric.data import Data

from torch_geometric_tactile.data import Protocol, splits
from torch_geometric_tactile.datasets import BioTacSP
from torch_geometric_tactile.transforms import KNNGraph

COUNTS = {  # stable, slip: the table of the published README
    ("train", "down"): (667, 609),
    ("train", "side"): (603, 670),
    ("train", "45"): (1058, 1075),
    ("test", "down"): (153, 163),
    ("test", "side"): (157, 165),
    ("test", "45"): (250, 261),
}


@pytest.mark.parametrize(("split", "palm"), COUNTS)
def test_recordings_of_a_palm_pose(bts3_root, split, palm):
    data = BioTacSP(bts3_root, split=split, palm=palm).data
    assert tuple(data.y.bincount().tolist()) == COUNTS[split, palm]
    assert len(data.session.unique()) == 1


@pytest.mark.parametrize(
    ("split", "grasps", "stable", "objects"),
    [("train", 4682, 2328, 41), ("test", 1149, 560, 10), (None, 5831, 2888, 51)],
)
def test_recordings_of_a_split(bts3_root, split, grasps, stable, objects):
    dataset = BioTacSP(bts3_root, split=split)
    assert repr(dataset) == f"BioTacSP({grasps})"
    assert dataset.data.y.eq(0).sum() == stable
    assert len(dataset.data.group.unique()) == objects
    assert len(dataset.group_names) == 51
    assert dataset.num_classes == 2
    assert dataset.data.x.isfinite().all()


def test_recordings_of_train_and_test_share_no_object(bts3_root):
    train, test = (set(BioTacSP(bts3_root, split=s).data.group.tolist()) for s in ("train", "test"))
    assert not train & test


@pytest.mark.parametrize(
    ("split", "palm", "name"),
    [
        ("train", "down", "bts3v2_palm_down.csv"),
        ("train", "45", "bts3v2_palm_45.csv"),
        ("test", "side", "bts3v2_palm_side_test.csv"),
    ],
)
def test_recordings_hold_the_numbers_of_the_file(bts3_root, split, palm, name):
    lines = (bts3_root / "raw" / name).read_text().splitlines()
    dataset = BioTacSP(bts3_root, split=split, palm=palm)
    assert dataset.session_names[int(dataset[0].session)] == name[len("bts3v2_") : -len(".csv")]
    for i in (0, len(lines) - 2):
        cells = lines[i + 1].split(",")
        sample = dataset[i]
        assert dataset.group_names[int(sample.group)] == cells[0].strip()
        assert sample.y.item() == int(cells[1])
        by_finger = np.array(cells[2:], dtype=np.float32).reshape(3, 24)
        assert np.array_equal(sample.x.numpy(), by_finger.T)


def test_recordings_sample_is_plain_data(bts3_root):
    dataset = BioTacSP(bts3_root, transform=KNNGraph(k=2))
    sample = dataset[7]
    assert type(sample) is Data
    assert sample.x.shape == (24, 3)
    assert sample.pos.equal(dataset.layout.pos)
    assert sample.normal.equal(dataset.layout.normal)
    assert sample.edge_index.shape == (2, 62)
    assert "edge_index" not in dataset.data


def test_recordings_trials_are_numbered_through(bts3_root):
    trials = [BioTacSP(bts3_root, split=split).data.trial for split in ("train", "test")]
    assert torch.cat(trials).equal(torch.arange(5831))


def test_recordings_leave_one_object_out(bts3_root):
    dataset = BioTacSP(bts3_root, split="test")
    folds = list(splits.leave_one_group_out(dataset))
    assert len(folds) == 10
    assert sum(len(fold.test) for fold in folds) == 1149


def test_given_parts_are_the_published_splits(bts3_root):
    whole = BioTacSP(bts3_root, split=None)
    parts = Protocol("given").split(whole)
    assert len(parts.val) == 0
    for name, index in (("train", parts.train), ("test", parts.test)):
        published = BioTacSP(bts3_root, split=name).data
        assert whole.data.index_select(index).x.equal(published.x)
    side = BioTacSP(bts3_root, split=None, palm="side")
    assert Protocol("given").split(side).test.equal((side.data.session == 4).nonzero().view(-1))
