import pytest
import torch

from torch_geometric_tactile.sensors import (
    HandKinematics,
    Joint,
    TaxelLayout,
    allegro_uskin,
    biotac_sp,
    grid,
)

LINE = TaxelLayout("line", [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]], adjacency={"a": [[0, 1], [1, 0]]})
PALM = TaxelLayout(
    "palm",
    [[0.0, 0.0, 0.2], [0.0, 0.0, 0.3], [0.0, 0.0, 0.4]],
    link=[1, 0, 0],
    link_names=("wrist", "palm"),
    patch=[0, 1, 1],
    patch_names=("low", "high"),
    adjacency={"a": [[2], [0]], "b": [[0], [1]]},
    source="measured",
)


def test_join_by_hand():
    hand = TaxelLayout.join([LINE, PALM, LINE], ["index", "palm", "thumb"], name="toy")
    assert repr(hand) == "TaxelLayout('toy', num_taxels=7, patches=4, digits=3)"
    assert hand.pos.equal(torch.cat([LINE.pos, PALM.pos, LINE.pos]))
    assert hand.digit_names == ("index", "palm", "thumb")
    assert hand.digit.tolist() == [0, 0, 1, 1, 1, 2, 2]
    assert hand.patch_names == ("index", "palm_low", "palm_high", "thumb")
    assert hand.patch.tolist() == [0, 0, 1, 2, 2, 3, 3]
    assert hand.link_names == ("index", "palm_wrist", "palm_palm", "thumb")
    assert hand.link.tolist() == [0, 0, 2, 1, 1, 3, 3]
    assert list(hand.adjacency) == ["a"]
    assert hand.edge_index("a").tolist() == [[0, 1, 4, 5, 6], [1, 0, 2, 6, 5]]
    assert hand.source == "measured"
    assert hand.normal is None
    assert hand.image_map is None


def test_join_keeps_normals_and_maps_that_all_have():
    pads = TaxelLayout.join([grid(2, 2, 0.01), grid(1, 3, 0.01)])
    assert pads.digit_names == ("grid_2x2", "grid_1x3")
    assert pads.normal.equal(torch.tensor([[0.0, 0.0, 1.0]]).expand(7, 3))
    cells = [[0, 0], [0, 1], [1, 0], [1, 1], [0, 2], [0, 3], [0, 4]]
    assert pads.image_map.tolist() == cells
    assert set(pads.adjacency) == {"original", "slanted", "dense"}
    assert pads.tangent.equal(torch.eye(3, dtype=torch.double)[:2].expand(7, 2, 3))
    mixed = TaxelLayout.join([grid(2, 2, 0.01), LINE], ["pad", "line"])
    assert mixed.normal is None
    assert mixed.tangent is None


def test_join_of_one_is_itself():
    hand = TaxelLayout.join([allegro_uskin()], ["right"])
    assert hand.matches(allegro_uskin())
    assert hand.edge_index("original").equal(allegro_uskin().edge_index("original"))
    assert hand.digit_names[0] == "right_index"


def test_joined_hand_is_saved_and_moved_by_its_links(tmp_path):
    hand = TaxelLayout.join([LINE, LINE], ["index", "thumb"], links=["tip_1", "tip_2"])
    hand.save(tmp_path / "hand.json")
    again = TaxelLayout.load(tmp_path / "hand.json")
    assert again.link_names == ("tip_1", "tip_2")
    assert again.edge_index("a").equal(hand.edge_index("a"))
    joints = [
        Joint("one", "base", "tip_1", xyz=(0, 1, 0), axis=(0, 0, 1)),
        Joint("two", "base", "tip_2", xyz=(0, 2, 0)),
    ]
    pos, _ = HandKinematics(joints).taxel_pose(again, torch.zeros(1))
    expected = torch.tensor([[0.0, 1.0, 0.0], [0.1, 1.0, 0.0], [0.0, 2.0, 0.0], [0.1, 2.0, 0.0]])
    torch.testing.assert_close(pos, expected)


def test_layouts_on_one_link_are_placed_by_poses():
    turned = torch.tensor([[0.0, -1.0, 0.0, 1.0], [1.0, 0, 0, 2.0], [0, 0, 1.0, 3.0], [0, 0, 0, 1]])
    pose = torch.stack([torch.eye(4), turned])
    sides = [grid(1, 2, 0.5), grid(1, 2, 0.5)]
    cube = TaxelLayout.join(sides, ["a", "b"], links=["cube", "cube"], pose=pose)
    assert cube.link_names == ("cube",)
    assert cube.pos.tolist() == [[0, 0, 0], [0.5, 0, 0], [1, 2, 3], [1, 2.5, 3]]
    assert cube.normal.tolist() == [[0, 0, 1]] * 4
    straight, turned = [[1, 0, 0], [0, 1, 0]], [[0, 1, 0], [-1, 0, 0]]
    assert cube.tangent.tolist() == [straight, straight, turned, turned]


def test_join_of_fingertips_has_names():
    hand = TaxelLayout.join([biotac_sp()] * 3, ["index", "middle", "thumb"])
    assert hand.digit.bincount().tolist() == [24, 24, 24]
    assert hand.normal.equal(biotac_sp().normal.repeat(3, 1))


@pytest.mark.parametrize(
    ("layouts", "arguments", "message"),
    [
        ([], {}, r"'layouts' must hold at least one layout \(got none\)"),
        ([LINE, LINE], {}, r"'names' must differ from one another \(got \['line', 'line'\]\)"),
        (
            [LINE, LINE],
            {"names": ["a"]},
            r"'names' must have 2 entries, one for each layout \(got 1\)",
        ),
        (
            [LINE, PALM],
            {"links": ["a"]},
            r"'links' must have 2 entries, one for each layout \(got 1\)",
        ),
        ([LINE, PALM], {"links": ["a", "b"]}, r"'links' must be None .* \(got 'palm' with wrist"),
        ([LINE], {"pose": torch.eye(4)}, r"'pose' must have shape \(1, 4, 4\) \(got \(4, 4\)\)"),
        (
            [LINE],
            {"pose": torch.diag(torch.tensor([1.0, 1.0, -1.0, 1.0]))[None]},
            "'pose' must hold rigid transforms",
        ),
    ],
)
def test_join_rejects(layouts, arguments, message):
    with pytest.raises(ValueError, match=message):
        TaxelLayout.join(layouts, **arguments)
