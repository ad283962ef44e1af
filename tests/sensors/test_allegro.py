import json

import pytest
import torch
from torch_geometric.utils import contains_self_loops, is_undirected, subgraph

from torch_geometric_tactile.sensors import (
    TaxelLayout,
    allegro_uskin,
    allegro_uskin_240,
    allegro_uskin_368,
    stock_path,
)

LAYOUT = allegro_uskin()
COUNTS = {"sparse": 1000, "slanted": 1184, "original": 1401, "dense": 2488}
PITCH = 4.667e-3
PLANAR = [name for name in LAYOUT.patch_names if not name.endswith("_tip")]


def edges(name, layout=LAYOUT):
    return set(map(tuple, layout.edge_index(name).t().tolist()))


def inside(segment, name="original", by="digit"):
    """Edges of the induced subgraph of a digit or a patch."""
    names = LAYOUT.digit_names if by == "digit" else LAYOUT.patch_names
    taxels = LAYOUT.segments(by) == names.index(segment)
    return subgraph(taxels, LAYOUT.edge_index(name))[0].size(1)


def patch(name):
    return LAYOUT.patch == LAYOUT.patch_names.index(name)


def test_repr_and_names():
    assert repr(LAYOUT) == "TaxelLayout('allegro_uskin', num_taxels=384, patches=22, digits=5)"
    assert LAYOUT.digit_names == ("index", "middle", "ring", "thumb", "palm")


def test_taxels_of_digits_and_patches():
    assert LAYOUT.digit.bincount().tolist() == [72, 72, 72, 56, 112]
    tips = [name.endswith("_tip") for name in LAYOUT.patch_names]
    assert LAYOUT.patch.bincount().tolist() == [24 if tip else 16 for tip in tips]
    assert sum(tips) == 4


def test_published_edge_counts_without_self_loops_or_duplicates():
    assert {name: LAYOUT.edge_index(name).size(1) for name in LAYOUT.adjacency} == COUNTS
    for name, count in COUNTS.items():
        assert len(edges(name)) == count
        assert not contains_self_loops(LAYOUT.edge_index(name))


def test_published_edge_counts_of_segments():
    found = [inside(digit) for digit in LAYOUT.digit_names]
    assert found == [258, 258, 258, 202, 392]
    assert {inside(name, by="patch") for name in PLANAR} == {48}
    tips = set(LAYOUT.patch_names) - set(PLANAR)
    assert {inside(name, by="patch") for name in tips} == {72}


def test_one_edge_has_no_reverse():
    for name in ("sparse", "slanted", "dense"):
        assert is_undirected(LAYOUT.edge_index(name), num_nodes=384)
    ((source, target),) = {(a, b) for a, b in edges("original") if (b, a) not in edges("original")}
    assert LAYOUT.patch_names[LAYOUT.patch[source]] == "thumb_1"
    assert LAYOUT.patch_names[LAYOUT.patch[target]] == "palm_2_middle"


def test_symmetric_leaves_only_that_edge_out():
    layout = allegro_uskin(symmetric=True)
    assert edges("original", layout) == {
        (a, b) for a, b in edges("original") if (b, a) in edges("original")
    }
    assert layout.edge_index("original").size(1) == 1400
    for name in ("sparse", "slanted", "dense"):
        assert layout.edge_index(name).equal(LAYOUT.edge_index(name))
    assert layout.matches(LAYOUT)


def test_adjacencies_hold_one_another():
    original = edges("original", allegro_uskin(symmetric=True))
    assert edges("sparse") < original
    assert original | edges("slanted") == edges("dense")
    fans = original & edges("slanted")  # the diagonals of the four fans: 12 pairs each
    assert len(fans) == 4 * 12 * 2
    joined = {frozenset(LAYOUT.patch[list(edge)].tolist()) for edge in fans}
    assert joined == {
        frozenset((LAYOUT.patch_names.index(below), LAYOUT.patch_names.index(tip)))
        for below, tip in (
            ("index_3", "index_tip"),
            ("middle_3", "middle_tip"),
            ("ring_3", "ring_tip"),
            ("thumb_2", "thumb_tip"),
        )
    }


@pytest.mark.parametrize(
    ("layout", "name"), [*((LAYOUT, name) for name in COUNTS), (allegro_uskin_368(), "original")]
)
def test_adjacency_is_connected(layout, name):
    near = torch.eye(layout.num_taxels, dtype=torch.bool)
    near[tuple(layout.edge_index(name))] = True
    near |= near.t().clone()
    reached = near.float()
    for _ in range(9):  # 2 ** 9 steps are more than there are taxels
        reached = (reached @ reached).gt(0).float()
    assert reached.all()


def test_image_map_is_a_hand_of_32_x_16_cells():
    rows, columns = LAYOUT.image_map.unbind(1)
    assert (int(rows.min()), int(rows.max())) == (0, 31)
    assert (int(columns.min()), int(columns.max())) == (0, 15)
    assert len(LAYOUT.image_map.unique(dim=0)) == 384
    middle = {name: LAYOUT.image_map[patch(name)].float().mean(0) for name in LAYOUT.patch_names}
    assert middle["index_tip"][0] < middle["index_3"][0] < middle["index_1"][0]
    assert middle["ring_1"][1] < middle["middle_1"][1] < middle["index_1"][1] < middle["thumb_1"][1]


def test_image_map_is_as_the_taxels_lie_on_the_link():
    for name in LAYOUT.patch_names:
        place, cell = LAYOUT.pos[patch(name)], LAYOUT.image_map[patch(name)]
        for axis, number, sign in ((1, 1, 1), (2, 0, -1)):  # y to the right, z upwards
            steps = (place[1:, axis] - place[:-1, axis]) * sign
            cells = cell[1:, number] - cell[:-1, number]
            moved = steps.abs() > 1e-6
            assert steps[moved].sign().equal(cells[moved].sign().float())


def test_normals_point_away_from_the_link():
    assert torch.allclose(LAYOUT.normal.norm(dim=1), torch.ones(384), atol=1e-6)
    # A point below the skin is nearer to the bone, the z axis of every finger link.
    finger = LAYOUT.digit < 4
    below = LAYOUT.pos - 0.002 * LAYOUT.normal
    assert (below[finger, :2].norm(dim=1) < LAYOUT.pos[finger, :2].norm(dim=1)).all()
    assert (LAYOUT.normal[~finger] == torch.tensor([1.0, 0.0, 0.0])).all()


@pytest.mark.parametrize("name", PLANAR)
def test_pitch_of_a_planar_patch(name):
    place = LAYOUT.pos[patch(name)].view(4, 4, 3)
    for step in (place.diff(dim=0), place.diff(dim=1)):
        assert torch.allclose(step.norm(dim=-1), torch.tensor(PITCH), atol=1e-8)


def test_first_taxel_of_the_index_by_hand():
    # Centre (14.8, 0, 8.6) mm, one and a half pitches to the left and down.
    expected = torch.tensor([14.8, -1.5 * 4.667, 8.6 - 1.5 * 4.667]) * 1e-3
    assert torch.allclose(LAYOUT.pos[0], expected, atol=1e-8)
    assert LAYOUT.link_names[LAYOUT.link[0]] == "link_1"
    assert LAYOUT.normal[0].tolist() == [1, 0, 0]


def test_last_taxel_of_the_index_tip_by_hand():
    # Row 7 lies 7 * 4.667 - 16.7 = 15.969 mm beyond the cylinder: bent by 15.969 / 14.4 rad over
    # the dome. It is half a column, 13 degrees, to the right of the finger's middle.
    bend, side = torch.tensor((7 * 4.667 - 16.7) / 14.4), torch.tensor(13.0).deg2rad()
    normal = torch.stack([side.cos() * bend.cos(), side.sin(), side.cos() * bend.sin()])
    expected = (torch.tensor([-1.5, 0.0, 19.8 + 16.7]) + 14.4 * normal) * 1e-3
    last = int(patch("index_tip").nonzero().max())
    assert torch.allclose(LAYOUT.normal[last], normal, atol=1e-6)
    assert torch.allclose(LAYOUT.pos[last], expected, atol=1e-8)
    assert LAYOUT.pos[last].tolist() == pytest.approx([0.0047521, 0.0032393, 0.0490610], abs=1e-7)


def test_copied_file_with_a_moved_patch(tmp_path):
    content = json.loads(stock_path("layouts", "allegro_uskin").read_text(encoding="utf-8"))
    content["patches"][5]["origin"][0] += 1
    path = tmp_path / "mine.json"
    path.write_text(json.dumps(content), encoding="utf-8")
    layout = TaxelLayout.load(path)
    moved = torch.zeros(384, 3)
    moved[LAYOUT.patch == 5, 0] = 1e-3
    assert torch.allclose(layout.pos - LAYOUT.pos, moved, atol=1e-8)
    for name in COUNTS:
        assert layout.edge_index(name).equal(LAYOUT.edge_index(name))


def test_hand_without_palm():
    layout = allegro_uskin_240()
    assert (layout.num_taxels, len(layout.patch_names), len(layout.digit_names)) == (240, 15, 4)
    assert layout.segments("patch").bincount().tolist() == [16] * 15
    assert layout.segments("digit").bincount().tolist() == [64, 64, 64, 48]
    # Taxels of a phalanx stand where those of the hand with a palm do.
    full = allegro_uskin()
    for name in ("index_1", "ring_3", "thumb_2"):
        of, among = layout.patch_names.index(name), full.patch_names.index(name)
        assert torch.equal(layout.pos[layout.patch == of], full.pos[full.patch == among])


def test_image_map_of_the_hand_without_palm():
    cells = allegro_uskin_240().image_map
    assert cells.max(dim=0).values.tolist() == [17, 15]
    assert not ((cells[:, 0] < 4) & (cells[:, 1] >= 12)).any()  # nothing above the thumb
    for left in (0, 4, 8, 12):
        top = 4 if left == 12 else 0
        rows, columns = cells[:, 0] - top, cells[:, 1] - left
        tip = (rows >= 0) & (rows < 6) & (columns >= 0) & (columns < 4)
        assert tip.sum() == 16  # of 24 cells


def test_edges_of_the_hand_without_palm():
    layout = allegro_uskin_240()
    for name in ("sparse", "slanted", "original", "dense"):
        source, target = layout.edge_index(name)
        digit = layout.segments("digit")
        assert torch.equal(digit[source], digit[target])
        assert {tuple(e) for e in layout.edge_index(name).t().tolist()} == {
            tuple(e) for e in layout.edge_index(name).flip(0).t().tolist()
        }
    # Straight edges of 11 phalanges and 4 fingertips, 7 seams and 4 fans, both ways.
    assert layout.edge_index("original").size(1) == 2 * (11 * 24 + 4 * 22 + 7 * 4 + 4 * 13)


def test_hand_that_is_sold_today():
    layout = allegro_uskin_368()
    assert (layout.num_taxels, len(layout.patch_names), len(layout.digit_names)) == (368, 18, 5)
    assert layout.digit.bincount().tolist() == [78, 78, 78, 62, 72]
    sizes = dict(zip(layout.patch_names, layout.patch.bincount().tolist(), strict=True))
    assert sorted(sizes.values()) == [16] * 11 + [24] * 3 + [30] * 4
    full = allegro_uskin()
    for name, size in sizes.items():
        if size == 16:
            of, among = layout.patch_names.index(name), full.patch_names.index(name)
            assert torch.equal(layout.pos[layout.patch == of], full.pos[full.patch == among])


def test_places_of_the_hand_that_is_sold_today():
    # XELA's public model: taxels of a curved fingertip are 28.6 mm apart across and 13.2 mm in
    # front of its axis, and its rows 6.5 mm apart; the upper palm patches are 20.4 mm below the
    # palm's edge, 22.6 mm beside its middle, with 7.24 mm between columns.
    layout = allegro_uskin_368()
    tip = layout.pos[layout.patch == layout.patch_names.index("ring_tip")]
    assert float(tip[:, 1].max() - tip[:, 1].min()) == pytest.approx(0.0286, abs=1e-3)
    assert float(tip[:, 0].max() + 0.0015) == pytest.approx(0.0132, abs=5e-4)
    assert float(tip[6, 2] - tip[0, 2]) == pytest.approx(0.0065, abs=1e-4)
    palm = layout.pos[layout.patch == layout.patch_names.index("palm_1_index")]
    assert palm.mean(dim=0).tolist() == pytest.approx([0.019, 0.0226, -0.0204], abs=1e-4)
    assert float(palm[1, 1] - palm[0, 1]) == pytest.approx(0.00724, abs=1e-4)


def test_edges_of_the_hand_that_is_sold_today_join_all_of_it_both_ways():
    layout = allegro_uskin_368()
    for name in COUNTS:
        found = edges(name, layout)
        assert found == {(target, source) for source, target in found}
        assert not contains_self_loops(layout.edge_index(name))
    # Straight edges of 11 phalanges, 4 fingertips and 3 palm patches; seams of 4 (7 between
    # phalanges, 4 to fingertips, 2 in and beside the palm), one of 6 and 4 of 2.
    inside = 11 * 24 + 4 * (4 * 5 + 3 + 1 + 3 * 6 + 4 + 2) + 3 * (4 * 5 + 3 * 6)
    assert len(edges("original", layout)) == 2 * (inside + 13 * 4 + 6 + 4 * 2)
