"""The printed sizes of the papers, and all parameters by arithmetic."""

import pytest
import torch

from torch_geometric_tactile.nn.models import (
    MTCNN,
    MTGCN,
    HandCNN,
    SegmentedThread,
    TactileFNN,
    TactileGCN,
)
from torch_geometric_tactile.sensors import allegro_uskin

LAYOUT = allegro_uskin()
EDGES = {"sparse": 1000, "slanted": 1184, "original": 1401, "dense": 2488}
WIDTH = {"tactile": 3, "edge": 4, "absolute": 4, "position": 3}
T, E, A, P = "tactile", "edge", "absolute", "position"


def num_parameters(module):
    return sum(parameter.numel() for parameter in module.parameters())


def linear(*sizes):
    """Weights and biases of layers, of each as (inputs, outputs)."""
    return sum(first * second + second for first, second in sizes)


def head(width, out_channels):
    # 1536(P)768, 384(P)192, 96(P)48
    return linear((width, 1536), (768, 384), (192, 96), (48, out_channels))


def tactile_thread(width, cells=1):
    # 14, 28, 56(P)28, 112(P)28, 112(P)7; a 3 x 3 kernel has nine cells
    sizes = ((width, 14), (14, 28), (28, 56), (28, 112), (28, 112))
    return sum(cells * first * second + second for first, second in sizes)


def other_thread(width, cells=1):
    # 7, 14, 28(P)14, 28(P)14, 56(P)7
    sizes = ((width, 7), (7, 14), (14, 28), (14, 28), (14, 56))
    return sum(cells * first * second + second for first, second in sizes)


def encoder(num_edges=1401):
    return linear((4 * num_edges, 384 * 4))


@pytest.mark.parametrize("num_joints", [0, 16])
@pytest.mark.parametrize(
    ("inputs", "width"),
    [
        ((T,), 3),
        ((E,), 4),
        ((A,), 4),
        ((T, E), 7),
        ((T, A), 7),
        ((E, A), 8),
        ((T, E, A), 11),
    ],
)
def test_tactile_gcn_paper_size(inputs, width, num_joints):
    with torch.device("meta"):
        model = TactileGCN(inputs=inputs, num_edges=1401, num_joints=num_joints)
    assert model.thread.in_channels == width
    assert model.thread.out_channels == 7
    assert model.head.in_channels == 2688 + num_joints
    expected = tactile_thread(width) + head(2688 + num_joints, 6)
    if E in inputs:
        assert num_parameters(model.encoder) == 8_609_280 == encoder()
        expected += 8_609_280
    assert num_parameters(model) == expected


@pytest.mark.parametrize("num_joints", [0, 16])
@pytest.mark.parametrize(
    ("threads", "width"), [((T, E), 5376), ((T, A), 5376), ((E, A), 5376), ((T, E, A), 8064)]
)
def test_mt_gcn_paper_size(threads, width, num_joints):
    with torch.device("meta"):
        model = MTGCN(inputs=threads, num_edges=1401, num_joints=num_joints)
    assert model.head.in_channels == width + num_joints
    assert {thread.out_channels for thread in model.threads.values()} == {7}
    expected = head(width + num_joints, 6)
    expected += sum(tactile_thread(3) if name == T else other_thread(4) for name in threads)
    expected += encoder() if E in threads else 0
    assert num_parameters(model) == expected


@pytest.mark.parametrize("name", EDGES)
def test_mt_gcn_paper_adjacency(name):
    # Table III: tactile and edge threads with joint angles.
    num_edges = LAYOUT.edge_index(name).size(1)
    assert num_edges == EDGES[name]
    with torch.device("meta"):
        model = MTGCN(num_edges=num_edges, num_joints=16)
    assert num_parameters(model.encoder) == 1536 * (4 * EDGES[name] + 1)
    rest = tactile_thread(3) + other_thread(4) + head(5376 + 16, 6)
    assert num_parameters(model) == rest + encoder(EDGES[name])


@pytest.mark.parametrize("num_joints", [0, 16])
@pytest.mark.parametrize(("inputs", "width"), [((T,), 1152), ((A,), 1536), ((T, A), 2688)])
def test_tactile_fnn_paper_size(inputs, width, num_joints):
    with torch.device("meta"):
        model = TactileFNN(inputs=inputs, num_joints=num_joints)
    assert model.head.in_channels == width + num_joints
    # 32768(P)16384, 4096(P)2048, 1024(P)512
    sizes = ((width + num_joints, 32768), (16384, 4096), (2048, 1024), (512, 6))
    assert num_parameters(model) == linear(*sizes)


@pytest.mark.parametrize("num_joints", [0, 16])
@pytest.mark.parametrize(("inputs", "width"), [((T,), 3), ((A,), 4), ((T, A), 7)])
def test_hand_cnn_paper_size(inputs, width, num_joints):
    with torch.device("meta"):
        model = HandCNN(LAYOUT, inputs=inputs, num_joints=num_joints)
    assert model.head.in_channels == 2688 + num_joints
    expected = tactile_thread(width, cells=9) + head(2688 + num_joints, 6)
    assert num_parameters(model) == expected


@pytest.mark.parametrize("num_joints", [0, 16])
def test_mt_cnn_paper_size(num_joints):
    with torch.device("meta"):
        model = MTCNN(LAYOUT, num_joints=num_joints)
    assert model.inputs == (T, A)
    assert model.head.in_channels == 5376 + num_joints
    threads = tactile_thread(3, cells=9) + other_thread(4, cells=9)
    assert num_parameters(model) == threads + head(5376 + num_joints, 6)


@pytest.mark.parametrize("num_joints", [0, 16])
@pytest.mark.parametrize("inputs", [(T,), (P,), (T, P)])
@pytest.mark.parametrize(("segments", "number"), [(None, 1), ("digit", 5), ("patch", 22)])
def test_tactile_gcn_of_segments_paper_size(segments, number, inputs, num_joints):
    # The head of one is that of all: small here, and counted below.
    small = {"head_widths": (2,), "head_pools": (1,)}
    model = TactileGCN(LAYOUT, 8, segments=segments, inputs=inputs, num_joints=num_joints, **small)
    width = sum(WIDTH[name] for name in inputs)
    assert model.thread.in_channels == width
    assert model.head.in_channels == 2688 + num_joints
    if segments is None:
        expected = tactile_thread(width)
    else:
        assert model.thread.num_segments == number
        expected = number * linear((width, 14), (14, 56))  # 14, 56(P)7 in each segment
    assert num_parameters(model.thread) == expected
    assert num_parameters(model) == expected + linear((2688 + num_joints, 2), (2, 8))


@pytest.mark.parametrize("num_joints", [0, 16])
def test_tactile_gcn_of_segments_paper_head(num_joints):
    model = TactileGCN(LAYOUT, 8, segments="patch", num_joints=num_joints)
    assert num_parameters(model.head) == head(2688 + num_joints, 8)
    assert num_parameters(model) == head(2688 + num_joints, 8) + 22 * linear((3, 14), (14, 56))


def test_paper_models_run():
    x = torch.zeros(2, 384, 3)
    edge_index = LAYOUT.edge_index("original")
    edge_attr, joint = torch.zeros(2, 1401, 4), torch.zeros(2, 16)
    assert MTGCN(num_edges=1401, num_joints=16)(x, edge_index, edge_attr, joint).shape == (2, 6)
    model = TactileGCN(out_channels=8, segments="patch", num_joints=16)
    assert model(x, edge_index, joint=joint).shape == (2, 8)
    assert HandCNN()(x).shape == (2, 6)


def test_widths_and_pools_of_a_segmented_thread_are_those_of_the_paper():
    thread = SegmentedThread(3, [0, 0, 1])
    assert repr(thread) == "SegmentedThread(3, widths=(14, 56), pools=(1, 8), num_segments=2)"
