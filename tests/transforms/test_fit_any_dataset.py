"""Fitting on any PyG data set."""

import pytest
import torch
from torch.utils.data import ConcatDataset, Subset
from torch_geometric.data import Batch, Data, InMemoryDataset
from torch_geometric.loader import DataLoader
from torch_geometric.transforms import BaseTransform, Compose

from torch_geometric_tactile.data import StaticDataset
from torch_geometric_tactile.sensors import grid
from torch_geometric_tactile.transforms import (
    FillMissing,
    Normalize,
    SessionZScore,
    Tare,
    ZScore,
    _samples,
    fit_parts,
    fit_transform,
)
from torch_geometric_tactile.transforms.fitting import fitted_parts

LAYOUT = grid(2, 3, pitch=0.01)
NUM_SAMPLES = 40


def static(transform=None):
    draw = torch.Generator().manual_seed(0)
    return StaticDataset.from_arrays(
        torch.randn(NUM_SAMPLES, 6, 2, generator=draw) * 3 + 5,
        torch.arange(NUM_SAMPLES) % 2,
        layout=LAYOUT,
        session=torch.arange(NUM_SAMPLES) // 10,
        time=0.1 * (torch.arange(NUM_SAMPLES) % 10).double(),
        joint=torch.rand(NUM_SAMPLES, 4, generator=draw),
        edge_attr=torch.rand(NUM_SAMPLES, LAYOUT.edge_index("original").size(1), 2, generator=draw),
        transform=transform,
    )


class Listed(InMemoryDataset):
    """The same samples in PyG's form."""

    def __init__(self, transform=None):
        super().__init__(None, transform)
        self.data, self.slices = self.collate(list(static()))


class Spoil(BaseTransform):
    def forward(self, data):
        raise AssertionError("the transform of the data set must be left out")


def halves(dataset):
    return ConcatDataset([dataset[:15], dataset[15:]])


SOURCES = {
    "StaticDataset": lambda: static(Spoil()),
    "StaticData": lambda: static().data,
    "list": lambda: list(static()),
    "tuple": lambda: tuple(static()),
    "Batch": lambda: Batch.from_data_list(list(static())),
    "InMemoryDataset": lambda: Listed(Spoil()),
    "selection": lambda: Listed(Spoil())[:NUM_SAMPLES],
    "Subset": lambda: Subset(static(Spoil()), range(NUM_SAMPLES)),
    "Subset of a list": lambda: Subset(list(static()), range(NUM_SAMPLES)),
    "Subset of PyG's": lambda: Subset(Listed(Spoil()), range(NUM_SAMPLES)),
    "ConcatDataset": lambda: halves(static(Spoil())),
    "ConcatDataset of PyG's": lambda: halves(Listed(Spoil())),
    "mixed": lambda: ConcatDataset([static(Spoil())[:15], Listed(Spoil())[15:]]),
    "nested": lambda: Subset(halves(static(Spoil())), range(NUM_SAMPLES)),
}


def transforms():
    return [
        ZScore(),
        Normalize(),
        SessionZScore(),
        ZScore("joint"),
        ZScore("edge_attr"),
        SessionZScore(attr="edge_attr"),
        Tare(),
        Tare(first=3),
        Tare(seconds=0.25),
        Compose([FillMissing(), Tare(seconds=0.25), ZScore()]),
    ]


def states(transform):
    return [part.state_dict() for part in fitted_parts(transform)]


def assert_same(found, expected):
    assert len(found) == len(expected) > 0
    for one, other in zip(found, expected, strict=True):
        for key, value in one.items():
            torch.testing.assert_close(value, other[key], rtol=1e-5, atol=1e-7)


@pytest.fixture(params=[2**22, 2**10], ids=["at once", "in chunks"])
def chunked(request, monkeypatch):
    monkeypatch.setattr(_samples, "_CHUNK_BYTES", request.param)


@pytest.mark.parametrize("source", SOURCES)
def test_fit_on_any_dataset(source, chunked):
    for found, expected in zip(transforms(), transforms(), strict=True):
        fit_parts(expected, static())
        fit_parts(found, SOURCES[source]())
        assert_same(states(found), states(expected))


@pytest.mark.parametrize("source", SOURCES)
def test_adapt_and_fit_transform_on_any_dataset(source):
    transform = Compose([SessionZScore(), ZScore()])
    fit_parts(transform, static()[:20])
    expected = fit_transform(transform, static(), adapt=True)
    again = Compose([SessionZScore(), ZScore()])
    fit_parts(again, static()[:20])
    found = fit_transform(again, SOURCES[source](), adapt=True)
    assert again.transforms[0].key_values.tolist() == [0, 1, 2, 3]
    torch.testing.assert_close(found.x, expected.x)


def test_fit_is_applied_to_data_objects():
    score = ZScore().fit(Listed())
    assert torch.allclose(score(Listed()[3]).x, score(static()[3]).x)


def ragged():
    """Two samples of the same taxels with other edges, as of a hand that closes."""
    edges = [torch.tensor([[0], [1]]), torch.tensor([[0, 1], [1, 2]])]
    x = torch.tensor([[1.0, 2, 3], [3, 6, 9]]).view(2, 3, 1)
    return [Data(x=x[i], edge_index=edges[i], session=torch.tensor([i])) for i in range(2)]


def test_fit_reads_only_what_it_needs():
    assert ZScore().fit(ragged()).center.view(-1).tolist() == [2, 4, 6]
    assert SessionZScore().fit(ragged()).center.view(2, 3).tolist() == [[1, 2, 3], [3, 6, 9]]
    with pytest.raises(ValueError, match="must have the same 'edge_index'"):
        ZScore().fit(ragged(), before=FillMissing())


def test_fit_on_positions_that_the_first_samples_share():
    # Five samples at one place, then five at another.
    pos = [torch.full((3, 3), float(i // 5)) for i in range(10)]
    data = [Data(x=torch.zeros(3, 1), pos=value) for value in pos]
    for source in (data, ConcatDataset([data[:5], data[5:]])):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(_samples, "_CHUNK_BYTES", 48)
            score = ZScore("pos").fit(source)
        assert score.center.unique().tolist() == [0.5]
        assert score.scale.unique().tolist() == [0.5]


@pytest.mark.parametrize("source", [DataLoader(list(static())), "text", None, 3, {}])
def test_fit_on_something_else(source):
    kind = type(source).__name__
    with pytest.raises(TypeError, match=rf"'data' must be a PyG data set, .* \(got {kind}\)"):
        ZScore().fit(source)


@pytest.mark.parametrize("source", [[], Listed()[:0], Subset(static(), []), ConcatDataset([[]])])
def test_fit_on_nothing(source):
    with pytest.raises(ValueError, match=r"ZScore must be fitted on samples \(got none\)"):
        ZScore().fit(source)
