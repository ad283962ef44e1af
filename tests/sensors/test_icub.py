import pytest
import torch

from torch_geometric_tactile.sensors import TaxelLayout, as_layout, icub_fingertip, icub_hand


def test_fingertip_at_the_places_of_its_source():
    layout = icub_fingertip()
    assert repr(layout) == "TaxelLayout('icub_fingertip', num_taxels=12, patches=1, digits=1)"
    assert layout.pos[10].tolist() == pytest.approx([-0.0187, 0.0016, 0.0025])
    assert layout.normal[10].tolist() == pytest.approx([-0.5, 0.471671, 0.72631])
    assert layout.pos[11].tolist() == pytest.approx([-0.0209, 0.0, 0.0])
    assert layout.normal[11].tolist() == [-1.0, 0.0, 0.0]
    assert layout.normal.norm(dim=1).tolist() == pytest.approx([1.0] * 12, abs=1e-5)
    assert "electronics-boards-public" in layout.source


def test_edges_join_what_is_near():
    layout = icub_fingertip()
    distance = torch.cdist(layout.pos, layout.pos)
    near = (distance < 0.0049) & (distance > 0)
    assert set(zip(*layout.edge_index("original").tolist(), strict=True)) == set(
        zip(*near.nonzero().T.tolist(), strict=True)
    )
    assert layout.edge_index("original").shape == (2, 38)
    assert near.any(dim=1).all()


def test_image_map_keeps_sides():
    layout = icub_fingertip()
    rows, columns = layout.image_map.T
    for a in range(12):
        for b in range(12):
            if layout.pos[a, 0] > layout.pos[b, 0]:
                assert rows[a] < rows[b]
            if rows[a] == rows[b] and columns[a] < columns[b]:
                assert layout.pos[a, 2] < layout.pos[b, 2]


def test_hand_is_five_fingertips():
    tip, hand = icub_fingertip(), icub_hand()
    fingers = ["thumb", "index", "middle", "ring", "little"]
    joined = TaxelLayout.join([tip] * 5, fingers, name="icub_hand")
    assert hand.name == joined.name == "icub_hand"
    for key in ("pos", "normal", "digit", "patch", "link", "image_map"):
        assert getattr(hand, key).equal(getattr(joined, key)), key
    for key in ("digit_names", "patch_names", "link_names"):
        assert getattr(hand, key) == tuple(fingers)
    assert hand.edge_index("original").equal(joined.edge_index("original"))
    assert as_layout("icub_hand").matches(hand)
