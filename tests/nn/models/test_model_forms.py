import copy
import pickle

import pytest
import torch
from nn import model_table
from nn.model_table import READING_MODELS, make_model, model_inputs
from small_models import (
    GRAPH_MODELS,
    HEAD,
    MODELS,
    NARROW,
    assert_close,
    block_diagonal,
    gradients,
    inputs,
    loop,
    small_model,
)

from torch_geometric_tactile.nn.conv._static_adjacency import AdjacencyCache
from torch_geometric_tactile.nn.models import GCNThread, SegmentedThread, TactileGCN


def threads(model):
    return [m for m in model.modules() if isinstance(m, GCNThread | SegmentedThread)]


def caches(model):
    found = [getattr(m, "_edge_cache", None) for m in model.modules()]
    return [kept for kept in found if isinstance(kept, AdjacencyCache)]


@pytest.mark.parametrize("batch_size", [3, 10])
@pytest.mark.parametrize("shared", [False, True])
@pytest.mark.parametrize("name", model_table.MODELS)
def test_model_static_equals_batch_and_loop(name, shared, batch_size):
    model = make_model(name, torch.double)
    given = model_inputs(model, batch_size, torch.double, shared)
    static = gradients(model, given)
    assert static["out"].shape == (batch_size, model.out_channels)
    assert all(value.abs().max() > 0 for value in static.values())
    assert_close(gradients(model, given, block_diagonal), static)
    assert_close(gradients(model, given, loop), static)


@pytest.mark.parametrize("name", model_table.MODELS)
def test_model_no_samples(name):
    model = make_model(name)
    given = {k: v if k == "edge_index" else v[:0] for k, v in model_inputs(model, 5).items()}
    assert model(**given).shape == (0, model.out_channels)
    flat = {k: v if k in ("joint", "edge_index") else v.flatten(0, 1) for k, v in given.items()}
    flat["edge_index"] = flat["edge_index"][:, :0]
    assert model(**flat).shape == (0, model.out_channels)


@pytest.mark.parametrize("name", model_table.MODELS)
def test_model_answers_nothing_to_missing_readings(name):
    model = make_model(name).eval()
    given = model_inputs(model, 3)
    given["x"][1] = torch.nan
    assert model(**given).isnan().any(dim=1).tolist() == [False, True, False]


NORMED_READINGS = ("taxel_", "temporal_", "posed_")


@pytest.mark.parametrize("name", [n for n in READING_MODELS if n.startswith(NORMED_READINGS)])
def test_model_trains_on_a_single_sample(name):
    model = make_model(name).train()
    out = model(**model_inputs(model, 1))
    assert out.shape == (1, model.out_channels)
    assert out.isfinite().all()


@pytest.mark.parametrize("dtype", [torch.float, torch.double])
@pytest.mark.parametrize("name", GRAPH_MODELS)
def test_model_fast_equals_slow(name, dtype):
    model = small_model(name, dtype)
    slow = small_model(name, dtype, fast=False)
    assert [thread.fast for thread in threads(model)] == [True] * len(threads(model))
    assert [thread.fast for thread in threads(slow)] == [False] * len(threads(model)) != []
    given = inputs(model, 10, dtype)
    rtol, atol = (1e-4, 1e-5) if dtype == torch.float else (1e-9, 1e-11)
    assert_close(gradients(model, given), gradients(slow, given), rtol, atol)


@pytest.mark.parametrize("name", ["gcn", "mt_gcn", "patches"])
def test_model_second_derivative(name):
    def twice(model):
        given = inputs(model, 9, torch.double)
        x = given.pop("x").requires_grad_()
        out = model(x, **given).square().sum()
        (grad,) = torch.autograd.grad(out, x, create_graph=True)
        grad.square().sum().backward()
        return x.grad

    assert twice(small_model(name, torch.double, fast=False)).abs().max() > 0
    with pytest.raises(RuntimeError, match="once_differentiable"):
        twice(small_model(name, torch.double))


@pytest.mark.parametrize("mode", [torch.no_grad, torch.inference_mode])
@pytest.mark.parametrize("fast", [True, False])
@pytest.mark.parametrize("name", GRAPH_MODELS)
def test_model_trains_after_validation(name, fast, mode):
    model = small_model(name, torch.double, fast=fast)
    sizes = (10, 2, 1)
    expected = [gradients(model, inputs(model, size, torch.double)) for size in sizes]
    for first in sizes:
        fresh = copy.deepcopy(model)
        with mode():
            fresh(**inputs(fresh, first, torch.double))
        for size, grads in zip(sizes, expected, strict=True):
            assert_close(gradients(fresh, inputs(fresh, size, torch.double)), grads)


@pytest.mark.parametrize("name", GRAPH_MODELS)
def test_model_copies_carry_no_cache(name):
    model = small_model(name)
    given = inputs(model, 10)
    expected = model(**given)
    model(**inputs(model, 2))
    assert any(cache.current is not None for cache in caches(model))
    for other in (copy.deepcopy(model), pickle.loads(pickle.dumps(model))):
        assert all(cache.current is None for cache in caches(other))
        assert torch.equal(other(**given), expected)


@pytest.mark.parametrize("name", MODELS)
def test_model_shares_positions(name):
    # Positions of the layout, the same for all samples (N, F).
    model = small_model(name)
    given = inputs(model, 3)
    for key in ("absolute", "pos"):
        if key in given:
            given[key] = given[key][:1].expand_as(given[key])
            once = {**given, key: given[key][0]}
            assert torch.equal(model(**once), model(**given))


@pytest.mark.parametrize("batch_size", [2, 10])
@pytest.mark.parametrize("name", model_table.MODELS)
def test_model_autocast(name, batch_size):
    model = make_model(name)
    given = model_inputs(model, batch_size)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        out = model(**given)
        out.float().square().sum().backward()
        again = model(**given)
    again.float().square().sum().backward()
    assert torch.allclose(out.float(), model(**given), atol=0.05)
    assert all(p.grad.isfinite().all() for p in model.parameters())


@pytest.mark.parametrize("form", [dict, block_diagonal])
def test_model_without_readings(form):
    # The readings only tell how many samples there are.
    model = TactileGCN(11, 3, inputs=("position",), **NARROW, **HEAD)
    given = inputs(model, 9)
    out = model(**form(given))
    assert torch.allclose(out, model(**form({**given, "x": given["x"] + 1})))
    assert torch.allclose(out[3], model(**loop(given)[3])[0], atol=1e-6)
    assert not torch.allclose(out, model(**form({**given, "pos": given["pos"] + 1})))
