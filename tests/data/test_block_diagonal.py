"""A batch built by repeating equals PyG's of the samples, attribute by attribute."""

import pickle

import pytest
import torch
from torch_geometric import EdgeIndex
from torch_geometric.data import Batch, Data

from torch_geometric_tactile.data import StaticData, static_data

EDGES = torch.tensor([[0, 1, 2], [1, 2, 0]])
SAMPLES, NODES = 4, 3


def assert_same_value(found, expected, what):
    assert type(found) is type(expected), what
    if isinstance(expected, torch.Tensor):
        assert found.dtype == expected.dtype, what
        assert found.layout == expected.layout, what
        if expected.layout != torch.strided:
            found, expected = found.to_dense(), expected.to_dense()
        assert found.shape == expected.shape, what
        assert torch.equal(found, expected), what
    elif isinstance(expected, dict):
        assert found.keys() == expected.keys(), what
        for key in expected:
            assert_same_value(found[key], expected[key], f"{what}[{key!r}]")
    elif isinstance(expected, list):
        assert len(found) == len(expected), what
        for i, value in enumerate(expected):
            assert_same_value(found[i], value, f"{what}[{i}]")
    else:
        assert found == expected, what


def assert_same_data(found, expected):
    assert set(found.keys()) == set(expected.keys())
    for key in expected.keys():  # noqa: SIM118
        assert_same_value(found[key], expected[key], key)


def assert_is_pygs_batch(data):
    found, expected = data.to_batch(), Batch.from_data_list(data.to_data_list())
    assert type(found) is type(expected)
    assert_same_data(found, expected)
    assert found.num_graphs == expected.num_graphs == len(found)
    assert found.num_nodes == expected.num_nodes
    assert_same_value(found._slice_dict, expected._slice_dict, "_slice_dict")
    assert_same_value(found._inc_dict, expected._inc_dict, "_inc_dict")
    if "adj_t" not in data:  # PyG does not take joined sparse tensors apart
        for one, other in zip(found.to_data_list(), expected.to_data_list(), strict=True):
            assert_same_data(one, other)
    assert_same_data(pickle.loads(pickle.dumps(found)), expected)


def long(*size):
    return torch.randint(0, NODES, size)


ATTRIBUTES = {
    "nothing": {},
    "shared edge_attr": {"edge_attr": torch.randn(3, 2)},
    "flat edge_attr": {"edge_attr": torch.randn(3)},
    "own edge_attr": {"edge_attr": torch.randn(SAMPLES, 3, 2)},
    "shared edge_weight": {"edge_weight": torch.rand(3)},
    "own edge_weight": {"edge_weight": torch.rand(SAMPLES, 3)},
    "shared pos": {"pos": torch.randn(NODES, 3), "normal": torch.randn(NODES, 3)},
    "own pos": {"pos": torch.randn(SAMPLES, NODES, 3)},
    "shared marks": {"dropped": torch.rand(NODES) > 0.5},
    "own marks": {"missing": torch.rand(SAMPLES, NODES) > 0.5},
    "flat y": {"y": torch.arange(SAMPLES)},
    "wide y": {"y": torch.rand(SAMPLES, 2)},
    "shared y": {"y": torch.arange(2), "shared": ["y"]},
    "joint": {"joint": torch.randn(SAMPLES, 16), "time": torch.rand(SAMPLES).double()},
    "shared joint": {"joint": torch.randn(1, 16), "shared": ["joint"]},
    "sample attribute of many dimensions": {"image": torch.randn(SAMPLES, 2, 3, 4)},
    "own node attribute": {"mask": torch.rand(SAMPLES, NODES) > 0.5, "node": ["mask"]},
    "shared node attribute": {
        "encoding": torch.randn(NODES, 2),
        "node": ["encoding"],
        "shared": ["encoding"],
    },
    "own edge attribute": {"length": torch.randn(SAMPLES, 3), "edge": ["length"]},
    "shared edge attribute": {"length": torch.randn(3), "edge": ["length"], "shared": ["length"]},
    "shared value": {"gain": torch.randn(5), "shared": ["gain"]},
    "shared scalar": {"gain": torch.tensor(0.5), "shared": ["gain"]},
    # PyG adds the number of nodes to attributes of this name, and joins their last dimension.
    "index of the sample": {"object_index": long(SAMPLES)},
    "wide index of the sample": {"object_index": long(SAMPLES, 2)},
    "deep index of the sample": {"object_index": long(SAMPLES, 2, 5)},
    "index of each taxel": {"patch_index": long(SAMPLES, NODES), "node": ["patch_index"]},
    "shared index": {"hull_index": long(2, 5), "shared": ["hull_index"]},
    "short index": {"object_index": long(SAMPLES).to(torch.int16)},
    "index of floats": {"object_index": torch.rand(SAMPLES)},
    "index of booleans": {"object_index": torch.rand(SAMPLES) > 0.5},
    "index of a scalar": {"gain_index": torch.tensor(1), "shared": ["gain_index"]},
    "face": {"face": long(3, 2), "shared": ["face"]},
    # PyG adds one more than their maximum.
    "shared batch": {"segment_batch": torch.tensor([0, 0, 1])},
    "own batch": {"segment_batch": long(SAMPLES, NODES)},
    "batch of the sample": {"finger_batch": torch.tensor([1, 0, 2, 0])},
    "single batch": {"segment_batch": torch.zeros(NODES, dtype=torch.long)},
    "string": {"note": "dry"},
    "number": {"rate": 50.0},
    "index that is a number": {"finger_index": 2},
    "dictionary": {"unit": {"x": "counts", "gain": torch.ones(2)}},
    "list": {"names": ["a", "b"], "shared": ["names"]},
    "list of tensors": {"parts": [torch.ones(1), torch.zeros(2)], "shared": ["parts"]},
    "sparse": {"adj_t": torch.eye(NODES).to_sparse_csr()},
    "number of nodes": {"num_nodes": NODES},
    "attribute that PyG takes for nodes": {"node_gain": torch.rand(SAMPLES)},
}


@pytest.mark.parametrize("name", ATTRIBUTES)
@pytest.mark.parametrize("readings", [True, False])
@pytest.mark.filterwarnings("ignore:Unable to accurately infer:UserWarning")
@pytest.mark.filterwarnings("ignore:Sparse CSR:UserWarning")
def test_to_batch_is_pygs(name, readings):
    torch.manual_seed(0)
    x = {"x": torch.randn(SAMPLES, NODES, 2), "edge_index": EDGES} if readings else {}
    own = {"own": torch.arange(SAMPLES)}
    declared = {key: ATTRIBUTES[name].get(key, ()) for key in ("node", "edge", "shared")}
    data = StaticData(**x, **own, **ATTRIBUTES[name])
    if not readings and any("index" in key for key in data.keys()):  # noqa: SIM118
        with pytest.raises(RuntimeError, match="infer"):
            Batch.from_data_list(data.to_data_list())
        with pytest.raises(RuntimeError, match="infer"):
            data.to_batch()
        return
    assert_is_pygs_batch(data)
    assert_is_pygs_batch(data.index_select(slice(1, 2)))
    assert data.schema == {key: sorted(names) for key, names in declared.items()}


@pytest.mark.parametrize("seed", range(40))
def test_to_batch_of_random_attributes_is_pygs(seed):
    torch.manual_seed(seed)

    def number(most):
        return int(torch.randint(1, most + 1, ()))

    samples, nodes, edges = number(5), number(4), number(6)
    sizes = {"node": nodes, "edge": edges}
    edge_index = torch.randint(0, nodes, (2, edges))
    given = {"x": torch.randn(samples, nodes, number(3)), "edge_index": edge_index}
    declared = {"node": [], "edge": [], "shared": []}
    for i in range(8):
        kind = ("a", "surface", "b_index", "edge_c", "d_batch", "weight")[number(6) - 1]
        key, shape = f"{kind}{i}", [number(3) for _ in range(number(3) - 1)]
        level = ("node", "edge", "sample")[number(3) - 1]
        if number(2) == 1:
            declared["shared"].append(key)
            shape = shape if level == "sample" else [sizes[level], *shape]
        else:
            shape = [samples, *([] if level == "sample" else [sizes[level]]), *shape]
        if level != "sample":
            declared[level].append(key)
        given[key] = torch.randint(0, 5, shape)
        if number(3) == 1 and kind != "d_batch":
            given[key] = given[key].float()
    data = StaticData(**given, **declared)
    expected = Batch.from_data_list(data.to_data_list())
    found = data.to_batch()
    assert_same_data(found, expected)
    assert_same_value(found._slice_dict, expected._slice_dict, "_slice_dict")
    assert_same_value(found._inc_dict, expected._inc_dict, "_inc_dict")
    chosen = torch.randint(0, samples, (3,))
    assert_is_pygs_batch(data.index_select(chosen))


def two_triangles(**kwargs):
    return StaticData(x=torch.arange(6.0).view(2, 3, 1), edge_index=EDGES.clone(), **kwargs)


def test_to_batch_by_hand():
    batch = two_triangles(edge_weight=torch.tensor([0.1, 0.2, 0.3])).to_batch()
    assert batch.x.view(-1).tolist() == [0, 1, 2, 3, 4, 5]
    assert batch.edge_index.tolist() == [[0, 1, 2, 3, 4, 5], [1, 2, 0, 4, 5, 3]]
    assert batch.edge_weight.tolist() == pytest.approx([0.1, 0.2, 0.3, 0.1, 0.2, 0.3])
    assert batch.batch.tolist() == [0, 0, 0, 1, 1, 1]
    assert batch.ptr.tolist() == [0, 3, 6]
    sizes = "x=[6, 1], edge_index=[2, 6], edge_weight=[6], batch=[6], ptr=[3]"
    assert repr(batch) == f"DataBatch({sizes})"


def test_to_batch_of_no_samples():
    data = two_triangles(
        y=torch.tensor([0, 1]),
        edge_attr=torch.ones(3, 2),
        missing=torch.zeros(2, 3),
        object_index=torch.arange(2),
        segment_batch=torch.zeros(2, 3, dtype=torch.long),
        note="dry",
    )
    batch = data.index_select(slice(0, 0)).to_batch()
    assert (batch.num_graphs, batch.num_nodes, batch.num_edges) == (0, 0, 0)
    shapes = {key: tuple(value.shape) for key, value in batch.to_dict().items() if key != "note"}
    assert shapes == {
        "x": (0, 1),
        "edge_index": (2, 0),
        "edge_attr": (0, 2),
        "y": (0,),
        "missing": (0,),
        "object_index": (0,),
        "segment_batch": (0,),
        "batch": (0,),
        "ptr": (1,),
    }
    assert batch.note == []
    assert batch.to_data_list() == []


def test_to_batch_of_no_taxels_is_pygs():
    assert_is_pygs_batch(StaticData(x=torch.zeros(2, 0, 1), y=torch.arange(2)))


def test_to_batch_of_pygs_edge_index():
    edge_index = EdgeIndex(EDGES, sparse_size=(3, 3), sort_order="row")
    data = StaticData(x=torch.randn(2, 3, 1), edge_index=edge_index)
    batch = data.to_batch()
    assert isinstance(batch.edge_index, EdgeIndex)
    assert batch.edge_index.sparse_size() == (6, 6)
    expected = Batch.from_data_list(data.to_data_list())
    assert torch.equal(batch.edge_index.as_tensor(), expected.edge_index.as_tensor())
    assert batch[1].edge_index.sparse_size() == (3, 3)


def test_to_batch_passes_gradients():
    data = two_triangles(edge_weight=torch.ones(3))
    data.x.requires_grad_()
    data.edge_weight.requires_grad_()
    batch = data.to_batch()
    (batch.x.sum() + 2 * batch.edge_weight.sum()).backward()
    assert data.x.grad.eq(1).all()
    assert data.edge_weight.grad.tolist() == [4, 4, 4]


def test_to_batch_copies_no_readings():
    data = two_triangles()
    assert data.to_batch().x.data_ptr() == data.x.data_ptr()


def edges_of(data):
    return data.to_batch().edge_index.tolist()


CHANGES = {
    "by an operation": lambda edges: edges.fill_(1),
    "through .data": lambda edges: edges.data.fill_(1),
    "through numpy": lambda edges: edges.numpy().fill(1),
    "through a view": lambda edges: edges[0].fill_(1),
}


@pytest.mark.parametrize("change", CHANGES)
def test_joined_edges_follow_the_edges(change):
    data = two_triangles()
    before = edges_of(data)
    CHANGES[change](data.edge_index)
    assert edges_of(data) == Batch.from_data_list(data.to_data_list()).edge_index.tolist()
    assert edges_of(data) != before
    assert edges_of(two_triangles()) == before


def test_joined_edges_are_kept_for_the_next_batch_unless_somebody_wrote_to_them():
    data = two_triangles()
    first = data.to_batch().edge_index
    assert two_triangles().to_batch().edge_index is first
    expected = first.tolist()
    first[0, 0] = 7
    assert edges_of(data) == expected


def test_joined_edges_are_kept_by_numbers_of_samples_and_taxels():
    edges_of(two_triangles())
    more = StaticData(x=torch.zeros(2, 5, 1), edge_index=EDGES)
    assert edges_of(more) == [[0, 1, 2, 5, 6, 7], [1, 2, 0, 6, 7, 5]]
    third = two_triangles().index_select([0, 1, 0])
    assert edges_of(third) == [[0, 1, 2, 3, 4, 5, 6, 7, 8], [1, 2, 0, 4, 5, 3, 7, 8, 6]]
    short = StaticData(x=torch.zeros(2, 3, 1), edge_index=EDGES.to(torch.int32))
    assert short.to_batch().edge_index.dtype == torch.int32


def test_joined_edges_in_inference_mode_do_not_spoil_training():
    edge_index = torch.tensor([[2, 1], [0, 2]])  # of no other test
    with torch.inference_mode():
        data = StaticData(x=torch.zeros(2, 3, 1), edge_index=edge_index)
        inside = data.to_batch().edge_index
    outside = data.to_batch().edge_index
    assert not outside.is_inference()
    assert torch.equal(inside, outside)


def test_few_joined_edges_are_kept(monkeypatch):
    cache = static_data._EdgeCache()
    for num_samples in range(2, 20):
        cache.get(EDGES, 3, num_samples)
    assert len(cache.entries) == static_data._MAX_CACHED_EDGES
    assert cache.entries[0].num_samples == 19
    monkeypatch.setattr(static_data, "_MAX_CACHED_BYTES", 2 * 3 * 2 * 8)
    cache.get(EDGES, 3, 2)
    assert len(cache.entries) == 1
    cache.get(EDGES, 3, 3)
    assert cache.entries == ()


def test_sample_of_a_batch_is_that_of_the_data():
    data = two_triangles(
        y=torch.tensor([3, 4]), node_pe=torch.rand(3, 2), node=["node_pe"], shared=["node_pe"]
    )
    batch = data.to_batch()
    assert isinstance(batch[1], Data)
    assert batch[1].edge_index.tolist() == EDGES.tolist()
    assert batch[1].y.tolist() == [4]
    assert torch.equal(batch[1].node_pe, data.node_pe)
