"""Whatever is attached to a layer is seen for every number of samples: in a batch of 7, which the
threads compute layer by layer, and in one of 8, which they may compute in one step."""

import pytest
import torch
from attachments import ATTACHMENTS, OF_LINEAR, WITHOUT_EFFECT
from small_models import EDGE_INDEX, GRAPH_MODELS, PATCH, inputs, samples, small_model
from torch.nn.modules.module import register_module_forward_hook, register_module_full_backward_hook
from torch_geometric.nn import GCNConv, summary
from torch_geometric.utils import get_embeddings

from torch_geometric_tactile.nn.conv import SegmentedGCNConv, StaticGCNConv
from torch_geometric_tactile.nn.models import GCNThread, SegmentedThread
from torch_geometric_tactile.nn.pool import ChannelMaxPool

THREADS = {
    "whole": lambda: GCNThread(3, (4, 8), (1, 4)),
    "segments": lambda: SegmentedThread(3, PATCH, (4, 8), (1, 4)),
}


def thread(name):
    torch.manual_seed(0)
    layer = THREADS[name]().double()
    for conv in layer.convs:
        torch.nn.init.normal_(conv.bias)
    return layer


def run(module, x, calls, *edges):
    """Outputs, gradients and calls, of the samples."""
    calls.clear()
    x = x.clone().requires_grad_()
    out = module(x, *edges)
    params = [value for value in module.parameters() if value.requires_grad]
    grads = torch.autograd.grad(out.square().sum(), [x, *params], allow_unused=True)
    return out.detach(), grads, list(calls)


def assert_same_grads(found, expected):
    for ours, theirs in zip(found, expected, strict=True):
        assert (ours is None) == (theirs is None)
        if ours is not None:
            assert torch.allclose(ours, theirs, rtol=1e-8, atol=1e-10)


@pytest.mark.parametrize("channels", [(3, 5), (5, 3)])
@pytest.mark.parametrize("name", ATTACHMENTS)
def test_attached_to_a_layer_as_to_pygs(name, channels):
    x, found = samples(8, 11, channels[0], dtype=torch.double), []
    plain = None
    for layer in (StaticGCNConv, GCNConv):
        torch.manual_seed(0)
        conv, calls = layer(*channels).double().eval(), []
        torch.nn.init.normal_(conv.bias)
        plain = conv(x, EDGE_INDEX)
        ATTACHMENTS[name](conv, calls)
        found.append(run(conv, x, calls, EDGE_INDEX))
    (out, grads, calls), (expected, expected_grads, expected_calls) = found
    assert torch.allclose(out, expected, rtol=1e-9, atol=1e-11)
    assert_same_grads(grads, expected_grads)
    assert calls == expected_calls
    assert torch.allclose(out, plain) == (name in WITHOUT_EFFECT)


@pytest.mark.parametrize(
    ("kind", "name"),
    [
        *(("whole", name) for name in ATTACHMENTS),
        *(("segments", name) for name in ATTACHMENTS if name not in OF_LINEAR),
    ],
)
def test_attached_to_a_thread(kind, name):
    layer, calls = thread(kind).eval(), []
    x = samples(8, 11, 3, dtype=torch.double)
    with torch.no_grad():
        plain = layer(x, EDGE_INDEX)
    ATTACHMENTS[name](layer.convs[1], calls)
    eight, _, of_eight = run(layer, x, calls, EDGE_INDEX)
    seven, grads, of_seven = run(layer, x[:7], calls, EDGE_INDEX)
    assert torch.allclose(eight[:7], seven, rtol=1e-9, atol=1e-11)
    assert of_eight == of_seven
    assert torch.allclose(eight, plain) == (name in WITHOUT_EFFECT)
    # The gradients of seven samples are those of eight, the last of which is not looked at.
    x = x.clone().requires_grad_()
    layer(x, EDGE_INDEX)[:7].square().sum().backward()
    assert torch.allclose(x.grad[:7], grads[0], rtol=1e-8, atol=1e-10)


@pytest.mark.parametrize("kind", THREADS)
def test_attached_to_a_pooling(kind):
    layer, calls = thread(kind), []
    layer.pools[0].register_forward_hook(lambda *args: calls.append("pool") or args[-1] + 1)
    x = samples(8, 11, 3, dtype=torch.double)
    eight, _, of_eight = run(layer, x, calls, EDGE_INDEX)
    seven, _, of_seven = run(layer, x[:7], calls, EDGE_INDEX)
    assert torch.allclose(eight[:7], seven)
    assert of_eight == of_seven == ["pool"]


@pytest.mark.parametrize("kind", THREADS)
@pytest.mark.parametrize(
    "register", [register_module_forward_hook, register_module_full_backward_hook]
)
def test_attached_to_all_modules(kind, register):
    layer, calls = thread(kind), []
    handle = register(lambda module, *args: calls.append(type(module).__name__) and None)
    try:
        x = samples(8, 11, 3, dtype=torch.double)
        _, _, of_eight = run(layer, x, calls, EDGE_INDEX)
        _, _, of_seven = run(layer, x[:7], calls, EDGE_INDEX)
    finally:
        handle.remove()
    assert of_eight == of_seven
    assert of_eight.count(type(layer.convs[0]).__name__) == 2


class Halved(StaticGCNConv):
    def message(self, x_j, edge_weight):
        return 0.5 * super().message(x_j, edge_weight)


class HalvedSegments(SegmentedGCNConv):
    def message(self, x_j, norm):
        return 0.5 * super().message(x_j, norm)


class Shifted(ChannelMaxPool):
    def forward(self, x):
        return super().forward(x) + 1


@pytest.mark.parametrize("kind", THREADS)
def test_attached_subclasses(kind):
    x = samples(8, 11, 3, dtype=torch.double)
    for change in ("conv", "pool"):
        layer = thread(kind)
        plain = layer(x, EDGE_INDEX)
        if change == "pool":
            layer.pools[0] = Shifted(1)
        else:
            old = layer.convs[0]
            new = Halved(3, 4) if kind == "whole" else HalvedSegments(PATCH, 3, 4)
            new.load_state_dict(old.state_dict())
            layer.convs[0] = new.double()
        out = layer(x, EDGE_INDEX)
        assert torch.allclose(out[:7], layer(x[:7], EDGE_INDEX))
        assert not torch.allclose(out, plain)


@pytest.mark.parametrize(
    "setting",
    [
        {"improved": True},
        {"add_self_loops": False},
        {"normalize": False, "add_self_loops": False},
        {"flow": "target_to_source"},
        {"fast": False},
        {"cached": True},
    ],
)
def test_attached_settings(setting):
    # A layer that a user has set otherwise is not computed as if it were not.
    x, layer = samples(8, 11, 3, dtype=torch.double), thread("whole")
    edges = (EDGE_INDEX[:, :7], 0.5 + torch.arange(7, dtype=torch.double))
    plain = layer(x, *edges)
    for name, value in setting.items():
        setattr(layer.convs[1], name, value)
    out = layer(x, *edges)
    assert torch.allclose(out[:7], layer(x[:7], *edges))
    assert torch.allclose(out, plain) == (set(setting) <= {"fast", "cached"})


@pytest.mark.parametrize("name", GRAPH_MODELS)
def test_attached_get_embeddings(name):
    model = small_model(name, torch.double)
    found = {}
    for batch_size in (7, 8):
        given = inputs(model, 8, torch.double)
        given = {k: v if k == "edge_index" else v[:batch_size] for k, v in given.items()}
        found[batch_size] = get_embeddings(model, **given)
    assert len(found[7]) == len(found[8]) >= 2
    for seven, eight in zip(found[7], found[8], strict=True):
        assert torch.allclose(eight[:7], seven)


@pytest.mark.parametrize("name", ["gcn_message", "mt_gcn", "patches"])
@pytest.mark.parametrize("leaf", ["MessagePassing", None])
def test_attached_summary(name, leaf):
    pytest.importorskip("tabulate", reason="needed by PyG's summary")
    model = small_model(name).eval()
    tables = []
    for batch_size in (7, 8):
        given = inputs(model, batch_size)
        args = (given.pop("x"), given.pop("edge_index"), given.pop("edge_attr", None))
        table = summary(model, *args, max_depth=6, leaf_module=leaf, **given)
        tables.append(" ".join(table.replace(f"[{batch_size},", "[B,").split()))
    assert tables[0].replace("-", "") == tables[1].replace("-", "")
    num_convs = sum(isinstance(m, (StaticGCNConv, SegmentedGCNConv)) for m in model.modules())
    assert tables[1].count("GCNConv | [B, 11") == num_convs > 0


def test_attached_thread_is_fast_again(monkeypatch):
    # With the hook gone, the layers are merged again; with one, they are not.
    merged = []
    name = "torch_geometric_tactile.nn._pooled_gcn.pooled_gcn"
    monkeypatch.setattr(name, lambda h, *args: merged.append(1) or h[:, :1])
    for kind in THREADS:
        layer, x = thread(kind), samples(8, 11, 3, dtype=torch.double)
        layer(x, EDGE_INDEX)
        assert len(merged) == 2
        handle = layer.convs[1].register_message_forward_hook(lambda *args: None)
        layer(x, EDGE_INDEX)
        assert len(merged) == 2
        handle.remove()
        layer(x, EDGE_INDEX)
        assert len(merged) == 4
        merged.clear()
