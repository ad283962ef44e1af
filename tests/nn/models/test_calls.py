import pytest
import torch
from mixed_sensors import gloves
from own_models import Attention, OfEdges, OneLayer, Ring
from torch_geometric.data import Batch, Data

from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.nn.models import MSCNN, GraspGCN, TactileFNN, TaxelNet
from torch_geometric_tactile.nn.models._calls import (
    call_model,
    input_names,
    is_graph_model,
    needs_edges,
    takes_batch,
)
from torch_geometric_tactile.nn.models._inputs import needed_inputs
from torch_geometric_tactile.predictor import AverageModel
from torch_geometric_tactile.sensors import grid

EDGES = torch.tensor([[0, 1, 2, 3], [1, 2, 3, 0]])
LAYOUT = grid(2, 2, 0.01)


class OptionalEdges(torch.nn.Module):
    def __init__(self):
        super().__init__()
        self.conv = Attention(1, 2).conv1

    def forward(self, x, edge_index=None):
        return x.mean(dim=-2)


class Weighted(torch.nn.Module):
    modalities = ("edge_attr", "absolute")

    def forward(self, x, edge_index, batch, edge_attr, absolute):
        pooled = torch.zeros(int(batch.max()) + 1, 1).index_add(0, batch, x + absolute)
        edges = batch[edge_index[0]]
        return pooled + torch.zeros_like(pooled).index_add(0, edges, edge_attr)


def static(num_samples=3, **more):
    draw = torch.Generator().manual_seed(0)
    x = torch.randn(num_samples, 4, 1, generator=draw)
    return StaticData(x=x, edge_index=EDGES, **more)


@pytest.mark.parametrize(
    ("model", "batch", "needs", "graph"),
    [
        (Attention(1, 2), True, True, True),
        (Ring(LAYOUT, 2), False, True, True),
        (OneLayer(2, 4), False, False, False),
        (OfEdges(2, 4), False, True, True),
        (OptionalEdges(), False, False, True),
        (torch.nn.Linear(1, 1), False, False, False),
        (TactileFNN(4, 2), False, False, False),
        (GraspGCN(), False, True, True),
        (AverageModel([Attention(1, 2)]), True, True, True),
        (AverageModel([OneLayer(2, 4)]), False, False, False),
    ],
    ids=lambda value: type(value).__name__,
)
def test_what_a_network_asks_for(model, batch, needs, graph):
    assert takes_batch(model) is takes_batch(torch.compile(model)) is batch
    assert needs_edges(model) is needs
    assert is_graph_model(model) is graph


class Unsaid(torch.nn.Module):
    def forward(self, x, edges, edge_attr, batch, *, joint, pos=None):
        return x


def test_what_is_given_by_keyword():
    assert input_names(Unsaid()) == ("edge_attr", "joint")
    assert input_names(Weighted()) == ("edge_attr", "absolute")
    assert input_names(Attention(1, 2)) == input_names(torch.nn.Linear(1, 1)) == ()
    assert input_names(GraspGCN()) == ()
    assert input_names(AverageModel([Unsaid()])) == ("edge_attr", "joint")
    with pytest.raises(ValueError, match=r"the model needs 'edge_attr' \(got none\): add Geo"):
        needed_inputs(Unsaid(), static(), lambda: "got none")


def test_classes_tell_whether_they_take_a_batch():
    assert takes_batch(Attention)
    assert not takes_batch(Ring)
    assert not takes_batch(dict)


def test_our_models_are_called_as_before():
    for kind in (TaxelNet, MSCNN, GraspGCN):
        assert not takes_batch(kind)


@pytest.mark.parametrize("num_samples", [1, 3])
@pytest.mark.parametrize("of_each", [False, True])
def test_static_samples_come_as_pygs_batch(num_samples, of_each):
    edge_attr = torch.rand(num_samples, 4, 1) if of_each else torch.rand(4, 1)
    data = static(num_samples, edge_attr=edge_attr, absolute=torch.rand(num_samples, 4, 1))
    model = Weighted()
    inputs = {name: data[name] for name in model.modalities}
    found = call_model(model, data, inputs)
    assert found.shape == (num_samples, 1)
    edges = edge_attr if of_each else edge_attr.expand(num_samples, 4, 1)
    torch.testing.assert_close(found, (data.x + data.absolute).sum(dim=1) + edges.sum(dim=1))
    batch = Batch.from_data_list(data.to_data_list())
    torch.testing.assert_close(
        call_model(model, batch, {name: batch[name] for name in model.modalities}), found
    )


def test_samples_of_several_sensors_are_as_each_alone():
    samples = gloves(4, 2)
    model = Attention(2, 3).eval()
    found = call_model(model, Batch.from_data_list(samples), {})
    alone = [call_model(model, sample, {}) for sample in samples]
    torch.testing.assert_close(found, torch.cat(alone))


def test_no_samples():
    assert call_model(OptionalEdges(), static(0), {}).shape == (0, 1)
    assert call_model(Attention(1, 2).eval(), static(0), {}).shape == (0, 2)


def test_one_taxel():
    data = Data(x=torch.ones(1, 1), edge_index=torch.zeros(2, 0, dtype=torch.long))
    assert call_model(Attention(1, 2), data, {}).shape == (1, 2)
