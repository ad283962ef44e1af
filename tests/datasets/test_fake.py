import warnings

import pytest
import torch
from torch_geometric.data import Data

from torch_geometric_tactile.data import Protocol
from torch_geometric_tactile.datasets import FakeTactileDataset
from torch_geometric_tactile.sensors import biotac, grid
from torch_geometric_tactile.transforms import KNNGraph


def test_fake_repr_and_sample():
    dataset = FakeTactileDataset(num_samples=20)
    assert repr(dataset) == "FakeTactileDataset(20)"
    assert (len(dataset), len(FakeTactileDataset())) == (20, 1000)
    assert type(dataset[0]) is Data
    assert dataset[0].x.shape == (24, 3)
    assert dataset[0].pos.equal(dataset.layout.pos)
    assert dataset.class_names == ["stable", "slip"]
    assert dataset.num_classes == 2
    assert dataset.data.trial.tolist() == list(range(20))


def test_fake_is_deterministic_by_seed():
    first, again, other = (FakeTactileDataset(50, seed=seed).data for seed in (3, 3, 4))
    for key in first.keys():  # noqa: SIM118
        assert first[key].equal(again[key])
    assert not first.x.equal(other.x)


@pytest.mark.parametrize("split", ["train", "test"])
def test_fake_has_both_classes(split):
    assert 0.3 < FakeTactileDataset(1000, split=split).data.y.float().mean() < 0.7


@pytest.mark.parametrize(("train_size", "test_size"), [(100, 100), (100, 5), (3, 100)])
def test_fake_test_split_has_other_groups_and_sessions(train_size, test_size):
    train = FakeTactileDataset(train_size)
    test = FakeTactileDataset(test_size, split="test")
    for key, names in (("group", "group_names"), ("session", "session_names")):
        numbers = [set(dataset.data[key].tolist()) for dataset in (train, test)]
        assert not numbers[0] & numbers[1]
        assert getattr(train, names) == getattr(test, names)
        assert max(numbers[0] | numbers[1]) < len(getattr(train, names))


def test_fake_all_is_train_and_test():
    whole, train, test = (FakeTactileDataset(30, split) for split in (None, "train", "test"))
    parts = Protocol("given").split(whole)
    assert [len(part) for part in parts] == [30, 0, 30]
    assert Protocol("given").split(whole[20:40]).test.tolist() == list(range(10, 20))
    for key in ("x", "y", "group", "session"):
        assert whole.data[key][parts.train].equal(train.data[key])
        assert whole.data[key][parts.test].equal(test.data[key])
    assert whole.data.trial.tolist() == list(range(60))


def test_fake_splits_and_seeds_share_no_reading():
    readings = [
        FakeTactileDataset(30, split=split, seed=seed).data.x
        for seed in (0, 1)
        for split in ("train", "test")
    ]
    for i, a in enumerate(readings):
        assert not any(a.equal(b) for b in readings[:i])


def test_fake_rounds_up_to_the_same_number_for_every_object():
    dataset = FakeTactileDataset(num_samples=7, num_objects=3)
    assert dataset.data.group.bincount().tolist() == [3, 3, 3]
    assert len(FakeTactileDataset(num_samples=3, num_objects=10)) == 3


def test_fake_single_sample_finger_and_taxel():
    dataset = FakeTactileDataset(1, layout=grid(1, 1, pitch=0.01), num_objects=1, num_fingers=1)
    assert dataset[0].x.shape == (1, 1)
    assert len(dataset) == 1


def test_fake_takes_layout_and_transforms():
    dataset = FakeTactileDataset(
        10,
        layout=biotac(),
        num_fingers=2,
        pre_transform=KNNGraph(k=2),
        transform=lambda data: data.update({"x": -data.x}),
        pre_filter=lambda data: int(data.session) == 1,
    )
    assert dataset[0].x.shape == (19, 2)
    assert dataset[0].x.lt(0).all()
    assert dataset[0].edge_index.size(1) > 0
    assert dataset.data.session.eq(1).all()
    assert torch.equal(dataset.batch([0]).x[0], dataset[0].x)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"split": "val"}, r"'split' must be 'train', 'test' or None \(got 'val'\)"),
        ({"num_samples": 0}, r"'num_samples' must be at least 1 \(got 0\)"),
        ({"num_objects": 0}, r"'num_objects' must be at least 1 \(got 0\)"),
        ({"num_fingers": 0}, r"'num_fingers' must be at least 1 \(got 0\)"),
    ],
)
def test_fake_rejects(arguments, message):
    with pytest.raises(ValueError, match=message):
        FakeTactileDataset(**arguments)


def test_all_samples_are_split_none_and_all_is_accepted_for_a_release():
    with pytest.warns(DeprecationWarning, match=r"split='all' is now split=None") as caught:
        dataset = FakeTactileDataset(30, "all")
    assert caught[0].filename == __file__
    assert dataset.split is None
    assert dataset.x.equal(FakeTactileDataset(30, None).x)


def test_given_parts_of_one_part_are_told():
    train = FakeTactileDataset(30)
    with pytest.warns(UserWarning, match=r"holds only its part 'train'.*split=None"):
        split = Protocol("given").split(train)
    assert not len(split.test)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Protocol("given").split(FakeTactileDataset(30, None))
        Protocol("group").split(train)
