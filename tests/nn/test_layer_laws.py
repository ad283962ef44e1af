"""Laws that hold for all layers: on one sample, on samples (B, N, F) and on PyG's batch."""

import copy
import io
import pickle

import pytest
import torch
from nn.layer_table import (
    CONVS,
    ENCODERS,
    GRAPH_LAYERS,
    LAYERS,
    LAZY_LAYERS,
    MATRIX_LAYERS,
    NO_EDGES,
    NUM_TAXELS,
    WEIGHTED_LAYERS,
    batch_inputs,
    layer_inputs,
    make_layer,
    sample_inputs,
)
from plain_models import MODELS as READING_MODELS
from small_models import EDGE_INDEX, MODELS, NUM_EDGES, samples
from torch.func import functional_call, grad, vmap

from torch_geometric_tactile import nn
from torch_geometric_tactile.nn import StaticGCNConv
from torch_geometric_tactile.testing import (
    assert_permutation_equivariant,
    assert_static_equals_batched,
)

GRAPHS = {
    "hand": EDGE_INDEX,
    "one way": EDGE_INDEX[:, :7],
    "loops and an edge twice": torch.tensor([[0, 1, 2, 2, 4, 4], [0, 2, 2, 3, 6, 6]]),
    "no edges": NO_EDGES,
}
NUMBERED_LAYERS = ("segmented", "segmented_thread", "edge_patch", "edge_dense")  # own weights
EDGE_FEATURE_LAYERS = ("gat_edges", "gatv2_edges")
FORMS = (None, 2, 9)  # one sample, and samples on either side of a limit of the threads
BASE_CLASSES = {"TactileModel", "Thread"}
every_layer = pytest.mark.parametrize("name", LAYERS)
every_graph_layer = pytest.mark.parametrize("name", GRAPH_LAYERS)
every_conv = pytest.mark.parametrize("name", CONVS)


def sample_forms(name):
    """The samples at once, one by one, and as PyG's batch."""
    forms = {"samples": lambda given: [given], "one by one": lambda g: sample_inputs(name, g)}
    if name == "cnn_thread":  # whose readings are images
        return {**forms, "one by one": lambda given: [[given[0][i : i + 1]] for i in range(9)]}
    return {**forms, "batch": lambda given: [batch_inputs(name, given)]}


def gradients(layer, arguments, form=lambda given: [given]):
    """The output, and the gradients of features, edge inputs and parameters."""
    leaves = [
        value.clone().requires_grad_() if is_differentiable(value) else value for value in arguments
    ]
    out = torch.cat([layer(*row).flatten() for row in form(leaves)])
    scale = torch.arange(out.numel(), dtype=out.dtype).cos()
    tensors = [*filter(is_differentiable, leaves), *layer.parameters()]
    grads = torch.autograd.grad((out * scale).sum(), tensors)
    return [out.detach(), *grads]


def is_differentiable(value):
    return isinstance(value, torch.Tensor) and value.is_floating_point()


def assert_all_close(values, expected, **tolerance):
    for value, expected_value in zip(values, expected, strict=True):
        torch.testing.assert_close(value, expected_value, **tolerance)


def test_all_layers_and_models_are_in_a_table():
    layers = {type(make_layer(name)).__name__ for name in LAYERS}
    models = {type(make()).__name__ for make in (*MODELS.values(), *READING_MODELS.values())}
    encoders = {
        "TouchEncoder"
    }  # of frames with time before the taxels: models/test_touch_encoder.py
    assert layers | models | encoders | BASE_CLASSES == set(nn.__all__)


@every_layer
def test_text_and_number_of_parameters(name):
    layer = make_layer(name)
    assert str(layer) == LAYERS[name].text
    assert sum(value.numel() for value in layer.parameters()) == LAYERS[name].num_parameters


@every_layer
def test_forms_have_the_same_numbers_and_gradients(name):
    layer, given = make_layer(name, torch.double), layer_inputs(name, 9, torch.double)
    expected, *others = [gradients(layer, given, form) for form in sample_forms(name).values()]
    assert all(value.abs().max() > 0 for value in expected)
    for values in others:
        assert_all_close(values, expected)


@every_graph_layer
@pytest.mark.parametrize("graph", GRAPHS)
@pytest.mark.parametrize("batch_size", [2, 9])
@pytest.mark.parametrize("reading", [0.5, torch.nan, torch.inf])
def test_static_equals_batched(name, graph, batch_size, reading):
    edge_index = EDGE_INDEX if name == "edge_dense" else GRAPHS[graph]
    layer, x = call_by_readings(name, make_layer(name)), samples(batch_size, NUM_TAXELS, 3)
    edge_attr = edge_input(name, edge_index, batch_size)
    features = edge_attr if name in ENCODERS else x
    features[1, 3:4, 0] = reading
    assert_static_equals_batched(layer, x, edge_index, edge_attr)
    if name in MATRIX_LAYERS:
        assert_static_equals_batched(layer, x, edge_index)


def call_by_readings(name, layer):
    """The layer with the arguments of the laws: an encoder counts the taxels of the readings."""
    if name in ENCODERS:
        return lambda x, edge_index, edge_attr: layer(edge_attr, edge_index, x.size(-2))
    return layer


def edge_input(name, edge_index, batch_size=None):
    """The third argument of the laws, or none: shared by the samples of a convolution."""
    features, _, *others = layer_inputs(name, batch_size, edge_index=edge_index)
    if name in ENCODERS:
        return features
    return others[0] if others else None


@every_graph_layer
@pytest.mark.parametrize("graph", ["hand", "one way"])
def test_permutation_equivariance_of_layers_without_weights_of_taxels(name, graph):
    edge_index = EDGE_INDEX if name == "edge_dense" else GRAPHS[graph]
    layer, x = call_by_readings(name, make_layer(name)), samples(9, NUM_TAXELS, 3)
    edge_attr = edge_input(name, edge_index)
    if name not in NUMBERED_LAYERS:
        assert_permutation_equivariant(layer, x, edge_index, edge_attr=edge_attr)
        return
    with pytest.raises(AssertionError, match="permutation equivariant: the largest difference"):
        assert_permutation_equivariant(layer, x, edge_index, edge_attr=edge_attr)


@every_conv
@pytest.mark.parametrize("bad", [torch.nan, torch.inf, -torch.inf])
@pytest.mark.parametrize("batch_size", FORMS)
def test_missing_and_infinite_readings_go_along_edges_alone(name, bad, batch_size):
    layer, given = make_layer(name), layer_inputs(name, batch_size)
    expected = layer(*given)
    broken = given[0].clone()
    broken[(3, 0) if batch_size is None else (0, 3, 0)] = bad
    out = layer(broken, *given[1:])
    reached = {3}
    for _ in range(2 if name.endswith("thread") else 1):  # convolutions
        reached |= {t for s, t in EDGE_INDEX.t().tolist() if s in reached}
    is_reached = torch.zeros(expected.shape[:-1], dtype=torch.bool)
    is_reached[(0,) * (batch_size is not None)][..., sorted(reached)] = True
    torch.testing.assert_close(out[~is_reached], expected[~is_reached])
    assert not torch.allclose(out[is_reached], expected[is_reached])


@every_layer
@pytest.mark.parametrize("batch_size", FORMS)
def test_inputs_are_not_written_to(name, batch_size):
    if name == "cnn_thread" and batch_size is None:
        pytest.skip("takes samples only")
    layer, given = make_layer(name), layer_inputs(name, batch_size)
    before = copy.deepcopy(given)
    given[0].requires_grad_()
    layer(*given).square().sum().backward()
    for value, expected in zip(given, before, strict=True):
        assert value.equal(expected) if torch.is_tensor(value) else value == expected


@every_layer
def test_no_samples(name):
    layer, given = make_layer(name), layer_inputs(name, 2)
    out = layer(*given)
    assert layer(given[0][:0], *given[1:]).shape == (0, *out.shape[1:])
    if name in ("edge_dense", "cnn_thread", *EDGE_FEATURE_LAYERS):
        return
    empty = layer_inputs(name, 0, edge_index=NO_EDGES)
    rows = layer(*batch_inputs(name, empty))
    assert rows.shape == (0, *out.shape[2:])


@every_layer
def test_copies_and_saved_weights_give_the_same_numbers(name):
    layer, other, given = make_layer(name), make_layer(name, seed=1), layer_inputs(name, 9)
    expected = layer(*given)
    file = io.BytesIO()
    torch.save(layer, file)
    file.seek(0)
    copies = [copy.deepcopy(layer), pickle.loads(pickle.dumps(layer))]
    for copied in (*copies, torch.load(file, weights_only=False)):
        cache = getattr(copied, "_edge_cache", None)
        assert cache is None or cache.current is None  # copies carry no edges along
        assert torch.equal(copied(*given), expected)
    state = layer.state_dict()
    assert state.keys() == dict(layer.named_parameters()).keys()
    assert torch.equal(other(*given), expected) == (not state)
    other.load_state_dict(state)
    assert torch.equal(other(*given), expected)


@pytest.mark.parametrize("name", [name for name in LAYERS if LAYERS[name].num_parameters])
def test_reset_draws_new_weights_by_the_seed(name):
    layer, given, outs = make_layer(name), layer_inputs(name, 9), []
    before = {key: value.detach().clone() for key, value in layer.named_parameters()}
    for _ in range(2):
        torch.manual_seed(3)
        layer.reset_parameters()
        outs.append(layer(*given))
    assert torch.equal(*outs)
    for key, value in layer.named_parameters():
        assert (value != before[key]).all(), key
        if key == "bias":
            assert not value.any()


@every_layer
@pytest.mark.parametrize("dtype", [torch.double, torch.bfloat16])
def test_numbers_of_other_precisions(name, dtype):
    layer, given = make_layer(name, dtype), layer_inputs(name, 9, dtype)
    out, expected = layer(*given), make_layer(name)(*layer_inputs(name, 9))
    assert out.dtype == dtype
    torch.testing.assert_close(out.float(), expected, rtol=0.1, atol=0.1)


@every_layer
@pytest.mark.parametrize("batch_size", [2, 9])
def test_autocast(name, batch_size):
    layer, given = make_layer(name), layer_inputs(name, batch_size)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        out = layer(*given)
    torch.testing.assert_close(out.float(), layer(*given), rtol=0.1, atol=0.1)


@every_layer
@pytest.mark.parametrize("mode", [torch.no_grad, torch.inference_mode])
def test_training_after_validation(name, mode):
    layer, given = make_layer(name), layer_inputs(name, 9)
    expected = gradients(copy.deepcopy(layer), given)
    with mode():
        layer(*given)
    assert_all_close(gradients(layer, given), expected)


@pytest.mark.full
@every_layer
@pytest.mark.parametrize("batch_size", [2, 9])
def test_compiled_layers_have_the_same_numbers_and_gradients(name, batch_size):
    torch.compiler.reset()
    layer, given = make_layer(name), layer_inputs(name, batch_size)
    compiled = torch.compile(layer, fullgraph=True, backend="aot_eager")
    expected = gradients(layer, given)
    assert_all_close(gradients(compiled, given), expected, rtol=1e-4, atol=1e-4)


@pytest.mark.full
@pytest.mark.parametrize("name", [name for name in LAYERS if name != "segmented"])
def test_exported_layers_take_any_number_of_samples(name):
    layer, given = make_layer(name).eval(), layer_inputs(name, 3)
    shapes = [{0: torch.export.Dim("batch")}, *[None] * (len(given) - 1)]
    exported = torch.export.export(layer, tuple(given), dynamic_shapes=shapes).module()
    for batch_size in (3, 20):
        given = layer_inputs(name, batch_size)
        torch.testing.assert_close(exported(*given), layer(*given))


@pytest.mark.parametrize("name", [name for name in CONVS if "thread" not in name])
def test_function_transforms(name):
    layer, (x, *others) = make_layer(name, fast=True), layer_inputs(name, 8)
    out = vmap(lambda x: layer(x, *others))(x.unflatten(0, (2, 4)))
    torch.testing.assert_close(out.flatten(0, 1), layer(x, *others))
    weights = {key: value.detach() for key, value in layer.named_parameters()}

    def loss(weights, x):
        return functional_call(layer, weights, (x, *others)).square().sum()

    weight_grads, x_grad = grad(loss, (0, 1))(weights, x)
    for key, value in grad(loss)(weights, x).items():  # where 'x' takes no part in the transform
        torch.testing.assert_close(value, weight_grads[key])
    layer(x.requires_grad_(), *others).square().sum().backward()
    torch.testing.assert_close(x_grad, x.grad)
    for key, value in layer.named_parameters():
        torch.testing.assert_close(weight_grads[key], value.grad)


@every_conv
@pytest.mark.parametrize("reading", [0.5, torch.nan, torch.inf])
def test_fast_form_has_the_numbers_and_gradients_of_messages(name, reading):
    fast, slow = (make_layer(name, torch.double, fast=fast) for fast in (True, False))
    given = layer_inputs(name, 9, torch.double)
    given[0][0, 3, 0] = reading
    outs = [gradients(layer, given) for layer in (fast, slow)]
    torch.testing.assert_close(outs[0][0], outs[1][0], equal_nan=True)
    if reading == 0.5:
        assert_all_close(*outs)


@pytest.mark.parametrize("name", [name for name in GRAPH_LAYERS if name != "edge_dense"])
@pytest.mark.parametrize("batch_size", FORMS)
def test_edges_that_were_written_to_are_noticed(name, batch_size):
    def replace(tensor):
        tensor.data = tensor.roll(1, 0)

    changes = [
        lambda tensor: tensor[..., :5].copy_(tensor[..., 5:10].clone()),
        lambda tensor: tensor.numpy().__setitem__((..., slice(0, 5)), 3),
        lambda tensor: tensor.data.__setitem__((..., slice(5, 9)), 5),
        replace,
    ]
    layer, given = make_layer(name), layer_inputs(name, batch_size)
    given[1:] = [copy.deepcopy(value) for value in given[1:]]
    outs = [layer(*given)]
    has_vectors = name in EDGE_FEATURE_LAYERS
    for value in filter(torch.is_tensor, given[1 : 2 if has_vectors else 3]):
        for change in changes:
            change(value)
            outs.append(layer(*given))
            torch.testing.assert_close(outs[-1], make_layer(name)(*given))
            assert not torch.allclose(outs[-1], outs[-2])


@pytest.mark.parametrize("name", MATRIX_LAYERS)
@pytest.mark.parametrize("layout", [torch.sparse_coo, torch.sparse_csr])
@pytest.mark.parametrize("batch_size", FORMS)
@pytest.mark.filterwarnings("ignore:Sparse")
def test_sparse_matrix_of_targets_and_sources(name, layout, batch_size):
    layer, (x, edge_index, *others) = make_layer(name), layer_inputs(name, batch_size)
    weight = others[0] if others else torch.ones(NUM_EDGES)
    matrix = torch.sparse_coo_tensor(edge_index.flip(0), weight, (NUM_TAXELS, NUM_TAXELS))
    out = layer(x, matrix.to_sparse(layout=layout))
    torch.testing.assert_close(out, layer(x, edge_index, *others))


@pytest.mark.parametrize("name", MATRIX_LAYERS)
@pytest.mark.parametrize("batch_size", FORMS)
@pytest.mark.filterwarnings("ignore:Sparse")
def test_sparse_matrix_of_the_caller_stays_as_it_is(name, batch_size):
    weight = samples(NUM_EDGES, seed=3).exp()
    matrix = torch.sparse_coo_tensor(EDGE_INDEX.flip(0), weight, (NUM_TAXELS, NUM_TAXELS))
    for layer in (make_layer(name), StaticGCNConv(3, 5, cached=True)):
        layer(layer_inputs(name, batch_size)[0], matrix)
    assert not matrix.is_coalesced()  # its indices are not sorted
    assert matrix.to_sparse_csr().to_dense().equal(matrix.to_dense())


# Layers with edge features fill those of self-loops by the targets, as in PyG.
ONE_WAY_LAYERS = ("sector", "edge_dense", *EDGE_FEATURE_LAYERS)


@pytest.mark.parametrize(
    "name",
    [name for name in GRAPH_LAYERS if name not in ONE_WAY_LAYERS],
)
@pytest.mark.parametrize("batch_size", FORMS)
def test_flow(name, batch_size):
    layer, other = make_layer(name), make_layer(name)
    for conv in getattr(layer, "convs", [layer]):
        conv.flow = "target_to_source"
    x, edge_index, *others = layer_inputs(name, batch_size, edge_index=GRAPHS["one way"])
    out = layer(x, edge_index, *others)
    torch.testing.assert_close(out, other(x, edge_index.flip(0), *others))
    assert not torch.allclose(out, other(x, edge_index, *others))


BAD_EDGES = [
    (torch.zeros(7, 2, dtype=torch.long), r"have shape \(2, num_edges\).* \(got \(7, 2\)\)"),
    (torch.zeros(2, dtype=torch.long), r"have shape \(2, num_edges\).* \(got \(2,\)\)"),
    (torch.zeros(1, 2, 3, dtype=torch.long), r"have shape \(2, num_edges\).*got \(1, 2, 3\)"),
    (torch.zeros(2, NUM_EDGES), r"hold integers \(got torch.float32\)"),
    (torch.zeros(2, NUM_EDGES, dtype=torch.bool), r"hold integers \(got torch.bool\)"),
    (EDGE_INDEX + 1, r"hold node indices from 0 to 10, .* \(got 1 to 11\)"),
    (EDGE_INDEX - 1, r"hold node indices from 0 to 10, .* \(got -1 to 9\)"),
    (EDGE_INDEX + torch.tensor([[1], [0]]), r"from 0 to 10, .* \(got 0 to 11\)"),
    (EDGE_INDEX - torch.tensor([[0], [1]]), r"from 0 to 10, .* \(got -1 to 10\)"),
    (torch.eye(12).to_sparse(), r"have shape"),
]


CHECKED_LAYERS = [
    *((name, {}) for name in GRAPH_LAYERS if name != "edge_dense"),  # which looks at no edges
    *((name, {"fast": False}) for name in CONVS),
    *(("gcn", setting) for setting in ({"normalize": False}, {"cached": True})),
]


@pytest.mark.parametrize(("name", "setting"), CHECKED_LAYERS)
@pytest.mark.parametrize("batch_size", FORMS)
@pytest.mark.parametrize(("edge_index", "match"), BAD_EDGES)
def test_bad_edges_are_refused(name, setting, batch_size, edge_index, match):
    layer, (x, edges, *others) = make_layer(name, **setting), layer_inputs(name, batch_size)
    for _ in range(2):  # the first failure leaves nothing behind
        with pytest.raises(ValueError, match=f"'edge_index' must .*{match}"):
            layer(x, edge_index, *others)
    layer(x, edges, *others)


@pytest.mark.parametrize("name", WEIGHTED_LAYERS)
@pytest.mark.parametrize("batch_size", FORMS)
@pytest.mark.parametrize(
    ("weight", "match"),
    [
        (torch.ones(4), r"have shape \(23,\), one weight per edge \(got \(4,\)\)"),
        (torch.ones(23, 2), r"have shape \(23,\), one weight per edge \(got \(23, 2\)\)"),
        (torch.tensor(1.0), r"have shape \(23,\), one weight per edge \(got \(\)\)"),
        (torch.ones(23, dtype=torch.bool), r"hold real numbers \(got torch.bool\)"),
        (torch.ones(23, dtype=torch.cfloat), r"hold real numbers \(got torch.complex64\)"),
    ],
)
def test_bad_weights_are_refused(name, batch_size, weight, match):
    layer, (x, edge_index, _) = make_layer(name), layer_inputs(name, batch_size)
    with pytest.raises(ValueError, match=f"'edge_weight' must {match}"):
        layer(x, edge_index, weight)


@pytest.mark.parametrize("name", WEIGHTED_LAYERS)
@pytest.mark.parametrize("batch_size", FORMS)
def test_weights_beside_a_sparse_matrix_are_refused(name, batch_size):
    x, _, weight = layer_inputs(name, batch_size)
    with pytest.raises(ValueError, match=r"'edge_weight' must be None if 'edge_index' is sparse"):
        make_layer(name)(x, torch.eye(NUM_TAXELS).to_sparse(), weight)


@every_graph_layer
@pytest.mark.parametrize("batch_size", FORMS)
def test_bad_features_are_refused(name, batch_size):
    layer, (x, *others) = make_layer(name), layer_inputs(name, batch_size)
    key = "edge_attr" if name in ENCODERS else "x"
    for bad in (x[..., :2], x.flatten()[:3]):
        with pytest.raises(ValueError, match=rf"'{key}' must have .*\(got "):
            layer(bad, *others)


@pytest.mark.parametrize("name", ["self", "difference", "segmented", "sector"])
def test_pairs_of_features_are_refused(name):
    x, *others = layer_inputs(name, None)
    with pytest.raises(ValueError, match=r"'x' must be a tensor with .* \(got tuple\)"):
        make_layer(name)((x, x), *others)


@pytest.mark.parametrize("name", LAZY_LAYERS)
def test_size_comes_from_the_first_input(name):
    lazy, sized, given = LAYERS[name].make(-1), make_layer(name), layer_inputs(name, 9)
    copied = copy.deepcopy(lazy)
    expected = lazy(*given)
    if not name.startswith("gcn"):  # PyG's layer keeps its -1
        assert str(lazy) == str(sized)
    assert {k: v.shape for k, v in lazy.state_dict().items()} == {
        k: v.shape for k, v in sized.state_dict().items()
    }
    sized.load_state_dict(lazy.state_dict())
    torch.testing.assert_close(sized(*given), expected)
    expected.sum().backward()
    assert all(p.grad is not None for p in lazy.parameters())
    assert copied(*given).shape == expected.shape  # a copy has a size of its own
    with pytest.raises(ValueError, match=r"'(x|edge_attr)' must"):
        lazy(given[0][..., :2], *given[1:])


@pytest.mark.parametrize("name", LAZY_LAYERS)
def test_size_comes_from_a_saved_state(name):
    given = layer_inputs(name, 9)
    sized, lazy = make_layer(name), LAYERS[name].make(-1)
    lazy.load_state_dict(sized.state_dict())
    torch.testing.assert_close(lazy(*given), sized(*given))
    file = io.BytesIO()
    torch.save(LAYERS[name].make(-1).state_dict(), file)  # without a size
    file.seek(0)
    lazy = LAYERS[name].make(-1)
    lazy.load_state_dict(torch.load(file, weights_only=False))
    assert lazy(*given).isfinite().all()


@pytest.mark.parametrize("name", [name for name in LAZY_LAYERS if "gcn" not in name])
@pytest.mark.parametrize("size", [0, -2])
def test_bad_size_is_refused(name, size):
    with pytest.raises(ValueError, match=rf"at least 1 \(got {size}\), or -1 to infer it from"):
        LAYERS[name].make(size)
