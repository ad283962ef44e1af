import numpy as np
import pytest
import torch
from scipy.sparse.csgraph import connected_components
from torch_geometric.data import Data
from torch_geometric.utils import to_scipy_sparse_matrix

from torch_geometric_tactile.sensors import (
    TaxelLayout,
    allegro_uskin,
    biotac_sp,
    grid,
    hexagonal,
    layout_sectors,
    letter_array,
    select_taxels,
    thinned,
)
from torch_geometric_tactile.transforms import KNNGraph


def parts(edge_index, num_taxels):
    # The number of parts, and the share of the largest.
    count, part = connected_components(to_scipy_sparse_matrix(edge_index, num_nodes=num_taxels))
    return count, np.bincount(part).max() / num_taxels


def test_selected_taxels_by_hand():
    layout = grid(2, 3, pitch=0.004)
    chosen = select_taxels(layout, [5, 0, 4, 1])
    assert repr(chosen) == "TaxelLayout('grid_2x3_4', num_taxels=4, patches=1, digits=1)"
    assert torch.equal(chosen.pos, layout.pos[[5, 0, 4, 1]])
    assert torch.equal(chosen.normal, layout.normal[:4])
    assert torch.equal(chosen.tangent, layout.tangent[:4])
    assert chosen.image_map.tolist() == [[1, 2], [0, 0], [1, 1], [0, 1]]
    edges = set(map(tuple, chosen.edge_index("original").t().tolist()))
    assert edges == {(0, 2), (2, 0), (1, 3), (3, 1), (2, 3), (3, 2)}
    assert list(chosen.adjacency) == list(layout.adjacency)
    assert chosen.source == layout.source


def test_all_taxels_are_the_layout():
    layout = allegro_uskin()
    same = select_taxels(layout, torch.arange(layout.num_taxels), name=layout.name)
    assert same.to_dict() == layout.to_dict()


def test_a_mask_keeps_the_order():
    layout = letter_array()
    dead = torch.isin(layout.image_map[:, 0], torch.tensor([3, 4, 20]))
    alive = select_taxels(layout, ~dead, name="alive")
    assert alive.name == "alive"
    assert alive.num_taxels == 29 * 32
    assert torch.equal(alive.image_map, layout.image_map[~dead])
    assert parts(alive.edge_index("original"), alive.num_taxels)[0] == 3
    sectors = layout_sectors(alive)
    assert parts(sectors.edge_index, alive.num_taxels)[0] == 1


def test_patches_and_digits_without_a_taxel_are_left_out():
    layout = allegro_uskin()
    chosen = layout.digit == 2
    finger = select_taxels(layout, chosen)
    assert finger.digit_names == (layout.digit_names[2],)
    assert finger.digit.tolist() == [0] * finger.num_taxels
    before = [layout.patch_names[i] for i in layout.patch[chosen].tolist()]
    assert [finger.patch_names[i] for i in finger.patch.tolist()] == before
    assert len(finger.patch_names) == len(set(before)) < len(layout.patch_names)
    assert torch.equal(finger.link, layout.link[chosen])
    assert finger.link_names == layout.link_names


def test_what_a_layout_lacks_its_part_lacks():
    layout = TaxelLayout("bare", torch.eye(3))
    chosen = select_taxels(layout, [2])
    assert chosen.pos.tolist() == [[0, 0, 1]]
    assert chosen.normal is None
    assert chosen.tangent is None
    assert chosen.image_map is None
    assert dict(chosen.adjacency) == {}


@pytest.mark.parametrize("layout", [letter_array(), hexagonal(7, 5, 0.01), biotac_sp()], ids=str)
def test_thinned_layouts_are_saved_and_read(tmp_path, layout):
    thin = thinned(layout, keep=0.4, seed=3)
    thin.save(tmp_path / "layout.json")
    loaded = TaxelLayout.load(tmp_path / "layout.json")
    assert loaded.to_dict() == thin.to_dict()
    assert loaded.matches(thin)


def test_thinned_is_a_random_part():
    layout = letter_array()
    thin = thinned(layout, keep=0.4, seed=0)
    assert thin.num_taxels == round(0.4 * 1024)
    cell = thin.image_map @ torch.tensor([32, 1])
    assert (cell.diff() > 0).all()
    assert torch.equal(thin.pos, layout.pos[cell])
    assert thinned(layout, keep=0.4, seed=0).matches(thin)
    assert not thinned(layout, keep=0.4, seed=1).matches(thin)
    more = thinned(layout, keep=0.7, seed=0).image_map @ torch.tensor([32, 1])
    assert torch.isin(cell, more).all()
    assert thinned(layout, keep=1.0).matches(layout)
    assert thinned(layout, keep=1e-9).num_taxels == 1


def test_a_thin_grid_falls_apart_until_it_is_joined_anew():
    thin = thinned(letter_array(), keep=0.4)
    count, largest = parts(thin.edge_index("original"), thin.num_taxels)
    assert count > 100
    assert largest < 0.1
    joined = KNNGraph(k=6)(Data(pos=thin.pos)).edge_index
    assert parts(joined, thin.num_taxels)[0] == 1
    assert parts(layout_sectors(thin).edge_index, thin.num_taxels)[0] == 1


@pytest.mark.parametrize(
    ("taxels", "message"),
    [
        ([], r"'taxels' must be a list of taxels, .*\(got shape \(0,\), torch.float32\)"),
        (torch.tensor([], dtype=torch.long), r"'taxels' must keep at least one taxel \(got none\)"),
        ([False] * 6, r"'taxels' must keep at least one taxel \(got none\)"),
        ([True] * 5, r"'taxels' must have a boolean for each of 6 taxels \(got 5\)"),
        ([0, 6], r"'taxels' must be numbers from 0 to 5 \(got 6\)"),
        ([0, 2, 0], r"'taxels' must name each taxel once \(got 3 indices for 2 taxels\)"),
        ([[0, 1]], r"'taxels' must be a list of taxels, .*got shape \(1, 2\)"),
    ],
)
def test_bad_taxels_are_refused(taxels, message):
    with pytest.raises(ValueError, match=message):
        select_taxels(grid(2, 3, pitch=0.01), taxels)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"keep": 0.0}, r"'keep' must be a fraction above 0 and at most 1 \(got 0.0\)"),
        ({"keep": 1.1}, r"'keep' must be a fraction above 0 and at most 1 \(got 1.1\)"),
        ({"keep": 0.5, "seed": -1}, r"'seed' must not be negative \(got -1\)"),
    ],
)
def test_bad_parts_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        thinned(grid(2, 3, pitch=0.01), **arguments)
