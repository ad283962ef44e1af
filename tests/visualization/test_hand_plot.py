from dataclasses import replace

import pytest
import torch

pytest.importorskip("matplotlib", reason="needs the extra 'viz'")

from torch_geometric_tactile.sensors import HandKinematics, Joint, TaxelLayout, allegro_uskin
from torch_geometric_tactile.visualization import open_hand, plot_hand
from torch_geometric_tactile.visualization._style import new_figure

HAND = HandKinematics.allegro()
LAYOUT = allegro_uskin()
HINGE = HandKinematics([Joint("hinge", "base", "tip", xyz=(0, 0, 0.01), axis=(1, 0, 0))])
# Three taxels of two patches, the last one on the moving link.
SMALL = TaxelLayout(
    "small",
    pos=torch.tensor([[0.0, 0.0, 0.0], [0.0, 0.002, 0.0], [0.003, 0.004, 0.0]]),
    link=[0, 0, 1],
    patch=[0, 0, 1],
    link_names=("base", "tip"),
    patch_names=("low", "high"),
    adjacency={"chain": [[0, 1, 1, 2, 0], [1, 0, 2, 1, 2]]},
)


def circles(figure):
    """Place and colour of each circle, far ones first."""
    for item in figure.axes[0].collections:
        if type(item).__name__ == "EllipseCollection":
            return torch.tensor(item.get_offsets()), torch.tensor(item.get_facecolors())
    raise AssertionError("no taxels drawn")


def lines(figure):
    return {
        item.get_label(): len(item.get_segments())
        for item in figure.axes[0].collections
        if type(item).__name__ == "LineCollection"
    }


def arrows(figure):
    return [patch for patch in figure.axes[0].patches if patch.get_label() == "one way only"]


# Pairs of an adjacency; 48 and 72 directed edges within the patches of the original one.
@pytest.mark.parametrize(
    ("name", "within", "between"),
    [
        ("sparse", 18 * 16 + 4 * 22, 18 * 4 + 4 * 13),
        ("slanted", 18 * 18 + 4 * 28, 18 * 6 + 4 * 12),
        ("original", 18 * 24 + 4 * 36, 18 * 4 + 4 * 13),
        ("dense", 18 * 42 + 4 * 64, 18 * 10 + 4 * 13),
    ],
)
def test_every_pair_is_drawn_once(name, within, between):
    figure = plot_hand(LAYOUT, adjacency=name)
    assert lines(figure) == {"within a patch": within, "between patches": between}
    one_way = len(arrows(figure))
    assert one_way == (1 if name == "original" else 0)
    assert 2 * (within + between) + one_way == LAYOUT.edge_index(name).size(1)


def test_arrow_points_from_source_to_target():
    (arrow,) = arrows(plot_hand(SMALL, HINGE, adjacency="chain"))
    tail, head = arrow._posA_posB
    assert tail == pytest.approx((0, 0), abs=1e-4)
    assert head == pytest.approx((4, 10), abs=1e-4)


def test_no_edges_unless_asked():
    assert lines(plot_hand(LAYOUT)) == {}


def test_taxels_stand_where_the_joints_put_them():
    # Seen from +x: y to the right, z up, in millimetres; the nearest taxel comes last.
    place, _ = circles(plot_hand(SMALL, HINGE, torch.zeros(1)))
    expected = torch.tensor([[0, 0], [2, 0], [4, 10]]).double()
    assert torch.allclose(place.double(), expected, atol=1e-4)
    place, _ = circles(plot_hand(SMALL, HINGE, torch.tensor([torch.pi / 2])))
    expected[2] = torch.tensor([0, 14])
    assert torch.allclose(place.double(), expected, atol=1e-4)


@pytest.mark.parametrize(
    ("view", "expected"),
    [
        ({"azimuth": 90.0}, [[0, 0], [0, 0], [-3, 10]]),  # from +y: x to the left
        ({"elevation": 90.0}, [[0, 0], [2, 0], [4, -3]]),  # from above: x towards the viewer
    ],
)
def test_viewer_walks_and_rises(view, expected):
    place, _ = circles(plot_hand(SMALL, HINGE, torch.zeros(1), **view))
    place = place.double()[place[:, 0].abs().argsort(stable=True)]
    assert torch.allclose(place, torch.tensor(expected).double(), atol=1e-4)


def test_fingertips_are_up_and_the_thumb_is_to_the_right():
    plane = HAND.taxel_pose(LAYOUT, open_hand(HAND)).pos[:, 1:] * 1e3
    place, _ = circles(plot_hand(LAYOUT))
    near = torch.cdist(plane.double(), place.double()).amin(dim=1)
    assert float(near.max()) < 1e-3
    middle = {
        name: plane[LAYOUT.digit == i].mean(dim=0) for i, name in enumerate(LAYOUT.digit_names)
    }
    assert middle["ring"][0] < middle["middle"][0] < middle["index"][0] < middle["thumb"][0]
    assert middle["palm"][1] < 0 < middle["middle"][1]


def test_open_hand_is_within_its_limits_and_shows_the_pads():
    joint = open_hand(HAND)
    assert not HAND.outside_limits(joint).any()
    thumb = LAYOUT.digit == LAYOUT.digit_names.index("thumb")
    normal = HAND.taxel_pose(LAYOUT, joint).normal
    planar = torch.tensor([not name.endswith("_tip") for name in LAYOUT.patch_names])[LAYOUT.patch]
    assert (normal[planar, 0] > 0.8).all()
    assert (normal[thumb, 0] > 0).float().mean() > 0.9


@pytest.mark.parametrize(("by", "count"), [("patch", 22), ("digit", 5)])
def test_each_segment_has_a_colour_of_its_own(by, count):
    _, color = circles(plot_hand(LAYOUT, color_by=by))
    assert len(color.unique(dim=0)) == count
    sizes = color.unique(dim=0, return_counts=True)[1].sort().values
    expected = LAYOUT.segments(by).bincount().sort().values
    assert sizes.equal(expected)


def test_value_colours_the_taxels():
    value = torch.tensor([0.0, 2.0, float("nan")])
    figure = plot_hand(SMALL, HINGE, value=value, limits=(0.0, 4.0), cmap="gray", label="force (N)")
    _, color = circles(figure)
    assert color[:2, 0].tolist() == pytest.approx([0.0, 0.5], abs=0.01)
    assert color[2].tolist() == [1, 1, 1, 1]  # a missing reading is white
    bar = figure.axes[1]
    assert bar.get_ylabel() == "force (N)"
    assert bar.get_ylim() == pytest.approx((0, 4))


def test_far_taxels_are_drawn_first_in_their_own_colours():
    figure = plot_hand(
        SMALL, HINGE, torch.zeros(1), value=torch.arange(3.0), cmap="gray", azimuth=180.0
    )
    place, color = circles(figure)  # from behind, the last taxel is the far one
    assert place[0].tolist() == pytest.approx([-4, 10], abs=1e-4)
    assert color[:, 0].tolist() == pytest.approx([1.0, 0.0, 0.5], abs=0.01)


def test_colour_scale_ends_at_lowest_and_highest_value():
    figure = plot_hand(SMALL, HINGE, value=torch.tensor([1.0, 5.0, 3.0]))
    assert figure.axes[1].get_ylim() == pytest.approx((1, 5))
    alike = plot_hand(SMALL, HINGE, value=torch.ones(3))
    assert alike.axes[1].get_ylim() == pytest.approx((0.5, 1.5))
    assert len(plot_hand(SMALL, HINGE, value=torch.ones(3), label=None).axes) == 1


@pytest.mark.parametrize("by", ["patch", "digit"])
def test_names_stand_beside_one_another(by):
    figure = plot_hand(LAYOUT, names=by)
    figure.canvas.draw()
    texts = figure.axes[0].texts
    names = LAYOUT.patch_names if by == "patch" else LAYOUT.digit_names
    assert tuple(text.get_text() for text in texts) == names
    boxes = [text.get_window_extent() for text in texts]
    for i, box in enumerate(boxes):
        assert not any(box.overlaps(other) for other in boxes[:i])
        assert figure.axes[0].get_window_extent().contains(box.x0, box.y0)


def test_own_axes_are_used():
    figure = new_figure(4, 4)
    left, right = figure.subplots(1, 2)
    assert plot_hand(SMALL, HINGE, ax=right, title="$5 hand") is figure
    assert right.get_title() == r"\$5 hand"
    assert not left.collections


def test_single_taxel():
    one = TaxelLayout("one", torch.zeros(1, 3), link_names=("base",))
    place, _ = circles(plot_hand(one, HINGE))
    assert place.tolist() == [[0, 0]]


def test_joint_with_gradient_is_drawn():
    plot_hand(SMALL, HINGE, torch.zeros(1, requires_grad=True))


EDGES = torch.tensor([[0, 1, 1], [1, 0, 2]])  # a pair, and an edge without its reverse


def edge_lines(figure):
    (item,) = [i for i in figure.axes[0].collections if type(i).__name__ == "LineCollection"]
    return torch.tensor(item.get_segments()), torch.tensor(item.get_colors())


def test_each_direction_has_the_half_next_to_its_target():
    figure = plot_hand(SMALL, HINGE, torch.zeros(1), EDGES, edge_value=torch.arange(3.0))
    place, color = edge_lines(figure)
    expected = [[[1, 0], [2, 0]], [[1, 0], [0, 0]], [[2, 0], [4, 10]]]
    assert torch.allclose(place, torch.tensor(expected).double(), atol=1e-4)
    assert len(color.unique(dim=0)) == 3


def test_edge_values_have_their_own_scale():
    figure = plot_hand(
        SMALL,
        HINGE,
        adjacency=EDGES,
        value=torch.tensor([5.0, 6.0, 7.0]),
        edge_value=torch.tensor([0.0, 2.0, 4.0]),
        edge_limits=(0.0, 4.0),
        edge_cmap="gray",
        edge_label="weight",
    )
    assert edge_lines(figure)[1][:, 0].tolist() == pytest.approx([0.0, 0.5, 1.0], abs=0.01)
    bars = {ax.get_ylabel(): ax.get_ylim() for ax in figure.axes[1:]}
    assert bars == {"reading": (5, 7), "weight": (0, 4)}
    assert len(plot_hand(SMALL, HINGE, adjacency=EDGES, edge_value=EDGES[0]).axes) == 2


def test_self_loops_are_left_out_with_their_values():
    looped = torch.tensor([[2, 0, 1, 1], [2, 1, 0, 2]])
    value = torch.tensor([100.0, 0.0, 1.0, 2.0])
    plain = plot_hand(SMALL, HINGE, adjacency=EDGES, edge_value=value[1:])
    _, color = edge_lines(plot_hand(SMALL, HINGE, adjacency=looped, edge_value=value))
    assert color.equal(edge_lines(plain)[1])


def test_every_directed_edge_of_the_hand_is_drawn():
    edge_index = LAYOUT.edge_index("original")
    figure = plot_hand(LAYOUT, adjacency="original", edge_value=edge_index[0])
    assert len(edge_lines(figure)[0]) == 1401


ODD = replace(SMALL, name="odd", link_names=("base", "toe"))


@pytest.mark.parametrize(
    ("layout", "arguments", "match"),
    [
        (LAYOUT, {"value": torch.zeros(383)}, r"'value' must have shape \(384,\) \(got \(383,\)\)"),
        (LAYOUT, {"joint": torch.zeros(2, 16)}, r"one frame with shape \(16,\) \(got \(2, 16\)\)"),
        (LAYOUT, {"adjacency": "round"}, r"'name' must be an adjacency .* \(got 'round'\)"),
        (LAYOUT, {"adjacency": torch.zeros(3, 2)}, r"'adjacency' must have shape \(2, num_edges\)"),
        (SMALL, {"adjacency": torch.tensor([[0], [3]])}, r"must join taxels 0 to 2 \(got 0 to 3\)"),
        (SMALL, {"value": torch.zeros(3), "limits": (1, 1)}, r"must be increasing \(got 1 and 1\)"),
        (SMALL, {"color_by": "link"}, r"'color_by' must be 'patch' or 'digit' \(got 'link'\)"),
        (SMALL, {"names": "link"}, r"'names' must be 'patch' or 'digit' \(got 'link'\)"),
        (ODD, {}, "must have the links of layout 'odd'"),
        (SMALL, {"edge_value": torch.zeros(3)}, "'adjacency' must be given with 'edge_value'"),
        (
            SMALL,
            {"adjacency": EDGES, "edge_value": torch.zeros(2)},
            r"'edge_value' must have shape \(3,\) \(got \(2,\)\)",
        ),
        (
            SMALL,
            {"adjacency": EDGES, "edge_value": EDGES[0], "edge_limits": (1, 0)},
            "'limits' must be increasing",
        ),
    ],
)
def test_bad_input_is_named(layout, arguments, match):
    with pytest.raises(ValueError, match=match):
        plot_hand(layout, None if layout is LAYOUT else HINGE, **arguments)
