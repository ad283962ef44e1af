import math
import pickle
import warnings
from dataclasses import replace

import pytest
import torch
from small_chains import CHAIN, angles, urdf

from torch_geometric_tactile.sensors import (
    HandKinematics,
    TaxelLayout,
    allegro_uskin,
    grid,
    kinematics,
)

HAND = HandKinematics.allegro()
LAYOUT = allegro_uskin()

# Links not in order: the second and third taxel are on links before the first one's.
SMALL = TaxelLayout(
    "small",
    pos=torch.tensor([[0.1, 0.0, 0.0], [0.0, 0.2, 0.0], [0.3, 0.0, 0.1], [0.0, 0.0, 0.4]]),
    normal=torch.tensor([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]),
    link=[2, 0, 1, 2],
    link_names=("base", "arm", "tip"),
)


def test_repr_and_joint_order():
    assert repr(HAND) == "HandKinematics('allegro_right', num_joints=16, num_links=21)"
    assert HAND.joint_names == tuple(f"joint_{i}.0" for i in range(16))
    assert HAND.link_names[0] == "palm_link"


# Tips of the models in the source of the table, to the digits printed there.
@pytest.mark.parametrize(
    ("angle", "tips"),
    [
        (
            0.0,
            [
                [0.0, 0.05531, 0.13344],
                [0.0, 0.0, 0.1362],
                [0.0, -0.05531, 0.13344],
                [-0.0132, 0.1677, -0.08607],
            ],
        ),
        (
            0.5,
            [
                [0.07445, 0.09155, 0.08101],
                [0.07445, 0.04067, 0.08713],
                [0.07445, -0.01052, 0.0881],
                [0.07173, 0.11518, -0.02841],
            ],
        ),
    ],
)
@pytest.mark.parametrize("dtype", [torch.float, torch.double])
def test_allegro_tips(angle, tips, dtype):
    links = [HAND.link_names.index(f"link_{i}_tip") for i in (3, 7, 11, 15)]
    found = HAND.link_pose(torch.full((16,), angle, dtype=dtype)).translation[links]
    assert found.dtype == dtype
    assert torch.allclose(found, torch.tensor(tips, dtype=dtype), rtol=0, atol=1e-5)


def test_small_chain_by_hand():
    hand = HandKinematics(CHAIN)
    joint = torch.tensor([math.pi / 2, math.pi / 2], dtype=torch.double)
    rotation, translation = hand.link_pose(joint)
    assert hand.link_names == ("base", "arm", "finger", "tip")
    # A quarter turn about z takes the arm's x to y; one about y takes the finger's x to -z.
    expected = torch.tensor([[0, 0, 0], [0, 0, 0], [0, 1, 0], [0, 1, -0.5]]).double()
    assert torch.allclose(translation, expected, atol=1e-12)
    arm = torch.tensor([[0, -1, 0], [1, 0, 0], [0, 0, 1]]).double()
    finger = arm @ torch.tensor([[0, 0, 1], [0, 1, 0], [-1, 0, 0]]).double()
    nail = torch.tensor([[0, -1, 0], [1, 0, 0], [0, 0, 1]]).double()
    expected = torch.stack([torch.eye(3).double(), arm, finger, finger @ nail])
    assert torch.allclose(rotation, expected, atol=1e-12)


def test_all_links_agree_with_pytorch_kinematics(write):
    reason = 'needs pytorch_kinematics, of the extra "test"'
    other = pytest.importorskip("pytorch_kinematics", reason=reason)
    path = write(urdf(HAND.joints))
    chain = other.build_chain_from_urdf(path.read_bytes()).to(dtype=torch.double)
    joint = angles(50, 16)
    theirs = chain.forward_kinematics(
        {name: joint[:, i] for i, name in enumerate(HAND.joint_names)}
    )
    for hand in (HAND, HandKinematics.from_urdf(path)):
        rotation, translation = hand.link_pose(joint)
        assert set(hand.link_names) == set(theirs)
        for i, link in enumerate(hand.link_names):
            matrix = theirs[link].get_matrix().expand(50, 4, 4)
            assert torch.allclose(rotation[:, i], matrix[:, :3, :3], atol=1e-6)
            assert torch.allclose(translation[:, i], matrix[:, :3, 3], atol=1e-6)


def test_from_urdf_is_the_table(write):
    hand = HandKinematics.from_urdf(write(urdf(HAND.joints, "allegro_right")))
    assert repr(hand) == repr(HAND)
    assert hand.joints == HAND.joints
    assert hand.lower.equal(HAND.lower)
    assert hand.upper.equal(HAND.upper)


def test_from_urdf_reads_what_files_hold_besides(write):
    text = urdf(CHAIN[:1]).replace(
        "</robot>",
        '<transmission name="t"><joint name="elbow"><hardwareInterface/></joint></transmission>'
        '<joint name="wheel" type="continuous"><parent link="arm"/><child link="rim"/>'
        '<limit effort="1" velocity="1"/></joint></robot>',
    )
    hand = HandKinematics.from_urdf(write(text))
    assert hand.joint_names == ("elbow", "wheel")
    assert hand.joints[1].axis == (1, 0, 0)  # URDF's default
    assert hand.upper.tolist() == [1.0, math.inf]


def test_from_urdf_in_the_order_of_names(write):
    path = write(urdf(HAND.joints))
    names = HAND.joint_names[::-1]
    hand = HandKinematics.from_urdf(path, joint_names=names)
    assert hand.joint_names == names
    joint = angles(3, 16)
    found, expected = hand.taxel_pose(LAYOUT, joint.flip(-1)), HAND.taxel_pose(LAYOUT, joint)
    assert torch.allclose(found.pos, expected.pos, atol=1e-12)


def test_from_urdf_keeps_unnamed_joints_at_zero(write):
    index = HAND.joint_names[:4]
    hand = HandKinematics.from_urdf(write(urdf(HAND.joints)), joint_names=index)
    assert hand.joint_names == index
    joint = angles(4)
    whole = torch.cat([joint, torch.zeros(12)])
    found, expected = hand.taxel_pose(LAYOUT, joint), HAND.taxel_pose(LAYOUT, whole)
    assert torch.allclose(found.pos, expected.pos, atol=1e-12)


def test_taxels_by_link_poses():
    joint = angles(5, 16)
    rotation, translation = HAND.link_pose(joint)
    links = [HAND.link_names.index(LAYOUT.link_names[i]) for i in LAYOUT.link.tolist()]
    pos, normal = LAYOUT.pos.double(), LAYOUT.normal.double()
    posed = HAND.taxel_pose(LAYOUT, joint)
    turned = (rotation[:, links] @ pos.unsqueeze(-1)).squeeze(-1)
    assert torch.allclose(posed.pos, turned + translation[:, links], atol=1e-12)
    turned = (rotation[:, links] @ normal.unsqueeze(-1)).squeeze(-1)
    assert torch.allclose(posed.normal, turned, atol=1e-12)


def test_layout_whose_links_are_not_in_order_by_hand():
    posed = HandKinematics(CHAIN).taxel_pose(SMALL, torch.tensor([math.pi / 2, 0.0]))
    # At the elbow's quarter turn the arm's x is y; the tip's frame is turned once more.
    expected = [[-0.1, 1.5, 0.0], [0.0, 0.2, 0.0], [0.0, 0.3, 0.1], [0.0, 1.5, 0.4]]
    assert torch.allclose(posed.pos, torch.tensor(expected), atol=1e-6)
    expected = [[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]]
    assert torch.allclose(posed.normal, torch.tensor(expected), atol=1e-6)


@pytest.mark.parametrize("dtype", [torch.float, torch.double])
def test_batch_is_the_loop_over_frames(dtype):
    joint = angles(9, 16, dtype=dtype)  # more than the few that are posed in another way
    posed = HAND.taxel_pose(LAYOUT, joint)
    assert posed.pos.dtype == posed.normal.dtype == dtype
    one_by_one = [HAND.taxel_pose(LAYOUT, frame) for frame in joint]
    torch.testing.assert_close(posed.pos, torch.stack([one.pos for one in one_by_one]))
    torch.testing.assert_close(posed.normal, torch.stack([one.normal for one in one_by_one]))


def test_float_agrees_with_double_to_a_micrometre():
    joint = angles(20, 16)
    single, double = HAND.taxel_pose(LAYOUT, joint.float()), HAND.taxel_pose(LAYOUT, joint)
    assert torch.allclose(single.pos.double(), double.pos, rtol=0, atol=1e-6)


@pytest.mark.parametrize("shape", [(), (0,), (2, 3), (2, 0, 3)])
def test_leading_dimensions_are_kept(shape):
    joint = angles(*shape, 16)
    pos, normal = HAND.taxel_pose(LAYOUT, joint)
    rotation, translation = HAND.link_pose(joint)
    assert pos.shape == normal.shape == (*shape, 384, 3)
    assert rotation.shape == (*shape, 21, 3, 3)
    assert translation.shape == (*shape, 21, 3)
    flat = HAND.taxel_pose(LAYOUT, joint.reshape(-1, 16)).pos
    assert torch.allclose(pos.reshape(-1, 384, 3), flat, atol=1e-12)


@pytest.mark.parametrize("num_frames", [4, 8, 9])
def test_more_frames_than_a_chunk(num_frames, monkeypatch):
    monkeypatch.setattr(kinematics, "_CHUNK", 4)
    hand, joint = HandKinematics(CHAIN), angles(num_frames, 2)
    posed = hand.taxel_pose(SMALL, joint)
    for i, frame in enumerate(joint):
        one = hand.taxel_pose(SMALL, frame)
        assert torch.allclose(posed.pos[i], one.pos, atol=1e-12)
        assert torch.allclose(posed.normal[i], one.normal, atol=1e-12)
    graded = hand.taxel_pose(SMALL, joint.clone().requires_grad_())
    assert graded.pos.requires_grad
    assert torch.allclose(graded.pos, posed.pos, atol=1e-12)
    assert torch.allclose(graded.normal, posed.normal, atol=1e-12)


def test_gradients_agree_with_differences():
    hand, joint = HandKinematics(CHAIN), angles(3, 2).requires_grad_()
    assert torch.autograd.gradcheck(lambda angle: hand.taxel_pose(SMALL, angle), joint)


@pytest.mark.parametrize("num_frames", [3, 20])
def test_normals_are_left_out_where_a_layout_has_none_or_they_are_not_wanted(num_frames):
    bare = TaxelLayout("bare", SMALL.pos, link=SMALL.link, link_names=SMALL.link_names)
    hand, joint = HandKinematics(CHAIN), angles(num_frames, 2)
    for posed in (hand.taxel_pose(bare, joint), hand.taxel_pose(SMALL, joint, normal=False)):
        assert posed.normal is None
        assert posed.pos.equal(hand.taxel_pose(SMALL, joint).pos)


@pytest.mark.parametrize("shape", [(), (3,)])
def test_axes_of_taxels_turn_as_normals_do(shape):
    hand, joint = HandKinematics(CHAIN), angles(*shape, 2)
    with torch.inference_mode():
        hand.taxel_axes(SMALL, joint)  # what is kept of it takes part in gradients later
    found = hand.taxel_axes(SMALL, joint.requires_grad_())
    assert found.shape == (*shape, 4, 3, 3)
    assert found.requires_grad
    for i, axis in enumerate(SMALL.axes().unbind(1)):
        turned = hand.taxel_pose(replace(SMALL, normal=axis.float()), joint).normal
        torch.testing.assert_close(found[..., i, :], turned, atol=1e-6, rtol=0)


def test_layout_whose_links_are_in_order_is_posed_as_any_other():
    order = SMALL.link.argsort()
    ordered = replace(
        SMALL, pos=SMALL.pos[order], normal=SMALL.normal[order], link=SMALL.link[order]
    )
    hand, joint = HandKinematics(CHAIN), angles(20, 2)
    posed, expected = hand.taxel_pose(ordered, joint), hand.taxel_pose(SMALL, joint)
    assert torch.allclose(posed.pos, expected.pos[:, order], atol=1e-12)
    assert torch.allclose(posed.normal, expected.normal[:, order], atol=1e-12)


def test_links_are_rigid_and_normals_keep_their_length():
    joint = angles(10, 16)
    pos, normal = HAND.taxel_pose(LAYOUT, joint)
    assert torch.allclose(normal.norm(dim=-1), torch.ones(10, 384).double(), atol=1e-6)
    for link in LAYOUT.link.unique():
        taxels = LAYOUT.link == link
        rest, moved = LAYOUT.pos[taxels].double(), pos[:, taxels]
        apart = (moved.unsqueeze(1) - moved.unsqueeze(2)).norm(dim=-1)
        assert torch.allclose(apart, (rest - rest.unsqueeze(1)).norm(dim=-1), rtol=0, atol=1e-9)
        tilt = normal[:, taxels] @ normal[:, taxels].mT
        still = LAYOUT.normal[taxels].double() @ LAYOUT.normal[taxels].double().T
        assert torch.allclose(tilt, still.expand_as(tilt), atol=1e-9)


def test_fingers_curl_towards_the_palm():
    open_hand, fist = torch.zeros(16), torch.zeros(16)
    fist[[1, 2, 3, 5, 6, 7, 9, 10, 11]] = 1.2
    tips = torch.tensor([name.endswith("_tip") for name in LAYOUT.patch_names])[LAYOUT.patch]
    fingers = tips & (LAYOUT.digit < 3)
    out, up = HAND.taxel_pose(LAYOUT, open_hand).pos[fingers][:, [0, 2]].mean(0)
    near, down = HAND.taxel_pose(LAYOUT, fist).pos[fingers][:, [0, 2]].mean(0)
    assert near > out
    assert down < up - 0.05


@pytest.mark.parametrize("dtype", [torch.float, torch.double])
def test_outside_limits_reports_and_does_not_clip(dtype):
    joint = torch.zeros(2, 16, dtype=dtype)
    joint[:, 12] = 0.3  # the thumb's base cannot reach zero
    assert not HAND.outside_limits(joint).any()
    joint[0, 0], joint[0, 1], joint[0, 2], joint[1, 3] = 0.47, 1.62, math.nan, -0.3
    outside = HAND.outside_limits(joint)
    assert outside.nonzero().tolist() == [[0, 1], [0, 2], [1, 3]]  # 0.47 is the limit itself
    bent = HAND.link_pose(joint[1]).rotation[HAND.link_names.index("link_3")]
    straight = HAND.link_pose(torch.zeros(16, dtype=dtype)).rotation[
        HAND.link_names.index("link_2")
    ]
    assert float((straight.T @ bent)[0, 0]) == pytest.approx(math.cos(0.3))


def test_degrees_warn_and_radians_do_not():
    joint = torch.zeros(16)
    joint[3] = 90.0
    for call in (HAND.link_pose, HAND.outside_limits, lambda q: HAND.taxel_pose(LAYOUT, q)):
        with pytest.warns(UserWarning, match=r"must be in radians; an angle of 90 looks like deg"):
            call(joint)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        HAND.link_pose(torch.full((16,), -math.pi))


def test_hand_pickles():
    hand = pickle.loads(pickle.dumps(HAND))
    joint = angles(2, 16)
    assert hand.taxel_pose(LAYOUT, joint).pos.equal(HAND.taxel_pose(LAYOUT, joint).pos)


def test_joint_angles_that_do_not_fit():
    for call in (HAND.link_pose, HAND.outside_limits, lambda q: HAND.taxel_pose(LAYOUT, q)):
        with pytest.raises(ValueError, match=r"'joint' must have shape \(\.\.\., 16\).*got \(15,"):
            call(torch.zeros(15))
        with pytest.raises(ValueError, match=r"'joint' must have shape .* \(got \(\)\)"):
            call(torch.tensor(0.0))
        with pytest.raises(ValueError, match=r"floating-point angles \(got torch\.int64\)"):
            call(torch.zeros(16, dtype=torch.long))


def test_hand_without_the_links_of_the_layout(write):
    hand = HandKinematics.from_urdf(write(urdf(CHAIN)))
    with pytest.raises(ValueError, match=r"'hand' must have the links of layout 'allegro_uskin'"):
        hand.taxel_pose(LAYOUT, torch.zeros(2))
    with pytest.raises(ValueError, match=r"got none named 'base'; its links are palm_link, link_0"):
        HAND.taxel_pose(grid(2, 2, 0.004), torch.zeros(16))


def test_what_is_kept_of_a_layout_serves_no_other():
    hand, layout = HandKinematics.allegro(), allegro_uskin()
    joint = torch.full((2, 16), 0.3)
    with torch.inference_mode():
        first = hand.taxel_pose(layout, joint).pos
    moved = replace(layout, pos=layout.pos + 0.001)
    assert not torch.allclose(hand.taxel_pose(moved, joint).pos, first)
    assert hand.taxel_pose(layout, joint.double()).pos.dtype == torch.double
    assert torch.equal(hand.taxel_pose(layout, joint).pos, first)


def test_gradient_after_inference_mode():
    hand, layout = HandKinematics.allegro(), allegro_uskin()
    joint = torch.full((2, 16), 0.3)
    with torch.inference_mode():
        hand.taxel_pose(layout, joint)
    joint.requires_grad_()
    hand.taxel_pose(layout, joint).pos.sum().backward()
    assert joint.grad.abs().sum() > 0
