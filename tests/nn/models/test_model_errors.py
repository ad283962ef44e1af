import pytest
import torch
from nn.model_table import READING_MODELS, make_model, model_inputs
from small_models import (
    EDGE_INDEX,
    EDGE_MODELS,
    GRAPH_MODELS,
    HEAD,
    LAYOUT,
    MODELS,
    NARROW,
    NUM_EDGES,
    block_diagonal,
    inputs,
    small_model,
)

from torch_geometric_tactile.nn.models import MTCNN, MTGCN, HandCNN, TactileFNN, TactileGCN

T = ("tactile",)
FORMS = {"static": dict, "batch": block_diagonal}


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("name", MODELS)
def test_model_missing_input(name, form):
    model = small_model(name)
    given = FORMS[form](inputs(model, 3))
    for key in model.modalities:
        with pytest.raises(ValueError, match=rf"'{key}' must be given: .* (num_joints|inputs)"):
            model(**{**given, key: None})


@pytest.mark.parametrize("name", GRAPH_MODELS)
def test_model_missing_edges(name):
    model = small_model(name)
    if name == "mt_gcn_adjacency":
        model = MTGCN(
            11,
            3,
            inputs=("tactile", "absolute"),
            threads={"tactile": {"adjacency": EDGE_INDEX}, "absolute": NARROW},
            **HEAD,
        )
    encoded = isinstance(getattr(model.encoder, "lin", None), torch.nn.Linear)
    if model.encoder is None or encoded:
        with pytest.raises(ValueError, match=r"'edge_index' must be given \(got None\)"):
            model(**{**inputs(model, 3), "edge_index": None})


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("name", MODELS)
def test_model_wrong_features(name, form):
    model = small_model(name)
    given = FORMS[form](inputs(model, 3))
    keys = {"tactile": "x", "edge": "edge_attr", "absolute": "absolute", "position": "pos"}
    for part in model.inputs:
        key, width = keys[part], model.channels[part]
        wrong = torch.cat([given[key]] * 2, dim=-1)
        with pytest.raises(ValueError, match=rf"'{key}' must have {width} features \(got shape"):
            model(**{**given, key: wrong})


@pytest.mark.parametrize("name", MODELS)
def test_model_wrong_samples(name):
    model = small_model(name)
    given = inputs(model, 3)
    for key in model.modalities:
        text = "must have shape" if key == "joint" else "must have 3 samples of 11 taxels"
        for other in (given[key][:2], given[key][[0, 1, 2, 2]]):
            with pytest.raises(ValueError, match=rf"'{key}' {text}.*got.*\({len(other)},"):
                model(**{**given, key: other})


@pytest.mark.parametrize("size", [(3, 10, 3), (32, 3), (11,), (1, 3, 11, 3)])
@pytest.mark.parametrize("name", MODELS)
def test_model_wrong_taxels(name, size):
    model = small_model(name)
    with pytest.raises(ValueError, match=r"'x' must have 11 taxels in each sample \(got shape"):
        model(**{**inputs(model, 3), "x": torch.zeros(size)})


@pytest.mark.parametrize("name", READING_MODELS)
def test_model_wrong_readings(name):
    model = make_model(name)
    given = model_inputs(model, 3)
    x = given["x"]
    wrong_widths = [] if name == "temporal_difference" else [x[..., 1:]]  # a shorter window
    for wrong in (*wrong_widths, x[:, 1:], x[0, 0], x.unsqueeze(0), x.flatten(0, 1)[1:]):
        with pytest.raises(ValueError, match=r"'x' must have .*\(got "):
            model(**{**given, "x": wrong})


@pytest.mark.parametrize("name", ["gcn", "digits", "fnn", "cnn"])
def test_model_wrong_positions(name):
    model = small_model(name)
    given = inputs(model, 3)
    for key in {"absolute", "pos"} & given.keys():
        for wrong in (given[key][:, :10], given[key][0, :10], given[key].transpose(0, 1)):
            with pytest.raises(ValueError, match=rf"'{key}' must have 3 samples of 11 taxels"):
                model(**{**given, key: wrong})


@pytest.mark.parametrize("size", [(3, 1), (3, 3), (2, 2), (6,), (2, 3), (0, 2)])
def test_model_wrong_joints(size):
    model = small_model("gcn")
    with pytest.raises(ValueError, match=r"'joint' must have shape \(3, 2\) \(got \("):
        model(**{**inputs(model, 3), "joint": torch.zeros(size)})


@pytest.mark.parametrize("name", EDGE_MODELS)
def test_model_wrong_edges(name):
    model = small_model(name)
    given = inputs(model, 3)
    for wrong in (given["edge_attr"][:, 1:], given["edge_attr"][0, 1:]):
        with pytest.raises(ValueError, match=rf"'edge_attr' must have {NUM_EDGES} rows, .*got sha"):
            model(**{**given, "edge_attr": wrong})


@pytest.mark.parametrize(
    ("make", "match"),
    [
        (lambda: TactileGCN(inputs=("touch",)), r"'inputs' must be some of .* \(got \('touch',\)"),
        (lambda: TactileGCN(inputs=()), r"'inputs' must be some of .* \(got \(\)\)"),
        (lambda: TactileGCN(inputs=("tactile", "tactile")), r"'inputs' must be some of"),
        (lambda: TactileGCN(channels={"touch": 3}), r"'inputs' must be some of"),
        (lambda: TactileGCN(inputs=("edge",)), r"'num_edges' must be given .* \(got None\)"),
        (
            lambda: TactileGCN(inputs=("edge",), encoder="linear"),
            r"'encoder' must be 'dense', 'message', 'attention' or a module \(got 'linear'\)",
        ),
        (
            lambda: MTGCN(threads={"absolute": {}}),
            r"'threads' must only have the inputs \('tactile', 'edge'\) \(got 'absolute'\)",
        ),
        (
            lambda: MTCNN(threads={"edge": {}}),
            r"'threads' must only have the inputs \('tactile', 'absolute'\) \(got 'edge'\)",
        ),
        (
            lambda: MTGCN(threads={"tactile": {"width": 3}}),
            r"'threads' must only have the settings .*, 'adjacency'\] \(got 'width' in 'tactile'\)",
        ),
        (lambda: MTGCN(), r"'num_edges' must be given"),
        (
            lambda: MTGCN(inputs=T, threads={"tactile": {"adjacency": "denser"}}),
            r"'name' must be an adjacency of layout 'allegro_uskin': .* \(got 'denser'\)",
        ),
        (
            lambda: MTGCN(5, inputs=T, threads={"tactile": {"adjacency": EDGE_INDEX}}),
            r"the adjacency of 'tactile' must join taxels 0 to 4 \(got 0 to 10\)",
        ),
        (
            lambda: MTGCN(11, inputs=T, threads={"tactile": {"adjacency": [[0, 1]]}}),
            r"the adjacency of 'tactile' must have shape \(2, num_edges\) \(got \(1, 2\)\)",
        ),
        (
            lambda: MTCNN(threads={"tactile": {"adjacency": "dense"}}),
            r"must only have the settings \['widths', 'pools'\] \(got 'adjacency' in 'tactile'\)",
        ),
        (
            lambda: TactileGCN(LAYOUT, segments="finger"),
            r"'segments' must be 'digit', 'patch' or None \(got 'finger'\)",
        ),
        (lambda: TactileFNN(inputs=("edge",)), r"'inputs' must not have 'edge', since the model"),
        (lambda: HandCNN(LAYOUT, inputs=("edge",)), r"'inputs' must not have 'edge'"),
        (lambda: MTCNN(LAYOUT, inputs=("edge",)), r"'inputs' must not have 'edge'"),
        (
            lambda: TactileGCN(384, segments="patch"),
            r"'layout' must be a layout, .* for segments='patch' \(got the number of taxels 384\)",
        ),
        (
            lambda: MTGCN(384, inputs=T, threads={"tactile": {"adjacency": "sparse"}}),
            r"'layout' must be .* for an adjacency by name \(got the number of taxels 384\)",
        ),
    ],
)
def test_model_bad_arguments(make, match):
    with pytest.raises(ValueError, match=match):
        make()
