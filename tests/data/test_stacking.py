import copy
import io
import pickle

import pytest
import torch
from torch_geometric.data import Data, HeteroData
from torch_geometric.transforms import BaseTransform, Compose, Distance, ToUndirected

from torch_geometric_tactile.data import StaticData, apply_transform
from torch_geometric_tactile.transforms import KNNGraph

EDGES = torch.tensor([[0, 1], [1, 0]])


def sample(i=0, **changes):
    x = torch.full((2, 1), float(i))
    return Data(**{"x": x, "edge_index": EDGES.clone(), "y": torch.tensor([i]), **changes})


def test_from_data_list_by_hand():
    data = StaticData.from_data_list([sample(0), sample(1), sample(2)])
    assert data.x.tolist() == [[[0.0], [0.0]], [[1.0], [1.0]], [[2.0], [2.0]]]
    assert data.y.tolist() == [0, 1, 2]
    assert data.edge_index.equal(EDGES)


def test_to_data_list_and_back():
    data = StaticData(
        x=torch.rand(3, 2, 4),
        edge_index=EDGES,
        edge_attr=torch.rand(3, 2, 5),
        pos=torch.rand(2, 3),
        y=torch.tensor([1, 0, 1]),
        joint=torch.rand(3, 16),
        bias=torch.rand(2, 7),
        mask=torch.rand(3, 2) > 0.5,
        length=torch.rand(3, 2),
        gain=torch.ones(3),
        object_index=torch.arange(3),
        note="dry",
        node=["bias", "mask"],
        edge=["length"],
        shared=["bias", "gain"],
    )
    back = StaticData.from_data_list(data.to_data_list(), **data.schema)
    assert back.schema == data.schema
    assert sorted(back.keys()) == sorted(data.keys())
    assert back.note == "dry"
    for key in set(data.keys()) - {"note"}:
        assert back[key].equal(data[key]), key
        assert back.is_shared(key) == data.is_shared(key), key
        assert back.level(key) == data.level(key), key


def test_from_data_list_single_sample():
    data = StaticData.from_data_list([sample(7)])
    assert data.num_samples == 1
    assert data.sample(0).y.tolist() == [7]


def test_from_data_list_stores_equal_positions_once():
    pos = torch.rand(2, 3)
    data = StaticData.from_data_list([sample(0, pos=pos), sample(1, pos=pos.clone())])
    assert data.pos.equal(pos)
    own = StaticData.from_data_list([sample(0, pos=pos), sample(1, pos=pos + 1)])
    assert own.pos.shape == (2, 2, 3)


def test_from_data_list_stacks_scalar_labels():
    data = StaticData.from_data_list([sample(y=torch.tensor(0.5)), sample(y=torch.tensor(1.5))])
    assert data.y.tolist() == [0.5, 1.5]


def test_from_data_list_brings_in_own_attributes():
    samples = [
        sample(
            i, mask=torch.tensor([i > 0, True]), length=torch.tensor([1.0, i]), bias=torch.ones(2)
        )
        for i in range(3)
    ]
    declared = {"node": ("mask", "bias"), "edge": ("length",), "shared": ("bias",)}
    data = StaticData.from_data_list(iter(samples), **declared)
    assert data.mask.tolist() == [[False, True], [True, True], [True, True]]
    assert data.length.tolist() == [[1, 0], [1, 1], [1, 2]]
    assert data.bias.tolist() == [1, 1]
    for i, expected in enumerate(samples):
        for key in expected.keys():  # noqa: SIM118
            assert torch.equal(data[i][key], expected[key]), key


def test_from_data_list_stores_declared_attributes_for_each_sample():
    mask = torch.ones(2)
    data = StaticData.from_data_list([sample(0, mask=mask), sample(1, mask=mask)], node=["mask"])
    assert data.mask.shape == (2, 2)
    weight = torch.ones(2)
    samples = [sample(0, edge_attr=weight), sample(1, edge_attr=2 * weight)]
    data = StaticData.from_data_list(samples, edge=["edge_attr"])
    assert data.edge_attr.tolist() == [[1, 1], [2, 2]]
    assert data[1].edge_attr.tolist() == [2, 2]


def test_from_data_list_takes_numbers_of_known_attributes():
    data = StaticData.from_data_list([sample(y=0), sample(y=2)])
    assert data.y.tolist() == [0, 2]
    assert StaticData.from_data_list([sample(y=True), sample(y=False)]).y.dtype == torch.bool
    assert StaticData.from_data_list([sample(rate=50.0), sample(rate=50.0)]).rate == 50.0
    with pytest.raises(ValueError, match="sample 1 must have the same 'rate'"):
        StaticData.from_data_list([sample(rate=50.0), sample(rate=60.0)])


def test_from_data_list_shares_sparse_edges():
    samples = [Data(x=torch.ones(2, 1), adj_t=torch.eye(2).to_sparse_csr()) for _ in range(2)]
    data = StaticData.from_data_list(samples)
    assert data.is_shared("adj_t")
    samples[1].adj_t = torch.ones(2, 2).to_sparse_csr()
    with pytest.raises(ValueError, match="sample 1 must have the same 'adj_t'"):
        StaticData.from_data_list(samples)


@pytest.mark.parametrize(
    ("second", "message"),
    [
        (
            sample(1, edge_index=EDGES[:, :1]),
            "sample 1 must have the same 'edge_index' as sample 0",
        ),
        (
            sample(1, x=torch.zeros(3, 1)),
            r"'x' must have the same shape in all samples \(got \[\(2, 1\), \(3, 1\)\]\)",
        ),
        (sample(1, pos=torch.zeros(2, 3)), "sample 0 must have 'pos', like sample 1"),
        (Data(x=torch.zeros(2, 1), edge_index=EDGES), "sample 1 must have 'y', like sample 0"),
    ],
)
def test_from_data_list_rejects(second, message):
    with pytest.raises(ValueError, match=message):
        StaticData.from_data_list([sample(0), second])


SAME = "sample 1 must have the same '{}' as sample 0"


@pytest.mark.parametrize(
    ("key", "first", "second", "declared", "message"),
    [
        ("note", "dry", "wet", [], SAME),
        ("gain", torch.ones(1), torch.zeros(1), ["shared"], SAME),
        ("bias", torch.ones(2), torch.zeros(2), ["node", "shared"], SAME),
        ("bias", torch.ones(2), torch.ones(2), [], r"'{}' must have a first .* \(2,\)\); name it"),
        ("pos", torch.ones(2), torch.zeros(2), [], "'{}' must have 2 dimensions in a sample"),
        ("edge_attr", torch.ones(2), torch.zeros(2), [], "'{}' must be named in 'edge' if it"),
    ],
)
def test_from_data_list_rejects_other_values(key, first, second, declared, message):
    samples = [sample(**{key: first}), sample(**{key: second})]
    with pytest.raises(ValueError, match=message.format(key)):
        StaticData.from_data_list(samples, **{argument: [key] for argument in declared})


def test_from_data_list_rejects_x_without_features():
    with pytest.raises(ValueError, match=r"'x' must have shape .* \(got \(2, 4\)\)"):
        StaticData.from_data_list([sample(x=torch.zeros(4)), sample(x=torch.ones(4))])


def test_from_data_list_rejects_none():
    with pytest.raises(ValueError, match=r"'data_list' must hold at least one sample \(got none\)"):
        StaticData.from_data_list([])


class Double(BaseTransform):
    def forward(self, data):
        data.x = data.x * 2
        return data


class StaticDouble(Double):
    supports_static = True


def square():
    pos = torch.tensor([[0.0, 0.0, 0.0], [3.0, 4.0, 0.0]])
    return StaticData(
        x=torch.ones(3, 2, 1),
        edge_index=EDGES,
        pos=pos,
        bias=torch.zeros(2),
        node=["bias"],
        shared=["bias"],
    )


@pytest.mark.parametrize("transform", [Double(), StaticDouble()])
def test_apply_transform_leaves_the_callers_data_alone(transform):
    data = square()
    out = apply_transform(transform, data)
    assert out.x.eq(2).all()
    assert data.x.eq(1).all()
    assert out.sample(2).bias.tolist() == [0.0, 0.0]


def test_apply_transform_none_returns_the_data():
    data = square()
    assert apply_transform(None, data) is data


def test_apply_transform_compose_is_one_after_the_other():
    whole = apply_transform(Compose([KNNGraph(k=1), Distance(norm=False), Double()]), square())
    assert whole.x.eq(2).all()
    assert whole.edge_attr.tolist() == [[5.0], [5.0]]
    assert apply_transform(Compose([]), square()).num_samples == 3


def test_apply_transform_sees_all_samples_at_once_where_it_can():
    class Count(StaticDouble):
        calls = 0
        supports_static = True  # of this `forward`; that of the parent is not inherited

        def forward(self, data):
            Count.calls += 1
            return super().forward(data)

    out = apply_transform(Compose([Count(), Double(), Count()]), square())
    assert Count.calls == 2
    assert out.x.eq(8).all()


def test_apply_transform_keeps_once_what_stands_once():
    data = square().declare(shared=["rest"])
    data.rest = torch.zeros(1, 16)
    assert apply_transform(Double(), data).rest.shape == (1, 16)


@pytest.mark.parametrize("transform", [Double(), StaticDouble()])
def test_apply_transform_no_samples(transform):
    out = apply_transform(transform, square().index_select(slice(0, 0)))
    assert out.x.shape == (0, 2, 1)


class Heights(BaseTransform):
    """Adds an attribute that nobody knows."""

    def forward(self, data):
        data.height = data.pos[:, 2]
        return data


def test_apply_transform_needs_new_attributes_declared():
    with pytest.raises(ValueError, match=r"'height' .* name it in 'node' or 'edge'"):
        apply_transform(Heights(), square())
    data = square().declare(node=["height"])  # before it is there
    out = apply_transform(Heights(), data)
    assert out.height.shape == (3, 2)
    assert out[1].height.tolist() == [0, 0]
    assert out.schema == data.schema


def test_apply_transform_rejects_topologies_that_differ():
    def cut(data):
        data.edge_index = data.edge_index[:, : int(data.y)]
        return data

    data = StaticData(x=torch.zeros(2, 2, 1), edge_index=EDGES, y=torch.tensor([1, 2]))
    with pytest.raises(ValueError, match=r"since all samples share it; use .*InMemoryDataset"):
        apply_transform(cut, data)


@pytest.mark.parametrize("other", [HeteroData(), (sample(), sample()), None, EDGES])
def test_from_data_list_of_other_kinds(other):
    match = rf"must hold torch_geometric.data.Data .*got {type(other).__name__} as sample 1\)"
    with pytest.raises(TypeError, match=match):
        StaticData.from_data_list([sample(), other])


def edges_only(num_samples=4):
    return StaticData.from_data_list([Data(edge_index=EDGES, num_nodes=2)] * num_samples)


def saved_and_loaded(data):
    file = io.BytesIO()
    torch.save(data, file)
    file.seek(0)
    return torch.load(file, weights_only=False)


@pytest.mark.parametrize(
    ("number", "change"),
    [
        (4, lambda data: data),
        (4, copy.copy),
        (4, copy.deepcopy),
        (4, lambda data: data.clone()),
        (4, lambda data: data.to("cpu")),
        (4, lambda data: data.contiguous()),
        (4, lambda data: pickle.loads(pickle.dumps(data))),
        (4, saved_and_loaded),
        (2, lambda data: data[1:3]),
        (0, lambda data: data[4:]),
        (3, lambda data: data[[3, 0, 0]]),
        (1, lambda data: data[torch.tensor([False, True, False, False])]),
        (2, lambda data: data[1:3].clone()[:]),
        (3, lambda data: StaticData.from_data_list(data.to_data_list()[1:])),
        (4, lambda data: StaticData(**data.to_dict(), num_samples=4)),
        (4, lambda data: apply_transform(ToUndirected(), data)),
        (4, lambda data: apply_transform(lambda sample: sample, data)),
    ],
)
def test_samples_without_an_attribute_of_their_own_are_counted(number, change):
    data = change(edges_only())
    assert data.num_samples == len(data) == data.num_graphs == number
    assert len(data.to_data_list()) == number
    assert data.to_batch().num_graphs == number
    assert data.to_batch().num_nodes == 2 * number


@pytest.mark.parametrize("index", [[4], [-5]])
def test_samples_without_an_attribute_of_their_own_are_not_made_up(index):
    with pytest.raises(IndexError):
        edges_only()[index]


def test_number_of_samples_outlives_the_attribute_that_told_it():
    data = StaticData(x=torch.zeros(3, 2, 1), edge_index=EDGES)
    del data.x
    assert data.num_samples == 3
    assert data[1:].num_samples == 2
    data.y = torch.arange(3)
    with pytest.raises(ValueError, match=r"'group' must have 3 rows"):
        data.group = torch.arange(2)


def test_new_attributes_must_have_the_number_of_samples():
    data = edges_only()
    with pytest.raises(ValueError, match=r"'y' must have 4 rows, one for each sample"):
        data.y = torch.arange(5)
    with pytest.raises(ValueError, match=r"'x' must have 4 samples, as declared"):
        data.x = torch.zeros(5, 2, 1)
    data.x = torch.zeros(4, 2, 1)
    data.x = torch.zeros(5, 2, 1)  # nothing else has rows
    assert data.num_samples == 5


@pytest.mark.parametrize("number", [-1, True, 2**40])
def test_other_numbers_of_samples_are_refused(number):
    with pytest.raises(ValueError, match="'num_samples' must be a non-negative integer"):
        StaticData(edge_index=EDGES, num_samples=number)
    with pytest.raises(ValueError, match="'x' must have 3 samples, as declared"):
        StaticData(x=torch.zeros(2, 2, 1), num_samples=3)
