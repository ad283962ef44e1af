import pytest
import torch
from torch.utils.data import ConcatDataset, SequentialSampler, Subset
from torch_geometric import EdgeIndex
from torch_geometric.data import Data
from torch_geometric.loader import DataLoader
from torch_geometric.transforms import Compose, Distance, ToUndirected

from torch_geometric_tactile.data import StaticData, StaticDataset
from torch_geometric_tactile.datasets import BioTacSP, FakeTactileDataset
from torch_geometric_tactile.loader import StaticLoader
from torch_geometric_tactile.sensors import grid
from torch_geometric_tactile.transforms import KNNGraph, SessionZScore


def halve(data):
    data = data.clone()
    data.x = data.x / 2
    return data


class EdgesOnly(StaticDataset):
    """Samples of three taxels."""

    def __init__(self, samples, root=None, transform=None):
        self.samples, self.layout = samples, grid(1, 3, pitch=0.01)
        super().__init__(root, transform)

    def read(self):
        return StaticData.from_data_list(self.samples), {}


def _name(transform):
    return getattr(transform, "__name__", repr(transform))


def transforms():
    zscore = SessionZScore().fit(FakeTactileDataset(num_samples=10))
    return [None, KNNGraph(k=2), halve, Distance(), zscore, Compose([zscore, ToUndirected()])]


def assert_same(static, batch):
    size, taxels = static.x.shape[:2]
    assert isinstance(static, StaticData)
    assert batch.num_graphs == size
    assert torch.allclose(static.x.view(size * taxels, -1), batch.x, atol=1e-5)
    for key in ("y", "trial", "group", "session"):
        assert static[key].equal(batch[key])
    start = torch.arange(size) * taxels
    edges = (static.edge_index[:, None] + start[None, :, None]).reshape(2, -1)
    assert edges.equal(batch.edge_index)
    assert static.pos.repeat(size, 1).equal(batch.pos)
    if "edge_attr" in batch:
        assert torch.allclose(static.edge_attr.repeat(size, 1), batch.edge_attr, atol=1e-5)


@pytest.mark.parametrize("transform", transforms(), ids=_name)
def test_loader_yields_the_batches_of_pyg(transform):
    dataset = FakeTactileDataset(10, pre_transform=KNNGraph(k=3), transform=transform)
    static = list(StaticLoader(dataset, batch_size=4))
    pyg = list(DataLoader(dataset, batch_size=4))
    assert [batch.num_samples for batch in static] == [4, 4, 2]
    for a, b in zip(static, pyg, strict=True):
        assert_same(a, b)


def test_loader_of_a_selection(toy):
    part = toy()[[4, 0, 3]]
    assert [batch.trial.tolist() for batch in StaticLoader(part, batch_size=2)] == [[2, 0], [1]]
    assert next(iter(StaticLoader(part, batch_size=1))).x.equal(part[0].x[None])


def test_loader_shuffle_is_deterministic_by_generator():
    dataset = FakeTactileDataset(num_samples=20)

    def order(seed):
        generator = torch.Generator().manual_seed(seed)
        loader = StaticLoader(dataset, batch_size=6, shuffle=True, generator=generator)
        return torch.cat([batch.trial for batch in loader]).tolist()

    assert order(1) == order(1) != order(2)
    assert sorted(order(1)) == list(range(20))


def test_loader_shuffle_is_that_of_pyg():
    dataset = FakeTactileDataset(num_samples=10)
    orders = [
        [
            b.trial.tolist()
            for b in kind(dataset, 4, True, generator=torch.Generator().manual_seed(0))
        ]
        for kind in (StaticLoader, DataLoader)
    ]
    assert orders[0] == orders[1]


@pytest.mark.parametrize(("size", "sizes"), [(10, [4, 4]), (8, [4, 4]), (3, []), (0, [])])
def test_loader_drop_last(size, sizes):
    dataset = FakeTactileDataset(num_samples=10)[:size]
    loader = StaticLoader(dataset, batch_size=4, drop_last=True)
    assert [batch.num_samples for batch in loader] == sizes
    assert len(loader) == len(sizes)


def test_loader_without_samples(toy):
    loader = StaticLoader(toy(transform=halve)[:0], batch_size=4)
    assert len(loader) == 0
    assert list(loader) == []


def test_loader_of_a_sampler_with_an_empty_last_batch(toy):
    loader = StaticLoader(toy(transform=halve), batch_sampler=[[0, 5], []])
    assert [batch.x.shape for batch in loader] == [(2, 4, 2), (0, 4, 2)]


def test_loader_without_batch_size_yields_one_sample_each(toy):
    batches = list(StaticLoader(toy(), batch_size=None))
    assert [batch.x.shape for batch in batches] == [(1, 4, 2)] * 6


@pytest.mark.parametrize(
    ("context", "workers"), [("fork", 2), pytest.param("spawn", 1, marks=pytest.mark.full)]
)
def test_loader_with_workers(write_bts3, tmp_path, context, workers):
    write_bts3(tmp_path / "raw")
    dataset = BioTacSP(tmp_path, pre_transform=KNNGraph(k=2), checksum=False)[3:]
    loader = StaticLoader(dataset, 8, num_workers=workers, multiprocessing_context=context)
    batches = [(batch.x.clone(), batch.edge_index.clone()) for batch in loader]
    assert torch.cat([x for x, _ in batches]).equal(dataset.data.x)
    assert all(edges.equal(dataset.data.edge_index) for _, edges in batches)


def test_loader_built_again_from_its_attributes(toy):
    loader = StaticLoader(toy(), batch_size=4)
    again = StaticLoader(
        loader.dataset,
        batch_size=2,
        sampler=SequentialSampler(loader.dataset),
        collate_fn=loader.collate_fn,
    )
    assert [batch.num_samples for batch in again] == [2, 2, 2]


def test_loader_leaves_the_dataset_alone(toy):
    dataset = toy(transform=halve)
    for batch in StaticLoader(dataset, batch_size=6):
        batch.x += 1
    assert dataset.data.x.equal(torch.arange(48.0).view(6, 4, 2))


@pytest.mark.parametrize("dataset", [[], torch.zeros(3), StaticData(x=torch.zeros(1, 1, 1))])
def test_loader_rejects_other_datasets(dataset):
    kind = type(dataset).__name__
    with pytest.raises(
        TypeError, match=rf"must be a StaticDataset, or .* \(got {kind}\); use torch_geom"
    ):
        StaticLoader(dataset)


@pytest.mark.parametrize("num_workers", [0, 2])
@pytest.mark.parametrize("sort_order", [None, "row", "col"])
def test_edges_of_samples_without_any_other_attribute(num_workers, sort_order):
    # The case of PyG's own test of its loader: a sample is its edges, in an EdgeIndex.
    rows = [[1, 0, 2, 1], [0, 1, 1, 2]] if sort_order == "col" else [[0, 1, 1, 2], [1, 0, 2, 1]]
    edges = EdgeIndex(rows, sparse_size=(3, 3), sort_order=sort_order, is_undirected=True)
    data = Data(edge_index=edges)
    loader = StaticLoader(EdgesOnly([data] * 4), batch_size=2, num_workers=num_workers)
    assert len(loader) == 2
    batches = list(loader)
    assert [batch.num_samples for batch in batches] == [2, 2]
    for batch in batches:
        for edge_index, size in ((batch.edge_index, 3), (batch.to_batch().edge_index, 6)):
            assert isinstance(edge_index, EdgeIndex)
            assert edge_index.dtype == torch.long
            assert edge_index.sparse_size() == (size, size)
            assert edge_index.sort_order == sort_order
            assert edge_index.is_undirected
        assert batch.to_batch().num_graphs == 2


def test_parts_without_an_attribute_of_their_own_keep_their_numbers():
    data = Data(edge_index=torch.tensor([[0, 1, 1, 2], [1, 0, 2, 1]]))
    first, second = EdgesOnly([data] * 3), EdgesOnly([data] * 2)
    loader = StaticLoader(ConcatDataset([first, Subset(second, [1])]), batch_size=3)
    assert [batch.num_samples for batch in loader] == [3, 1]
    assert [batch.num_samples for batch in StaticLoader(first[[2, 0]], batch_size=5)] == [2]
    moved = EdgesOnly([data] * 3, transform=lambda sample: sample)
    assert [batch.num_samples for batch in StaticLoader(moved, batch_size=2)] == [2, 1]
    crossing = ConcatDataset([first, second])
    assert [batch.num_samples for batch in StaticLoader(crossing, batch_size=4)] == [4, 1]


@pytest.mark.parametrize("context", ["forkserver", "spawn"])
def test_lambda_is_named_where_workers_are_not_forked(context):
    dataset = FakeTactileDataset(4, transform=lambda sample: sample)
    loader = StaticLoader(dataset, 2, num_workers=1, multiprocessing_context=context)
    with pytest.raises(TypeError, match=r"must be picklable .*lambda.* functions or classes of a"):
        next(iter(loader))
    assert len(list(StaticLoader(dataset, 2))) == 2


@pytest.mark.full
def test_function_of_a_module_works_where_workers_are_not_forked():
    dataset = FakeTactileDataset(4, transform=ToUndirected())
    loader = StaticLoader(dataset, 2, num_workers=1, multiprocessing_context="forkserver")
    assert [batch.num_samples for batch in loader] == [2, 2]
