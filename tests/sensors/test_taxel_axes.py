from dataclasses import replace

import pytest
import torch

from torch_geometric_tactile.sensors import (
    TaxelLayout,
    allegro_uskin,
    allegro_uskin_240,
    allegro_uskin_368,
    biotac,
    biotac_sp,
    grid,
)

STOCK = [
    allegro_uskin(),
    allegro_uskin_240(),
    allegro_uskin_368(),
    biotac(),
    biotac_sp(),
    grid(3, 4, 0.004),
]
BARE = [replace(layout, normal=None, tangent=None) for layout in STOCK]


@pytest.mark.parametrize("layout", STOCK + BARE, ids=repr)
def test_axes_are_orthonormal_and_right_handed(layout):
    axes = layout.axes(torch.double)
    eye = torch.eye(3, dtype=torch.double).expand_as(axes)
    torch.testing.assert_close(axes @ axes.mT, eye, atol=2e-5, rtol=0)
    torch.testing.assert_close(axes.det(), torch.ones(len(layout)).double(), atol=2e-5, rtol=0)


@pytest.mark.parametrize("layout", STOCK, ids=repr)
def test_axes_hold_what_is_given(layout):
    axes = layout.axes()
    assert axes.dtype == torch.float
    assert axes[:, 2].equal(layout.normal)
    if layout.tangent is not None:
        assert axes[:, :2].equal(layout.tangent.float())


def test_axes_of_a_hand_point_to_the_ends_of_its_links():
    layout = allegro_uskin()
    axes = layout.axes(torch.double)
    assert (axes[:, 1, 2] > 0).all()
    flat = (layout.normal == torch.tensor([1.0, 0.0, 0.0])).all(dim=1)
    assert int(flat.sum()) == 288
    assert axes[flat].equal(torch.eye(3).double()[[1, 2, 0]].expand(288, 3, 3))


def test_without_tangent_x_is_the_x_axis_of_the_link_laid_onto_the_skin():
    normal = torch.tensor([[0.0, 0.0, 1.0], [0.0, 0.6, 0.8], [0.6, 0.0, 0.8], [-1.0, 0.0, 0.0]])
    layout = TaxelLayout("four", torch.zeros(4, 3), normal=normal)
    expected = [
        [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
        [[1, 0, 0], [0, 0.8, -0.6], [0, 0.6, 0.8]],
        [[0.8, 0, -0.6], [0, 1, 0], [0.6, 0, 0.8]],
        [[0, 1, 0], [0, 0, -1], [-1, 0, 0]],  # its y axis where x stands on the skin
    ]
    torch.testing.assert_close(layout.axes(), torch.tensor(expected))


def test_without_normal_it_is_x_times_y():
    tangent = torch.eye(3)[torch.tensor([[0, 1], [2, 0]])]
    layout = TaxelLayout("two", torch.zeros(2, 3), tangent=tangent)
    assert layout.axes()[:, 2].tolist() == [[0, 0, 1], [0, 1, 0]]


def test_flat_pad_without_anything_faces_z():
    layout = TaxelLayout("pad", [[0.0, 0.0], [0.01, 0.0], [0.0, 0.01]])
    assert layout.axes().equal(torch.eye(3).expand(3, 3, 3))


def sphere(count=400, radius=0.01):
    step = torch.arange(count) + 0.5
    height, angle = 1 - 2 * step / count, step * torch.pi * (1 + 5**0.5)
    side = (1 - height**2).sqrt()
    return radius * torch.stack([side * angle.cos(), side * angle.sin(), height], dim=1)


def test_normals_of_a_sphere_point_away_from_its_centre():
    pos = sphere()
    shifted = torch.tensor([0.1, -0.2, 0.3])
    normal = TaxelLayout("ball", pos + shifted).axes()[:, 2]
    assert float((normal * pos / 0.01).sum(dim=1).min()) > 0.99


def test_normals_are_found_on_each_link_by_itself():
    pos = sphere()
    both = TaxelLayout(
        "two",
        torch.cat([pos, -pos.flip(0)]),
        link=[0] * 400 + [1] * 400,
        link_names=("a", "b"),
    )
    alone = TaxelLayout("one", pos).axes(), TaxelLayout("one", -pos.flip(0)).axes()
    assert both.axes().equal(torch.cat(alone))


def test_slanted_plane_faces_upwards_and_a_wall_its_largest_component():
    slopes = torch.tensor([[[0.6, 0.0, 0.8], [0.0, 1.0, 0.0]], [[-0.8, 0.6, 0.0], [0.0, 0.0, 1.0]]])
    upwards = [-0.8, 0.0, 0.6], [0.6, 0.8, 0.0]
    for slope, expected in zip(slopes, upwards, strict=True):
        for sign in (1.0, -1.0):  # no side is outwards
            pos = sign * grid(3, 4, 0.01).pos[:, :2] @ slope
            normal = TaxelLayout("plane", pos).axes()[:, 2]
            target = torch.tensor(expected).expand(12, 3)
            torch.testing.assert_close(normal, target, atol=1e-4, rtol=0)


def test_taxels_in_a_line_and_alone():
    slanted = TaxelLayout("line", torch.arange(4)[:, None] * torch.tensor([[0.03, 0.0, 0.04]]))
    torch.testing.assert_close(slanted.axes()[:, 2], torch.tensor([[-0.8, 0.0, 0.6]] * 4))
    upright = TaxelLayout("line", torch.arange(4)[:, None] * torch.tensor([[0.0, 0.0, 0.04]]))
    torch.testing.assert_close(upright.axes()[:, 2], torch.tensor([[1.0, 0.0, 0.0]] * 4))
    assert TaxelLayout("dot", [[1.0, 2.0, 3.0]]).axes().equal(torch.eye(3)[None])
    twice = TaxelLayout("pair", [[0.0, 0.0, 0.0], [0.0, 0.0, 0.1]]).axes()
    assert twice.isfinite().all()


def test_axes_follow_a_joined_layout_that_is_turned():
    turn = torch.tensor([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    pose = torch.eye(4)[None].clone()
    pose[0, :3, :3] = turn
    tip = allegro_uskin()
    one = TaxelLayout("tip", tip.pos, normal=tip.normal, tangent=tip.tangent)
    turned = TaxelLayout.join([one], pose=pose)
    expected = one.axes(torch.double) @ turn.double().t()
    torch.testing.assert_close(turned.axes(torch.double), expected, atol=1e-7, rtol=0)
