import pytest
import torch
from small_models import ALL, EDGE_INDEX, MODELS, NUM_EDGES, samples, small_model

from torch_geometric_tactile.nn.models import MTCNN, MTGCN, HandCNN, TactileFNN, TactileGCN
from torch_geometric_tactile.sensors import TaxelLayout, grid
from torch_geometric_tactile.testing import assert_permutation_equivariant

# Two joined taxels in one row. With weights of one and no biases, each layer sums.
PAIR = torch.tensor([[0, 1], [1, 0]])
X = torch.tensor([[[1.0, 2.0, 3.0], [4.0, 5.0, 7.0]]])  # sums 6 and 16
ABSOLUTE = torch.tensor([[[1.0, 0.0, 0.0, 0.0], [1.0, 1.0, 1.0, 0.0]]])  # sums 1 and 3
EDGE_ATTR = torch.tensor([[[1.0, 0.0, 0.0, 1.0], [0.0, 0.0, 5.0, 0.0]]])  # sums 2 and 5
JOINT = torch.tensor([[0.5, 0.25]])
ONE = {"widths": (2,), "pools": (2,)}
HEAD = {"head_widths": (2,), "head_pools": (2,)}


def summing(model):
    for name, parameter in model.named_parameters():
        torch.nn.init.constant_(parameter, 0.0 if "bias" in name else 1.0)
    return model


def check(model, expected, **given):
    given = {"x": X, "edge_index": PAIR, **given}
    for size in (1, 9):
        rows = {
            k: v if k == "edge_index" else v.expand(size, *v.shape[1:]) for k, v in given.items()
        }
        assert torch.allclose(summing(model)(**rows), torch.full((size, 1), expected))


def test_tactile_gcn_by_hand():
    # Each taxel gets the mean 11 of the sums.
    check(TactileGCN(2, 1, **ONE, **HEAD), 22.0)
    check(TactileGCN(2, 1, num_joints=2, **ONE, **HEAD), 22.75, joint=JOINT)
    # The dense encoder gives each of 4 features of a taxel the sum of all edges, 7.
    model = TactileGCN(2, 1, inputs=("tactile", "edge"), num_edges=2, **ONE, **HEAD)
    check(model, 22.0 + 2 * 4 * 7.0, edge_attr=EDGE_ATTR)


def test_mt_gcn_by_hand():
    both = ("tactile", "absolute")
    threads = {"tactile": ONE, "absolute": ONE}
    model = MTGCN(2, 1, inputs=both, threads=threads, num_joints=2, **HEAD)
    check(model, 22.0 + 4.0 + 0.75, joint=JOINT, absolute=ABSOLUTE)
    # One way, from 0 to 1: degrees 1 and 2.
    own = {"adjacency": [[0], [1]], **ONE}
    model = MTGCN(2, 1, inputs=both, threads={**threads, "absolute": own}, **HEAD)
    check(model, 22.0 + 1.0 + 3.0 / 2 + 1.0 / 2**0.5, absolute=ABSOLUTE)


@pytest.mark.parametrize("segments", ["digit", "patch", None])
def test_tactile_gcn_of_segments_by_hand(segments):
    layout = TaxelLayout(
        "two", torch.zeros(2, 3), patch=torch.tensor([0, 1]), patch_names=("a", "b"), adjacency={}
    )
    # Taxels that are alone keep their sums, which makes no difference for the total of a mean.
    weighted = TactileGCN(layout, 1, segments=segments, num_joints=2, **ONE, **HEAD)
    check(weighted, 22.75, joint=JOINT)
    features = weighted.node_features(X, PAIR)
    expected = [[6.0], [16.0]] if segments == "patch" else [[11.0], [11.0]]
    assert torch.allclose(features, torch.tensor([expected]))


def test_tactile_fnn_by_hand():
    model = TactileFNN(2, 1, inputs=("tactile", "absolute"), num_joints=2, **ONE)
    check(model, 22.0 + 4.0 + 0.75, joint=JOINT, absolute=ABSOLUTE)


def test_hand_cnn_by_hand():
    # Both taxels see both of one row.
    layout = grid(1, 2, pitch=0.01)
    check(HandCNN(layout, 1, num_joints=2, **ONE, **HEAD), 44.75, joint=JOINT)
    model = MTCNN(layout, 1, threads={"tactile": ONE, "absolute": ONE}, **HEAD)
    check(model, 44.0 + 8.0, absolute=ABSOLUTE)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("gcn", f"TactileGCN(11, 3, inputs={ALL}, num_joints=2)"),
        ("mt_gcn", "MTGCN(11, 3, inputs=('tactile', 'edge'), num_joints=2)"),
        ("mt_gcn_adjacency", "MTGCN(11, 3, inputs=('absolute', 'tactile'))"),
        ("whole", "TactileGCN(11, 3, inputs=('tactile',))"),
        (
            "patches",
            "TactileGCN(11, 3, inputs=('tactile', 'edge'), num_joints=2, segments='patch')",
        ),
        ("fnn", "TactileFNN(11, 3, inputs=('tactile', 'absolute'), num_joints=2)"),
        ("cnn", "HandCNN(11, 3, inputs=('tactile', 'position'), num_joints=2)"),
        ("mt_cnn", "MTCNN(11, 3, inputs=('tactile', 'absolute'))"),
    ],
)
def test_model_repr(name, text):
    assert str(MODELS[name]()) == text


def test_model_modalities():
    modalities = {name: MODELS[name]().modalities for name in MODELS}
    assert modalities["gcn"] == ("edge_attr", "absolute", "pos", "joint")
    assert modalities["mt_gcn_adjacency"] == ("absolute",)
    assert modalities["whole"] == ()
    assert modalities["fnn"] == ("absolute", "joint")


def test_mt_gcn_node_features_of_a_thread():
    model = small_model("mt_gcn")
    x, edge_attr = samples(2, 11, 3), samples(2, NUM_EDGES, 4)
    both = model.node_features(x, EDGE_INDEX, edge_attr)
    assert both.shape == (2, 11, 4)
    tactile = model.node_features(x, EDGE_INDEX, edge_attr, thread="tactile")
    edge = model.node_features(x, EDGE_INDEX, edge_attr, thread="edge")
    assert torch.equal(torch.cat([tactile, edge], dim=-1), both)
    with pytest.raises(ValueError, match=r"'thread' must be one of .* \(got 'absolute'\)"):
        model.node_features(x, EDGE_INDEX, edge_attr, thread="absolute")


def test_node_features_are_equivariant():
    # With an encoder that shares its weights, all but the fully connected layers.
    model = small_model("gcn_attention")
    assert_permutation_equivariant(
        model.node_features, samples(2, 11, 3), EDGE_INDEX, edge_attr=samples(NUM_EDGES, 4)
    )
    model = small_model("mt_gcn")
    with pytest.raises(AssertionError, match="permutation equivariant"):
        assert_permutation_equivariant(
            model.node_features, samples(2, 11, 3), EDGE_INDEX, edge_attr=samples(NUM_EDGES, 4)
        )
