"""`StaticGATConv` and `StaticGATv2Conv` have PyG's numbers on (B, N, F), in each of their forms."""

import copy
import math
import warnings
from functools import partial

import pytest
import torch
from attachments import ATTACHMENTS, WITHOUT_EFFECT
from attention_pairs import EDGES, LAYERS, assert_same, gradients, on_batch, pair
from small_models import EDGE_INDEX, samples
from torch.autograd import forward_ad
from torch.func import functional_call, grad, jvp, vmap
from torch_geometric import EdgeIndex
from torch_geometric.explain.algorithm.utils import clear_masks, set_masks
from torch_geometric.nn import GATConv, GATv2Conv

from torch_geometric_tactile.nn.conv import StaticGATConv, StaticGATv2Conv
from torch_geometric_tactile.nn.conv import _attention_edges as attention_edges
from torch_geometric_tactile.nn.conv import _static_attention as static_attention

both = pytest.mark.parametrize("kind", LAYERS)
SETTINGS = [
    {},
    {"heads": 1},
    {"concat": False},
    {"negative_slope": 0.5},
    {"add_self_loops": False},
    {"bias": False},
    {"residual": True},
    {"residual": True, "concat": False, "bias": False},
    {"flow": "target_to_source"},
    {"aggr": "mean"},
    {"aggr": "max"},
    {"dropout": 0.5},
    {"edge_dim": 2},
]
FORMS = [(5, 3), (6, 5, 3)]


@pytest.fixture
def products(monkeypatch):
    """Notes each product of the fast form."""
    calls = []
    for module in ("static_gat_conv", "static_gatv2_conv"):
        path = f"torch_geometric_tactile.nn.conv.{module}.Attention.apply"
        from torch_geometric_tactile.nn.conv._attention_product import Attention

        apply = Attention.apply

        def counted(self, rows, apply=apply):
            calls.append(len(rows))
            return apply(self, rows)

        monkeypatch.setattr(path, counted)
        break  # both modules have the same class
    return calls


def is_fast(setting):
    return "aggr" not in setting


@both
def test_attention_by_hand(kind):
    # With no attention vector, all neighbours count the same: the mean of 1 and 4, times 10.
    conv = LAYERS[kind][0](1, 1, bias=False)
    with torch.no_grad():
        for name, value in conv.named_parameters():
            value.fill_(0.0 if "att" in name else 10.0)
    edge_index, x = torch.tensor([[0, 1], [1, 0]]), torch.tensor([[1.0], [4.0]])
    for form in (x, x[None], x.expand(9, 2, 1)):
        assert torch.allclose(conv(form, edge_index), torch.full((2, 1), 25.0))
    # Logits of 1 and 4 at both targets, of which LeakyReLU leaves positive ones as they are.
    with torch.no_grad():
        for name, value in conv.named_parameters():
            value.fill_(0.0 if "dst" in name else 1.0)
    share = 1 / (1 + math.exp(3))
    expected = torch.full((2, 1), share + 4 * (1 - share))
    for form in (x, x[None], x.expand(9, 2, 1)):
        assert torch.allclose(conv(form, edge_index), expected)


@both
@pytest.mark.parametrize("setting", SETTINGS, ids=str)
@pytest.mark.parametrize("edges", EDGES)
@pytest.mark.parametrize("num_samples", [1, 6])
def test_attention_gives_the_numbers_of_pyg(kind, setting, edges, num_samples, products):
    ours, theirs = pair(kind, 3, 4, **{"heads": 2, **setting})
    ours.eval(), theirs.eval()
    x, edge_index = samples(num_samples, 5, 3, dtype=torch.double), EDGES[edges]
    expected = on_batch(theirs, x, edge_index)
    found = ours(x, edge_index)
    assert_same(found, expected)
    assert found.is_contiguous()
    assert bool(products) == (
        is_fast(setting) and not (edges == "none" and setting.get("add_self_loops") is False)
    )
    products.clear()
    assert_same(ours(x, edge_index), expected)  # of what was kept
    assert_same(on_batch(ours, x, edge_index), expected)
    assert_same(ours(x.view(1, num_samples, 5, 3), edge_index), expected[None])
    assert_same(ours(x[0], edge_index), expected[0])
    ours.fast = False
    products.clear()
    assert_same(ours(x, edge_index), expected)
    assert products == []


@both
@pytest.mark.parametrize("setting", SETTINGS, ids=str)
@pytest.mark.parametrize("edges", EDGES)
def test_attention_gradients(kind, setting, edges):
    ours, theirs = (layer.eval() for layer in pair(kind, 3, 4, **{"heads": 2, **setting}))
    x, edge_index = samples(6, 5, 3, dtype=torch.double), EDGES[edges]
    expected = gradients(theirs, x, lambda layer, x: on_batch(layer, x, edge_index))
    found = gradients(ours, x, lambda layer, x: layer(x, edge_index))
    for a, b in zip(found, expected, strict=True):
        if b is None or a is None:
            assert a is None or not a.any()
            assert b is None or not b.any()
        else:
            assert_same(a, b)


@both
@pytest.mark.parametrize("edges", ["both_ways", "star"])
@pytest.mark.parametrize("needed", range(4))
def test_attention_gradients_of_some(kind, edges, needed):
    # Only what needs a gradient gets one, and it does not depend on the others.
    ours, x = pair(kind, 3, 4, heads=2)[0], samples(6, 5, 3, dtype=torch.double).requires_grad_()
    inputs = [x, *(value for name, value in ours.named_parameters() if name != "bias")]
    ours(x, EDGES[edges]).square().sum().backward()
    expected = inputs[needed].grad
    for value in [x, *ours.parameters()]:
        value.grad = None
        value.requires_grad_(value is inputs[needed])
    ours(x, EDGES[edges]).square().sum().backward()
    assert_same(inputs[needed].grad, expected)
    assert sum(value.grad is not None for value in [x, *ours.parameters()]) == 1


@both
@pytest.mark.parametrize("dropout", [0.0, 0.5])
def test_attention_second_derivatives(kind, dropout):
    ours = pair(kind, 2, 2, heads=2, dropout=dropout)[0]
    x, edge_index = samples(2, 5, 2, dtype=torch.double).requires_grad_(), EDGES["star"]

    def compute(x, *weights):
        torch.manual_seed(3)
        named = dict(zip(dict(ours.named_parameters()), weights, strict=True))
        return functional_call(ours, named, (x, edge_index)).square()

    inputs = (x, *ours.parameters())
    assert torch.autograd.gradcheck(compute, inputs)
    assert torch.autograd.gradgradcheck(compute, inputs)
    first, again = (
        torch.autograd.grad(compute(*inputs).sum(), inputs, create_graph=create_graph)
        for create_graph in (False, True)
    )
    for a, b in zip(first, again, strict=True):
        assert_same(a, b)


@both
def test_attention_dropout(kind, products):
    # Each coefficient is dropped by itself, the others are scaled, and the gradient knows which.
    ours = pair(kind, 3, 1, heads=2, dropout=0.4, bias=False)[0].train()
    x, edge_index = samples(400, 5, 3, dtype=torch.double), EDGES["both_ways"]
    torch.manual_seed(1)
    found = ours(x, edge_index)
    assert len(products) == 1
    mean = torch.stack([ours(x, edge_index) for _ in range(200)]).mean(dim=0)
    ours.eval()
    expected = ours(x, edge_index)
    assert not torch.allclose(found, expected)
    assert (mean - expected).abs().mean() < 0.05 * expected.abs().mean()
    # Node 0 has two neighbours, both of which are dropped with a probability of 0.16.
    dropped = (found[:, 0] == 0).double().mean()
    assert 0.11 < float(dropped) < 0.21
    ours.dropout = 1.0
    ours.train()
    assert not ours(x, edge_index).any()


@both
@pytest.mark.parametrize("fill_value", [0.5, "mean", "add", "max", torch.tensor([0.3, -0.2])])
@pytest.mark.parametrize("edges", ["self_loops", "star"])
@pytest.mark.parametrize("compiled", [False, pytest.param(True, marks=pytest.mark.full)])
def test_attention_edge_features(kind, fill_value, edges, compiled):
    edge_index = EDGES[edges]
    attr = samples(edge_index.size(1), 2, dtype=torch.double, seed=4)
    if isinstance(fill_value, torch.Tensor):
        fill_value = fill_value.double()
    ours, theirs = pair(kind, 3, 4, heads=2, edge_dim=2, fill_value=fill_value)
    x = samples(6, 5, 3, dtype=torch.double)
    expected = on_batch(theirs, x, edge_index, attr)
    if compiled:
        torch.compiler.reset()
        ours = torch.compile(ours, fullgraph=True, backend="eager")
    assert_same(ours(x, edge_index, attr), expected)
    assert_same(ours(x[0], edge_index, attr), expected[0])


@both
def test_attention_edge_features_of_one_column(kind):
    ours, theirs = pair(kind, 3, 4, heads=2, edge_dim=1)
    x, edge_index = samples(6, 5, 3, dtype=torch.double), EDGES["one_way"]
    attr = samples(4, dtype=torch.double, seed=4)
    assert_same(ours(x, edge_index, attr), on_batch(theirs, x, edge_index, attr))


@both
def test_attention_share_weights_and_lazy(kind):
    x, edge_index = samples(6, 5, 3), EDGES["one_way"]
    conv = LAYERS[kind][0](-1, 4, heads=2)
    first = conv(x, edge_index)
    assert torch.allclose(conv(x, edge_index), first, atol=1e-6)
    assert conv.state_dict().keys() == LAYERS[kind][1](3, 4, heads=2).state_dict().keys()
    if kind == "gatv2":
        ours, theirs = pair(kind, 3, 4, heads=2, share_weights=True)
        assert_same(ours(x.double(), edge_index), on_batch(theirs, x.double(), edge_index))
        compute = partial(lambda run, layer, x: run(layer, x), lambda c, x: c(x, edge_index))
        found = gradients(ours, x.double(), compute)
        expected = gradients(theirs, x.double(), lambda c, x: on_batch(c, x, edge_index))
        for a, b in zip(found, expected, strict=True):
            assert_same(a, b)


@both
@pytest.mark.parametrize("bad", [math.inf, -math.inf, math.nan])
@pytest.mark.parametrize("loops", [False, True])
@pytest.mark.parametrize("edges", EDGES)
def test_attention_to_infinite_and_missing_readings(kind, bad, loops, edges, products):
    # What is not finite has PyG's places, and goes no further than to neighbours.
    ours, theirs = pair(kind, 3, 4, heads=2, add_self_loops=loops)
    for node in range(5):
        x = samples(3, 5, 3, dtype=torch.double)
        x[1, node, 0] = bad
        found = ours(x, EDGES[edges])
        expected = on_batch(theirs, x, EDGES[edges])
        assert found.isfinite().equal(expected.isfinite())
        is_fine = expected.isfinite()
        assert torch.allclose(found[is_fine], expected[is_fine])
        assert found[::2].isfinite().all()
    assert products or edges == "none"


@both
@pytest.mark.parametrize("bad", [math.inf, math.nan])
@pytest.mark.parametrize("loops", [False, True])
@pytest.mark.parametrize("edges", ["one_way", "star", "twice"])
def test_attention_gradients_of_infinite_and_missing_readings(kind, bad, loops, edges):
    # The places of nodes with fewer neighbours take no part, in this sample or in another.
    ours, theirs = pair(kind, 3, 4, heads=2, add_self_loops=loops)
    for node in range(5):
        x = samples(3, 5, 3, dtype=torch.double)
        x[0, node, 0] = bad
        found = gradients(ours, x, lambda layer, x: layer(x, EDGES[edges]))[0]
        expected = gradients(theirs, x, lambda layer, x: on_batch(layer, x, EDGES[edges]))[0]
        assert found.isfinite().equal(expected.isfinite())
        is_fine = expected.isfinite()
        assert torch.allclose(found[is_fine], expected[is_fine])
        assert found[1:].isfinite().all()


@both
def test_attention_of_large_logits(kind):
    # The largest logit is subtracted, as in PyG.
    ours, theirs = pair(kind, 3, 4, heads=2)
    x = 1e4 * samples(3, 5, 3, dtype=torch.double)
    found = ours(x, EDGES["star"])
    assert found.isfinite().all()
    assert_same(found, on_batch(theirs, x, EDGES["star"]), atol=1e-6)


@both
def test_attention_of_no_taxel_and_a_single_one(kind):
    ours, theirs = pair(kind, 3, 4, heads=2)
    assert ours(samples(2, 0, 3, dtype=torch.double), EDGES["none"]).shape == (2, 0, 8)
    x = samples(2, 1, 3, dtype=torch.double)
    assert_same(ours(x, EDGES["none"]), on_batch(theirs, x, EDGES["none"]))


@both
def test_attention_by_messages_adds_loops_once(kind, monkeypatch):
    layer, edges, x = LAYERS[kind][0](3, 4, fast=False), EDGE_INDEX.clone(), samples(2, 11, 3)
    removed, remove = [], static_attention.remove_self_loops
    monkeypatch.setattr(
        static_attention, "remove_self_loops", lambda *a: removed.append(1) or remove(*a)
    )
    first = layer(x, edges)
    torch.testing.assert_close(layer(x, edges), first)
    assert len(removed) == 1
    edges[:, 0] = edges[:, 1]  # a write is noticed
    fresh = copy.deepcopy(layer)(x, edges)
    assert not torch.allclose(fresh, first)
    torch.testing.assert_close(layer(x, edges), fresh)
    returned, _ = layer(x, edges, return_attention_weights=True)[1]
    returned.zero_()  # the caller's own
    torch.testing.assert_close(layer(x, edges), fresh)


@both
def test_attention_sorts_its_edges_once(kind, monkeypatch):
    made = []
    init = attention_edges.AttentionEdges.__init__
    monkeypatch.setattr(
        attention_edges.AttentionEdges,
        "__init__",
        lambda self, *args: made.append(1) or init(self, *args),
    )
    ours, theirs = pair(kind, 3, 4, heads=2)
    edge_index = EDGES["one_way"].clone()
    for num_samples in (6, 2, 6):
        ours(samples(num_samples, 5, 3, dtype=torch.double), edge_index)
    assert len(made) == 1
    x = samples(6, 5, 3, dtype=torch.double)
    for value in (0, 4):
        edge_index[0].fill_(value)  # in place, through a view
        assert_same(ours(x, edge_index), on_batch(theirs, x, edge_index))
    assert len(made) == 3
    x = samples(6, 7, 3, dtype=torch.double)  # other nodes
    assert_same(ours(x, edge_index), on_batch(theirs, x, edge_index))
    ours.flow = theirs.flow = "target_to_source"  # settings of a layer that was called
    assert_same(ours(x, edge_index), on_batch(theirs, x, edge_index))
    ours.add_self_loops = theirs.add_self_loops = False
    assert_same(ours(x, edge_index), on_batch(theirs, x, edge_index))


@both
def test_attention_in_several_products(kind, monkeypatch, products):
    # Large batches are split, and the indices of few sizes are kept.
    monkeypatch.setattr(attention_edges, "_MAX_COEFFICIENTS", 100)
    monkeypatch.setattr(attention_edges, "_MAX_PATTERNS", 2)
    ours, theirs = pair(kind, 3, 4, heads=2)
    for num_samples in (1, 2, 7, 8, 9):
        x = samples(num_samples, 5, 3, dtype=torch.double)
        products.clear()
        assert_same(ours(x, EDGES["both_ways"]), on_batch(theirs, x, EDGES["both_ways"]))
        assert len(products) == math.ceil(num_samples / 3)
        assert len(ours._edge_cache.current._patterns) <= 2


def test_gatv2_blocks_of_samples(monkeypatch):
    from torch_geometric_tactile.nn.conv import static_gatv2_conv

    ours, theirs = pair("gatv2", 3, 4, heads=2)
    x, edge_index = samples(7, 5, 3, dtype=torch.double), EDGES["star"]
    expected = gradients(theirs, x, lambda layer, x: on_batch(layer, x, edge_index))
    for size in (1, 200, 10**6):  # a sample at a time, a few and a part, all
        monkeypatch.setattr(static_gatv2_conv, "_BLOCK_SIZE", size)
        for a, b in zip(
            gradients(ours, x, lambda layer, x: layer(x, edge_index)), expected, strict=True
        ):
            assert_same(a, b)


@both
def test_attention_of_a_hub_passes_messages(kind, products):
    # A node that all others join: padding all of them to its neighbours would cost more.
    edge_index = torch.stack([torch.arange(40), torch.zeros(40, dtype=torch.long)])
    ours, theirs = pair(kind, 3, 4, heads=2)
    x = samples(3, 40, 3, dtype=torch.double)
    assert_same(ours(x, edge_index), on_batch(theirs, x, edge_index))
    assert products == []


@both
def test_attention_trains_after_inference_mode(kind):
    ours, x = pair(kind, 3, 4, heads=2)[0], samples(6, 5, 3, dtype=torch.double)
    with torch.inference_mode():
        before = ours(x, EDGES["star"])
    after = ours(x, EDGES["star"])
    after.sum().backward()
    assert torch.equal(after, before)


@both
def test_attention_weights_are_returned(kind):
    ours, theirs = pair(kind, 3, 4, heads=2)
    x, edge_index = samples(6, 5, 3, dtype=torch.double), EDGES["star"]
    out, (edges, alpha) = ours(x, edge_index, return_attention_weights=True)
    assert_same(out, ours(x, edge_index))
    assert alpha.shape == (6, edges.size(1), 2)
    for i in range(6):
        _, (expected_edges, expected) = theirs(x[i], edge_index, return_attention_weights=True)
        assert torch.equal(edges, expected_edges)
        assert_same(alpha[i], expected)
    assert_same(ours(x[0], edge_index, return_attention_weights=True)[1][1], expected_of(theirs, x))


def expected_of(theirs, x):
    return theirs(x[0], EDGES["star"], return_attention_weights=True)[1][1]


@both
@pytest.mark.parametrize("dtype", [torch.int32, torch.int16, torch.uint8])
def test_attention_any_integers(kind, dtype):
    ours = pair(kind, 3, 4, heads=2)[0]
    for size in FORMS:
        x = samples(*size, dtype=torch.double)
        assert_same(ours(x, EDGES["star"].to(dtype)), ours(x, EDGES["star"]))


@both
def test_attention_edge_index_of_pyg(kind, products):
    ours = pair(kind, 3, 4, heads=2)[0]
    edges = EdgeIndex(EDGES["star"], sparse_size=(5, 5))
    for size in FORMS:
        x = samples(*size, dtype=torch.double)
        assert_same(ours(x, edges), ours(x, EDGES["star"]))
    assert len(products) == 2


@both
def test_attention_bad_features(kind):
    conv = LAYERS[kind][0](3, 4, heads=2, edge_dim=2)
    with pytest.raises(ValueError, match=r"'x' must hold floating-point numbers \(got torch.int"):
        conv(torch.zeros(5, 3, dtype=torch.long), EDGES["star"])
    for size in FORMS:
        for attr in (samples(5, 2), samples(6, 6, 2)):
            with pytest.raises(ValueError, match=r"'edge_attr' must have 6 rows.*\(got shape"):
                conv(samples(*size), EDGES["star"], attr)
        with pytest.raises(ValueError, match=r"'edge_attr' must have 2 features \(got 3\)"):
            conv(samples(*size), EDGES["star"], samples(6, 3))
    plain = LAYERS[kind][0](3, 4)
    if kind == "gatv2":
        with pytest.raises(ValueError, match=r"'edge_attr' must be None without 'edge_dim'"):
            plain(samples(5, 3), EDGES["star"], samples(6, 2))
    else:  # PyG's layer ignores them
        attr = samples(6, 2)
        for size in FORMS:
            x = samples(*size)
            assert torch.allclose(plain(x, EDGES["star"], attr), plain(x, EDGES["star"]), atol=1e-6)


@pytest.mark.full
@both
@pytest.mark.parametrize("loops", [False, True])
@pytest.mark.parametrize("edges", ["self_loops", "star"])
def test_attention_compile_and_export(kind, loops, edges):
    torch.compiler.reset()
    ours = pair(kind, 3, 4, heads=2, add_self_loops=loops)[0].eval()
    edge_index, x = EDGES[edges], samples(6, 5, 3, dtype=torch.double)
    compiled = torch.compile(ours, fullgraph=True, backend="aot_eager")
    assert_same(compiled(x, edge_index), ours(x, edge_index))
    batch = torch.export.Dim("batch")
    shapes = {"x": {0: batch}, "edge_index": None}
    exported = torch.export.export(ours, (x, edge_index), dynamic_shapes=shapes).module()
    x = samples(9, 5, 3, dtype=torch.double)
    assert_same(exported(x, edge_index), ours(x, edge_index))
    x[1, 0] = math.inf
    assert exported(x, edge_index).isfinite().equal(ours(x, edge_index).isfinite())


@pytest.mark.full
@both
def test_attention_onnx(kind, tmp_path):
    runtime = pytest.importorskip("onnxruntime")
    pytest.importorskip("onnxscript")
    conv, x = LAYERS[kind][0](3, 4, heads=2).eval(), samples(6, 5, 3)
    path = tmp_path / "layer.onnx"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        torch.onnx.export(conv, (x, EDGES["self_loops"]), path, dynamo=True, opset_version=18)
    session = runtime.InferenceSession(path, providers=["CPUExecutionProvider"])
    names = [node.name for node in session.get_inputs()]
    values = (x.numpy(), EDGES["self_loops"].numpy())
    found = session.run(None, dict(zip(names, values, strict=True)))[0]
    assert torch.allclose(torch.from_numpy(found), conv(x, EDGES["self_loops"]), atol=1e-5)


@both
def test_attention_under_transforms(kind):
    ours = pair(kind, 3, 4, heads=2)[0]
    x, edge_index = samples(6, 5, 3, dtype=torch.double), EDGES["star"]
    weights = {name: value.detach() for name, value in ours.named_parameters()}

    def loss(weights, x):
        return functional_call(ours, weights, (x, edge_index)).square().sum()

    expected = torch.autograd.grad(ours(x, edge_index).square().sum(), list(ours.parameters()))
    each = vmap(grad(loss), (None, 0))(weights, x.unsqueeze(1))
    for name, value in zip(weights, expected, strict=True):
        assert_same(each[name].sum(dim=0), value)
    tangent = samples(6, 5, 3, dtype=torch.double, seed=5)
    _, forward = jvp(lambda x: ours(x, edge_index), (x,), (tangent,))
    h = 1e-6
    step = (ours(x + h * tangent, edge_index) - ours(x - h * tangent, edge_index)) / (2 * h)
    assert torch.allclose(forward, step, atol=1e-7)
    with forward_ad.dual_level():
        dual = ours(forward_ad.make_dual(x, tangent), edge_index)
        assert_same(forward_ad.unpack_dual(dual).tangent, forward)


@both
def test_attention_autocast(kind, products):
    ours, theirs = pair(kind, 3, 4, heads=2, dtype=torch.float)
    x = samples(6, 5, 3)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        found, expected = ours(x, EDGES["star"]), on_batch(theirs, x, EDGES["star"])
    assert products == []
    assert found.dtype == expected.dtype
    assert torch.allclose(found.float(), expected.float(), atol=0.05)


@both
def test_attention_explained(kind):
    ours, theirs = pair(kind, 3, 4, heads=2)
    x, edge_index = samples(6, 5, 3, dtype=torch.double), EDGES["star"]
    unmasked = ours(x, edge_index)
    mask = torch.nn.Parameter(torch.linspace(0, 1, 6, dtype=torch.double))
    for conv in (ours, theirs):
        set_masks(conv, mask, edge_index, apply_sigmoid=False)
    found = ours(x, edge_index)
    assert_same(found, torch.stack([theirs(row, edge_index) for row in x]))
    assert not torch.allclose(found, unmasked)
    clear_masks(ours)
    assert torch.equal(ours(x, edge_index), unmasked)


class OfSources(StaticGATv2Conv):
    """Gives the map of the sources the name that the attachments know."""

    @property
    def lin(self):
        return self.lin_l


class OfSourcesOfPyG(GATv2Conv):
    @property
    def lin(self):
        return self.lin_l


ATTACHED = {"gat": LAYERS["gat"], "gatv2": (OfSources, OfSourcesOfPyG)}


@both
@pytest.mark.parametrize("name", [name for name in ATTACHMENTS if name != "explained"])
def test_attached_to_attention_as_to_pygs(kind, name):
    if (kind, name) == ("gatv2", "adapter"):
        pytest.skip("replaces a map by its name")
    x, found = samples(8, 11, 3, dtype=torch.double), []
    state = pair(kind, 3, 4, heads=2)[1].state_dict()
    for cls in ATTACHED[kind]:
        conv, calls = cls(3, 4, heads=2).double().eval(), []
        conv.load_state_dict(state)

        def compute(layer, x):
            return layer(x, EDGE_INDEX)

        run = compute if cls is ATTACHED[kind][0] else partial(on_batch, edge_index=EDGE_INDEX)
        plain = run(conv, x).detach()
        calls.clear()
        torch.manual_seed(0)  # for a norm that is estimated
        ATTACHMENTS[name](conv, calls)
        out = run(conv, x).detach()
        calls.clear()
        grads = gradients(conv, x, run)
        found.append((out, grads, list(calls)))
        assert torch.allclose(out, plain) == (name in WITHOUT_EFFECT)
    (out, grads, calls), (expected, expected_grads, expected_calls) = found
    assert_same(out, expected, atol=1e-8)
    assert calls == expected_calls
    for a, b in zip(grads, expected_grads, strict=True):
        assert (a is None) == (b is None)
        if a is not None:
            assert_same(a, b, atol=1e-8)


@both
@pytest.mark.parametrize("method", ["propagate", "message", "aggregate", "edge_update"])
def test_attention_message_hooks(kind, method):
    found = []
    x, edge_index = samples(6, 5, 3, dtype=torch.double), EDGES["star"]
    for conv in pair(kind, 3, 4, heads=2):
        calls = []
        getattr(conv, f"register_{method}_forward_pre_hook")(
            lambda *args, calls=calls: calls.append("before")
        )
        getattr(conv, f"register_{method}_forward_hook")(lambda *args: args[-1] + 1)
        static = isinstance(conv, (StaticGATConv, StaticGATv2Conv))
        found.append(conv(x, edge_index) if static else on_batch(conv, x, edge_index))
        assert calls == ["before"]
    assert_same(*found)


class Halved:
    def message(self, x_j, alpha):
        return 0.5 * super().message(x_j, alpha)


class Sharper:
    """Its own `edge_update`, with the arguments of PyG's, which it calls."""

    def edge_update(self, *args, **kwargs):
        return super().edge_update(*args, **kwargs) ** 2


def subclass(mixin, layer):
    # PyG reads the arguments from the signature.
    kind = type(f"{mixin.__name__}{layer.__name__}", (mixin, layer), {})
    if mixin is Sharper:
        if issubclass(layer, GATConv):

            def edge_update(self, alpha_j, alpha_i, edge_attr, index, ptr, dim_size):
                return (
                    layer.edge_update(self, alpha_j, alpha_i, edge_attr, index, ptr, dim_size) ** 2
                )
        else:

            def edge_update(self, x_j, x_i, edge_attr, index, ptr, dim_size):
                return layer.edge_update(self, x_j, x_i, edge_attr, index, ptr, dim_size) ** 2

        edge_update.__annotations__ = dict(layer.edge_update.__annotations__)
        kind = type(kind.__name__, (layer,), {"edge_update": edge_update})
    return kind


@both
@pytest.mark.parametrize("mixin", [Halved, Sharper])
@pytest.mark.parametrize("with_attr", [False, True])
def test_attention_subclasses(kind, mixin, with_attr, products):
    x, edge_index = samples(6, 5, 3, dtype=torch.double), EDGES["star"]
    attr = samples(6, 2, dtype=torch.double, seed=4) if with_attr else None
    outs = []
    torch.manual_seed(0)
    plain = LAYERS[kind][1](3, 4, heads=2, edge_dim=2).double()
    for layer in LAYERS[kind]:
        own = subclass(mixin, layer)
        again = type("Again", (own,), {})  # defined after its parent was compiled
        for cls in (own, again):
            conv = cls(3, 4, heads=2, edge_dim=2).double()
            conv.load_state_dict(plain.state_dict())
            static = issubclass(layer, (StaticGATConv, StaticGATv2Conv))
            outs.append(
                conv(x, edge_index, attr) if static else on_batch(conv, x, edge_index, attr)
            )
            again = type("Again", (own,), {})
    for out in outs[1:]:
        assert_same(out, outs[0])
    assert not torch.allclose(outs[0], on_batch(plain, x, edge_index, attr))
    assert products == []


@both
def test_attention_plain_subclass_is_fast(kind, products):
    own = type("Child", (LAYERS[kind][0],), {})
    for cls in (own, type("GrandChild", (own,), {})):
        conv = cls(3, 4, heads=2)
        for _ in range(2):
            conv(samples(6, 5, 3), EDGES["star"])
        cls(3, 4).forward(samples(5, 3), EDGES["star"])
    assert len(products) == 4


@both
def test_attention_bipartite(kind):
    # A pair of sources and targets goes to PyG's own code.
    ours, theirs = pair(kind, (3, 2), 4, heads=2)
    x = samples(5, 3, dtype=torch.double), samples(4, 2, dtype=torch.double)
    edge_index = torch.tensor([[0, 4, 2], [3, 1, 1]])
    assert_same(ours(x, edge_index), theirs(x, edge_index))


def test_attention_of_two_maps_on_one_input():
    # PyG's layers for bipartite graphs take one tensor as well.
    for kind in LAYERS:
        ours, theirs = pair(kind, (3, 3), 4, heads=2)
        x = samples(6, 5, 3, dtype=torch.double)
        assert_same(ours(x, EDGES["star"]), on_batch(theirs, x, EDGES["star"]))


@pytest.mark.parametrize("of_pyg", [GATConv, GATv2Conv])
def test_attention_is_pygs(of_pyg):
    ours = {GATConv: StaticGATConv, GATv2Conv: StaticGATv2Conv}[of_pyg]
    assert issubclass(ours, of_pyg)
    torch.manual_seed(0)
    first = ours(3, 4, heads=2, residual=True).state_dict()
    torch.manual_seed(0)
    second = of_pyg(3, 4, heads=2, residual=True).state_dict()
    assert first.keys() == second.keys()
    assert all(torch.equal(first[name], second[name]) for name in first)
