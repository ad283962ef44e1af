from dataclasses import replace

import pytest
import torch
from torch_geometric.data import Batch, Data
from torch_geometric.loader import DataLoader
from torch_geometric.transforms import Compose

from torch_geometric_tactile.data import StaticData, StaticDataset
from torch_geometric_tactile.loader import StaticLoader
from torch_geometric_tactile.sensors import HandKinematics, TaxelLayout, allegro_uskin
from torch_geometric_tactile.sensors.kinematics import Joint
from torch_geometric_tactile.transforms import GeometricEdgeAttr, TaxelPose

HAND = HandKinematics.allegro()
LAYOUT = allegro_uskin()
# One finger that turns about z at 0.1 m above the root, with two taxels on it.
FINGER = HandKinematics(
    [Joint("bend", "palm", "finger", xyz=(0.0, 0.0, 0.1), axis=(0.0, 0.0, 1.0))], name="finger"
)
PAIR = TaxelLayout(
    "pair",
    pos=torch.tensor([[0.02, 0.0, 0.0], [0.0, 0.03, 0.0]]),
    normal=torch.tensor([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
    link_names=("finger",),
)


def angles(num_samples, seed=0):
    return 0.5 * torch.rand(num_samples, 16, generator=torch.Generator().manual_seed(seed))


def recording(num_samples=3):
    return StaticData(
        x=torch.zeros(num_samples, 384, 3),
        edge_index=LAYOUT.edge_index("original"),
        joint=angles(num_samples),
    )


class Grasps(StaticDataset):
    layout = LAYOUT

    def read(self):
        return recording(5), {}


def test_taxel_pose_is_that_of_the_covered_allegro_hand_unless_told_otherwise():
    stock, given = (t(Data(joint=angles(1))) for t in (TaxelPose(), TaxelPose(LAYOUT, HAND)))
    assert stock.pos.equal(given.pos)
    assert stock.normal.equal(given.normal)
    with pytest.raises(ValueError, match="link"):
        TaxelPose(kinematics=FINGER)


@pytest.mark.parametrize("joint", [torch.tensor([torch.pi / 2]), torch.tensor([[torch.pi / 2]])])
def test_taxel_pose_quarter_turn(joint):
    data = TaxelPose(PAIR, FINGER)(Data(joint=joint))
    expected = torch.tensor([[0.0, 0.02, 0.1], [-0.03, 0.0, 0.1]])
    assert torch.allclose(data.pos, expected, atol=1e-7)
    assert torch.allclose(data.normal, torch.tensor([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]), atol=1e-6)


@pytest.mark.parametrize("num_samples", [1, 5])  # few frames go another way than many
def test_taxel_pose_without_normals(num_samples):
    given = StaticData(x=torch.zeros(num_samples, 384, 3), joint=angles(num_samples))
    data = TaxelPose(LAYOUT, HAND, normal=False)(given.index_select(slice(None)))
    assert "normal" not in data
    assert torch.equal(data.pos, TaxelPose(LAYOUT, HAND)(given).pos)


def test_taxel_pose_is_that_of_the_kinematics():
    data = TaxelPose(LAYOUT, HAND)(recording())
    assert data.pos.shape == data.normal.shape == (3, 384, 3)
    assert torch.equal(data.pos, HAND.taxel_pose(LAYOUT, data.joint).pos)
    assert not torch.equal(data.pos[0], data.pos[1])


def test_taxel_pose_one_pose_for_all_samples():
    for joint in (angles(1), angles(1)[0]):
        data = StaticData(x=torch.zeros(3, 384, 3), joint=joint, shared=["joint"])
        data = TaxelPose(LAYOUT, HAND)(data)
        assert data.pos.shape == (384, 3)
        assert data.is_shared("pos")


def test_taxel_pose_batch_of_flat_angles():
    samples = [Data(x=torch.zeros(384, 3), joint=joint) for joint in angles(2)]
    batch = TaxelPose(LAYOUT, HAND)(Batch.from_data_list(samples))
    assert batch.joint.shape == (32,)
    assert torch.equal(batch.pos, HAND.taxel_pose(LAYOUT, angles(2)).pos.view(-1, 3))


def test_taxel_pose_single_taxel_without_normal():
    layout = TaxelLayout("one", pos=torch.tensor([[0.02, 0.0, 0.0]]), link_names=("finger",))
    data = TaxelPose(layout, FINGER)(Data(joint=torch.zeros(1)))
    assert torch.allclose(data.pos, torch.tensor([[0.02, 0.0, 0.1]]))
    assert "normal" not in data


def test_taxel_pose_gradients_reach_the_joints():
    transform = Compose([TaxelPose(LAYOUT, HAND), GeometricEdgeAttr()])
    data = recording(2)
    data.joint.requires_grad_()
    out = transform(data)
    assert out.edge_attr.shape == (2, 1401, 4)
    out.edge_attr[0].square().sum().backward()
    assert data.joint.grad[0].abs().min() > 0
    assert data.joint.grad[1].abs().max() == 0


def test_taxel_pose_gradients_are_exact():
    transform = Compose([TaxelPose(PAIR, FINGER), GeometricEdgeAttr()])

    def edge_attr(joint):
        edge_index = torch.tensor([[0, 1, 1], [1, 0, 1]])  # with a loop of length zero
        out = transform(StaticData(x=joint.new_zeros(2, 2, 1), edge_index=edge_index, joint=joint))
        return out.edge_attr

    joint = torch.tensor([[0.3], [-0.4]], dtype=torch.double, requires_grad=True)
    assert torch.autograd.gradcheck(edge_attr, joint)


def test_taxel_pose_loaders_agree():
    transform = Compose([TaxelPose(LAYOUT, HAND), GeometricEdgeAttr()])
    dataset = Grasps(transform=transform)
    static = list(StaticLoader(dataset, batch_size=3))
    pyg = list(DataLoader(dataset, batch_size=3))
    assert [batch.edge_attr.shape for batch in static] == [(3, 1401, 4), (2, 1401, 4)]
    for a, b in zip(static, pyg, strict=True):
        assert torch.allclose(a.edge_attr.view(-1, 4), b.edge_attr, atol=1e-7)
        assert torch.allclose(a.pos.view(-1, 3), b.pos, atol=1e-7)
        assert torch.allclose(a.normal.view(-1, 3), b.normal, atol=1e-6)
    placed = Grasps(pre_transform=transform)
    assert torch.allclose(placed[4].edge_attr, dataset[4].edge_attr, atol=1e-7)


def test_taxel_pose_bad_input():
    transform = TaxelPose(LAYOUT, HAND)
    for joint in (torch.zeros(15), torch.zeros(1, 17), torch.zeros(1, 1, 16), torch.tensor(0.0)):
        with pytest.raises(
            ValueError, match=r"must have 16 angles in each sample, .* 'allegro_right'"
        ):
            transform(Data(joint=joint))
    with pytest.raises(
        ValueError, match=r"'joint' must have 1 rows, one for each sample .*\(2, 16\)"
    ):
        transform(Data(joint=torch.zeros(2, 16)))
    two = StaticData(x=torch.zeros(3, 384, 3), joint=torch.zeros(2, 16), shared=["joint"])
    with pytest.raises(
        ValueError, match=r"'joint' must have 1 rows, one for each sample .*\(2, 16\)"
    ):
        transform(two)
    batch = Batch.from_data_list([Data(x=torch.zeros(384, 3))] * 2)
    batch.joint = torch.zeros(3, 16)
    with pytest.raises(ValueError, match=r"'joint' must have 2 rows"):
        transform(batch)
    with pytest.raises(ValueError, match=r"384 taxels, as in layout 'allegro_uskin' \(got 4\)"):
        transform(Data(x=torch.zeros(4, 3), joint=torch.zeros(16)))
    with pytest.raises(ValueError, match=r"'finger' must have the links of layout 'allegro_uskin'"):
        TaxelPose(LAYOUT, FINGER)


def test_layout_is_found_by_name_or_file(tmp_path):
    PAIR.save(tmp_path / "pair.json")
    assert TaxelPose("allegro_uskin_240").layout.num_taxels == 240
    assert TaxelPose(tmp_path / "pair.json", FINGER).layout.matches(PAIR)


def test_taxel_pose_with_tangents_by_hand():
    tangent = torch.tensor([[[0.0, 1, 0], [0, 0, 1]], [[1, 0, 0], [0, 1, 0]]])
    layout = replace(PAIR, tangent=tangent)
    data = TaxelPose(layout, FINGER, tangent=True)(Data(joint=torch.tensor([torch.pi / 2])))
    expected = torch.tensor([[[-1.0, 0, 0], [0, 0, 1]], [[0, 1, 0], [-1, 0, 0]]])
    torch.testing.assert_close(data.tangent, expected, atol=1e-6, rtol=0)


@pytest.mark.parametrize("num_samples", [1, 2, 9])
def test_taxel_pose_tangents_are_those_of_the_kinematics(num_samples):
    data = TaxelPose(LAYOUT, HAND, tangent=True)(recording(num_samples))
    assert data.tangent.shape == (num_samples, 384, 2, 3)
    axes = torch.cat([data.tangent, data.normal.unsqueeze(2)], dim=2)
    torch.testing.assert_close(axes, HAND.taxel_axes(LAYOUT, data.joint), atol=1e-6, rtol=0)
    eye = torch.eye(3).expand_as(axes)
    torch.testing.assert_close(axes @ axes.mT, eye, atol=1e-5, rtol=0)
    alone = TaxelPose(LAYOUT, HAND)(recording(num_samples))
    assert "tangent" not in alone
    assert alone.pos.equal(data.pos)


def test_taxel_pose_tangents_of_shared_angles():
    shared = StaticData(x=torch.zeros(3, 384, 3), joint=angles(1)[0], shared=["joint"])
    transform = TaxelPose(LAYOUT, HAND, tangent=True)
    posed = transform(shared)
    assert posed.tangent.shape == (384, 2, 3)
    assert posed.is_shared("tangent")
