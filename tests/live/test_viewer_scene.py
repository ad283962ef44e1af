from itertools import pairwise

import numpy as np
import pytest
import torch

from torch_geometric_tactile.live._viewer.scene import layout_scene, number_scene
from torch_geometric_tactile.sensors import (
    HandKinematics,
    TaxelLayout,
    allegro_uskin,
    biotac_sp,
    grid,
    icub_hand,
)


def places(scene, pose):
    """Places and normals as the page computes them."""
    link = scene.link.astype(int)
    rotation = pose[:, :9].reshape(-1, 3, 3)[link]
    pos = np.einsum("nij,nj->ni", rotation, scene.pos) + pose[:, 9:][link]
    return pos, np.einsum("nij,nj->ni", rotation, scene.axes[:, 2])


def test_hand_is_where_its_kinematics_have_it():
    layout, hand = allegro_uskin(), HandKinematics.allegro()
    scene = layout_scene(layout)
    assert scene.form == "hand"
    assert scene.num_joints == 16
    joint = torch.rand(16, generator=torch.Generator().manual_seed(0))
    pos, normal = places(scene, scene.link_poses(joint.numpy()))
    posed = hand.taxel_pose(layout, joint)
    np.testing.assert_allclose(pos, posed.pos, atol=1e-6)
    np.testing.assert_allclose(normal, posed.normal, atol=1e-5)


def test_hand_without_joint_angles_is_open_or_as_told():
    layout, hand = allegro_uskin(), HandKinematics.allegro()
    told = np.full(16, 0.3, dtype=np.float32)
    scene = layout_scene(layout, joint=told)
    np.testing.assert_array_equal(scene.pose, scene.link_poses(told))
    pos, _ = places(layout_scene(layout), layout_scene(layout).pose)
    assert np.ptp(pos[:, 2]) > 0.2  # metres: the fingers point up
    assert np.ptp(hand.taxel_pose(layout, torch.full((16,), 1.2)).pos[:, 2].numpy()) < 0.2


def test_hand_has_names_and_bodies_on_its_links():
    scene = layout_scene(allegro_uskin())
    assert [label["text"] for label in scene.labels] == ["index", "middle", "ring", "thumb"]
    assert {body["link"] for body in scene.bodies} <= set(range(len(scene.pose)))
    carried = set(scene.link.tolist())
    assert all(body["link"] in carried for body in scene.bodies if body["sphere"])


def test_layout_on_links_of_another_hand():
    with pytest.raises(ValueError, match="must have the links of layout 'biotac_sp'"):
        layout_scene(biotac_sp(), HandKinematics.allegro())


def test_grid_is_seen_from_the_front():
    layout = grid(2, 3, pitch=0.01)
    scene = layout_scene(layout)
    assert (scene.form, scene.num_joints, scene.labels) == ("pads", 0, [])
    pos, normal = places(scene, scene.pose)
    np.testing.assert_allclose(pos[:, 0], [0, 0.01, 0.02] * 2, atol=1e-6)
    np.testing.assert_allclose(np.diff(pos[::3, 1]), 0.01, atol=1e-6)
    np.testing.assert_allclose(normal, [[0, 0, 1]] * 6, atol=1e-6)
    np.testing.assert_allclose(scene.size, 0.01)


def test_pads_that_no_hand_carries_are_side_by_side():
    layout = icub_hand()
    scene = layout_scene(layout)
    pos, normal = places(scene, scene.pose)
    assert normal[:, 2].mean() > 0.5
    spans = [pos[scene.link == index, 0] for index in range(5)]
    assert all(left.max() < right.min() for left, right in pairwise(spans))
    assert [label["text"] for label in scene.labels] == list(layout.link_names)


def test_single_taxel_has_a_size():
    scene = layout_scene(TaxelLayout("one", pos=torch.zeros(1, 3)))
    assert scene.size[0] > 0
    assert np.isfinite(scene.pose).all()


@pytest.mark.parametrize("num_taxels", [1, 2, 5, 256, 368])
def test_unknown_layout_is_a_grid_by_number(num_taxels):
    scene = number_scene(num_taxels)
    assert (scene.form, scene.num_taxels) == ("numbers", num_taxels)
    columns = len(set(scene.pos[:, 0]))
    assert scene.pos[0].tolist() == [0, 0, 0]
    assert (scene.pos[:, 0] == np.arange(num_taxels) % columns).all()
    assert (np.diff(scene.pos[:, 1]) <= 0).all()  # rows from the top
    assert columns**2 >= num_taxels > (columns - 1) ** 2
