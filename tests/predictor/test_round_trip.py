"""Every transform and model of the package goes through the file of a predictor, or is a user's
own, which is given again when the file is read."""

import inspect
import json
import resource

import pytest
import small_models
import torch
import torch_geometric.transforms as pyg
from torch_geometric.data import Data
from torch_geometric.transforms import BaseTransform, Compose

from torch_geometric_tactile import Predictor, nn, transforms
from torch_geometric_tactile.baselines import flat_forest
from torch_geometric_tactile.data import StaticData, join_frames
from torch_geometric_tactile.nn.models import (
    BMFCNN,
    GraspGCN,
    GraspLSTM,
    PosedTaxelNet,
    SmallCNN,
    TactileFNN,
    TaxelNet,
    TemporalCNN,
    TemporalTaxelNet,
)
from torch_geometric_tactile.predictor import (
    AverageModel,
    EstimatorModel,
    MissingOwnError,
    _classes,
)
from torch_geometric_tactile.predictor._plain_data import Builder, Describer
from torch_geometric_tactile.sensors import TaxelLayout, grid

HAND = small_models.HAND
LAYOUT = TaxelLayout(
    "finger",
    pos=torch.rand(6, 3, generator=torch.Generator().manual_seed(0)) / 10,
    normal=torch.eye(3).repeat(2, 1),
    link=torch.tensor([0, 0, 1, 1, 2, 2]),
    patch=torch.tensor([0, 0, 0, 1, 1, 1]),
    digit=torch.tensor([0, 0, 1, 1, 1, 1]),
    link_names=("base", "middle", "tip"),
    patch_names=("left", "right"),
    digit_names=("one", "two"),
    adjacency={"ring": torch.tensor([[0, 1, 2, 3, 4, 5], [1, 2, 3, 4, 5, 0]])},
)
GRID = grid(2, 3, 0.01)
OTHER = TaxelLayout("other", pos=LAYOUT.pos + 1, patch=LAYOUT.patch, patch_names=("a", "b"))


def samples():
    draw = torch.Generator().manual_seed(1)
    return StaticData(
        x=torch.randn(8, 6, 3, generator=draw) + 3,
        pos=LAYOUT.pos,
        normal=LAYOUT.normal,
        tangent=LAYOUT.axes()[:, :2],
        edge_index=LAYOUT.edge_index("ring"),
        edge_attr=torch.rand(6, 2, generator=draw),
        joint=torch.randn(8, 2, generator=draw),
        session=torch.arange(8) // 4,
        trial=torch.arange(8) // 2,
        time=torch.arange(8) / 10,
    )


def windows():
    frames = torch.randn(8, 6, 9, 3, generator=torch.Generator().manual_seed(2))
    frames[:, :, 4:] += 20
    data = samples()
    data.x, data.num_frames = join_frames(frames), 9
    return data


def calibrated(*size, **options):
    """A calibration of three channels of degree two, the same at each call."""
    draw = torch.Generator().manual_seed(3)
    low = torch.rand(*size[:-2], 3, generator=draw) + 1
    return transforms.Calibrate(
        torch.randn(*size, generator=draw), low, low + 3, degree=2, source="a press", **options
    )


WINDOWED = {  # of windows of frames
    "Calibrate": [
        lambda: calibrated(6, 10, 2),
        lambda: calibrated(10, 3, per="sensor"),
    ],
    "ContactCrop": [
        lambda: transforms.ContactCrop(3, 4.0, 6.0, sustain=2, before=1, missing="keep"),
        lambda: transforms.ContactCrop(4, 3.0, 0.5),
    ],
    "FillMissing": [lambda: transforms.FillMissing()],
    "Normalize": [lambda: transforms.Normalize(per="signal")],
    "Resample": [lambda: transforms.Resample(5), lambda: transforms.Resample(20)],
    "SelectChannels": [lambda: transforms.SelectChannels([2, 0])],
    "SessionZScore": [lambda: transforms.SessionZScore(per="signal")],
    "TaxelDescriptors": [lambda: transforms.TaxelDescriptors(LAYOUT)],
    "ZScore": [
        lambda: transforms.ZScore(per="signal"),
        lambda: transforms.ZScore(per="signal", scale_per="channel"),
    ],
}
OURS = {
    "AbsoluteMorphology": [
        lambda: transforms.AbsoluteMorphology(),
        lambda: transforms.AbsoluteMorphology((0.1, 0.2, 0.3), cat=True),
    ],
    "Calibrate": [
        lambda: transforms.Calibrate(torch.eye(4)[:, :2]),
        lambda: calibrated(10, 3),
        lambda: calibrated(6, 10, 2, units=("microtesla", "unit of the file")),
        lambda: calibrated(6, 10, 1, per="sensor"),
    ],
    "CommonMode": [
        lambda: transforms.CommonMode(),
        lambda: transforms.CommonMode("patch", LAYOUT),
        lambda: transforms.CommonMode([4, 4, 7, 7, 7, 9]),
    ],
    "DropPatches": [
        lambda: transforms.DropPatches(LAYOUT, patches=["right"], value=float("nan")),
        lambda: transforms.DropPatches(OTHER, p=0.0),
    ],
    "DropTaxels": [
        lambda: transforms.DropTaxels(taxels=[1, 4], value=-1.0),
        lambda: transforms.DropTaxels(p=1.0),
    ],
    "SelectChannels": [lambda: transforms.SelectChannels([1, 0])],
    "FillMissing": [lambda: transforms.FillMissing(0.5)],
    "GeometricEdgeAttr": [
        lambda: transforms.GeometricEdgeAttr(),
        lambda: transforms.GeometricEdgeAttr(norm=True, max_value=0.3, cat=False),
    ],
    "KNNGraph": [lambda: transforms.KNNGraph(2), lambda: transforms.KNNGraph(1, symmetric=False)],
    "Normalize": [
        lambda: transforms.Normalize(-2.0, 5.0),
        lambda: transforms.Normalize(0.0, 2.0, attr="joint"),
        lambda: transforms.Normalize(per="channel"),
    ],
    "SectorGraph": [
        lambda: transforms.SectorGraph(LAYOUT),
        lambda: transforms.SectorGraph(LAYOUT, 4, radius=0.2, within="link"),
    ],
    "RandomContrast": [lambda: transforms.RandomContrast(1.0, 1.0, center=0.5)],
    "RandomInversion": [
        lambda: transforms.RandomInversion(p=1.0, high=2.0),
        lambda: transforms.RandomInversion(p=0.0),
    ],
    "RandomGain": [
        lambda: transforms.RandomGain(0.0),
        lambda: transforms.RandomGain(0.0, "patch", LAYOUT),
    ],
    "RandomMirror": [
        lambda: transforms.RandomMirror(GRID, p=1.0, negate=0),
        lambda: transforms.RandomMirror(GRID, p=0.0, along="rows"),
    ],
    "RandomNoise": [lambda: transforms.RandomNoise(0.0)],
    "RandomOffset": [
        lambda: transforms.RandomOffset(0.0),
        lambda: transforms.RandomOffset(0.0, [4, 4, 7, 7, 7, 9]),
    ],
    "RandomShift": [lambda: transforms.RandomShift(GRID, 0, 0, value=7.0)],
    "RandomTimeShift": [
        lambda: transforms.RandomTimeShift(0),
        lambda: transforms.RandomTimeShift(0, 1),
    ],
    "SessionZScore": [
        lambda: transforms.SessionZScore(),
        lambda: transforms.SessionZScore("trial", attr="joint"),
        lambda: transforms.SessionZScore(attr="edge_attr"),
        lambda: transforms.SessionZScore(per="channel"),
    ],
    "SquareRoot": [lambda: transforms.SquareRoot()],
    "NormalizeRMS": [lambda: transforms.NormalizeRMS()],
    "Tare": [
        lambda: transforms.Tare(),
        lambda: transforms.Tare("trial", first=1),
        lambda: transforms.Tare(seconds=0.15),
    ],
    "TaxelDescriptors": [
        lambda: transforms.TaxelDescriptors(LAYOUT),
        lambda: transforms.TaxelDescriptors(LAYOUT, posed=True),
    ],
    "TaxelForce": [
        lambda: transforms.TaxelForce(),
        lambda: transforms.TaxelForce("force"),
    ],
    "TaxelPose": [
        lambda: transforms.TaxelPose(LAYOUT, HAND),
        lambda: transforms.TaxelPose(LAYOUT, HAND, normal=False),
        lambda: transforms.TaxelPose(LAYOUT, HAND, tangent=True),
    ],
    "TopologicalSegmentation": [
        lambda: transforms.TopologicalSegmentation("patch", LAYOUT),
        lambda: transforms.TopologicalSegmentation("digit", LAYOUT, drop=False),
        lambda: transforms.TopologicalSegmentation([4, 4, 7, 7, 7, 9]),
    ],
    "ZScore": [
        lambda: transforms.ZScore(),
        lambda: transforms.ZScore(attr="joint"),
        lambda: transforms.ZScore("edge_attr"),
        lambda: transforms.ZScore(per="channel"),
        lambda: transforms.ZScore(scale_per="channel"),
        lambda: transforms.ZScore(scale_per="channel", with_mean=False),
    ],
}
PYG = {
    "AddRemainingSelfLoops": lambda: pyg.AddRemainingSelfLoops("edge_attr", 2.0),
    "AddSelfLoops": lambda: pyg.AddSelfLoops("edge_attr", "mean"),
    "Cartesian": lambda: pyg.Cartesian(norm=False),
    "Center": lambda: pyg.Center(),
    "Compose": lambda: Compose([pyg.Distance(), Compose([transforms.FillMissing(1.0)])]),
    "Constant": lambda: pyg.Constant(2.0),
    "Distance": lambda: pyg.Distance(max_value=0.5, cat=False, interval=(-1.0, 1.0)),
    "LocalCartesian": lambda: pyg.LocalCartesian(cat=False),
    "LocalDegreeProfile": lambda: pyg.LocalDegreeProfile(),
    "NormalizeFeatures": lambda: pyg.NormalizeFeatures(["x"]),
    "NormalizeScale": lambda: pyg.NormalizeScale(),
    "OneHotDegree": lambda: pyg.OneHotDegree(3, cat=False),
    "RemoveDuplicatedEdges": lambda: pyg.RemoveDuplicatedEdges(["edge_attr"], "mean"),
    "RemoveSelfLoops": lambda: pyg.RemoveSelfLoops("edge_attr"),
    "Spherical": lambda: pyg.Spherical(norm=False),
    "TargetIndegree": lambda: pyg.TargetIndegree(norm=False),
    "ToUndirected": lambda: pyg.ToUndirected(reduce="mean"),
}
EXAMPLES = [
    *((make, samples) for makes in OURS.values() for make in makes),
    *((make, windows) for makes in WINDOWED.values() for make in makes),
]


def through_text(transform, own=None):
    """The transform, described, as text, and built again."""
    describer = Describer(LAYOUT)
    text = json.dumps(describer.transform(transform), allow_nan=False)
    layout = TaxelLayout.from_dict(json.loads(json.dumps(LAYOUT.to_dict())))
    return Builder(layout, describer.tensors, own).transform(json.loads(text))


def equal(a, b):
    assert a.keys() == b.keys()
    for key in list(a.keys()):
        torch.testing.assert_close(a[key], b[key], rtol=0, atol=0, equal_nan=True)


def test_every_transform_has_an_example():
    ours = {n for n in transforms.__all__ if inspect.isclass(getattr(transforms, n))}
    assert {*OURS, *WINDOWED} == ours - {"FittedTransform", "TactileTransform"}  # the base classes
    assert set(_classes.transform_classes()) == ours - {"TactileTransform"} | set(PYG)


@pytest.mark.parametrize(
    ("make", "data"), EXAMPLES, ids=[repr(make()).replace("\n", "") for make, _ in EXAMPLES]
)
def test_transforms_of_ours_are_built_again(make, data):
    transform = make()
    if isinstance(transform, transforms.FittedTransform):
        unfitted = through_text(transform)
        assert unfitted.center is None
        transform.fit(data())
    again = through_text(transform)
    assert type(again) is type(transform)
    assert repr(again) == repr(transform)
    equal(again(data()), transform(data()))


@pytest.mark.parametrize("name", PYG)
def test_transforms_of_pyg_are_built_again(name):
    transform = PYG[name]()
    again = through_text(transform)
    assert type(again) is type(transform)
    assert repr(again) == repr(transform)
    data = samples().sample(0)
    keys = ("x", "pos", "edge_index", "edge_attr")
    data = Data(**{key: data[key].clone() for key in keys})
    equal(again(data.clone()), transform(data.clone()))


class Shift(BaseTransform):
    def __init__(self, by):
        self.by = by

    def forward(self, data):
        data.x = data.x + self.by
        return data

    def __repr__(self):
        return f"Shift({self.by})"


class Gain(transforms.ZScore):
    """A fitted transform of one's own."""


def plain(data):
    return data


def test_transforms_of_ones_own_are_given_again():
    gain = Gain().fit(samples())
    generator = torch.Generator().manual_seed(0)
    random = transforms.DropTaxels(p=0.5, generator=generator)  # a state that no file has
    chain = Compose([transforms.FillMissing(), Shift(1), gain, plain, random])
    given = [Gain(), plain, Compose([Shift(2), Shift(1), random]), transforms.FillMissing(9.0)]
    again = through_text(chain, given)
    assert repr(again) == repr(chain)
    data = samples()
    for part, other in zip(chain.transforms[:4], again.transforms[:4], strict=True):
        equal(part(data), other(data))
    assert again.transforms[2].center.equal(gain.center)
    assert given[0].center is None  # a copy was fitted
    for own in (None, [Shift(2)], [Gain()]):
        with pytest.raises(MissingOwnError, match=r"must contain your transform 'Shift\(1\)'"):
            through_text(chain, own)


ROWS = (torch.randn(9, 11, 3, generator=torch.Generator().manual_seed(3)).numpy(), [0, 1, 2] * 3)
# Parts of models, and the base class: no model of readings.
PARTS = {"CNNThread", "GCNThread", "PooledMLP", "SegmentedThread", "TactileModel", "Thread"}
IMAGE = grid(20, 21, 0.01)
MODELS = {
    **small_models.MODELS,
    "bmf_cnn": lambda: BMFCNN(IMAGE, 3, in_channels=3, fusion="bilinear(C2)+C3", hidden_channels=5),
    "grasp": lambda: GraspGCN(11, 3, in_channels=1, hidden_channels=5, num_fingers=3),
    "lstm": lambda: GraspLSTM(11, 3, hidden_channels=5),
    "lstm_one": lambda: GraspLSTM(11, 3, finger=2, hidden_channels=4, num_layers=2),
    "posed": lambda: PosedTaxelNet(small_models.LAYOUT, 3, num_strongest=5),
    "posed_open": lambda: PosedTaxelNet(small_models.LAYOUT, 3, posed=False, widths=(4, 2)),
    "small_cnn": lambda: SmallCNN(small_models.LAYOUT, 3, widths=(4, 4), hidden_channels=5),
    "taxel": lambda: TaxelNet(small_models.LAYOUT, 3, direct_channels=2, max_taxels=6),
    "taxel_pyramid": lambda: TaxelNet(small_models.LAYOUT, 3, max_taxels=6, head_taxels=3, depth=1),
    "taxel_described": lambda: TaxelNet(small_models.LAYOUT, 3, descriptor_channels=4),
    "taxel_joint": lambda: TaxelNet(small_models.LAYOUT, 3, conv="self", num_joints=2),
    "temporal_pooled": lambda: TemporalTaxelNet(
        *(small_models.LAYOUT, 3), pool="mean", mixed_channels=4, num_filters=2, filter_size=2
    ),
    "temporal": lambda: TemporalTaxelNet(
        small_models.LAYOUT, 3, num_filters=2, filter_size=2, max_taxels=6, num_joints=2
    ),
    "temporal_cnn": lambda: TemporalCNN(11, 3, in_channels=3, widths=[4, 5], kernel_sizes=[5, 3]),
    "average": lambda: AverageModel(
        [GraspGCN(11, 2, in_channels=1, num_fingers=3), TactileFNN(11, 2)],
        numbers=True,
        center=torch.tensor([1.0, -2.0], dtype=torch.double),
        scale=torch.tensor([3.0, 0.5], dtype=torch.double),
    ),
    "estimator": lambda: EstimatorModel.of(
        flat_forest(num_trees=5).set_params(randomforestclassifier__random_state=0).fit(*ROWS), 3
    ),
    "grasp_one": lambda: GraspGCN(11, num_fingers=3, fusion=None, finger=1, num_layers=2),
}
LAYOUTS = {"bmf_cnn": IMAGE}  # all others are on the small one
OWN = {"gcn_patch"}  # with an encoder that is given as a module


def test_every_model_has_an_example():
    built = set(_classes.model_classes())
    assert {type(make()).__name__ for make in MODELS.values()} == built - PARTS
    encoders = {"TouchEncoder"}  # its features are those of a policy, and no prediction
    assert built == {*nn.models.__all__, "AverageModel", "EstimatorModel"} - encoders


@pytest.mark.parametrize("name", MODELS)
def test_models_are_built_again(name, tmp_path):
    torch.manual_seed(0)
    model = MODELS[name]().eval()
    layout = LAYOUTS.get(name, small_models.LAYOUT)
    predictor = Predictor(model, layout, adjacency="original")
    predictor.save(tmp_path / "a.predictor")
    own = None
    if name in OWN:
        with pytest.raises(MissingOwnError, match=r"'model' must be given.*TactileGCN"):
            Predictor.load(tmp_path / "a.predictor")
        own = MODELS[name]()
    state = torch.get_rng_state()
    again = Predictor.load(tmp_path / "a.predictor", model=own)
    assert torch.get_rng_state().equal(state)
    assert type(again.model) is type(model)
    assert repr(again.model) == repr(model)
    assert not again.model.training
    x = torch.randn(3, layout.num_taxels, 3)
    data = StaticData(x=x, edge_index=layout.edge_index("original"))
    for key in getattr(model, "modalities", ()):
        data[key] = torch.randn(3, *small_models.SIZES[key])
    with torch.no_grad():
        assert again.logits(data).equal(predictor.logits(data))


@pytest.mark.parametrize(
    "described",
    [
        {"class": "DropTaxels", "arguments": {"generator": 5}},
        {"class": "DropPatches", "arguments": {"layout": {"$layout": None}, "generator": 5}},
        *(
            {"class": f"Random{name}", "arguments": {"generator": [1]}}
            for name in ("Noise", "Offset", "Gain", "TimeShift", "Contrast", "Inversion")
        ),
        {"class": "RandomMirror", "arguments": {"layout": {"$layout": None}, "generator": 5}},
        {"class": "RandomShift", "arguments": {"layout": {"$layout": None}, "generator": "a"}},
    ],
    ids=lambda described: described["class"],
)
def test_other_generators_are_refused_when_built(described):
    with pytest.raises(ValueError, match=r"'generator' must be a torch\.Generator, .*\(got "):
        Builder(LAYOUT if "Patches" in described["class"] else GRID, {}).transform(described)


def test_random_transforms_all_check_their_generators():
    takes = {
        name
        for name, kind in _classes.transform_classes().items()
        if "generator" in inspect.signature(kind.__init__).parameters
    }
    assert takes == {"DropTaxels", "DropPatches"} | {
        f"Random{name}"
        for name in ("Noise", "Offset", "Gain", "TimeShift", "Contrast", "Inversion", "Mirror")
    } | {"RandomShift"}


def references(kind):
    """What names one tensor many times."""
    tensor = {"$tensor": "big"}
    if kind == "transform":
        one = {"class": "Calibrate", "arguments": {"coefficients": tensor, "degree": 1}}
        parts = [{"$transform": one}] * 3000
        return torch.zeros(100, 4000), {"class": "Compose", "arguments": {"transforms": parts}}
    if kind == "state":
        state = {"center": [tensor] * 3000, "scale": tensor, "key_values": tensor}
        return torch.zeros(400_000), {"class": "ZScore", "arguments": {}, "state": state}
    beside = {"step": "Beside", "models": [[{"step": "Constant", "values": tensor}]] * 3000}
    steps = [{"step": "Readings"}, beside]
    return torch.zeros(400_000).bool(), {"class": "EstimatorModel", "arguments": {"steps": steps}}


@pytest.mark.parametrize("kind", ["transform", "state", "model"])
def test_tensor_that_is_named_many_times_is_refused(kind):
    big, described = references(kind)
    builder = Builder(GRID, {"big": big})
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(ValueError, match="its tensors must not be referenced too often"):
        (builder.model if kind == "model" else builder.transform)(described)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 600_000  # KiB


def test_models_and_transforms_of_a_file_share_one_limit(monkeypatch):
    big = torch.zeros(4000)
    monkeypatch.setattr("torch_geometric_tactile.data._allocation_limit.MODEL_BYTES", 0)
    builder = Builder(GRID, {"big": big})
    for _ in range(4):
        builder.tensor("big")
    with pytest.raises(ValueError, match="must not be referenced too often"):
        builder.tensor("big")


SIZES = [
    ("TaxelNet", {"num_sectors": 10**6}, r"'num_sectors' must be at most 360"),
    ("TaxelNet", {"depth": 10**9}, r"'depth' must be at most 1000"),
    ("TaxelNet", {"in_channels": 10**9}, "must not be larger than its weights"),
    ("TaxelNet", {"widths": [10**9]}, "must not be larger than its weights"),
    ("TaxelNet", {"hidden_channels": 10**9}, "must not be larger than its weights"),
    ("TemporalTaxelNet", {"num_sectors": 10**6}, r"'num_sectors' must be at most 360"),
    ("TemporalCNN", {"in_channels": 10**9}, "must not be larger than its weights"),
    ("TemporalCNN", {"widths": [10**9]}, "must not be larger than its weights"),
    ("TemporalCNN", {"kernel_sizes": [10**9 + 1]}, "must not be larger than its weights"),
    ("TemporalCNN", {"kernel_sizes": [3.0]}, r"'kernel_sizes' must be odd numbers of frames"),
    ("GraspGCN", {"num_layers": 10**9}, r"'num_layers' must be at most 1000"),
    ("GraspLSTM", {"num_layers": 10**9}, r"'num_layers' must be at most 1000"),
    ("PosedTaxelNet", {"in_channels": 10**9}, "must not be larger than its weights"),
    ("SmallCNN", {"hidden_channels": 10**9}, "must not be larger than its weights"),
]


@pytest.mark.parametrize(("name", "size", "match"), SIZES)
def test_sizes_beyond_all_measure_are_refused_before_memory_is_taken(name, size, match):
    required = {} if name.startswith("Grasp") else {"layout": {"$layout": None}, "out_channels": 2}
    builder = Builder(grid(4, 4, 0.01), {})
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(ValueError, match=match):
        builder.model({"class": name, "arguments": {**required, **size}})
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 600_000  # KiB


def test_sectors_of_a_transform_are_limited():
    described = {"class": "SectorGraph", "arguments": {"layout": {"$layout": None}}}
    described["arguments"]["num_sectors"] = 10**6
    with pytest.raises(ValueError, match=r"'num_sectors' must be at most 360, one for each degree"):
        Builder(GRID, {}).transform(described)
