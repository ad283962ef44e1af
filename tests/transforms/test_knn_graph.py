import pytest
import torch
from sklearn.neighbors import kneighbors_graph
from torch_geometric.data import Batch, Data
from torch_geometric.utils import contains_self_loops, is_undirected

from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.sensors import biotac, biotac_sp, grid
from torch_geometric_tactile.transforms import KNNGraph


def edges(pos, k=2, symmetric=True):
    return KNNGraph(k, symmetric)(Data(pos=pos)).edge_index


def sklearn_edges(pos, k, symmetric):
    graph = torch.from_numpy(kneighbors_graph(pos.double().numpy(), k).toarray())  # taxel x near
    graph = graph.t()  # edges run from the neighbour to the taxel
    return (graph + graph.t() if symmetric else graph).nonzero().t()


def random_pos(num_taxels, seed=0):
    return torch.randn(num_taxels, 3, generator=torch.Generator().manual_seed(seed))


def test_knn_graph_row_of_three():
    pos = grid(1, 3, pitch=0.002).pos
    assert edges(pos, 1, symmetric=False).tolist() == [[0, 1, 1], [1, 0, 2]]
    assert edges(pos, 1).tolist() == [[0, 1, 1, 2], [1, 0, 2, 1]]
    assert edges(pos, 2).tolist() == [[0, 0, 1, 1, 2, 2], [1, 2, 0, 2, 0, 1]]


def test_knn_graph_square():
    # 0 1
    # 2 3: two neighbours are equally near, the third is the diagonal.
    pos = grid(2, 2, pitch=0.002).pos
    assert edges(pos, 1, symmetric=False).tolist() == [[0, 0, 1, 1], [1, 2, 0, 3]]
    assert edges(pos, 2).tolist() == [[0, 0, 1, 1, 2, 2, 3, 3], [1, 2, 0, 3, 0, 3, 1, 2]]


def test_knn_graph_ties_take_lower_number():
    # The centre of a 3x3 grid has four neighbours at the same distance: 1, 3, 5, 7.
    edge_index = edges(grid(3, 3, pitch=0.0047).pos, 2, symmetric=False)
    assert edge_index[0, edge_index[1] == 4].tolist() == [1, 3]


@pytest.mark.parametrize("rows", [3, 4, 6, 8, 11])
@pytest.mark.parametrize("k", [2, 3])
def test_knn_graph_ties_ignore_rounding(rows, k):
    exact = edges(grid(rows, 5, pitch=1.0).pos.double(), k)
    for pitch in (0.0047, 0.002, 0.1):
        pos = grid(rows, 5, pitch).pos
        assert torch.equal(edges(pos, k), exact)
        assert torch.equal(edges(pos.double(), k), exact)


def test_knn_graph_rigid_motion():
    generator = torch.Generator().manual_seed(0)
    for layout in (grid(4, 4, 0.004667), grid(6, 5, 0.002), biotac(), biotac_sp()):
        before = edges(layout.pos)
        for _ in range(5):
            rotation, _ = torch.linalg.qr(
                torch.randn(3, 3, dtype=torch.double, generator=generator)
            )
            shift = 0.1 * torch.randn(3, dtype=torch.double, generator=generator)
            moved = (layout.pos.double() @ rotation + shift).float()
            assert torch.equal(edges(moved), before)


def test_knn_graph_third_coordinate():
    # Taxels 0 and 1 lie above one another, far apart; 2 is beside 0.
    pos = torch.tensor([[0.0, 0.0, 0.0], [0.0, 0.0, 0.01], [0.002, 0.0, 0.0], [0.0, 0.002, 0.01]])
    assert edges(pos, 1).tolist() == [[0, 1, 2, 3], [2, 3, 0, 1]]


@pytest.mark.parametrize("k", [1, 2, 5, 29])
@pytest.mark.parametrize("symmetric", [False, True])
def test_knn_graph_equals_sklearn(k, symmetric):
    for seed in range(3):
        pos = random_pos(30, seed)
        assert torch.equal(edges(pos, k, symmetric), sklearn_edges(pos, k, symmetric))


def test_knn_graph_symmetric_is_union():
    one_way, both = edges(random_pos(30), symmetric=False), edges(random_pos(30))
    assert not is_undirected(one_way)
    assert is_undirected(both)
    assert not contains_self_loops(both)
    assert one_way.size(1) == 60
    pairs = {tuple(pair) for pair in one_way.t().tolist()}
    assert {tuple(pair) for pair in both.t().tolist()} == pairs | {(b, a) for a, b in pairs}


@pytest.mark.parametrize("layout", [biotac(), biotac_sp()])
def test_knn_graph_biotac(layout):
    for k in (1, 2, layout.num_taxels - 1):
        one_way = edges(layout.pos, k, symmetric=False)
        assert one_way[1].bincount().tolist() == [k] * layout.num_taxels
    # For k = 2, no choice between equally near electrodes is left to chance.
    expected = sklearn_edges(layout.pos, 2, symmetric=True)
    assert edges(layout.pos, 2).size(1) == expected.size(1)
    assert torch.equal(edges(layout.pos, 2), expected)


def test_knn_graph_same_place():
    assert edges(torch.zeros(3, 3), 1, symmetric=False).tolist() == [[0, 0, 1], [1, 2, 0]]


def test_knn_graph_batch_of_sensors():
    layouts = (biotac(), grid(2, 2, 0.002))
    batch = KNNGraph(2)(Batch.from_data_list([Data(pos=layout.pos) for layout in layouts]))
    parts = [edges(layouts[0].pos), edges(layouts[1].pos) + 19]
    assert torch.equal(batch.edge_index, torch.cat(parts, dim=1))


def test_knn_graph_drops_the_numbers_of_other_edges():
    data = Data(pos=grid(1, 3, 0.002).pos, edge_index=torch.tensor([[0], [2]]))
    data.edge_attr, data.edge_weight = torch.ones(1, 4), torch.ones(1)
    out = KNNGraph(1)(data)
    assert "edge_attr" not in out
    assert "edge_weight" not in out


def test_knn_graph_bad_input():
    with pytest.raises(ValueError, match=r"'k' must be at least 1 \(got 0\)"):
        KNNGraph(0)
    for k in (3, 4):
        with pytest.raises(ValueError, match=rf"below the number of taxels, 3 \(got {k}\)"):
            edges(torch.randn(3, 3), k)
    with pytest.raises(ValueError, match=r"below the number of taxels, 1 \(got 1\)"):
        edges(torch.zeros(1, 3), 1)
    with pytest.raises(ValueError, match=r"'pos' must have shape .* \(got \(5, 2\)\)"):
        edges(torch.zeros(5, 2))
    with pytest.raises(ValueError, match=r"the same for all samples \(got \(4, 5, 3\)\)"):
        KNNGraph(2)(StaticData(x=torch.zeros(4, 5, 1), pos=torch.zeros(4, 5, 3)))
