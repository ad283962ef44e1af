import io

import pytest
import torch
from nn.model_table import MODELS, make_model, model_inputs
from small_models import LAYOUT, samples

from torch_geometric_tactile.nn.models import MTGCN, TactileGCN


@pytest.mark.parametrize("name", MODELS)
def test_model_state_round_trip(name):
    model, other = make_model(name), make_model(name)
    other.reset_parameters()
    given = model_inputs(model, 9)
    expected = model(**given)
    assert not torch.allclose(other(**given), expected)
    file = io.BytesIO()
    torch.save(model.state_dict(), file)
    file.seek(0)
    other.load_state_dict(torch.load(file, weights_only=True), strict=True)
    assert torch.equal(other(**given), expected)


@pytest.mark.parametrize("name", MODELS)
def test_model_reset_parameters(name):
    model, outs = make_model(name), []
    given = model_inputs(model, 9)
    for parameter in model.parameters():  # as after a training: zero biases have moved as well
        parameter.data += 1.0
    before = {key: value.clone() for key, value in model.named_parameters()}
    model(**given)
    for _ in range(2):
        torch.manual_seed(3)
        model.reset_parameters()
        outs.append(model(**given))
    assert torch.equal(*outs)
    for key, value in model.named_parameters():
        assert (value != before[key]).all(), key
    for key, value in model.named_buffers():
        if key.endswith(("num_batches_tracked", "running_mean")):
            assert not value.any(), key


def test_model_reset_encoder_of_the_user():
    class Encoder(torch.nn.Module):
        def __init__(self):
            super().__init__()
            self.lin = torch.nn.Linear(4, 4)

        def forward(self, edge_attr, edge_index, num_nodes):
            return (
                self.lin(edge_attr)
                .new_zeros(num_nodes, 4)
                .index_add(-2, edge_index[1], self.lin(edge_attr))
            )

    model = TactileGCN(11, 3, inputs=("edge",), encoder=Encoder(), widths=(4,), pools=(1,))
    before = model.encoder.lin.weight.clone()
    model.reset_parameters()
    assert not torch.equal(model.encoder.lin.weight, before)
    x, edge_attr = samples(1, 11, 3), samples(LAYOUT.adjacency["original"].size(1), 4)
    assert model(x, LAYOUT.adjacency["original"], edge_attr).shape == (1, 3)


def test_mt_gcn_state_keys():
    threads = {"tactile": {"adjacency": "dense"}, "edge": {}}
    with torch.device("meta"):
        keys = list(MTGCN(num_edges=1401, num_joints=16).state_dict())
    small = {"head_widths": (2,), "head_pools": (1,)}
    other = MTGCN("allegro_uskin", threads=threads, num_edges=2, **small)
    assert list(other.state_dict())[:4] == keys[:4]  # an adjacency is no state
    convs = [
        f"threads.{thread}.convs.{i}.{key}"
        for thread in ("tactile", "edge")
        for i in range(5)
        for key in ("bias", "lin.weight")
    ]
    lins = [f"head.lins.{i}.{key}" for i in range(3) for key in ("weight", "bias")]
    assert keys == [
        "encoder.lin.weight",
        "encoder.lin.bias",
        *convs,
        *lins,
        "head.lin_out.weight",
        "head.lin_out.bias",
    ]


def test_tactile_gcn_state_keys():
    lins = [f"head.lins.{i}.{key}" for i in range(3) for key in ("weight", "bias")]
    head = [*lins, "head.lin_out.weight", "head.lin_out.bias"]
    state = TactileGCN(segments="patch").state_dict()
    convs = [f"thread.convs.{i}.{key}" for i in range(2) for key in ("weight", "bias")]
    assert list(state) == [*convs, *head]
    shapes = {key: tuple(state[key].shape) for key in convs}
    assert shapes == {
        "thread.convs.0.weight": (22, 14, 3),
        "thread.convs.0.bias": (22, 14),
        "thread.convs.1.weight": (22, 56, 14),
        "thread.convs.1.bias": (22, 56),
    }
    whole = [f"thread.convs.{i}.{key}" for i in range(5) for key in ("bias", "lin.weight")]
    assert list(TactileGCN(384).state_dict()) == [*whole, *head]
