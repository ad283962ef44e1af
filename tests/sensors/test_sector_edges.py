import importlib
import math

import pytest
import torch

from torch_geometric_tactile.sensors import (
    TaxelLayout,
    allegro_uskin,
    biotac_sp,
    grid,
    layout_sectors,
    sector_edges,
)

# Row and column of the neighbour in each of eight sectors.
STEPS = [(0, 1), (1, 1), (1, 0), (1, -1), (0, -1), (-1, -1), (-1, 0), (-1, 1)]
FLAT = torch.eye(3)


def edges(pos, num_sectors=8, axes=FLAT, **kwargs):
    """Neighbour by taxel and sector."""
    pos = torch.as_tensor(pos, dtype=torch.float)
    found = sector_edges(pos, axes.expand(len(pos), 3, 3), num_sectors, **kwargs)
    neighbours, targets = found.edge_index.tolist()
    keys = list(zip(targets, found.sector.tolist(), strict=True))
    assert keys == sorted(set(keys))
    return dict(zip(keys, neighbours, strict=True))


def around(angles, lengths=None, **kwargs):
    """The neighbours of a taxel at the origin by sector, of taxels at angles in degrees."""
    lengths = [1.0] * len(angles) if lengths is None else lengths
    places = [
        (r * math.cos(math.radians(a)), r * math.sin(math.radians(a)), 0.0)
        for a, r in zip(angles, lengths, strict=True)
    ]
    found = edges([(0.0, 0.0, 0.0), *places], **{"radius": 100.0, **kwargs})
    return {sector: j - 1 for (i, sector), j in found.items() if i == 0}


@pytest.mark.parametrize("ratio", [0.42, 0.5, 1.0, 2.0, 2.4])
@pytest.mark.parametrize("size", [(5, 7), (1, 3), (4, 1), (2, 2)])
def test_sector_edges_of_a_grid_are_the_eight_cells(ratio, size):
    layout = grid(*size, pitch=0.002)
    found = edges(layout.pos * torch.tensor([1.0, ratio, 1.0]))
    rows, cols = size
    expected = {
        (r * cols + c, s): (r + dr) * cols + c + dc
        for r in range(rows)
        for c in range(cols)
        for s, (dr, dc) in enumerate(STEPS)
        if 0 <= r + dr < rows and 0 <= c + dc < cols
    }
    assert found == expected


def test_sector_edges_counter_clockwise_from_x():
    assert around([0, 45, 90, 135, 180, 225, 270, 315]) == {s: s for s in range(8)}
    assert around([0, 90, 180, 270], num_sectors=4) == {s: s for s in range(4)}
    assert around([0, 120, 240], num_sectors=3) == {s: s for s in range(3)}
    assert around([10, 200], [2.0, 1.0], num_sectors=1) == {0: 1}


def test_sector_edges_seen_from_the_tip_of_the_normal():
    # The same taxels, turned in space with their axes.
    turn, _ = torch.linalg.qr(
        torch.randn(3, 3, generator=torch.Generator().manual_seed(0)).double()
    )
    turn = turn * turn.det()
    pos = grid(3, 4, 0.002).pos.double()
    axes = (torch.eye(3).double() @ turn.t()).expand(12, 3, 3)
    turned = sector_edges(pos @ turn.t() + 0.3, axes)
    assert torch.equal(turned.edge_index, sector_edges(pos, FLAT.expand(12, 3, 3)).edge_index)
    assert torch.equal(turned.sector, sector_edges(pos, FLAT.expand(12, 3, 3)).sector)
    # Seen from the other side, the order is reversed.
    other = torch.diag(torch.tensor([1.0, -1.0, -1.0]))
    assert edges([(0, 0, 0), (0, 1, 0)], axes=other)[0, 6] == 1
    assert edges([(0, 0, 0), (0, 1, 0)])[0, 2] == 1


def test_sector_edges_border_belongs_to_the_next():
    for angle, expected in ((22.5, 1), (22.4, 0), (337.5, 0), (337.4, 7)):
        assert around([angle]) == {expected: 0}


def test_sector_edges_ties():
    assert around([0, 5], [1.0, 0.9]) == {0: 1}  # the nearer
    assert around([15, -5, 10]) == {0: 1}  # as near: the one closer to the middle
    assert around([10, -10]) == {0: 0}  # as close: the lower number
    assert around([-10, 10]) == {0: 0}
    assert around([10, -10], [1.00001, 1.0]) == {0: 0}  # equal but for rounding


def test_sector_edges_nearest_in_space():
    # The second lies below the skin: closer in the plane, farther away.
    pos = [(0, 0, 0), (1.0, 0, 0), (0.5, 0, -2.0)]
    assert edges(pos, radius=5.0)[0, 0] == 1
    assert edges([(0, 0, 0), (0, 0, 1.0)], radius=5.0) == {}  # exactly above: in no sector


def test_sector_edges_radius():
    row = [(0.0, 0, 0), (1.0, 0, 0), (3.9, 0, 0), (4.9, 0, 0)]
    near = {(0, 0): 1, (1, 4): 0, (2, 0): 3, (3, 4): 2}
    assert edges(row) == near | {(1, 0): 2, (2, 4): 1}  # within three times the distance of 1
    assert edges(row, radius=2.0) == near
    assert edges(row, radius=2.9) == edges(row)  # up to and with it
    assert edges([(0.0, 0, 0), (1.0, 0, 0), (4.1, 0, 0), (5.1, 0, 0)]) == near  # 3.1 is beyond
    far = [*row, (9.9, 0, 0)]  # 5 to its nearest: its own distance counts
    assert edges(far)[4, 4] == 3
    assert (3, 0) not in edges(far)


def test_sector_edges_group():
    row = [(0.0, 0, 0), (1.0, 0, 0), (2.0, 0, 0), (3.0, 0, 0)]
    group = torch.tensor([7, 7, -1, -1])
    assert edges(row, group=group) == {(0, 0): 1, (1, 4): 0, (2, 0): 3, (3, 4): 2}
    assert edges(row, group=torch.arange(4)) == {}


def test_sector_edges_same_place_and_single():
    assert edges([(0, 0, 0)]) == {}
    assert edges([(0, 0, 0), (0, 0, 0)]) == {}


def test_sector_edges_two_axes_are_enough():
    pos, axes = biotac_sp().pos, biotac_sp().axes()
    assert torch.equal(sector_edges(pos, axes).sector, sector_edges(pos, axes[:, :2]).sector)


def test_sector_edges_blocks(monkeypatch):
    module = importlib.import_module("torch_geometric_tactile.sensors.sector_edges")
    layout = biotac_sp()
    whole = sector_edges(layout.pos, layout.axes())
    monkeypatch.setattr(module, "_MAX_PAIRS", 50)
    parts = sector_edges(layout.pos, layout.axes())
    assert torch.equal(parts.edge_index, whole.edge_index)
    assert torch.equal(parts.sector, whole.sector)


def test_layout_sectors_stay_within():
    layout = allegro_uskin()
    source, target = layout_sectors(layout).edge_index
    assert torch.equal(layout.patch[source], layout.patch[target])
    numbers = {
        "link": torch.tensor([0, 0, 1, 1]),
        "patch": torch.tensor([0, 1, 1, 1]),
        "link_names": ("a", "b"),
        "patch_names": ("c", "d"),
    }
    row = TaxelLayout("row", grid(1, 4, 0.001).pos, **numbers)
    assert layout_sectors(row).edge_index.tolist() == [[3, 2], [2, 3]]
    assert layout_sectors(row, within="link").edge_index.tolist() == [[1, 0, 3, 2], [0, 1, 2, 3]]


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ({"pos": torch.zeros(4, 2)}, r"'pos' must have shape \(num_taxels, 3\) \(got \(4, 2\)\)"),
        ({"axes": torch.eye(3)}, r"'axes' must have shape \(4, 3, 3\).* \(got \(3, 3\)\)"),
        ({"num_sectors": 0}, r"'num_sectors' must be at least 1 \(got 0\)"),
        ({"radius": 0.0}, r"'radius' must be positive metres \(got 0.0\)"),
        ({"group": torch.zeros(3).long()}, r"'group' must have shape \(4,\) \(got \(3,\)\)"),
    ],
)
def test_sector_edges_bad_input(arguments, match):
    given = {"pos": torch.zeros(4, 3), "axes": torch.zeros(4, 3, 3), **arguments}
    with pytest.raises(ValueError, match=match):
        sector_edges(**given)


def test_layout_sectors_bad_within():
    with pytest.raises(ValueError, match=r"'within' must be 'patch' or 'link' \(got 'digit'\)"):
        layout_sectors(biotac_sp(), within="digit")
