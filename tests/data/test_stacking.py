import pytest
import torch
from torch_geometric.data import Data
from torch_geometric.transforms import BaseTransform, Compose, Distance, RandomJitter

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
        gain=torch.ones(3),
        note="dry",
        shared=["gain"],
    )
    back = StaticData.from_data_list(data.to_data_list(), shared=data.shared)
    assert sorted(back.keys()) == sorted(data.keys())
    assert back.note == "dry"
    for key in set(data.keys()) - {"note"}:
        assert back[key].equal(data[key]), key
        assert back.is_shared(key) == data.is_shared(key), key


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


def test_from_data_list_shares_what_has_a_row_for_each_taxel():
    data = StaticData.from_data_list([sample(0, bias=torch.ones(2)), sample(1, bias=torch.ones(2))])
    assert data.is_shared("bias")
    assert data.sample(1).bias.tolist() == [1.0, 1.0]


@pytest.mark.parametrize(
    ("second", "message"),
    [
        (
            sample(1, edge_index=EDGES[:, :1]),
            "sample 1 must have the same 'edge_index' as sample 0",
        ),
        (sample(1, edge_index=EDGES.flip(0)), "sample 1 must have the same 'edge_index'"),
        (sample(1, x=torch.zeros(3, 1)), r"'x' in one shape \(got \[\(2, 1\), \(3, 1\)\]\)"),
        (sample(1, pos=torch.zeros(2, 3)), "sample 0 must have 'pos' as sample 1 has"),
        (Data(x=torch.zeros(2, 1), edge_index=EDGES), "sample 1 must have 'y' as sample 0 has"),
    ],
)
def test_from_data_list_rejects(second, message):
    with pytest.raises(ValueError, match=message):
        StaticData.from_data_list([sample(0), second])


def test_from_data_list_rejects_other_text_and_rows():
    with pytest.raises(ValueError, match="sample 1 must have the same 'note'"):
        StaticData.from_data_list([sample(note="dry"), sample(note="wet")])
    with pytest.raises(ValueError, match=r"'bias' .* first dimension of size 1"):
        StaticData.from_data_list([sample(bias=torch.ones(2)), sample(bias=torch.zeros(2))])
    several = [sample(gain=torch.ones(1)), sample(gain=torch.zeros(1))]
    with pytest.raises(ValueError, match="sample 1 must have the same 'gain'"):
        StaticData.from_data_list(several, shared=["gain"])


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
    return StaticData(x=torch.ones(3, 2, 1), edge_index=EDGES, pos=pos, bias=torch.zeros(2))


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


def test_apply_transform_of_pyg_stores_edge_attr_once():
    out = apply_transform(Distance(norm=False), square())
    assert out.edge_attr.tolist() == [[5.0], [5.0]]


def test_apply_transform_compose_is_one_after_the_other():
    whole = apply_transform(Compose([KNNGraph(k=1), Distance(norm=False), Double()]), square())
    assert whole.x.eq(2).all()
    assert whole.edge_attr.tolist() == [[5.0], [5.0]]
    assert apply_transform(Compose([]), square()).num_samples == 3


def test_apply_transform_sees_all_samples_at_once_where_it_can():
    class Count(StaticDouble):
        calls = 0

        def forward(self, data):
            Count.calls += 1
            return super().forward(data)

    out = apply_transform(Compose([Count(), Double(), Count()]), square())
    assert Count.calls == 2
    assert out.x.eq(8).all()


def test_apply_transform_keeps_once_what_stands_once():
    data = square()
    data.rest = torch.zeros(1, 16)
    assert apply_transform(Double(), data).rest.shape == (1, 16)


def test_apply_transform_gives_samples_positions_of_their_own():
    out = apply_transform(RandomJitter(1.0), square().index_select(slice(0, 2)))
    assert out.pos.shape == (2, 2, 3)
    assert not out.pos[0].equal(out.pos[1])


@pytest.mark.parametrize("transform", [Double(), StaticDouble()])
def test_apply_transform_no_samples(transform):
    out = apply_transform(transform, square().index_select(slice(0, 0)))
    assert out.x.shape == (0, 2, 1)


def test_apply_transform_rejects_topologies_that_differ():
    def cut(data):
        data.edge_index = data.edge_index[:, : int(data.y)]
        return data

    data = StaticData(x=torch.zeros(2, 2, 1), edge_index=EDGES, y=torch.tensor([1, 2]))
    with pytest.raises(ValueError, match=r"one topology, many samples; use .*InMemoryDataset"):
        apply_transform(cut, data)
