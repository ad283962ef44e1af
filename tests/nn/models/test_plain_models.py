"""What holds for all models of readings, as `test_model_forms` and others say it of the hand's."""

import copy

import pytest
import torch
from plain_models import MODELS, given, trained
from small_models import block_diagonal, loop

EDGES = torch.tensor([[0, 1], [1, 0]])


@pytest.fixture(params=MODELS)
def model(request):
    torch.compiler.reset()
    return trained(MODELS[request.param]())


def test_plain_model_static_equals_batch_and_loop(model):
    for batch_size in (2, 9):
        data = given(model, batch_size)
        expected = model(**data)
        assert expected.shape == (batch_size, model.out_channels)
        assert torch.allclose(model(**block_diagonal(data)), expected, atol=1e-5)
        rows = torch.cat([model(**row) for row in loop(data)])
        assert torch.allclose(rows, expected, atol=1e-5)
    empty = {name: value if name == "edge_index" else value[:0] for name, value in data.items()}
    assert model(**empty).shape == (0, model.out_channels)


@pytest.mark.parametrize("name", [name for name in MODELS if not name.startswith("gcn_")])
def test_plain_model_needs_no_edges(name):
    model = MODELS[name]().eval()
    data = given(model, 9)
    assert torch.equal(model(edge_index=EDGES, **data), model(**data))


def test_plain_model_gradients_reach_all(model):
    for part in ("dropout", "taxel_dropout"):
        if isinstance(getattr(model, part, None), float):
            setattr(model, part, 0.0)
    data = given(model.train(), 16)
    leaves = {name: value.requires_grad_() for name, value in data.items() if name != "edge_index"}
    model(**data).square().sum().backward()
    for name, value in (*leaves.items(), *model.named_parameters()):
        assert value.grad.isfinite().all(), name
        assert value.grad.abs().max() > 0, name


@pytest.mark.full
def test_plain_model_compile(model):
    compiled = torch.compile(model, fullgraph=True, backend="aot_eager")
    data = given(model, 9)
    assert torch.allclose(compiled(**data), model(**data), atol=1e-5)
    model.train()
    compiled.train()
    compiled(**data).square().sum().backward()
    assert all(weight.grad.abs().max() > 0 for weight in model.parameters() if weight.dim() > 1)


@pytest.mark.full
def test_plain_model_export(model):
    data, batch = given(model, 3), torch.export.Dim("batch")
    shapes = {name: None if name == "edge_index" else {0: batch} for name in data}
    exported = torch.export.export(model, (), data, dynamic_shapes=shapes).module()
    for size in (3, 20):
        data = given(model, size)
        with torch.no_grad():
            assert torch.allclose(exported(**data), model(**data), atol=1e-5)


def test_plain_model_seed_and_reset(model):
    before, outs = copy.deepcopy(model.state_dict()), []
    for _ in range(2):
        torch.manual_seed(3)
        model.reset_parameters()
        outs.append(model(**given(model, 9)))
    assert torch.equal(*outs)
    for name, value in model.state_dict().items():
        if "weight" in name and "norm" not in name:
            assert not torch.equal(value, before[name]), name
        if name.endswith(("num_batches_tracked", "running_mean")):
            assert not value.any(), name
