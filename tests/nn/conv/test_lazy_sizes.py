"""Layers that take their input size from the first input."""

import copy
import io

import pytest
import torch
from small_models import EDGE_INDEX, NUM_EDGES, samples

from torch_geometric_tactile.nn import (
    EdgeAttentionEncoder,
    EdgeFeatureEncoder,
    EdgeMessageEncoder,
    EdgePatchEncoder,
    SectorConv,
    SegmentedGCNConv,
    SelfGCNConv,
    StaticGCNConv,
)

SEGMENT = torch.arange(11) // 4
SECTOR = torch.arange(NUM_EDGES) % 8
X, EDGE_ATTR = samples(6, 11, 3), samples(6, NUM_EDGES, 3)

# A layer with a size, and its input.
LAYERS = {
    "gcn": (lambda size: StaticGCNConv(size, 5), (X, EDGE_INDEX)),
    "self": (lambda size: SelfGCNConv(size, 5), (X, EDGE_INDEX)),
    "difference": (lambda size: SelfGCNConv(size, 5, difference=True), (X, EDGE_INDEX)),
    "segmented": (lambda size: SegmentedGCNConv(SEGMENT, size, 5), (X, EDGE_INDEX)),
    "sector": (lambda size: SectorConv(size, 5), (X, EDGE_INDEX, SECTOR)),
    "message": (lambda size: EdgeMessageEncoder(size, 5), (EDGE_ATTR, EDGE_INDEX)),
    "attention": (lambda size: EdgeAttentionEncoder(size, 5), (EDGE_ATTR, EDGE_INDEX)),
    "patch": (lambda size: EdgePatchEncoder(SEGMENT, size, 5), (EDGE_ATTR, EDGE_INDEX)),
    "edges": (lambda size: EdgeFeatureEncoder(11, NUM_EDGES, size, 5), (EDGE_ATTR,)),
}


@pytest.mark.parametrize("name", LAYERS)
def test_size_comes_from_the_first_input(name):
    make, inputs = LAYERS[name]
    torch.manual_seed(0)
    lazy, sized = make(-1), make(3)
    copied = copy.deepcopy(lazy)
    expected = lazy(*inputs)
    if name != "gcn":  # PyG's GCNConv keeps its -1
        assert str(lazy) == str(sized)
    assert {k: v.shape for k, v in lazy.state_dict().items()} == {
        k: v.shape for k, v in sized.state_dict().items()
    }
    sized.load_state_dict(lazy.state_dict())
    assert torch.allclose(sized(*inputs), expected, atol=1e-6)
    expected.sum().backward()
    assert all(p.grad is not None for p in lazy.parameters())
    assert copied(*inputs).shape == expected.shape  # a copy has a size of its own
    with pytest.raises(ValueError, match=r"'(x|edge_attr)' must"):
        lazy(inputs[0][..., :2], *inputs[1:])


@pytest.mark.parametrize("name", LAYERS)
def test_size_comes_from_a_saved_state(name):
    make, inputs = LAYERS[name]
    sized, lazy = make(3), make(-1)
    lazy.load_state_dict(sized.state_dict())
    assert torch.allclose(lazy(*inputs), sized(*inputs), atol=1e-6)


@pytest.mark.parametrize("name", LAYERS)
def test_layer_without_a_size_is_saved_and_loaded(name):
    make, inputs = LAYERS[name]
    file = io.BytesIO()
    torch.save(make(-1).state_dict(), file)
    file.seek(0)
    lazy = make(-1)
    lazy.load_state_dict(torch.load(file, weights_only=False))
    assert lazy(*inputs).isfinite().all()
