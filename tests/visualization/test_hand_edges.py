import pytest
import torch

pytest.importorskip("matplotlib", reason="needs the extra 'viz'")

from torch_geometric_tactile.sensors import HandKinematics, Joint, TaxelLayout, allegro_uskin
from torch_geometric_tactile.visualization import plot_hand

HINGE = HandKinematics([Joint("hinge", "base", "tip", xyz=(0, 0, 0.01), axis=(1, 0, 0))])
# In the plane, in millimetres: 0 at (0, 0), 1 at (2, 0), 2 at (4, 10).
SMALL = TaxelLayout(
    "small",
    pos=torch.tensor([[0.0, 0.0, 0.0], [0.0, 0.002, 0.0], [0.003, 0.004, 0.0]]),
    link=[0, 0, 1],
    link_names=("base", "tip"),
)
EDGES = torch.tensor([[0, 1, 1], [1, 0, 2]])  # a pair, and an edge without its reverse


def lines(figure):
    (item,) = [i for i in figure.axes[0].collections if type(i).__name__ == "LineCollection"]
    return torch.tensor(item.get_segments()), torch.tensor(item.get_colors())


def test_each_direction_has_the_half_next_to_its_target():
    figure = plot_hand(SMALL, HINGE, torch.zeros(1), EDGES, edge_value=torch.arange(3.0))
    place, color = lines(figure)
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
    assert lines(figure)[1][:, 0].tolist() == pytest.approx([0.0, 0.5, 1.0], abs=0.01)
    bars = {ax.get_ylabel(): ax.get_ylim() for ax in figure.axes[1:]}
    assert bars == {"reading": (5, 7), "weight": (0, 4)}
    assert len(plot_hand(SMALL, HINGE, adjacency=EDGES, edge_value=EDGES[0]).axes) == 2


def test_self_loops_are_left_out_with_their_values():
    looped = torch.tensor([[2, 0, 1, 1], [2, 1, 0, 2]])
    value = torch.tensor([100.0, 0.0, 1.0, 2.0])
    plain = plot_hand(SMALL, HINGE, adjacency=EDGES, edge_value=value[1:])
    _, color = lines(plot_hand(SMALL, HINGE, adjacency=looped, edge_value=value))
    assert color.equal(lines(plain)[1])


def test_every_directed_edge_of_the_hand_is_drawn():
    layout = allegro_uskin()
    edge_index = layout.edge_index("original")
    figure = plot_hand(layout, adjacency="original", edge_value=edge_index[0])
    assert len(lines(figure)[0]) == 1401


def test_bad_input_is_named():
    with pytest.raises(ValueError, match="'adjacency' must be given where 'edge_value' is"):
        plot_hand(SMALL, HINGE, edge_value=torch.zeros(3))
    with pytest.raises(ValueError, match=r"'edge_value' must have shape \(3,\) \(got \(2,\)\)"):
        plot_hand(SMALL, HINGE, adjacency=EDGES, edge_value=torch.zeros(2))
    with pytest.raises(ValueError, match=r"'limits' must rise"):
        plot_hand(SMALL, HINGE, adjacency=EDGES, edge_value=EDGES[0], edge_limits=(1, 0))
