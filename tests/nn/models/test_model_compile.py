import shutil

import pytest
import torch
from nn.model_table import MODELS, make_model, model_inputs
from small_models import EDGE_INDEX, assert_close, gradients, inputs, samples, small_model

from torch_geometric_tactile.nn.models import GCNThread

pytestmark = pytest.mark.slow

# Every class and every encoder once: a compilation takes seconds.
COMPILED = [name for name in MODELS if name not in ("mt_gcn", "digits", "cnn", "whole")]


def without_prefix(values):
    return {key.removeprefix("_orig_mod."): value for key, value in values.items()}


@pytest.mark.full
@pytest.mark.parametrize("name", COMPILED)
def test_model_compile(name):
    torch.compiler.reset()
    model = make_model(name)
    compiled = torch.compile(model, fullgraph=True, backend="aot_eager")
    given = model_inputs(model, 9)
    expected = gradients(model, given)
    assert_close(without_prefix(gradients(compiled, given)), expected, 1e-4, 1e-5)
    if model.training:
        return
    model.train()
    compiled.train()
    compiled(**given).square().sum().backward()
    assert all(weight.grad.abs().max() > 0 for weight in model.parameters() if weight.dim() > 1)


@pytest.mark.full
def test_model_compile_inductor():
    if not any(shutil.which(name) for name in ("c++", "g++", "clang++")):
        pytest.skip("no C++ compiler")
    torch.compiler.reset()
    thread = GCNThread(3, (4,), (2,))
    compiled = torch.compile(thread, fullgraph=True)
    given = {"x": samples(9, 11, 3), "edge_index": EDGE_INDEX}
    found = without_prefix(gradients(compiled, given))
    assert_close(found, gradients(thread, given), 1e-4, 1e-5)


@pytest.mark.full
@pytest.mark.parametrize("name", MODELS)
def test_model_export(name):
    model = make_model(name).eval()
    given = model_inputs(model, 3)
    batch = torch.export.Dim("batch")
    shapes = {key: None if key == "edge_index" else {0: batch} for key in given}
    exported = torch.export.export(model, (), given, dynamic_shapes=shapes).module()
    for size in (3, 20):  # the layout for many samples must not be baked in, nor kept out
        given = model_inputs(model, size)
        with torch.no_grad():
            assert torch.allclose(exported(**given), model(**given), atol=1e-5)


@pytest.mark.parametrize("name", ["gcn_attention", "mt_gcn", "patches"])
def test_model_export_another_graph(name):
    # The edges are an input, not a constant.
    model = small_model(name).eval()
    given = inputs(model, 3)
    exported = torch.export.export(model, (), given).module()
    edge_index = given["edge_index"].clone()
    edge_index[:, :6] = edge_index[:, 6:12]
    other = {**given, "edge_index": edge_index}
    with torch.no_grad():
        assert torch.allclose(exported(**other), model(**other), atol=1e-5)
        assert not torch.allclose(model(**other), model(**given), atol=1e-5)
