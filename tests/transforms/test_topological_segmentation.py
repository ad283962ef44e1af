import pytest
import torch
from torch_geometric.data import Batch, Data
from torch_geometric.loader import DataLoader
from torch_geometric.nn import global_mean_pool
from torch_geometric.utils import subgraph

from torch_geometric_tactile.data import StaticData, StaticDataset
from torch_geometric_tactile.loader import StaticLoader
from torch_geometric_tactile.sensors import allegro_uskin, grid
from torch_geometric_tactile.transforms import TopologicalSegmentation

LAYOUT = allegro_uskin()
ROW = torch.tensor([[0, 1, 1, 2, 2, 3], [1, 0, 2, 1, 3, 2]])  # 0 - 1 - 2 - 3
HALVES = [0, 0, 1, 1]


def row(**kwargs):
    return Data(x=torch.arange(8.0).view(4, 2), edge_index=ROW, **kwargs)


def samples(num_samples=3, **kwargs):
    generator = torch.Generator().manual_seed(0)
    x = torch.randn(num_samples, 4, 2, generator=generator)
    return StaticData(x=x, edge_index=ROW, y=torch.arange(num_samples), **kwargs)


def hand(num_samples=2):
    generator = torch.Generator().manual_seed(0)
    edge_index = LAYOUT.edge_index("original")
    return StaticData(
        x=torch.randn(num_samples, 384, 3, generator=generator),
        edge_index=edge_index,
        edge_attr=torch.randn(num_samples, edge_index.size(1), 4, generator=generator),
        pos=LAYOUT.pos,
        normal=LAYOUT.normal,
        y=torch.arange(num_samples),
        joint=torch.zeros(num_samples, 16),
    )


class Rows(StaticDataset):
    layout = grid(1, 4, pitch=0.01)

    def read(self):
        return samples(5), {}


def test_topological_segmentation_by_hand():
    data = row(edge_attr=torch.arange(6.0).view(6, 1), edge_weight=torch.arange(6.0))
    out = TopologicalSegmentation(HALVES)(data)
    assert out.segment_batch.tolist() == HALVES
    assert out.edge_index.tolist() == [[0, 1, 2, 3], [1, 0, 3, 2]]
    assert out.edge_attr.view(-1).tolist() == [0, 1, 4, 5]
    assert out.edge_weight.tolist() == [0, 1, 4, 5]
    assert "edge_is_within" not in out
    out = TopologicalSegmentation(HALVES, drop=False)(data)
    assert torch.equal(out.edge_index, ROW)
    assert out.edge_is_within.tolist() == [True, True, False, False, True, True]
    assert out.edge_attr.size(0) == 6


def test_topological_segmentation_numbers_anew():
    transform = TopologicalSegmentation(torch.tensor([7, -2, 7, 30]))
    assert transform(row()).segment_batch.tolist() == [1, 0, 1, 2]
    assert transform.num_segments == 3
    assert len(transform.split(row())) == 3


@pytest.mark.parametrize(
    ("by", "sizes"),
    [
        ("digit", {"index": 258, "middle": 258, "ring": 258, "thumb": 202, "palm": 392}),
        ("patch", None),
    ],
)
def test_topological_segmentation_of_the_hand(by, sizes):
    transform = TopologicalSegmentation(by, LAYOUT)
    names = getattr(LAYOUT, f"{by}_names")
    data = transform(hand())
    source, target = data.edge_index
    counts = data.segment_batch[source].bincount(minlength=len(names)).tolist()
    taxels = data.segment_batch.bincount().tolist()
    if sizes is None:
        assert all(count == {16: 48, 24: 72}[n] for count, n in zip(counts, taxels, strict=True))
        assert sorted(taxels) == [16] * 18 + [24] * 4
    else:
        assert dict(zip(names, counts, strict=True)) == sizes
        assert taxels == [72, 72, 72, 56, 112]
    assert torch.equal(data.segment_batch[source], data.segment_batch[target])
    parts = transform.split(hand())
    assert [part.num_edges for part in parts] == counts
    assert [part.num_nodes for part in parts] == taxels


@pytest.mark.parametrize("by", ["digit", "patch"])
def test_topological_segmentation_is_the_induced_subgraph(by):
    data = hand().sample(1)
    for k, part in enumerate(TopologicalSegmentation(by, LAYOUT).split(data)):
        mask = LAYOUT.segments(by) == k
        edge_index, edge_attr = subgraph(
            mask, data.edge_index, data.edge_attr, relabel_nodes=True, num_nodes=384
        )
        assert type(part) is Data
        assert torch.equal(part.edge_index, edge_index)
        assert torch.equal(part.edge_attr, edge_attr)
        for key in ("x", "pos", "normal"):
            assert torch.equal(part[key], data[key][mask])
        assert torch.equal(part.y, data.y)
        assert part.joint.shape == (1, 16)
        assert set(part.keys()) == set(data.keys())


def test_topological_segmentation_collates():
    # Whether PyG joins segmented samples or a batch is segmented: no number occurs in two samples.
    transform = TopologicalSegmentation(HALVES)
    expected = [0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 5, 5]
    joined = next(iter(DataLoader([transform(row()) for _ in range(3)], batch_size=3)))
    assert joined.segment_batch.tolist() == expected
    assert joined[2].segment_batch.tolist() == HALVES
    segmented = transform(Batch.from_data_list([row()] * 3))
    assert segmented.segment_batch.tolist() == expected
    assert torch.equal(segmented.edge_index, joined.edge_index)
    pooled = global_mean_pool(joined.x, joined.segment_batch)
    assert pooled.tolist() == [[1, 2], [5, 6]] * 3


@pytest.mark.parametrize("when", ["transform", "pre_transform"])
def test_topological_segmentation_loaders_agree(when):
    dataset = Rows(**{when: TopologicalSegmentation(HALVES)})
    static = list(StaticLoader(dataset, batch_size=4))  # as many samples as taxels
    pyg = list(DataLoader(dataset, batch_size=4))
    for a, b, size in zip(static, pyg, (4, 1), strict=True):
        assert a.segment_batch.tolist() == HALVES
        assert a.edge_index.shape == (2, 4)
        expected = torch.tensor(HALVES) + 2 * torch.arange(size)[:, None]
        assert torch.equal(b.segment_batch, expected.view(-1))
        assert torch.equal(a.x.view(-1, 2), b.x)


@pytest.mark.parametrize("num_samples", [0, 1, 2, 3, 4])
def test_topological_segmentation_split_many(num_samples):
    transform = TopologicalSegmentation(HALVES, drop=False)
    data = samples(num_samples, edge_attr=torch.randn(num_samples, 6, 2), pos=torch.randn(4, 3))
    data.joint = torch.zeros(num_samples, 4)
    data.dropped = torch.rand(num_samples, 4) < 0.5
    parts = transform.split(transform(data))
    assert [part.x.shape for part in parts] == [(num_samples, 2, 2)] * 2
    for k, part in enumerate(parts):
        assert isinstance(part, StaticData)
        assert "segment_batch" not in part
        assert part.edge_index.tolist() == [[0, 1], [1, 0]]
        assert part.joint.shape == (num_samples, 4)
        for i in range(num_samples):
            single = transform.split(data.sample(i))[k]
            for key in single.keys():  # noqa: SIM118
                assert torch.equal(part.sample(i)[key], single[key]), key
    if num_samples == 0:
        return
    batch = Batch.from_data_list(data.to_data_list())
    batch.edge_label_index = torch.zeros(2, 1, dtype=torch.long)
    for part, joined in zip(parts, transform.split(transform(batch)), strict=True):
        expected = Batch.from_data_list(part.to_data_list())
        assert isinstance(joined, Batch)
        assert joined.num_graphs == num_samples
        for key in ("x", "pos", "edge_index", "edge_attr", "y", "joint", "dropped", "batch", "ptr"):
            assert torch.equal(joined[key], expected[key]), key
        assert joined.edge_label_index.shape == (2, 1)


@pytest.mark.parametrize("drop", [False, True])
def test_topological_segmentation_batch_comes_apart_again(drop):
    transform = TopologicalSegmentation([0, 1, 1, 1], drop=drop)
    data = samples(3, edge_attr=torch.randn(3, 6, 2), pos=torch.randn(4, 3))
    batch = Batch.from_data_list(data.to_data_list())
    batch.label = torch.arange(12)  # set later: PyG does not know where its samples begin
    whole = transform(batch)
    for i in range(3):
        expected = transform(data.sample(i))
        for key in expected.keys():  # noqa: SIM118
            assert torch.equal(whole[i][key], expected[key]), key
        for k, part in enumerate(transform.split(whole)):
            expected = transform.split(data.sample(i))[k]
            for key in expected.keys():  # noqa: SIM118
                assert torch.equal(part[i][key], expected[key]), key
            assert torch.equal(part[i].label, batch.label.view(3, 4)[i, transform.segment == k])
    assert torch.equal(batch[2].edge_index, ROW)


def test_topological_segmentation_split_keeps_what_stood_once():
    label, gain = torch.arange(4), torch.ones(2, 4)  # of which one has a row for each taxel
    data = samples(2, label=label, gain=gain, node=["label"], shared=["label", "gain"])
    for k, part in enumerate(TopologicalSegmentation(HALVES).split(data)):
        assert part.sample(0).label.tolist() == [2 * k, 2 * k + 1]
        assert part.gain is data.gain


def test_topological_segmentation_split_joint_as_long_as_taxels():
    data = row(joint=torch.arange(4.0), label=torch.arange(4))
    part = TopologicalSegmentation(HALVES).split(data)[1]
    assert part.joint.tolist() == [0, 1, 2, 3]
    assert part.label.tolist() == [2, 3]


def test_topological_segmentation_without_readings():
    data = Data(edge_index=ROW, num_nodes=4)
    assert TopologicalSegmentation(HALVES)(data).num_edges == 4
    parts = TopologicalSegmentation([0, 0, 0, 1]).split(data)
    assert [part.num_nodes for part in parts] == [3, 1]
    assert [part.num_edges for part in parts] == [4, 0]


def test_topological_segmentation_single_taxel():
    data = Data(x=torch.ones(1, 1), edge_index=torch.empty(2, 0, dtype=torch.long))
    transform = TopologicalSegmentation([5])
    assert transform(data).segment_batch.tolist() == [0]
    assert transform.split(data)[0].x.tolist() == [[1]]
    empty = samples(0)
    assert TopologicalSegmentation(HALVES)(empty).x.shape == (0, 4, 2)


def test_topological_segmentation_caller_unedited():
    data = samples(3, edge_attr=torch.ones(6, 1))
    transform = TopologicalSegmentation(HALVES)
    transform(data)
    transform.split(data)
    assert data.edge_index is ROW
    assert data.edge_attr.shape == (6, 1)
    assert "segment_batch" not in data


def test_topological_segmentation_bad_input():
    with pytest.raises(ValueError, match=r"requires a 'layout' .* \(got 'digit'\)"):
        TopologicalSegmentation("digit")
    with pytest.raises(ValueError, match=r"'by' must be one of .* \(got 'finger'\)"):
        TopologicalSegmentation("finger", LAYOUT)
    for wrong in ([], [[0, 1]], [0.0, 1.0]):
        with pytest.raises(
            ValueError, match="'by', if neither 'digit' nor 'patch', must be a whole n"
        ):
            TopologicalSegmentation(wrong)
    with pytest.raises(ValueError, match=r"must have 384 numbers, .* layout .* \(got 4\)"):
        TopologicalSegmentation(HALVES, LAYOUT)
    for data in (row(), samples(), Batch.from_data_list([row()] * 2)):
        with pytest.raises(ValueError, match=r"3 taxels, as in the segmentation \(got 4\)"):
            TopologicalSegmentation([0, 1, 1])(data)
        with pytest.raises(ValueError, match=r"3 taxels, as in the segmentation \(got 4\)"):
            TopologicalSegmentation([0, 1, 1]).split(data)
    for call in (TopologicalSegmentation(HALVES), TopologicalSegmentation(HALVES).split):
        with pytest.raises(ValueError, match=r"needs 'edge_index' \(got none\)"):
            call(Data(x=torch.zeros(4, 1)))


def test_layout_is_found_by_name():
    named = TopologicalSegmentation("digit", "allegro_uskin")
    assert named.segment.bincount().tolist() == [72, 72, 72, 56, 112]
