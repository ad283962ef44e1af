import inspect

import pytest
import torch
from nn.model_table import GRAPH_MODELS, MODELS, make_model, model_inputs
from small_models import LAYOUT, inputs, samples

from torch_geometric_tactile import nn
from torch_geometric_tactile.nn import (
    BMFCNN,
    MSCNN,
    MTCNN,
    MTGCN,
    GraspGCN,
    GraspLSTM,
    HandCNN,
    PosedTaxelNet,
    SmallCNN,
    TactileFNN,
    TactileGCN,
    TaxelNet,
    TemporalCNN,
    TemporalTaxelNet,
)
from torch_geometric_tactile.nn.models._calls import needs_edges
from torch_geometric_tactile.sensors import stock_path

CLASSES = [
    BMFCNN,
    MSCNN,
    MTCNN,
    MTGCN,
    GraspGCN,
    GraspLSTM,
    HandCNN,
    PosedTaxelNet,
    SmallCNN,
    TactileFNN,
    TactileGCN,
    TaxelNet,
    TemporalCNN,
    TemporalTaxelNet,
]
OURS = [PosedTaxelNet, SmallCNN, TaxelNet, TemporalCNN, TemporalTaxelNet]  # no sensor of a paper
PYGS = {"StaticGATConv", "StaticGATv2Conv"}  # take PyG's arguments, in PyG's order
FORWARD = ["x", "edge_index", "edge_attr", "joint", "absolute", "pos"]
SMALL = {"head_widths": (2,), "head_pools": (1,)}


def parameters(function):
    return [p for p in inspect.signature(function).parameters.values() if p.name != "self"]


def test_all_models_are_checked():
    named = [getattr(nn.models, name) for name in nn.models.__all__]
    models = [c for c in named if issubclass(c, nn.models._base_model.BaseModel)]
    assert set(models) == {*CLASSES, nn.TactileModel}


@pytest.mark.parametrize("cls", CLASSES)
def test_model_takes_layout_and_outputs_first(cls):
    layout, outputs, *others = parameters(cls.__init__)
    assert (layout.name, outputs.name) == ("layout", "out_channels")
    assert {p.kind for p in others} == {inspect.Parameter.KEYWORD_ONLY}
    if cls in OURS:
        return
    assert cls(**({} if "num_edges" not in [p.name for p in others] else {"num_edges": 3}))


@pytest.mark.parametrize("cls", OURS)
def test_our_models_have_no_layout_or_outputs_by_default(cls):
    with pytest.raises(TypeError, match="required positional arguments: 'layout' and 'out_chann"):
        cls()
    with pytest.raises(TypeError, match="required positional argument: 'out_channels'"):
        cls("allegro_uskin")


@pytest.mark.parametrize("cls", CLASSES)
def test_model_forward_has_one_order(cls):
    given = [p for p in parameters(cls.forward) if p.kind is not inspect.Parameter.KEYWORD_ONLY]
    assert [p.name for p in given] == FORWARD
    assert [p.default for p in given[1:]] == [None] * (len(given) - 1)


@pytest.mark.parametrize("name", sorted({*nn.__all__} - PYGS))
def test_no_more_than_seven_positional_arguments(name):
    cls = getattr(nn, name)
    for method in (cls.__init__, cls.forward):
        positional = [
            p for p in parameters(method) if p.kind is inspect.Parameter.POSITIONAL_OR_KEYWORD
        ]
        assert len(positional) <= 7, method


@pytest.mark.parametrize("name", MODELS)
def test_model_ignores_inputs_of_others(name):
    model = make_model(name).eval()
    given = model_inputs(model, 9)
    out = model(**given)
    size = (9, model.num_nodes)
    sizes = {"joint": (9, 2), "absolute": (*size, 4), "pos": (*size, 3), "edge_attr": (9, 23, 4)}
    others = {key: samples(*size) for key, size in sizes.items()}
    assert torch.equal(model(**{**others, **given}), out)
    assert needs_edges(model) == (name in GRAPH_MODELS)
    if not needs_edges(model):
        assert torch.equal(model(**{**given, "edge_index": None}), out)


@pytest.mark.parametrize("segments", [None, "patch"])
def test_model_layout_by_object_name_path(segments, tmp_path):
    path = tmp_path / "own.json"
    LAYOUT.save(path)
    layouts = [LAYOUT, path, str(path)] + ([11] if segments is None else [])
    models = []
    for layout in layouts:
        torch.manual_seed(0)
        models.append(TactileGCN(layout, 3, segments=segments, **SMALL))
    first, *others = models
    given = inputs(first, 9)
    for other in others:
        assert str(other) == str(first)
        assert torch.equal(other(**given), first(**given))


def test_model_layout_by_name():
    named = HandCNN("allegro_uskin", 2, **SMALL)
    loaded = HandCNN(stock_path("layouts", "allegro_uskin"), 2, **SMALL)
    assert named.num_nodes == 384
    assert torch.equal(named.thread.cell, loaded.thread.cell)
    assert (
        GraspGCN("biotac_sp").num_nodes
        == TactileFNN("biotac_sp", widths=(2,), pools=(1,)).num_nodes
    )


@pytest.mark.parametrize("cls", CLASSES)
def test_model_layout_bad(cls):
    more = {"num_edges": 3} if cls is MTGCN else {}
    with pytest.raises(ValueError, match=r"'layout' must be one of .*'biotac_sp'.* \(got 'hand'\)"):
        cls("hand", 2, **more)
    needs = {
        BMFCNN: "image map",
        HandCNN: "image map",
        MSCNN: "image map",
        MTCNN: "image map",
        PosedTaxelNet: "poses",
        SmallCNN: "image map",
        TaxelNet: "neighbours",
        TemporalTaxelNet: "neighbours",
    }
    if needs.get(cls) == "image map":
        with pytest.raises(ValueError, match=r"have an image_map \(got none in 'biotac_sp'\)"):
            cls("biotac_sp", 2)
    match = rf"'layout' must be .* {needs[cls]}" if cls in needs else r"'layout' must have"
    with pytest.raises(ValueError, match=rf"{match}.*got"):
        cls(0, 2, **more)
    with pytest.raises(FileNotFoundError, match=r"none\.json"):
        cls("none.json", 2, **more)


def test_model_layout_on_the_meta_device():
    # The layout keeps its numbers where the weights have none.
    with torch.device("meta"):
        model = HandCNN("allegro_uskin", 2)
        named = MTGCN("allegro_uskin", 2, threads={"edge": {"adjacency": "sparse"}}, num_edges=9)
    assert model.thread.size == (32, 16)
    assert model.head.lin_out.weight.is_meta
    assert named.edge_edge_index.shape == (2, 1000)
