import copy
import pickle

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader
from torch_geometric.data import Data
from torch_geometric.transforms import NormalizeFeatures, ToUndirected

from torch_geometric_tactile.data import StaticData

EDGES = torch.tensor([[0, 1], [1, 0]])


def first_of(samples):  # no lambda, which workers that are not forked cannot take
    return samples[0]


def two_taxels(samples=3, **kwargs):
    x = torch.arange(samples * 4.0).view(samples, 2, 2)
    return StaticData(x=x, edge_index=EDGES, y=torch.arange(samples), **kwargs)


def test_static_data_repr_and_counts():
    data = two_taxels()
    assert repr(data) == "StaticData(x=[3, 2, 2], edge_index=[2, 2], y=[3])"
    assert (data.num_samples, data.num_nodes, data.num_features, data.num_edges) == (3, 2, 2, 2)


def test_sample_by_hand():
    pos = torch.zeros(2, 3)
    sample = two_taxels(pos=pos, force=torch.tensor([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]])).sample(1)
    assert type(sample) is Data
    assert sample.x.tolist() == [[4.0, 5.0], [6.0, 7.0]]
    assert sample.y.tolist() == [1]
    assert sample.force.tolist() == [[3.0, 4.0]]
    assert sample.edge_index is EDGES
    assert sample.pos is pos


@pytest.mark.parametrize("i", [-3, -1, 0, 2])
def test_sample_counts_from_both_ends(i):
    assert two_taxels().sample(i).y.tolist() == [i % 3]


@pytest.mark.parametrize("i", [3, -4])
def test_sample_out_of_range(i):
    with pytest.raises(IndexError, match=rf"'i' must be below 3 \(got {i}\)"):
        two_taxels().sample(i)


@pytest.mark.parametrize("shape", [(4,), (4, 3), (1, 2, 3, 4)])
def test_static_data_rejects_x_of_other_dimensions(shape):
    with pytest.raises(ValueError, match=r"'x' must have shape \(num_samples, num_nodes"):
        StaticData(x=torch.zeros(shape))


@pytest.mark.parametrize(
    "duplicate",
    [
        copy.copy,
        copy.deepcopy,
        StaticData.clone,
        lambda data: pickle.loads(pickle.dumps(data)),
        lambda data: data.to("cpu"),
        lambda data: data.index_select(slice(None)),
        lambda data: next(iter(DataLoader([data], collate_fn=first_of, num_workers=1))),
    ],
    ids=["copy", "deepcopy", "clone", "pickle", "to", "index_select", "worker"],
)
def test_copies_keep_the_levels(duplicate):
    original = two_taxels(gain=torch.ones(3), mask=torch.ones(3, 2), shared=["gain"], node=["mask"])
    data = duplicate(original)
    assert type(data) is StaticData
    assert data.schema == {"node": ["mask"], "edge": [], "shared": ["gain"]}
    assert data.sample(0).gain.shape == (3,)
    assert data.sample(0).mask.shape == (2,)
    with pytest.raises(ValueError, match="'y' must have 3 rows"):
        data.y = torch.zeros(6)
    if data is not original:  # PyG moves attributes in place
        data.declare(shared=["other"])
        assert original.schema["shared"] == ["gain"]


def test_dtype_changes_keep_the_levels():
    data = two_taxels(mask=torch.ones(3, 2), node=["mask"]).apply(lambda value: value.double())
    assert data.mask.dtype == torch.double
    assert data.level("mask") == "node"


@pytest.mark.parametrize(
    ("index", "kept"),
    [
        (slice(1, None), [1, 2]),
        (torch.tensor([2, 0, 2]), [2, 0, 2]),
        (torch.tensor([True, False, True]), [0, 2]),
        (torch.tensor([-1]), [2]),
        ([2, 1], [2, 1]),
        ([], []),
        (np.array([0, 2]), [0, 2]),
        (np.array([False, True, False]), [1]),
        (torch.tensor([], dtype=torch.long), []),
    ],
)
def test_index_select_takes(index, kept):
    data = two_taxels()
    out = data.index_select(index)
    assert torch.equal(data[index].x, out.x)
    assert out.y.tolist() == kept
    assert out.x.equal(data.x[kept])
    assert out.x.shape == (len(kept), 2, 2)
    assert out.edge_index is EDGES
    assert data.num_samples == 3


def test_index_select_slice_copies_nothing():
    data = two_taxels()
    assert data.index_select(slice(0, 2)).x.data_ptr() == data.x.data_ptr()


def test_index_select_lets_samples_get_positions_of_their_own():
    data = two_taxels(pos=torch.zeros(2, 3)).index_select(slice(0, 2))
    data.pos = torch.ones(2, 2, 3)
    assert data.sample(0).pos.shape == (2, 3)


def test_empty_static_data():
    data = two_taxels(samples=0)
    assert (data.num_samples, data.num_nodes) == (0, 2)
    assert data.to_data_list() == []
    assert data.index_select([]).num_samples == 0
    assert data
    with pytest.raises(IndexError, match="'i' must be below 0"):
        data.sample(0)


def test_single_taxel_and_sample():
    data = StaticData(x=torch.ones(1, 1, 1), pos=torch.zeros(1, 3), y=torch.tensor([1]))
    assert data.is_shared("pos")
    assert data.sample(0).x.shape == (1, 1)
    assert data.sample(0).pos.shape == (1, 3)
    assert data.sample(0).y.tolist() == [1]
    assert data.to_batch()[0].pos.shape == (1, 3)


@pytest.mark.parametrize("i", [1, -2, np.int64(1), torch.tensor(1), np.array(1)])
def test_an_index_gives_a_sample(i):
    data = two_taxels()
    for sample in (data[i], data.get_example(int(i))):
        assert type(sample) is Data
        assert sample.y.tolist() == [1]


def test_a_name_gives_an_attribute():
    data = two_taxels()
    assert data["x"] is data.x
    with pytest.raises(KeyError, match="force"):
        data["force"]


def test_number_of_graphs_is_that_of_samples():
    data = two_taxels()
    assert data.num_graphs == len(data) == len(data.to_data_list()) == 3


def test_number_of_samples_without_readings():
    assert StaticData(joint=torch.zeros(5, 16)).num_samples == 5
    assert StaticData(pos=torch.zeros(5, 3)).num_samples == 0
    assert StaticData().num_samples == 0
    assert StaticData(joint=torch.zeros(2, 3)).sample(1).joint.shape == (1, 3)


@pytest.mark.parametrize("key", ["batch", "ptr"])
def test_stacked_samples_have_no_batch(key):
    data = two_taxels()
    assert not hasattr(data, key)
    assert key not in data
    with pytest.raises(AttributeError, match=rf"has no '{key}': .* call 'to_batch\(\)'"):
        getattr(data, key)
    with pytest.raises(ValueError, match=rf"has no '{key}': call 'to_batch\(\)'"):
        data[key] = torch.zeros(6, dtype=torch.long)
    assert hasattr(data.to_batch(), key)


def test_other_missing_attributes_are_told_as_pyg_does():
    with pytest.raises(AttributeError, match="no attribute 'force'"):
        _ = two_taxels().force


def test_pyg_counts_taxels_and_edges_by_level():
    data = two_taxels(samples=2, edge_attr=torch.zeros(2, 2, 5), pos=torch.zeros(2, 2, 3))
    assert (data.num_nodes, data.num_edges) == (2, 2)
    assert data.is_node_attr("x")
    assert data.is_edge_attr("edge_attr")
    assert not data.is_node_attr("y")  # as many labels as taxels
    assert not data.is_edge_attr("y")
    assert sorted(data.edge_attrs()) == ["edge_attr", "edge_index"]
    assert StaticData(edge_attr=torch.zeros(3, 7, 5)).num_edges == 7
    assert StaticData(pos=torch.zeros(3, 7, 3)).num_nodes == 7


def test_pyg_transform_that_writes_to_the_store_is_checked_too():
    data = two_taxels()
    data._store["mask"] = torch.ones(3)
    with pytest.raises(ValueError, match="'mask' must have 3 rows"):
        data._store["mask"] = torch.ones(2)
    assert NormalizeFeatures()(two_taxels()).x.sum(-1).allclose(torch.ones(3, 2))


def test_pyg_transform_of_edges_takes_edge_attributes_along():
    one_way = StaticData(
        x=torch.zeros(2, 2, 1),
        edge_index=torch.tensor([[0], [1]]),
        edge_weight=torch.tensor([0.5]),
    )
    both = ToUndirected()(one_way)
    assert both.edge_index.tolist() == [[0, 1], [1, 0]]
    assert both.edge_weight.tolist() == [0.5, 0.5]
    assert both.to_batch().edge_weight.tolist() == [0.5] * 4
