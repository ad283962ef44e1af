import copy
import pickle

import pytest
import torch
from small_models import GRAPH_MODELS, NUM_EDGES, block_diagonal, inputs, loop, small_model
from torch_geometric.explain import Explainer, GNNExplainer
from torch_geometric.explain.algorithm.utils import clear_masks, set_masks
from torch_geometric.nn import MessagePassing


def explainer(model, task="multiclass_classification"):
    return Explainer(
        model,
        GNNExplainer(epochs=2),
        explanation_type="model",
        node_mask_type="attributes",
        edge_mask_type="object",
        model_config={"mode": task, "task_level": "graph", "return_type": "raw"},
    )


def assert_untouched(model, before, given, expected):
    for module in model.modules():
        if isinstance(module, MessagePassing):
            assert not module.explain
            assert module._edge_mask is None
    assert model.state_dict().keys() == before.keys()
    assert all(torch.equal(value, before[key]) for key, value in model.state_dict().items())
    assert torch.equal(model(**given), expected)


@pytest.mark.parametrize("name", GRAPH_MODELS)
def test_model_explainer(name):
    model = small_model(name)
    before = copy.deepcopy(model.state_dict())
    given = inputs(model, 9)
    expected = model(**given)
    (one,) = loop(inputs(model, 1))
    others = {key: value for key, value in one.items() if key not in ("x", "edge_index")}
    explanation = explainer(model)(one["x"], one["edge_index"], **others)
    assert explanation.node_mask.shape == (11, 3)
    assert explanation.edge_mask.shape == (NUM_EDGES,)
    assert explanation.node_mask.abs().max() > 0
    assert explanation.edge_mask.abs().max() > 0
    assert_untouched(model, before, given, expected)


def test_model_explainer_of_edges_between_segments():
    # What the segmented network does not see cannot explain anything.
    model = small_model("digits")
    (one,) = loop(inputs(model, 1))
    explanation = explainer(model)(one["x"], one["edge_index"], pos=one["pos"])
    segment = model.thread.convs[0].segment[one["edge_index"]]
    between = segment[0] != segment[1]
    assert explanation.edge_mask[between].abs().max() == 0
    assert explanation.edge_mask[~between].abs().max() > 0


@pytest.mark.parametrize("name", ["gcn", "mt_gcn", "patches"])
def test_model_explainer_sees_edges_by_features(name):
    # Explainers that keep messages, as GraphMaskExplainer, count on one row for each edge.
    model, seen = small_model(name), []

    def explain_message(self, out):
        seen.append(out.dim())
        return out

    convs = [m for m in model.modules() if isinstance(m, MessagePassing)]
    for conv in convs:
        conv.explain_message = explain_message.__get__(conv, MessagePassing)
        conv.explain = True
    model(**loop(inputs(model, 1))[0])
    assert seen == [2] * len(convs)


def test_model_explainer_of_own_edges():
    # The thread with an adjacency of its own is as it is, whatever mask the data's edges have.
    model = small_model("mt_gcn_adjacency")
    given = inputs(model, 1)
    features = [model.node_features(**given, thread=name) for name in ("absolute", "tactile")]
    set_masks(model, torch.nn.Parameter(torch.zeros(NUM_EDGES)), given["edge_index"], False)
    for row in (given, block_diagonal(given)):
        absolute, tactile = (
            model.node_features(**row, thread=name) for name in ("absolute", "tactile")
        )
        assert torch.allclose(absolute, features[0], atol=1e-6)
        assert not torch.allclose(tactile, features[1], atol=1e-4)
    clear_masks(model)
    for other in (copy.deepcopy(model), pickle.loads(pickle.dumps(model))):
        assert torch.equal(other(**given), model(**given))


@pytest.mark.parametrize("name", ["gcn_message", "mt_gcn", "mt_gcn_adjacency", "patches"])
def test_model_edge_masks_in_all_forms(name):
    # A mask on a batch is a mask on each of its samples.
    model = small_model(name)
    given = inputs(model, 3)
    expected = model(**given)
    mask = torch.linspace(0, 1, NUM_EDGES)
    outs = []
    for rows in (loop(given), [block_diagonal(given)], [given]):
        for row in rows:
            repeated = mask.repeat(row["edge_index"].size(1) // NUM_EDGES)
            set_masks(model, torch.nn.Parameter(repeated), row["edge_index"], apply_sigmoid=False)
            outs.append(model(**row).detach())
            clear_masks(model)
    assert torch.allclose(torch.cat(outs[:3]), outs[3], atol=1e-6)
    assert torch.allclose(outs[3], outs[4], atol=1e-6)
    assert not torch.allclose(outs[3], expected, atol=1e-4)
    assert torch.equal(model(**given), expected)
