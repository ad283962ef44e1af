"""What a bare `MessagePassing()` compiles into PyG's class changes no layer of this package."""

import subprocess
import sys

import pytest

CODE = """
import torch
from torch_geometric.nn import GCNConv, MessagePassing

if {early}:
    MessagePassing()
from torch_geometric_tactile.nn import SectorConv, SegmentedGCNConv
from torch_geometric_tactile.nn import SelfGCNConv, StaticGATConv, StaticGATv2Conv, StaticGCNConv
from torch_geometric_tactile.nn.conv._explainable_propagate import restore_propagate

class Scaled(StaticGCNConv):
    def message(self, x_j, edge_weight, scale: float = 3.0):
        return scale * super().message(x_j, edge_weight)

class Child(SectorConv):
    pass

class Doubled(StaticGCNConv):
    def propagate(self, edge_index, size=None, **kwargs):
        return 2 * super().propagate(edge_index, size=size, **kwargs)

if not {early}:
    MessagePassing()
x, edges = torch.rand(3, 2), torch.tensor([[0, 1, 1, 2], [1, 0, 2, 1]])
sectors = torch.zeros(4).long()

def masked(conv, *inputs):
    module = getattr(conv, "conv", conv)
    assert conv(*inputs).abs().sum() > 0
    module.explain, module._apply_sigmoid = True, False
    module._edge_mask, module._loop_mask = torch.ones(4), torch.ones(4).bool()
    whole = conv(*inputs)
    module._edge_mask = torch.zeros(4)
    none = conv(*inputs)
    module.explain = False
    return whole, none

plain = dict(bias=False, normalize=False)
for kind in (StaticGCNConv, Scaled, Doubled):
    conv = kind(2, 3, **plain)
    if kind is StaticGCNConv:  # PyG's form for explainers takes no default arguments
        whole, none = masked(conv, x, edges)
        assert torch.allclose(whole, conv(x, edges)), kind
        assert not none.any(), kind
    weights = torch.zeros(3, 3).index_put((edges[1], edges[0]), torch.ones(4))
    factor = {{StaticGCNConv: 1, Scaled: 3, Doubled: 2}}[kind]
    assert torch.allclose(conv(x, edges), factor * weights @ conv.lin(x), atol=1e-6), kind
for conv, more in (
    (SectorConv(2, 3, 4), (sectors,)),
    (Child(2, 3, 4), (sectors,)),
    (SegmentedGCNConv([0, 0, 0], 2, 3), ()),
    (SelfGCNConv(2, 3), ()),
    (StaticGATConv(2, 3), ()),
    (StaticGATv2Conv(2, 3), ()),
):
    whole, none = masked(conv, x, edges, *more)
    assert torch.allclose(whole, conv(x, edges, *more), atol=1e-6), conv
    assert not torch.allclose(whole, none), conv
conv = GCNConv(2, 3, **plain)
restore_propagate(conv)
whole, none = masked(conv, x, edges)
assert not none.any()
"""


@pytest.mark.full
@pytest.mark.parametrize("early", [True, False])
def test_layers_are_explained_after_a_bare_message_passing(early, tmp_path):
    path = tmp_path / "layers.py"  # a file, since PyG reads the source of classes
    path.write_text(CODE.format(early=early))
    done = subprocess.run([sys.executable, path], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
