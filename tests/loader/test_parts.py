"""StaticLoader of parts of data sets, and of several in one."""

import re

import pytest
import torch
from torch.utils.data import ConcatDataset, DataLoader, Subset, random_split
from torch_geometric.loader import DataListLoader
from torch_geometric.loader import DataLoader as PyGLoader
from torch_geometric.transforms import Distance, RandomJitter

from torch_geometric_tactile.data import StaticData, StaticDataset
from torch_geometric_tactile.datasets import FakeTactileDataset
from torch_geometric_tactile.loader import StaticLoader
from torch_geometric_tactile.sensors import grid
from torch_geometric_tactile.transforms import KNNGraph, ZScore

LAYOUT = grid(2, 2, pitch=0.01)


def numbered(start, num_samples=4, **kwargs):
    """Samples whose `trial` and readings are their number."""
    trial = torch.arange(start, start + num_samples)
    x = trial.float().view(-1, 1, 1).expand(-1, 4, 2)
    return StaticDataset.from_arrays(x, trial % 2, layout=LAYOUT, trial=trial, **kwargs)


def trials(loader):
    return [batch.trial.tolist() for batch in loader]


def in_a_row(loader):
    return [trial for batch in trials(loader) for trial in batch]


def both():
    return ConcatDataset([numbered(0), numbered(4, 3)])


def nested():
    inner = ConcatDataset([numbered(0)[[3, 2, 1, 0]], Subset(numbered(4), [0, 3])])
    return Subset(ConcatDataset([inner, numbered(10, 1)]), [6, 0, 5, 1, 4])


PARTS = [
    (lambda: Subset(numbered(0), [3, 1, 2]), [3, 1, 2]),
    (lambda: Subset(Subset(numbered(0), [3, 1, 2]), [2, 0]), [2, 3]),
    (lambda: Subset(numbered(0)[[2, 3]], torch.tensor([1, 0])), [3, 2]),
    (both, [0, 1, 2, 3, 4, 5, 6]),
    (nested, [10, 3, 7, 2, 4]),
]


@pytest.mark.parametrize("workers", [0, 1])
@pytest.mark.parametrize(("make", "expected"), PARTS)
def test_loader_of_parts(make, expected, workers):
    dataset = make()
    loader = StaticLoader(dataset, batch_size=3, num_workers=workers)
    assert loader.dataset is dataset
    assert len(loader) == -(-len(expected) // 3)
    batches = list(loader)
    assert torch.cat([batch.trial for batch in batches]).tolist() == expected
    assert all(isinstance(batch, StaticData) for batch in batches)
    for batch in batches:
        assert batch.x[:, 3, 1].tolist() == batch.trial.tolist()
        assert batch.pos.shape == (4, 3)
        assert batch.edge_index.equal(LAYOUT.edge_index("original"))


@pytest.mark.parametrize(("make", "expected"), PARTS)
def test_loader_of_parts_yields_the_numbers_of_pyg(make, expected):
    for static, batch in zip(
        StaticLoader(make(), batch_size=2), PyGLoader(make(), batch_size=2), strict=True
    ):
        assert static.x.flatten(0, 1).equal(batch.x)
        assert static.y.equal(batch.y)


def test_loader_of_random_split_parts():
    dataset = numbered(0, 10)
    generator = torch.Generator().manual_seed(0)
    parts = random_split(dataset, [0.7, 0.3], generator=generator)
    found = [sorted(in_a_row(StaticLoader(part, 4, shuffle=True))) for part in parts]
    assert [len(part) for part in found] == [7, 3]
    assert sorted(found[0] + found[1]) == list(range(10))


def test_loader_of_the_sum_of_two():
    assert trials(StaticLoader(numbered(0, 2) + numbered(2, 2), batch_size=3)) == [[0, 1, 2], [3]]


@pytest.mark.parametrize("make", [lambda: numbered(0), both, nested])
def test_loader_exposes_its_dataset(make):
    dataset = make()
    assert StaticLoader(dataset).dataset is dataset
    assert StaticLoader(dataset, batch_size=None).dataset is dataset


@pytest.mark.parametrize("make", [lambda: numbered(0), both])
def test_loader_without_batch_size(make):
    assert trials(StaticLoader(make(), batch_size=None))[:3] == [[0], [1], [2]]
    loader = StaticLoader(make(), batch_size=None, sampler=[[2, 0], [3]])
    assert trials(loader) == [[2, 0], [3]]


def test_loader_of_several_with_a_batch_sampler():
    loader = StaticLoader(both(), batch_sampler=[[5, 0], [], [-1]])
    assert [batch.x.shape for batch in loader] == [(2, 4, 2), (0, 4, 2), (1, 4, 2)]
    assert trials(loader) == [[4 + 1, 0], [], [6]]


def test_loader_of_several_keeps_its_workers():
    loader = StaticLoader(both(), 4, num_workers=1, persistent_workers=True)
    assert trials(loader) == trials(loader) == [[0, 1, 2, 3], [4, 5, 6]]
    assert loader.dataset is not None


def test_transforms_of_each_part():
    def shift(data):
        data.x = data.x + 100
        return data

    dataset = ConcatDataset([numbered(0, 2), numbered(2, 2, transform=shift)])
    (batch,) = StaticLoader(dataset, batch_sampler=[[3, 0, 2, 1]])
    assert batch.x[:, 0, 0].tolist() == [103, 0, 102, 1]


def test_positions_of_parts_that_differ_become_the_samples_own():
    moved = numbered(4, 3)
    moved._data.pos = moved._data.pos + 1
    (batch,) = StaticLoader(ConcatDataset([numbered(0), moved]), batch_sampler=[[4, 0]])
    assert batch.pos.shape == (2, 4, 3)
    assert batch.pos[0].equal(batch.pos[1] + 1)
    assert batch.trial.tolist() == [4, 0]


def test_random_transform_of_several():
    dataset = ConcatDataset([numbered(0), numbered(4, 3, transform=RandomJitter(0.001))])
    (batch,) = StaticLoader(dataset, batch_sampler=[[0, 5, 6]])
    assert batch.pos.shape == (3, 4, 3)
    assert batch.pos[0].equal(LAYOUT.pos)
    assert not batch.pos[1].equal(batch.pos[2])


def other_layout():
    x = torch.zeros(2, 4, 2)
    return StaticDataset.from_arrays(x, layout=grid(1, 4, pitch=0.01), trial=torch.zeros(2))


@pytest.mark.parametrize(
    ("other", "match"),
    [
        (
            other_layout,
            r"must have the layout of part 0, 'grid_2x2' \(got 'grid_1x4'.* in part 1\)",
        ),
        (lambda: numbered(4, transform=KNNGraph(k=3)), r"must have the same edges .* in part 1"),
        (lambda: numbered(4, transform=Distance()), r"same attributes \(got \['edge_attr'\]"),
        (lambda: numbered(4, force=torch.zeros(4)), r"same attributes \(got \['force'\]"),
    ],
)
def test_parts_that_cannot_be_joined(other, match):
    with pytest.raises(ValueError, match=match):
        StaticLoader(ConcatDataset([numbered(0), other()]))


@pytest.mark.parametrize(
    ("ours", "theirs"),
    [
        ({"y": ["cube", "ball"]}, {"y": ["cup", "ball"]}),
        (
            {"y": [0, 1], "class_names": ["hold", "slip"]},
            {"y": [0, 1], "class_names": ["slip", "hold"]},
        ),
        ({"group": ["a", "b"]}, {"group": ["b", "c"]}),
        ({"session": ["a", "b"]}, {"session": [0, 1]}),
    ],
)
def test_parts_whose_names_differ(ours, theirs):
    x = torch.zeros(2, 4, 1)
    first, other = (
        StaticDataset.from_arrays(x, layout=LAYOUT, **columns) for columns in (ours, theirs)
    )
    both = ConcatDataset([first, first[:0], Subset(other, [0])])
    key = next(iter(ours))
    names = {"y": "class_names", "group": "group_names", "session": "session_names"}[key]
    lists = [re.escape(str(getattr(part, names))) for part in (first, other)]
    match = rf"part 2 .* must have the {names} of the first, {lists[0]}, .* \(got {lists[1]}\)"
    with pytest.raises(ValueError, match=match):
        StaticLoader(both)
    with pytest.raises(ValueError, match=match):
        ZScore().fit(both)

    def without(data):
        del data[key]
        return data

    first.transform = other.transform = without  # then nothing can be mixed
    assert len(list(StaticLoader(both))) == 3


def test_parts_whose_empty_one_has_other_names():
    named = StaticDataset.from_arrays(torch.zeros(2, 4, 1), ["b", "a"], layout=LAYOUT)
    other = StaticDataset.from_arrays(torch.zeros(2, 4, 1), ["c", "a"], layout=LAYOUT)
    (batch,) = StaticLoader(ConcatDataset([other[:0], named, named]), 4)
    assert batch.y.tolist() == [1, 0, 1, 0]


def test_parts_whose_shared_value_differs():
    parts = [numbered(i, gain=torch.tensor([1.0 + i]), shared=["gain"]) for i in (0, 4)]
    loader = StaticLoader(ConcatDataset(parts), batch_size=8)
    with pytest.raises(ValueError, match="'gain' must be equal in all batches"):
        next(iter(loader))


def test_parts_with_other_channels():
    x = torch.zeros(2, 4, 5)
    other = StaticDataset.from_arrays(x, torch.zeros(2), layout=LAYOUT, trial=torch.zeros(2))
    loader = StaticLoader(ConcatDataset([numbered(0), other]), batch_size=8)
    with pytest.raises(ValueError, match=r"'x' must have one type and shape in all batches"):
        next(iter(loader))


@pytest.mark.parametrize("wrap", [list, lambda part: Subset(part, [0])])
def test_parts_of_other_kinds(wrap):
    dataset = ConcatDataset([numbered(0), wrap(list(numbered(0)))])
    with pytest.raises(TypeError, match=r"must be a StaticDataset, or .* \(got list\); use"):
        StaticLoader(dataset)


@pytest.mark.parametrize("key", ["follow_batch", "exclude_keys"])
def test_loader_refuses_arguments_of_pygs_loader(key):
    with pytest.raises(TypeError, match=rf"takes no '{key}' \(got \['x'\]\): "):
        StaticLoader(numbered(0), **{key: ["x"]})
    assert len(StaticLoader(numbered(0), **{key: None})) == 4  # as PyG's default


def test_loader_refuses_a_collate_fn():
    with pytest.raises(TypeError, match=r"takes no 'collate_fn', since it slices"):
        StaticLoader(numbered(0), collate_fn=list)
    loader = StaticLoader(numbered(0), 2)
    assert trials(StaticLoader(numbered(0), 2, collate_fn=loader.collate_fn)) == trials(loader)


@pytest.mark.parametrize("make", [lambda: numbered(0, transform=Distance()), both, nested])
def test_collate_fn_of_the_loader_in_another_loader(make):
    # As other training libraries do.
    loader = StaticLoader(make(), batch_size=3)
    again = DataLoader(loader.dataset, 3, collate_fn=loader.collate_fn)
    single = DataLoader(loader.dataset, batch_size=None, collate_fn=loader.collate_fn)
    assert trials(again) == trials(loader)
    assert in_a_row(single) == in_a_row(loader)
    for one, other in zip(loader, again, strict=True):
        assert set(one.keys()) == set(other.keys())
        assert one.x.equal(other.x)
        assert one.pos.equal(other.pos)


@pytest.mark.parametrize("workers", [0, 1])
def test_pygs_loader_gets_data_objects(workers):
    dataset = FakeTactileDataset(10, transform=KNNGraph(k=2))
    loader = PyGLoader(dataset, 4, num_workers=workers, follow_batch=["y"], exclude_keys=["pos"])
    batches = list(loader)
    assert [batch.num_graphs for batch in batches] == [4, 4, 2]
    assert batches[0].y_batch.tolist() == [0, 1, 2, 3]
    assert "pos" not in batches[0]
    assert batches[0][1].x.equal(dataset[1].x)


@pytest.mark.parametrize("make", [lambda: numbered(0), both, nested])
def test_pygs_loader_of_lists_gives_lists_with_any_number_of_workers(make):
    found = [list(DataListLoader(make(), 3, num_workers=workers)) for workers in (0, 2)]
    for one, other in zip(*found, strict=True):
        assert type(one) is type(other) is list
        assert [data.trial.tolist() for data in one] == [data.trial.tolist() for data in other]


def test_pygs_loader_applies_a_random_transform_once_to_each():
    dataset = FakeTactileDataset(5, transform=RandomJitter(0.001))
    torch.manual_seed(0)
    (batch,) = PyGLoader(dataset, batch_size=5)
    torch.manual_seed(0)
    torch.empty((), dtype=torch.int64).random_()  # the seed that the loader draws
    assert batch.pos.equal(torch.cat([data.pos for data in dataset]))


def test_samples_in_a_plain_loader_of_workers():
    loader = DataLoader(numbered(0, 4), 2, collate_fn=_as_they_are, num_workers=1)
    (first, _) = loader
    assert [type(part) for part in first] == [type(numbered(0)[0])] * 2


def _as_they_are(samples):
    assert len(samples) == 2
    assert samples[-1].trial.item() == samples[0:2][1].trial.item()
    return samples
