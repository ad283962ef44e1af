import pytest
import torch
from nn.models.test_model_explain import explainer
from plain_models import GRASP_GCNS
from torch_geometric.data import Data

from torch_geometric_tactile.data import StaticDataset, Trials, join_frames, split_frames
from torch_geometric_tactile.nn.models import GraspGCN
from torch_geometric_tactile.sensors import biotac, biotac_sp
from torch_geometric_tactile.testing import assert_static_equals_batched
from torch_geometric_tactile.transforms import KNNGraph

EDGE_INDEX = KNNGraph(2)(Data(pos=biotac_sp().pos)).edge_index


def readings(*size):
    return torch.randn(*size, generator=torch.Generator().manual_seed(0))


def num_parameters(model):
    return sum(parameter.numel() for parameter in model.parameters())


@pytest.fixture(params=GRASP_GCNS)
def model(request):
    torch.manual_seed(0)
    return GraspGCN(**GRASP_GCNS[request.param]).eval()


def test_grasp_gcn_repr():
    assert str(GraspGCN()) == (
        "GraspGCN(24, 2, in_channels=1, hidden_channels=64, num_fingers=3, fusion='data')"
    )
    model = GraspGCN(19, 4, in_channels=60, fusion=None, finger=2, num_layers=2)
    assert str(model) == (
        "GraspGCN(19, 4, in_channels=60, hidden_channels=64, num_fingers=3, fusion=None, finger=2, "
        "num_layers=2)"
    )


def test_grasp_gcn_parameter_counts():
    fc = 24 * 64 * 2 + 2
    assert num_parameters(GraspGCN(fusion="data")) == 3 * 64 + 64 + fc
    assert num_parameters(GraspGCN(fusion=None, finger=0)) == 64 + 64 + fc
    assert num_parameters(GraspGCN(fusion="feature")) == 3 * (64 + 64) + 3 * 24 * 64 * 2 + 2
    # The paper's 19 electrodes with 60 frames of each finger.
    paper = {"layout": 19, "in_channels": 60}
    assert num_parameters(GraspGCN(**paper)) == 180 * 64 + 64 + 19 * 64 * 2 + 2
    deep = GraspGCN(num_layers=2)
    assert num_parameters(deep) == 3 * 64 + 64 + 64 * 64 + 64 + fc


def test_grasp_gcn_by_hand():
    # Two joined electrodes share their mean; ReLU drops the negative sum of finger 1.
    model = GraspGCN(2, 1, hidden_channels=1, num_fingers=2, fusion="feature")
    for parameter in model.parameters():
        torch.nn.init.constant_(parameter, 1.0)
    for thread in model.convs:
        torch.nn.init.zeros_(thread[0].bias)
    x = torch.tensor([[[2.0, -3.0], [4.0, -5.0]]])
    out = model(x, torch.tensor([[0, 1], [1, 0]]))
    assert torch.allclose(out, torch.tensor([[3.0 + 3.0 + 0.0 + 0.0 + 1.0]]))


def test_grasp_gcn_feature_fusion_holds_the_one_finger_models():
    fused = GraspGCN(fusion="feature")
    x = readings(5, 24, 3)
    total = fused.lin.bias
    for finger in range(3):
        single = GraspGCN(fusion=None, finger=finger)
        single.convs[0].load_state_dict(fused.convs[finger].state_dict())
        columns = slice(finger * 24 * 64, (finger + 1) * 24 * 64)
        single.lin.weight.data = fused.lin.weight[:, columns].detach()
        single.lin.bias.data.zero_()
        total = total + single(x, EDGE_INDEX)
    assert torch.allclose(fused(x, EDGE_INDEX), total, atol=1e-5)


def test_grasp_gcn_joint_angles_join_the_features():
    model, x, joint = GraspGCN(num_joints=7).eval(), readings(5, 24, 3), readings(5, 7)
    assert str(model).endswith("fusion='data', num_joints=7)")
    assert model.modalities == ("joint",)
    without = GraspGCN().eval()
    without.convs.load_state_dict(model.convs.state_dict())
    without.lin.weight.data = model.lin.weight[:, :-7].detach()
    without.lin.bias.data = model.lin.bias.detach()
    expected = without(x, EDGE_INDEX) + joint @ model.lin.weight[:, -7:].T
    assert torch.allclose(model(x, EDGE_INDEX, joint=joint), expected, atol=1e-5)
    with pytest.raises(ValueError, match=r"'joint' must be given: the model has num_joints=7"):
        model(x, EDGE_INDEX)
    with pytest.raises(ValueError, match=r"'num_joints' must not be negative"):
        GraspGCN(num_joints=-1)

    def of_one_posture(x, edge_index):
        return model(x, edge_index, joint=joint[:1].repeat(x.numel() // (24 * 3), 1))

    assert_static_equals_batched(of_one_posture, x, EDGE_INDEX)


@pytest.mark.parametrize("finger", [0, 1, 2])
def test_grasp_gcn_one_finger_ignores_the_others(finger):
    model, x = GraspGCN(fusion=None, finger=finger, in_channels=2), readings(5, 24, 6)
    out = model(x, EDGE_INDEX)
    others = x + 1
    others[..., 2 * finger : 2 * finger + 2] = x[..., 2 * finger : 2 * finger + 2]
    assert torch.equal(model(others, EDGE_INDEX), out)
    assert not torch.allclose(model(x + 1, EDGE_INDEX), out)


def test_grasp_gcn_laws(model):
    weight = torch.rand(EDGE_INDEX.size(1), generator=torch.Generator().manual_seed(0))

    def weighted(x, edge_index, edge_weight):
        return model(x, edge_index, edge_weight=edge_weight)

    assert_static_equals_batched(weighted, readings(5, 24, 3), EDGE_INDEX, weight)


def test_grasp_gcn_edge_weight(model):
    x, weight = readings(5, 24, 3), torch.ones(EDGE_INDEX.size(1))
    assert torch.allclose(model(x, EDGE_INDEX, edge_weight=weight), model(x, EDGE_INDEX), atol=1e-6)
    without = model(x, EDGE_INDEX[:, :0])
    assert torch.allclose(model(x, EDGE_INDEX, edge_weight=0 * weight), without, atol=1e-6)
    assert not torch.allclose(without, model(x, EDGE_INDEX), atol=1e-3)


def test_grasp_gcn_single_electrode():
    model = GraspGCN(1, hidden_channels=4, num_fingers=1)
    assert model(readings(5, 1, 1), torch.empty(2, 0, dtype=torch.long)).shape == (5, 2)


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ({"fusion": "data"}, 180 * 64 + 64 + 19 * 64 * 2 + 2),
        ({"fusion": "feature"}, 3 * (60 * 64 + 64) + 3 * 19 * 64 * 2 + 2),
        *(({"fusion": None, "finger": i}, 60 * 64 + 64 + 19 * 64 * 2 + 2) for i in range(3)),
    ],
    ids=["DF", "FF", "L", "M", "R"],
)
def test_grasp_gcn_over_60_frames(arguments, expected):
    """Parameter counts by arithmetic, and each finger's frames go to the finger's weights."""
    torch.manual_seed(0)
    edge_index = KNNGraph(2)(Data(pos=biotac().pos)).edge_index
    model = GraspGCN("biotac", 2, in_channels=60, **arguments)
    assert num_parameters(model) == expected
    window = Trials(frames_of_grasps(), series=()).batch([0, 1, 2])
    assert (window.x.shape, window.num_frames) == ((3, 19, 180), 60)
    frames = split_frames(window.x, 60).clone().requires_grad_()
    model(join_frames(frames), edge_index).square().sum().backward()
    touched = frames.grad.abs().amax(dim=(0, 1, 2)) > 0
    used = [arguments["finger"]] if "finger" in arguments else [0, 1, 2]
    assert touched.nonzero().view(-1).tolist() == used
    assert frames.grad[..., used].abs().amax(dim=(0, 1)).min() > 0  # of every frame
    for finger in range(3):
        model.zero_grad()
        alone = torch.zeros(3, 19, 60, 3)
        alone[:, :, 10, finger] = frames.detach()[:, :, 10, finger]  # one frame of one finger
        model(join_frames(alone), edge_index).square().sum().backward()
        grads = [thread[0].lin.weight.grad.abs().amax(dim=0) for thread in model.convs]
        columns = torch.cat(grads).nonzero().view(-1).tolist()
        first = 60 * (0 if used == [finger] else finger)
        assert columns == ([first + 10] if finger in used else [])


def frames_of_grasps():
    trial = torch.arange(3).repeat_interleave(60)
    return StaticDataset.from_arrays(readings(180, 19, 3), trial % 2, trial=trial, layout=biotac())


def test_grasp_gcn_dropout():
    model, x = GraspGCN(dropout=0.5), readings(5, 24, 3)
    assert not torch.equal(model(x, EDGE_INDEX), model(x, EDGE_INDEX))
    model.eval()
    assert torch.equal(model(x, EDGE_INDEX), model(x, EDGE_INDEX))


def test_grasp_gcn_explainer(model):
    x = readings(24, 3)
    explanation = explainer(model)(x, EDGE_INDEX)
    assert explanation.node_mask.shape == (24, 3)
    assert explanation.edge_mask.shape == (EDGE_INDEX.size(1),)
    assert explanation.edge_mask.abs().max() > 0
    if model.fusion is None:
        assert explanation.node_mask[:, [0, 2]].abs().max() == 0  # what the model never saw
    assert_static_equals_batched(model, readings(5, 24, 3), EDGE_INDEX)  # and it left no trace


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ({"fusion": "late"}, r"'fusion' must be 'data', 'feature' or None \(got 'late'\)"),
        ({"fusion": None}, r"'finger' must be between 0 and 2 .* \(got None\)"),
        ({"fusion": None, "finger": 3}, r"'finger' must be between 0 and 2 .* \(got 3\)"),
        ({"fusion": None, "finger": -1}, r"'finger' must be between 0 and 2 .* \(got -1\)"),
        ({"fusion": "data", "finger": 0}, r"'finger' must be None if .* \(got 0\)"),
    ],
)
def test_grasp_gcn_bad_fusion(arguments, match):
    with pytest.raises(ValueError, match=match):
        GraspGCN(**arguments)


@pytest.mark.parametrize("size", [(5, 24, 2), (5, 23, 3)])
def test_grasp_gcn_bad_shape(size):
    with pytest.raises(ValueError, match=r"must have 24 nodes and 3 channels .*got shape"):
        GraspGCN()(torch.zeros(size), EDGE_INDEX)


def test_grasp_gcn_bad_number_of_nodes():
    with pytest.raises(ValueError, match=r"'x' must have 24 nodes \(got 48\)"):
        GraspGCN()(torch.zeros(5, 48, 3), EDGE_INDEX)


def test_grasp_gcn_weights_are_no_edge_features():
    weight = torch.ones(EDGE_INDEX.size(1))
    with pytest.raises(ValueError, match=r"pass edge weights as 'edge_weight' \(got shape \("):
        GraspGCN()(readings(5, 24, 3), EDGE_INDEX, weight)


def test_grasp_gcn_needs_edges():
    with pytest.raises(ValueError, match=r"'edge_index' must be given \(got None\)"):
        GraspGCN()(readings(5, 24, 3))


def test_grasp_gcn_fast():
    fast, slow = GraspGCN(fusion="feature"), GraspGCN(fusion="feature", fast=False)
    slow.load_state_dict(fast.state_dict())
    for model, expected in ((fast, True), (slow, False)):
        assert [conv.fast for thread in model.convs for conv in thread] == [expected] * 3
    x = readings(9, 24, 3)
    assert torch.allclose(slow(x, EDGE_INDEX), fast(x, EDGE_INDEX), atol=1e-6)
