from dataclasses import FrozenInstanceError

import pytest
import torch

from torch_geometric_tactile.sensors import TaxelLayout, grid

POS = torch.tensor([[0.0, 0.0, 0.0], [0.0, 0.003, 0.004], [0.01, 0.0, 0.0]])
XY = torch.eye(3)[:2].expand(3, 2, 3)


def test_layout_repr_and_length():
    layout = TaxelLayout("thumb", POS)
    assert repr(layout) == "TaxelLayout('thumb', num_taxels=3, patches=1, digits=1)"
    assert len(layout) == layout.num_taxels == 3


def test_layout_defaults_are_one_link_patch_and_digit():
    layout = TaxelLayout("thumb", POS)
    assert layout.link.tolist() == layout.patch.tolist() == layout.digit.tolist() == [0, 0, 0]
    assert layout.normal is None
    assert layout.image_map is None
    assert dict(layout.adjacency) == {}


def test_layout_single_taxel():
    layout = TaxelLayout("dot", [[1.0, 2.0, 3.0]], adjacency={"none": torch.empty(2, 0)})
    assert layout.num_taxels == 1
    assert layout.segments("digit").tolist() == [0]
    assert layout.edge_index("none").shape == (2, 0)
    assert layout.edge_index("none").dtype == torch.long


def test_layout_of_a_flat_pad_has_z_zero():
    layout = TaxelLayout("pad", [[0.01, 0.02], [0.03, 0.04]])
    assert layout.pos.tolist() == torch.tensor([[0.01, 0.02, 0.0], [0.03, 0.04, 0.0]]).tolist()
    assert layout.normal is None


def test_layout_segments_by_hand():
    layout = TaxelLayout(
        "hand",
        POS,
        patch=[0, 1, 1],
        digit=[1, 0, 0],
        patch_names=("a", "b"),
        digit_names=("x", "y"),
    )
    assert layout.segments("patch").tolist() == [0, 1, 1]
    assert layout.segments("digit").tolist() == [1, 0, 0]
    assert repr(layout).endswith("patches=2, digits=2)")


def test_layout_is_frozen():
    layout = grid(2, 2, pitch=0.01)
    with pytest.raises(FrozenInstanceError):
        layout.pos = POS
    with pytest.raises(FrozenInstanceError):
        del layout.name


def test_layout_matches_same_places_only():
    layout = TaxelLayout("thumb", POS)
    assert layout.matches(TaxelLayout("other name", POS + 5e-10))
    assert not layout.matches(TaxelLayout("thumb", POS + torch.tensor([0.0, 0.0, 1e-6])))
    assert not layout.matches(TaxelLayout("thumb", POS[:2]))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"pos": torch.zeros(3)}, r"'pos' must have shape \(num_taxels, 3\), or .*\(got \(3,\)\)"),
        ({"pos": torch.zeros(3, 4)}, r"'pos' must have shape .* \(got \(3, 4\)\)"),
        ({"pos": torch.zeros(0, 3)}, r"'pos' must have shape .* \(got \(0, 3\)\)"),
        ({"pos": POS / 0}, "'pos' must hold finite numbers"),
        ({"normal": POS[:2]}, r"'normal' must have shape \(3, 3\) \(got \(2, 3\)\)"),
        ({"normal": torch.ones(3, 3)}, r"'normal' must hold unit vectors \(got a length of 1.732"),
        ({"tangent": POS[:2]}, r"'tangent' must have shape \(3, 2, 3\) \(got \(2, 3\)\)"),
        ({"tangent": XY * 0.9}, r"'tangent' must hold unit vectors \(got a length of 0.9\)"),
        ({"tangent": XY[:, [0, 0]]}, r"must hold axes at right angles .* \(got a cosine of 1\)"),
        (
            {"tangent": XY, "normal": [[0.6, 0.0, 0.8]] * 3},
            r"to each other and to the normals \(got a cosine of 0.6\)",
        ),
        ({"link": [0.0, 0.5, 0.0]}, r"'link' must be a whole number for each taxel"),
        ({"link": [0, 0]}, r"'link' must have shape \(3,\) \(got \(2,\)\)"),
        (
            {"patch": [0, 0, 1]},
            r"'patch' must hold indices into 'patch_names', 0 to 0 \(got 0 to 1",
        ),
        ({"image_map": [[0, 0]]}, r"'image_map' must have shape \(3, 2\) \(got \(1, 2\)\)"),
        ({"image_map": [[0, 0], [0, 1], [0, 1]]}, "each taxel a separate cell"),
        ({"image_map": [[0, 0], [0, 1.2], [0, 1.4]]}, "'image_map' must hold whole numbers"),
        ({"image_map": [[0, 0], [0, 1], [1 << 14, 1]]}, r"0 to 16383 \(got 16384\)"),
        ({"name": 3}, r"'name' must be a string \(got 3\)"),
        ({"link_names": "base"}, r"'link_names' must be a list of strings \(got 'base'\)"),
        ({"patch_names": ("a", "a")}, "'patch_names' must differ from one another"),
        ({"adjacency": {"a": torch.zeros(3, 2)}}, r"adjacency 'a' must have shape \(2, num_edges"),
        ({"adjacency": {"a": [[0.5], [1.0]]}}, "adjacency 'a' must hold whole numbers"),
        ({"adjacency": {"a": [[0], [3]]}}, r"adjacency 'a' must join taxels 0 to 2 \(got 0 to 3"),
    ],
)
def test_layout_rejects(arguments, message):
    with pytest.raises(ValueError, match=message):
        TaxelLayout(**{"name": "bad", "pos": POS, **arguments})


def test_edge_index_unknown_name_lists_the_known():
    with pytest.raises(ValueError, match=r"'original', 'slanted', 'dense' \(got 'round'\)"):
        grid(2, 2, pitch=0.01).edge_index("round")
    with pytest.raises(ValueError, match="none; see KNNGraph"):
        TaxelLayout("bare", POS).edge_index("original")


@pytest.mark.parametrize(
    ("names", "expected"),
    [(["ring", "original"], "original"), (["ring"], "ring"), (["ring", "star"], None), ([], None)],
)
def test_default_adjacency_is_the_original_or_the_only_one(names, expected):
    adjacency = {name: torch.tensor([[0], [1]]) for name in names}
    assert TaxelLayout("thumb", POS, adjacency=adjacency).default_adjacency == expected


def test_segments_unknown_kind():
    with pytest.raises(ValueError, match=r"'by' must be one of .* \(got 'link'\)"):
        TaxelLayout("bare", POS).segments("link")


def test_with_adjacency_adds_or_replaces_one_and_is_the_default():
    layout = TaxelLayout("bare", POS)
    with pytest.raises(
        ValueError, match=r"'name' must be an adjacency.*'bare': none; see KNNGraph \(got"
    ):
        layout.edge_index()
    edges = torch.tensor([[0, 1], [1, 0]])
    ring = layout.with_adjacency("ring", edges)
    assert ring.edge_index().equal(edges)
    assert not layout.adjacency
    assert (ring.name, ring.pos is layout.pos or ring.pos.equal(layout.pos)) == ("bare", True)
    two = ring.with_adjacency("line", edges[:, :1])
    assert sorted(two.adjacency) == ["line", "ring"]
    with pytest.raises(
        ValueError, match=r"'name' must be an adjacency.*'ring', 'line' \(got None\)"
    ):
        two.edge_index()
    assert two.with_adjacency("original", edges.flip(0)).edge_index().equal(edges.flip(0))
    assert two.with_adjacency("ring", edges[:, 1:]).edge_index("ring").equal(edges[:, 1:])
    with pytest.raises(ValueError, match="adjacency 'far'"):
        layout.with_adjacency("far", torch.tensor([[0], [99]]))
