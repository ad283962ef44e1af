import pytest
import torch
from torch_geometric.data import Batch, Data
from torch_geometric.transforms import Cartesian, Distance

from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.sensors import allegro_uskin, biotac_sp
from torch_geometric_tactile.transforms import GeometricEdgeAttr, KNNGraph

EDGES = torch.tensor([[1, 0, 2], [0, 1, 1]])
POS = torch.tensor([[0.0, 0.0, 0.0], [0.03, 0.04, 0.0], [0.03, 0.04, 0.02]])


def random_poses(num_samples=3, num_taxels=24, dtype=torch.float):
    generator = torch.Generator().manual_seed(0)
    pos = 0.05 * torch.randn(num_samples, num_taxels, 3, generator=generator, dtype=dtype)
    edge_index = KNNGraph(3)(Data(pos=biotac_sp().pos)).edge_index
    x = torch.zeros(num_samples, num_taxels, 3, dtype=dtype)
    return StaticData(x=x, edge_index=edge_index, pos=pos)


def rotation(seed):
    generator = torch.Generator().manual_seed(seed)
    turn, _ = torch.linalg.qr(torch.randn(3, 3, dtype=torch.double, generator=generator))
    return turn * turn.det()


def test_geometric_edge_attr_by_hand():
    # Neighbour minus target: 1 - 0, 0 - 1, 2 - 1.
    expected = torch.tensor(
        [[0.05, 0.03, 0.04, 0.0], [0.05, -0.03, -0.04, 0.0], [0.02, 0.0, 0.0, 0.02]]
    )
    data = Data(pos=POS, edge_index=EDGES)
    assert torch.allclose(GeometricEdgeAttr()(data).edge_attr, expected)
    assert torch.allclose(GeometricEdgeAttr(norm=True)(data).edge_attr, expected / 0.05)
    half = GeometricEdgeAttr(norm=True, max_value=0.1)
    assert torch.allclose(half(data).edge_attr, expected / 0.1)


def test_geometric_edge_attr_equals_pyg():
    layout = allegro_uskin()
    data = Data(pos=layout.pos, edge_index=layout.edge_index("original"))
    expected = Cartesian(norm=False)(Distance(norm=False)(data)).edge_attr
    assert torch.allclose(GeometricEdgeAttr()(data).edge_attr, expected)
    expected = Distance(norm=True)(data).edge_attr
    assert torch.allclose(GeometricEdgeAttr(norm=True)(data).edge_attr[:, :1], expected)


def test_geometric_edge_attr_norm_is_of_each_graph():
    data = random_poses()
    scale = torch.tensor([1.0, 2.0, 5.0]).view(3, 1, 1)
    grown = StaticData(x=data.x, edge_index=data.edge_index, pos=data.pos * scale)
    transform = GeometricEdgeAttr(norm=True)
    edge_attr = transform(grown).edge_attr
    assert torch.allclose(edge_attr, transform(data).edge_attr, atol=1e-6)
    assert torch.allclose(edge_attr[..., 0].amax(1), torch.ones(3))
    assert edge_attr.abs().max() <= 1 + 1e-6
    assert not torch.allclose(
        GeometricEdgeAttr()(grown).edge_attr, GeometricEdgeAttr()(data).edge_attr
    )


@pytest.mark.parametrize("norm", [False, True])
def test_geometric_edge_attr_moves_with_the_hand(norm):
    data = random_poses(dtype=torch.double)
    before = GeometricEdgeAttr(norm)(data).edge_attr
    for seed in range(3):
        turn = rotation(seed)
        shift = torch.randn(3, dtype=torch.double)
        data.pos = random_poses(dtype=torch.double).pos @ turn.t() + shift
        after = GeometricEdgeAttr(norm)(data).edge_attr
        assert after.dtype == torch.double
        assert torch.allclose(after[..., 0], before[..., 0], atol=1e-12)
        assert torch.allclose(after[..., 1:], before[..., 1:] @ turn.t(), atol=1e-12)


def test_geometric_edge_attr_reverse_edge():
    data = random_poses()
    forth = GeometricEdgeAttr()(data).edge_attr
    data.edge_index = data.edge_index.flip(0)
    back = GeometricEdgeAttr()(data).edge_attr
    assert torch.equal(back[..., 0], forth[..., 0])
    assert torch.equal(back[..., 1:], -forth[..., 1:])


def test_geometric_edge_attr_cat():
    data = Data(pos=POS, edge_index=EDGES, edge_attr=torch.tensor([7, 8, 9]))
    out = GeometricEdgeAttr()(data).edge_attr
    assert out.shape == (3, 5)
    assert out.dtype == torch.float
    assert out[:, 0].tolist() == [7, 8, 9]
    assert GeometricEdgeAttr(cat=False)(data).edge_attr.shape == (3, 4)
    data.edge_attr = torch.ones(3, 2, dtype=torch.double)
    assert GeometricEdgeAttr()(data).edge_attr.dtype == torch.double


@pytest.mark.parametrize("norm", [False, True])
def test_geometric_edge_attr_of_no_edges_and_loops(norm):
    transform = GeometricEdgeAttr(norm)
    single = Data(x=torch.ones(1, 3), pos=POS[:1], edge_index=torch.empty(2, 0, dtype=torch.long))
    assert transform(single).edge_attr.shape == (0, 4)
    assert transform(Batch.from_data_list([single] * 2)).edge_attr.shape == (0, 4)
    loop = Data(x=torch.ones(1, 3), pos=POS[:1], edge_index=torch.zeros(2, 1, dtype=torch.long))
    assert transform(loop).edge_attr.tolist() == [[0, 0, 0, 0]]
    assert transform(Batch.from_data_list([loop] * 2)).edge_attr.tolist() == [[0, 0, 0, 0]] * 2


def test_geometric_edge_attr_bad_input():
    transform = GeometricEdgeAttr()
    with pytest.raises(ValueError, match=r"'pos' must have shape .* \(got \(3, 2\)\)"):
        transform(Data(pos=POS[:, :2], edge_index=EDGES))
    with pytest.raises(
        ValueError, match=r"'edge_attr' must have 3 rows, one for each edge \(got 2\)"
    ):
        transform(Data(pos=POS, edge_index=EDGES, edge_attr=torch.zeros(2, 1)))
    with pytest.raises(ValueError, match=r"'max_value' requires norm=True \(got 0.1 without it\)"):
        GeometricEdgeAttr(max_value=0.1)
    for wrong in (0.0, -1.0, float("nan")):
        with pytest.raises(
            ValueError, match=rf"must be a positive length in metres \(got {wrong}\)"
        ):
            GeometricEdgeAttr(norm=True, max_value=wrong)
