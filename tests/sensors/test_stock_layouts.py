import pytest
import torch

from torch_geometric_tactile.sensors import biotac, biotac_sp, grid


def test_biotac_by_hand():
    layout = biotac()
    assert repr(layout) == "TaxelLayout('biotac', num_taxels=19, patches=1, digits=1)"
    assert layout.pos[6, 0] == pytest.approx(4.763e-3)  # E7, Table I


def test_biotac_sp_by_hand():
    layout = biotac_sp()
    assert layout.num_taxels == 24
    assert layout.pos[0, 0] == pytest.approx(0.386434851 * 0.0254)
    assert layout.pos[0, 0] == pytest.approx(9.8154e-3, abs=1e-7)


@pytest.mark.parametrize("layout", [biotac(), biotac_sp(), grid(3, 2, pitch=0.01)])
def test_normals_have_unit_length(layout):
    assert layout.normal.norm(dim=1).tolist() == pytest.approx([1.0] * len(layout), abs=1e-4)


@pytest.mark.parametrize("layout", [biotac(), biotac_sp()])
def test_fingertips_are_centimetres_large_and_hold_no_taxel_twice(layout):
    assert 0.01 < float((layout.pos.amax(0) - layout.pos.amin(0)).max()) < 0.03
    assert len(layout.pos.unique(dim=0)) == len(layout)


def test_biotac_sp_is_mirrored_in_z():
    layout = biotac_sp()
    mirror = torch.tensor([1.0, 1.0, -1.0])
    assert layout.pos[10:20].equal(layout.pos[:10] * mirror)
    assert layout.normal[10:20].equal(layout.normal[:10] * mirror)
    assert layout.pos[:10, 2].gt(0).all()


def test_grid_by_hand():
    layout = grid(2, 3, pitch=0.004)
    assert repr(layout) == "TaxelLayout('grid_2x3', num_taxels=6, patches=1, digits=1)"
    expected = [[0, 0, 0], [4, 0, 0], [8, 0, 0], [0, 4, 0], [4, 4, 0], [8, 4, 0]]
    assert torch.allclose(layout.pos, torch.tensor(expected) * 1e-3)
    assert layout.normal.tolist() == [[0.0, 0.0, 1.0]] * 6
    assert layout.image_map.tolist() == [[0, 0], [0, 1], [0, 2], [1, 0], [1, 1], [1, 2]]


def edges(layout, name):
    return set(map(tuple, layout.edge_index(name).t().tolist()))


def test_grid_edges_by_hand():
    layout = grid(2, 2, pitch=0.004)
    straight = {(0, 1), (1, 0), (2, 3), (3, 2), (0, 2), (2, 0), (1, 3), (3, 1)}
    slanted = {(0, 3), (3, 0), (1, 2), (2, 1)}
    assert edges(layout, "original") == straight
    assert edges(layout, "slanted") == slanted
    assert edges(layout, "dense") == straight | slanted


def test_grid_edge_counts_of_the_papers():
    layout = grid(4, 4, pitch=0.004667)
    counts = {name: layout.edge_index(name).size(1) for name in layout.adjacency}
    assert counts == {"original": 48, "slanted": 36, "dense": 84}
    for name, count in counts.items():
        assert len(edges(layout, name)) == count


@pytest.mark.parametrize(("rows", "cols"), [(3, 5), (5, 3), (1, 4), (4, 1)])
def test_grid_edges_join_neighbours_in_both_directions(rows, cols):
    layout = grid(rows, cols, pitch=1.0)
    for name, lengths in (("original", {1}), ("slanted", {2}), ("dense", {1, 2})):
        found = edges(layout, name)
        assert found == {(target, source) for source, target in found}
        for source, target in found:
            square = (layout.pos[source] - layout.pos[target]).square().sum()
            assert int(square.round()) in lengths
    assert layout.edge_index("original").size(1) == 2 * (rows * (cols - 1) + cols * (rows - 1))
    assert layout.edge_index("slanted").size(1) == 4 * (rows - 1) * (cols - 1)


def test_grid_single_taxel_has_no_edges():
    layout = grid(1, 1, pitch=0.004)
    for name in ("original", "slanted", "dense"):
        assert layout.edge_index(name).shape == (2, 0)
    assert layout.pos.tolist() == [[0.0, 0.0, 0.0]]
