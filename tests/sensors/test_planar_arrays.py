import pytest
import torch

from torch_geometric_tactile.sensors import grid, hexagonal, layout_sectors


def edges(layout):
    return set(map(tuple, layout.edge_index("original").t().tolist()))


def test_hexagonal_by_hand():
    layout = hexagonal(3, 2, pitch=0.002)
    assert repr(layout) == "TaxelLayout('hexagonal_3x2', num_taxels=6, patches=1, digits=1)"
    x, y = [0, 2, 1, 3, 0, 2], [0, 0, 3**0.5, 3**0.5, 12**0.5, 12**0.5]
    expected = torch.tensor([x, y, [0] * 6]).t() * 1e-3
    assert torch.allclose(layout.pos, expected, atol=1e-9)
    assert layout.normal.tolist() == [[0.0, 0.0, 1.0]] * 6
    assert torch.equal(layout.axes(), torch.eye(3).expand(6, 3, 3))
    assert layout.image_map.tolist() == [[0, 0], [0, 1], [1, 0], [1, 1], [2, 0], [2, 1]]
    pairs = {(0, 1), (2, 3), (4, 5), (0, 2), (1, 2), (1, 3), (2, 4), (2, 5), (3, 5)}
    assert edges(layout) == pairs | {(j, i) for i, j in pairs}


@pytest.mark.parametrize(("rows", "cols"), [(1, 1), (1, 4), (4, 1), (2, 3), (5, 4), (6, 7)])
def test_hexagonal_edges_are_all_pairs_at_the_pitch(rows, cols):
    layout = hexagonal(rows, cols, pitch=0.00125)
    distance = torch.cdist(layout.pos.double(), layout.pos.double()) / 0.00125
    near = (distance - 1).abs() < 1e-3
    assert edges(layout) == set(map(tuple, near.nonzero().tolist()))
    assert layout.edge_index("original").size(1) == int(near.sum())
    assert (distance + 9 * torch.eye(rows * cols)).min() > 1 - 1e-3


def test_six_sectors_are_the_six_neighbours():
    layout = hexagonal(5, 6, pitch=0.01)
    found = layout_sectors(layout, num_sectors=6, radius=0.011)
    assert set(map(tuple, found.edge_index.t().tolist())) == edges(layout)
    inner = found.edge_index[1] == 2 * 6 + 2
    assert found.sector[inner].tolist() == [0, 1, 2, 3, 4, 5]
    assert found.edge_index[0, inner].tolist() == [15, 20, 19, 13, 7, 8]


@pytest.mark.parametrize("make", [grid, hexagonal])
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((0, 3, 0.1), r"'rows' and 'cols' must be at least 1 \(got 0 and 3\)"),
        ((3, 0, 0.1), r"'rows' and 'cols' must be at least 1 \(got 3 and 0\)"),
        ((10**6, 2, 0.1), r"at most 1000000 taxels \(got 1000000 and 2\)"),
        ((3, 3, 0.0), r"'pitch' must be a positive length in metres \(got 0.0\)"),
        ((3, 3, float("inf")), r"'pitch' must be a positive length in metres \(got inf\)"),
    ],
)
def test_bad_sizes_are_refused_before_taxels_are_made(make, arguments, message):
    with pytest.raises(ValueError, match=message):
        make(*arguments)
