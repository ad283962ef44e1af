# ruff: noqa: E402
"""Every model and every transform of the package is part of a graph, or refused by its name. A
graph is compared with its predictor before it is written, so that an export is a comparison."""

import json
import sys
from importlib import import_module

import numpy as np
import pytest

for extra in ("onnx", "onnxscript", "onnxruntime"):
    pytest.importorskip(extra, reason="needs the extra 'export'")
pytest.importorskip("yaml", reason="needs the extra 'train'")

import small_models
import torch
import torch_geometric.transforms as pyg
from torch_geometric.transforms import Compose

from torch_geometric_tactile import Predictor, nn
from torch_geometric_tactile import transforms as T
from torch_geometric_tactile.data import StaticData, StaticDataset, Trials, Windows
from torch_geometric_tactile.data._transform_rules import flat
from torch_geometric_tactile.experiments._compared_models import MODELS as COMPARED
from torch_geometric_tactile.nn.models import (
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
from torch_geometric_tactile.predictor import _classes, export_onnx
from torch_geometric_tactile.predictor._onnx_graph import OnnxGraph
from torch_geometric_tactile.predictor.export_onnx import _random_examples
from torch_geometric_tactile.sensors import TaxelLayout, grid

HAND = small_models.HAND
SMALL = small_models.LAYOUT
LAYOUT = TaxelLayout(
    name="placed",
    pos=SMALL.pos,
    normal=torch.nn.functional.normalize(SMALL.pos, dim=1),
    link=torch.arange(11) % 3,
    link_names=("base", "middle", "tip"),
    patch=SMALL.patch,
    digit=SMALL.digit,
    patch_names=SMALL.patch_names,
    digit_names=SMALL.digit_names,
    adjacency=SMALL.adjacency,
    image_map=SMALL.image_map,
)
EDGES = LAYOUT.edge_index("original")
WITHIN = int((LAYOUT.patch[EDGES[0]] == LAYOUT.patch[EDGES[1]]).sum())
IMAGE = grid(20, 21, 0.01)
NARROW, HEAD = small_models.NARROW, small_models.HEAD
THREADS = {"tactile": NARROW, "edge": NARROW}


class Reader(torch.nn.Module):
    """Takes whatever transforms set."""

    def __init__(self, *modalities):
        super().__init__()
        self.modalities = modalities
        self.weight = torch.nn.Parameter(torch.ones(()))

    def forward(self, x, edge_index, **more):
        values = [x.flatten(1), *(value.float().reshape(1, -1) for value in more.values())]
        values.append(edge_index.float().reshape(1, -1))
        out = 0
        for value in values:
            wave = torch.arange(value.size(1)).sin()
            out = out + (value * wave).sum(dim=1, keepdim=True) / value.size(1)
        return self.weight * torch.cat([out, -out], dim=1)


class DescriptorReader(torch.nn.Module):
    """A linear model of descriptors."""

    modalities = ("descriptors",)

    def __init__(self):
        super().__init__()
        self.lin = torch.nn.Linear(len(T.TaxelDescriptors(LAYOUT).names(num_channels=3)), 2)

    def forward(self, x, edge_index, descriptors):
        return self.lin(descriptors)


def calibrated(per):
    """Forces of three channels, whose readings leave the range."""
    draw = torch.Generator().manual_seed(2)
    low = 280 + 10 * torch.rand(11, 3, generator=draw)
    coefficients = torch.randn(11, 10, 3, generator=draw)
    return T.Calibrate(coefficients, low, low + 30, degree=2, per=per)


def frames(layout=LAYOUT, num_samples=40):
    draw = torch.Generator().manual_seed(1)
    return StaticData(
        x=300 + 20 * torch.randn(num_samples, layout.num_taxels, 3, generator=draw),
        joint=torch.rand(num_samples, 2, generator=draw),
        session=torch.arange(num_samples) // 20,
        trial=torch.arange(num_samples) // 20,
        step=torch.arange(num_samples) % 20,
        y=torch.arange(num_samples) // 20,
        pos=layout.pos,
        edge_index=layout.edge_index("original"),
    )


def dataset(transform=None, layout=LAYOUT):
    return StaticDataset._from_samples((frames(layout), {}), layout, transform, None, None)


PAIRS = {  # a data set, a model, and transforms
    "tactile_gcn": lambda: (
        dataset(),
        TactileGCN(
            LAYOUT,
            2,
            segments="patch",
            inputs=("tactile", "edge"),
            encoder="message",
            num_joints=2,
            **NARROW,
            **HEAD,
        ),
        [
            T.Tare(first=5),
            T.ZScore(per="channel"),
            T.TaxelPose(LAYOUT, HAND),
            T.GeometricEdgeAttr(),
            T.ZScore(attr="edge_attr", per="channel"),
            T.Normalize(attr="joint"),
        ],
    ),
    "mt_gcn": lambda: (
        dataset(),
        MTGCN(11, 3, threads=THREADS, num_edges=WITHIN, num_joints=2, **HEAD),
        [
            T.SessionZScore(),
            T.TaxelPose(LAYOUT, HAND),
            T.GeometricEdgeAttr(norm=True),
            T.TopologicalSegmentation("patch", LAYOUT),
        ],
    ),
    "descriptors": lambda: (
        dataset(),
        DescriptorReader(),
        [T.ZScore(scale_per="channel"), T.TaxelDescriptors(LAYOUT)],
    ),
    "calibrated": lambda: (dataset(), Reader("force"), [calibrated("sensor"), calibrated("taxel")]),
    "described": lambda: (
        dataset(),
        TaxelNet(LAYOUT, 3, widths=(4,), descriptor_channels=4),
        [T.SquareRoot(), T.NormalizeRMS(), T.ZScore(scale_per="channel")],
    ),
    "taxel_net": lambda: (
        dataset(),
        TaxelNet(LAYOUT, 3, max_taxels=6, widths=(4,), hidden_channels=5),
        [
            T.CommonMode("patch", LAYOUT),
            T.SessionZScore(per="channel"),
            T.FillMissing(),
            T.RandomNoise(0.0),
            T.RandomGain(0.0),
            T.RandomOffset(0.0),
            T.RandomInversion(p=0.0),
            T.RandomTimeShift(0),
        ],
    ),
    "posed_taxel_net": lambda: (
        dataset(),
        PosedTaxelNet(LAYOUT, 3, num_strongest=5, widths=(4,), hidden_channels=5),
        [T.FillMissing(), T.TaxelPose(LAYOUT, HAND, tangent=True), T.TaxelForce()],
    ),
    "small_cnn": lambda: (
        dataset(),
        SmallCNN(LAYOUT, 3, widths=(4, 4), hidden_channels=5, in_channels=2),
        [T.ZScore(), T.DropTaxels(taxels=[1, 4], value=-1.0), T.SelectChannels([2, 0])],
    ),
    "hand_cnn": lambda: (
        dataset(),
        HandCNN(LAYOUT, 3, inputs=("tactile", "position"), num_joints=2, **NARROW, **HEAD),
        [T.TaxelPose(LAYOUT, HAND, normal=False), T.ZScore(attr="pos"), T.ZScore(per="channel")],
    ),
    "mt_cnn": lambda: (
        dataset(),
        MTCNN(LAYOUT, 3, threads={"tactile": NARROW, "absolute": NARROW}, **HEAD),
        [T.DropPatches(LAYOUT, patches=["second"]), T.AbsoluteMorphology()],
    ),
    "tactile_fnn": lambda: (
        dataset(),
        TactileFNN(11, 3, num_joints=2, widths=(8,), pools=(1,)),
        [T.RandomMirror(grid(1, 11, 0.01), p=0.0), T.RandomShift(grid(1, 11, 0.01), 0, 0)],
    ),
    "ms_cnn": lambda: (
        dataset(layout=SMALL),
        MSCNN(small_models.FINGERS, 3, pattern="VI", hidden_channels=5, num_joints=2),
        [T.ZScore(scale_per="channel")],
    ),
    "bmf_cnn": lambda: (
        StaticDataset._from_samples((frames(IMAGE), {}), IMAGE, None, None, None),
        BMFCNN(IMAGE, 3, in_channels=3, hidden_channels=5),
        [T.ZScore(per="channel")],
    ),
    "grasp_gcn": lambda: (
        Windows(dataset(T.CommonMode()), 8),
        GraspGCN(11, 2, in_channels=5, hidden_channels=4, num_fingers=3),
        [T.ZScore(per="signal"), T.Resample(5)],
    ),
    "grasp_lstm": lambda: (
        Trials(dataset()),
        GraspLSTM(11, 2, hidden_channels=4),
        [T.Resample(9), T.SessionZScore(per="signal")],
    ),
    "temporal_cnn": lambda: (
        Windows(dataset(), 6, hop=2),
        TemporalCNN(LAYOUT, 2, in_channels=3, widths=(4, 4, 5)),
        [T.ZScore(per="signal")],
    ),
    "temporal_taxel_net": lambda: (
        Windows(dataset(), 6, hop=2),
        TemporalTaxelNet(
            LAYOUT,
            2,
            in_channels=3,
            num_filters=2,
            filter_size=2,
            dilation=1,
            num_blocks=1,
            widths=(4,),
            num_joints=2,
        ),
        [T.ZScore(per="signal")],
    ),
    "temporal_pooled": lambda: (
        Windows(dataset(), 6, hop=2),
        TemporalTaxelNet(
            *(LAYOUT, 2),
            in_channels=3,
            num_filters=2,
            filter_size=1,
            dilation=1,
            num_blocks=1,
            pool="mean_max",
            mixed_channels=5,
            widths=(4,),
        ),
        [T.ZScore(per="signal")],
    ),
    "temporal_mixed": lambda: (
        Windows(dataset(), 6, hop=2),
        TemporalTaxelNet(
            *(LAYOUT, 2),
            in_channels=3,
            num_filters=2,
            filter_size=2,
            dilation=1,
            num_blocks=1,
            kernel_size=2,
            mixed_channels=5,
            widths=(4,),
        ),
        [T.ZScore(per="signal")],
    ),
    "knn": lambda: (
        dataset(),
        Reader("pos", "segment_batch", "edge_is_within"),
        [
            T.KNNGraph(3),
            T.TaxelPose(LAYOUT, HAND),
            T.TopologicalSegmentation("digit", LAYOUT, drop=False),
        ],
    ),
    "pyg": lambda: (
        dataset(),
        Reader("edge_attr", "pos", "edge_sector"),
        [
            T.SectorGraph(LAYOUT),
            pyg.Center(),
            pyg.NormalizeScale(),
            pyg.Distance(),
            pyg.Cartesian(),
            pyg.LocalCartesian(),
            pyg.Spherical(),
            pyg.TargetIndegree(),
            pyg.Constant(2.0),
            pyg.LocalDegreeProfile(),
            pyg.NormalizeFeatures(["x"]),
        ],
    ),
    "pyg_edges": lambda: (
        dataset(),
        Reader("edge_attr"),
        [
            pyg.Distance(),
            pyg.ToUndirected(),
            pyg.AddSelfLoops("edge_attr"),
            pyg.RemoveSelfLoops("edge_attr"),
            pyg.AddRemainingSelfLoops("edge_attr"),
            pyg.RemoveDuplicatedEdges(["edge_attr"]),
            Compose([pyg.OneHotDegree(11, cat=False)]),
        ],
    ),
}


STEPPED = {"temporal_mixed", "temporal_taxel_net"}


def doubled(parent):
    def forward(self, data):
        data = parent.forward(self, data)
        data.x = 2 * data.x
        return data

    return type(f"Twice{parent.__name__}", (parent,), {"forward": forward})


REFUSED = {
    "TwiceDropTaxels": (doubled(T.DropTaxels)(taxels=[1]), r"^TwiceDrop.*its operations have"),
    "TwiceTare": (
        doubled(T.Tare)(),
        r"^TwiceTare\(.* it measures sessions but overrides 'forward'",
    ),
    "ContactCrop": (T.ContactCrop(3, missing="keep"), r"^ContactCrop\(.* cannot be exported: the "),
    "RandomNoise": (T.RandomNoise(0.5), r"^RandomNoise\(std=0.5\) cannot be exported: it draws"),
    "RandomContrast": (T.RandomContrast(1.0, 1.0), r"^RandomContrast\(.* cannot be exported: it"),
    "DropTaxels": (T.DropTaxels(p=0.5), r"^DropTaxels\(p=0.5.* cannot be exported: it draws"),
    "SessionZScore": (T.SessionZScore(attr="joint"), r"^SessionZScore\(.*only readings may be"),
    "two": (
        Compose([T.Tare(), T.SessionZScore()]),
        r"only one .* \(got Tare\('session', first=None\) and SessionZScore\('session'\)\)",
    ),
    "own": (
        lambda data: data if data.x.sum() > 0 else data.clone(),
        r"<lambda>.* cannot be exported: its operations have no ONNX equivalent, or depend on ",
    ),
}


def fitted(data, model, parts, **more):
    transform = Compose(parts)
    T.fit_parts(transform, data)
    return Predictor.from_dataset(model.eval(), data, transform, **more)


# Of readings, of places and edges, and of windows in steps; `make check` exports the others.
QUICK_PAIRS = {"knn", "taxel_net", "temporal_mixed"}


def test_every_transform_and_model_is_in_a_pair():
    made = [pair() for pair in PAIRS.values()]
    parts = [part for _, _, parts in made for part in flat(Compose(parts))]
    names = {type(part).__name__ for part in parts} | {"Compose"} | set(REFUSED)
    known = set(_classes.transform_classes()) - {"FittedTransform"}
    assert known - names == set()
    models = {type(model).__name__ for _, model, _ in made}
    whole = {name for name in nn.models.__all__ if "Thread" not in name}
    assert whole - models == {"PooledMLP", "TactileModel", "TouchEncoder"}
    networks = {"taxel_net", "posed_taxel_net", "temporal", "gcn", "grasp_gcn", "fnn", "cnn"}
    networks |= {"lstm", "temporal_cnn"}
    assert networks < {model.name for model in COMPARED}


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=[pytest.mark.full] * (name not in QUICK_PAIRS)) for name in PAIRS],
)
def test_graphs_give_the_numbers_of_predictors(name, tmp_path):
    torch.manual_seed(0)
    path = tmp_path / "model.onnx"
    exported = export_onnx(fitted(*PAIRS[name]()), path)
    assert exported.difference < 1e-5
    assert exported.num_bytes == path.stat().st_size
    assert exported.metadata["is_stepped"] == (name in STEPPED)


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_exported_is_named(name, tmp_path):
    transform, match = REFUSED[name]
    data = Windows(dataset(), 8) if name == "ContactCrop" else dataset()
    model = GraspLSTM(11, 2, hidden_channels=4)
    predictor = fitted(data, model, [transform])
    with pytest.raises(NotImplementedError, match=match):
        export_onnx(predictor, tmp_path / "model.onnx")
    assert not list(tmp_path.iterdir())


@pytest.fixture(scope="module")
def small():
    model = TactileFNN(11, 2, num_joints=2, widths=(4,), pools=(1,))
    return fitted(dataset(), model, [T.Tare(first=3), T.ZScore(per="channel")])


@pytest.fixture(scope="module")
def path(small, tmp_path_factory):
    path = tmp_path_factory.mktemp("onnx") / "model.onnx"
    before = small(frames().x[0], frames().joint[0], session=0)
    export_onnx(small, path, unit="count")
    assert small(frames().x[0], frames().joint[0], session=0).equal(before)  # as it was
    return path


def session_of(path):
    import onnxruntime

    return onnxruntime.InferenceSession(path)


def test_metadata_says_what_the_file_is(path):
    session = session_of(path)
    info = json.loads(session.get_modelmeta().custom_metadata_map["torch_geometric_tactile"])
    assert info["layout"] == "placed"
    assert (info["num_taxels"], info["num_channels"], info["num_joints"]) == (11, 3, 2)
    assert (info["unit"], info["task"], info["window"]) == ("count", "multiclass", None)
    assert info["rest"]["transform"] == "Tare('session', first=3)"
    assert info["parity"] < 1e-5
    shapes = {node.name: node.shape for node in session.get_inputs()}
    assert shapes == {"tactile": [1, 11, 3], "rest": [11, 3], "joint": [2]}


def test_the_rest_is_an_input(path):
    session = session_of(path)
    x, joint = frames().x[:1].numpy(), frames().joint[0].numpy()
    rest = x[0].astype(np.float64) - 3
    (out,) = session.run(None, {"tactile": x, "rest": rest, "joint": joint})
    (same,) = session.run(None, {"tactile": x + 64, "rest": rest + 64, "joint": joint})
    (other,) = session.run(None, {"tactile": x + 64, "rest": rest, "joint": joint})
    assert np.abs(out - same).max() < 1e-5
    assert np.abs(out - other).max() > 1e-3


@pytest.mark.parametrize(
    ("first", "shown"),
    [
        (T.CommonMode(), True),
        (T.SelectChannels([2, 0, 1]), True),
        (T.TaxelPose(LAYOUT, HAND), False),
        (T.Normalize(attr="joint"), False),
    ],
    ids=repr,
)
def test_what_the_rest_is_measured_on_is_an_output_if_steps_before_change_readings(first, shown):
    model = TactileFNN(11, 2, num_joints=2, widths=(4,), pools=(1,))
    graph = OnnxGraph(fitted(dataset(), model, [first, T.Tare(first=3)]), 3)
    assert ("before_rest" in graph.output_names) == graph.outputs_rest_readings == shown


@pytest.mark.full
@pytest.mark.slow
def test_the_rest_is_an_input_of_a_predictor_of_tared_readings(tmp_path):
    model = TactileFNN(11, 2, num_joints=2, widths=(4,), pools=(1,))
    tared = fitted(dataset(), model, [T.ZScore(per="channel")])
    exported = export_onnx(tared.with_tare(), tmp_path / "a.onnx")
    assert exported.metadata["rest"]["transform"] == "Tare('session', first=None)"
    x, joint = frames().x[:1], frames().joint[0]
    feed = {"tactile": x.numpy() + 64, "rest": np.full((11, 3), 64.0), "joint": joint.numpy()}
    (out,) = session_of(tmp_path / "a.onnx").run(None, feed)
    assert np.abs(out - tared(x, joint).numpy()).max() < 1e-5


@pytest.mark.parametrize("change", [1e-3, np.nan], ids=["different", "missing"])
def test_a_difference_is_an_error_and_leaves_nothing(change, small, path, tmp_path, monkeypatch):
    import onnx

    exporting = import_module("torch_geometric_tactile.predictor.export_onnx")
    program, answer = onnx.load(path), exporting._run_graph
    del program.metadata_props[:]
    monkeypatch.setattr(
        sys.modules[export_onnx.__module__], "_export_program", lambda graph: program
    )
    monkeypatch.setattr(exporting, "_run_graph", lambda *given: answer(*given) + change)
    with pytest.raises(ValueError, match=r"must agree with it to 1e-05 \(got a difference of"):
        export_onnx(small, tmp_path / "model.onnx")
    assert not list(tmp_path.iterdir())
    monkeypatch.setattr(exporting, "_run_graph", answer)
    assert export_onnx(small, tmp_path / "model.onnx").difference < 1e-5


def test_sizes_are_those_of_data_and_model():
    unknown = TactileFNN(11, 2, num_joints=2, widths=(4,), pools=(1,))
    by_trying = OnnxGraph(Predictor(unknown, LAYOUT, adjacency="original"))
    assert (by_trying.num_channels, by_trying.num_joints) == (3, 2)
    of_data = OnnxGraph(Predictor.from_dataset(Reader("joint"), dataset()))
    assert (of_data.num_channels, of_data.num_joints) == (3, 2)
    with pytest.raises(ValueError, match=r"must hold 'num_joints' to be exported \(got None\)"):
        OnnxGraph(Predictor(Reader("joint"), LAYOUT, adjacency="original"), 3)


@pytest.mark.parametrize(
    ("data", "per"),
    [(dataset(), None), (dataset(), "channel"), (Windows(dataset(), 8), "signal")],
    ids=["taxels", "channels", "windows"],
)
def test_graphs_are_compared_on_readings_like_those_of_the_data(data, per):
    model = GraspLSTM(11, 2, hidden_channels=4)
    predictor = fitted(data, model, [T.ZScore() if per is None else T.ZScore(per=per)])
    graph = OnnxGraph(predictor)
    frames = np.stack([frames for frames, _ in _random_examples(graph, predictor)])
    assert frames.shape[1:] == (graph.length, 11, 3)
    assert np.isnan(frames).any(axis=(1, 2, 3)).tolist() == [False] * 5 + [True] * 2
    assert np.nanmean(frames) == pytest.approx(300, abs=15)  # as in the data
    assert frames[:4].std() == pytest.approx(27, abs=10)  # 0.5, 1, 1.5 and 2 times 20


def test_bad_arguments(small, tmp_path):
    with pytest.raises(ValueError, match="'unit' must be one of"):
        export_onnx(small, tmp_path / "model.onnx", unit="volt")
    predictor = Predictor(Reader(), LAYOUT, adjacency="original")
    with pytest.raises(ValueError, match=r"'num_channels' must be given.*accepts \[1, 2, 3"):
        export_onnx(predictor, tmp_path / "model.onnx")
