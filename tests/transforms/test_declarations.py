"""What transforms say of themselves holds, and is all that others ask of them."""

import copy

import pytest
import torch
from predictor.test_round_trip import GRID, HAND, LAYOUT, OURS, WINDOWED, samples, windows

from torch_geometric_tactile import transforms
from torch_geometric_tactile.data import (
    StaticData,
    StaticDataset,
    apply_transform,
    join_frames,
    split_frames,
)
from torch_geometric_tactile.nn import TaxelNet
from torch_geometric_tactile.predictor import Predictor
from torch_geometric_tactile.sensors import grid
from torch_geometric_tactile.transforms import FittedTransform, TactileTransform

ALL = [(make, samples) for makes in OURS.values() for make in makes]
ALL += [(make, windows) for makes in WINDOWED.values() for make in makes]
IDS = [f"{make()!r}".replace("\n", "") for make, _ in ALL]
NOT_RANDOM = pytest.mark.parametrize(
    ("make", "given"), [(make, given) for make, given in ALL if not make().is_random]
)
DRAWN = [
    transforms.DropTaxels(p=0.5),
    transforms.DropPatches(grid(2, 3, pitch=0.01), p=0.5),
    transforms.RandomGain(0.5),
    transforms.RandomNoise(0.5),
    transforms.RandomOffset(0.5),
]
PLACES = ("pos", "edge_index", "edge_attr", "edge_weight", "num_frames", "valid_frames")


HALVES = [3, 3, 3, 8, 8, 8]
SHOWN = [
    (transforms.AbsoluteMorphology([0, 0, 1], cat=True), "origin=(0.0, 0.0, 1.0), cat=True"),
    (
        transforms.Calibrate(torch.ones(4, 2)),
        "3 -> 2, degree=1, per='taxel', units=('count', 'newton')",
    ),
    (
        transforms.Calibrate(torch.ones(6, 10, 1), degree=2, per="sensor"),
        "3 -> 1, num_taxels=6, degree=2, per='sensor', units=('count', 'newton')",
    ),
    (transforms.CommonMode(), ""),
    (transforms.CommonMode(layout=LAYOUT), ""),
    (transforms.CommonMode("digit", LAYOUT), "'digit', num_segments=2"),
    (transforms.CommonMode(HALVES), "numbers, num_segments=2"),
    (
        transforms.ContactCrop(),
        "rest=10, k=5.0, floor=5.0, sustain=3, before=0, missing='error'",
    ),
    (transforms.DropPatches(LAYOUT), "'finger', p=0.1, value=0.0"),
    (transforms.DropPatches(LAYOUT, patches=[1]), "'finger', patches=['right'], value=0.0"),
    (transforms.DropTaxels(), "p=0.1, value=0.0"),
    (transforms.DropTaxels(taxels=[2, 0], value=1.0), "taxels=[0, 2], value=1.0"),
    (transforms.FillMissing(), "value=0.0"),
    (transforms.GeometricEdgeAttr(), "norm=False, max_value=None, cat=True"),
    (transforms.GeometricEdgeAttr(True, 0.2, cat=False), "norm=True, max_value=0.2, cat=False"),
    (transforms.KNNGraph(3, symmetric=False), "k=3, symmetric=False"),
    (transforms.Normalize(0, 10), "low=0.0, high=10.0"),
    (transforms.Normalize(attr="pos"), "low=-1.0, high=1.0, attr='pos'"),
    (transforms.Normalize(per="channel"), "low=-1.0, high=1.0, per='channel'"),
    (transforms.RandomContrast(center=0.5), "low=1.0, high=1.5, center=0.5"),
    (transforms.RandomGain(0.2), "std=0.2"),
    (transforms.RandomGain(0.2, "digit", LAYOUT), "std=0.2, 'digit', num_segments=2"),
    (transforms.RandomInversion(generator=torch.Generator()), "p=0.5, low=0.0, high=1.0"),
    (transforms.RandomMirror(GRID), "'grid_2x3', p=0.5, along='columns'"),
    (transforms.RandomMirror(GRID, negate=0), "'grid_2x3', p=0.5, along='columns', negate=0"),
    (transforms.RandomNoise(), "std=0.1"),
    (transforms.RandomOffset(1, HALVES), "std=1.0, numbers, num_segments=2"),
    (transforms.RandomShift(GRID), "'grid_2x3', rows=1, columns=1, value=0.0"),
    (transforms.RandomTimeShift(), "steps=1"),
    (transforms.RandomTimeShift(3, 7), "steps=3, num_frames=7"),
    (transforms.Resample(), "60"),
    (
        transforms.SectorGraph("biotac_sp", 4, 0.01, "link"),
        "'biotac_sp', num_sectors=4, radius=0.01, within='link'",
    ),
    (transforms.SelectChannels([2, 0]), "[2, 0]"),
    (transforms.SessionZScore("trial"), "'trial'"),
    (transforms.SessionZScore(attr="pos"), "'session', attr='pos'"),
    (transforms.SessionZScore(per="channel"), "'session', per='channel'"),
    (transforms.SquareRoot(), ""),
    (transforms.NormalizeRMS(), ""),
    (transforms.Tare(), "'session', first=None"),
    (transforms.Tare("trial", first=5), "'trial', first=5"),
    (transforms.Tare("trial", attr="joint"), "'trial', first=None, attr='joint'"),
    (transforms.Tare(seconds=0.5, attr="joint"), "'session', seconds=0.5, attr='joint'"),
    (transforms.TaxelDescriptors(LAYOUT), "'finger', posed=False"),
    (transforms.TaxelForce(), ""),
    (transforms.TaxelForce("force"), "'force'"),
    (transforms.TaxelPose(LAYOUT, HAND), "'finger', 'finger'"),
    (
        transforms.TopologicalSegmentation("digit", LAYOUT),
        "'digit', num_segments=2, drop=True",
    ),
    (
        transforms.TopologicalSegmentation(HALVES, drop=False),
        "numbers, num_segments=2, drop=False",
    ),
    (transforms.ZScore(per="taxel"), ""),
    (transforms.ZScore(scale_per="channel"), "scale_per='channel'"),
    (transforms.ZScore(with_mean=False), "with_mean=False"),
    (transforms.ZScore("joint", per="channel"), "attr='joint', per='channel'"),
]


@pytest.mark.parametrize(("transform", "arguments"), SHOWN)
def test_arguments_are_shown(transform, arguments):
    assert repr(transform) == f"{type(transform).__name__}({arguments})"


def test_each_transform_is_shown():
    assert {type(transform).__name__ for transform, _ in SHOWN} == {*OURS, *WINDOWED}


def ready(make, data):
    transform = make()
    return transform.fit(data) if isinstance(transform, FittedTransform) else transform


def same(a, b):
    if not isinstance(a, torch.Tensor) or not isinstance(b, torch.Tensor):
        return a is b or a == b
    return a.shape == b.shape and torch.allclose(a, b, 0, 0, equal_nan=True)


@pytest.mark.parametrize(("make", "given"), ALL, ids=IDS)
def test_only_what_is_declared_is_written(make, given):
    data = given()
    transform, before = ready(make, data), data.to_dict()
    after = transform(copy.copy(data)).to_dict()
    changed = {k for k in {*before, *after} if k not in after or not same(before.get(k), after[k])}
    assert changed <= {*transform.writes}


@pytest.mark.parametrize(("make", "given"), ALL, ids=IDS)
def test_the_caller_keeps_its_data(make, given):
    data = given()
    data.x[0, 1] = torch.nan
    data.dropped = torch.zeros(8, 6, dtype=torch.bool)
    before = copy.deepcopy(data.to_dict())
    ready(make, data)(data)
    assert {*data.keys()} == {*before}
    assert all(same(data[key], value) for key, value in before.items())


@pytest.mark.parametrize(("make", "given"), ALL, ids=IDS)
def test_only_what_is_declared_is_read(make, given):
    data = given()
    transform = ready(make, data)
    expected = transform(copy.copy(data)).to_dict()
    poisoned = copy.copy(data)
    for key, value in data.to_dict().items():
        if key in transform.reads or key in PLACES or not isinstance(value, torch.Tensor):
            continue
        if value.is_floating_point():
            poisoned[key] = value + 1e3
    found = transform(poisoned).to_dict()
    for key in {*transform.writes} & {*expected}:
        if key in transform.reads or key not in poisoned or key not in data:
            assert same(found[key], expected[key]), key


@pytest.mark.parametrize(("make", "given"), ALL, ids=IDS)
def test_no_samples_stay_none(make, given):
    data = given()
    transform, none = ready(make, data), torch.empty(0, dtype=torch.long)
    some, empty = transform(copy.copy(data)), transform(data.index_select(none))
    for key in transform.writes:
        if isinstance(getattr(some, key, None), torch.Tensor):
            expected = some[key] if some.is_shared(key) else some[key][:0]
            assert empty[key].shape == expected.shape, key


OPTIONAL = {("KNNGraph", "edge_index"), ("TaxelPose", "x")}


@pytest.mark.parametrize(("make", "given"), ALL, ids=IDS)
def test_what_is_missing_is_named(make, given):
    transform = ready(make, given())
    for key in {"x", "pos", "normal", "tangent", "joint", "edge_index"} & {*transform.reads}:
        name = type(transform).__name__
        if (name, key) in OPTIONAL or getattr(transform, "attr", key) != key:
            continue
        data = given()
        del data[key]
        with pytest.raises(ValueError, match=rf"^{name} needs '{key}' \(got none\)"):
            transform(data)


@NOT_RANDOM
def test_what_is_not_random_gives_the_same_again(make, given):
    data = given()
    transform = ready(make, data)
    first, again = (transform(copy.copy(data)).to_dict() for _ in range(2))
    assert all(same(first[key], again[key]) for key in first)


@NOT_RANDOM
def test_only_what_is_per_frame_does_the_same_to_each_frame(make, given):
    data = windows()
    transform = ready(make, data)
    if isinstance(transform, transforms.TaxelForce):
        data.x = data.x[..., :3]  # it takes no windows
        data.num_frames = 1
    frames, whole = split_frames(data.x, data.num_frames), transform(copy.copy(data))
    outs = []
    for t in range(data.num_frames):
        data.x, data.num_frames = frames[:, :, t], 1
        try:
            outs.append(transform(copy.copy(data)))
        except ValueError:  # has a number for each frame, or needs more than one
            assert not transform.per_frame
            return
    x = join_frames(torch.stack([out.x for out in outs], dim=2))
    is_same = x.shape == whole.x.shape and torch.allclose(x, whole.x, 0, 1e-5, equal_nan=True)
    for key in {*transform.writes} - {"x"}:
        is_same = is_same and all(same(out.get(key), whole.get(key)) for out in outs)
    assert is_same == transform.per_frame


def test_of_what_is_random_only_noise_and_dead_taxels_are_per_frame():
    drawn = [make() for make, _ in ALL]
    found = {type(one).__name__ for one in drawn if one.is_random and one.per_frame}
    assert found == {"RandomNoise", "DropTaxels", "DropPatches"}


@pytest.mark.parametrize("shared", [True, False], ids=["one for all", "one each"])
@NOT_RANDOM
def test_step_of_an_exported_graph_does_what_the_transform_does(make, given, shared):
    data = given()
    transform = ready(make, data)
    if getattr(transform, "key", None) is not None:
        return  # a graph is given the rest of the session
    data.x[0, 1] = torch.nan
    data.x[1, 2, 3::4] = torch.nan
    if not shared:
        data.edge_attr = data.edge_attr.expand(8, -1, -1)
        data.dropped = torch.arange(48).view(8, 6) % 5 == 0
    known = data.index_select(slice(0, 1))
    if isinstance(transform, transforms.ContactCrop):
        with pytest.raises(NotImplementedError, match="the length of its windows depends on"):
            transform.graph_step(known, set())
        return
    for _ in range(2):  # the second time from what was kept of the first
        expected = transform(copy.copy(data)).to_dict()
        found = transform.graph_step(known, set())(copy.copy(data)).to_dict()
        assert found.keys() == expected.keys()
        for key, value in expected.items():
            value, other = torch.as_tensor(value), torch.as_tensor(found[key])
            assert torch.allclose(other.expand_as(value), value, 1e-5, 1e-5, equal_nan=True), key


@pytest.mark.parametrize("transform", DRAWN, ids=repr)
def test_what_is_random_draws(transform):
    assert transform.is_random
    data = StaticData(x=torch.ones(20, 6, 2), pos=grid(2, 3, pitch=0.01).pos)
    first, again = (transform(copy.copy(data)).x for _ in range(2))
    assert not first.equal(again)


def test_a_class_without_declarations_is_refused():
    with pytest.raises(TypeError, match=r"'per_frame' of Half must be declared, .*\(got none\)"):

        class Half(TactileTransform):
            reads = writes = ("x",)

            def forward(self, data):
                return data


class Fold(TactileTransform):
    """One class, and no other line anywhere: how far from the middle of a reading's range."""

    reads, writes, per_frame = ("x",), ("x",), True
    calls = 0

    def forward(self, data):
        type(self).calls += 1
        data.x = (data.x - 0.5).abs()
        return data


class Heights(TactileTransform):
    """Follows from what all samples share."""

    reads, writes, per_frame = ("pos",), ("edge_attr",), True
    calls = 0

    def forward(self, data):
        type(self).calls += 1
        source, target = data.edge_index
        data.edge_attr = (data.pos[..., source, 2:] - data.pos[..., target, 2:]).abs()
        return data


@pytest.fixture
def dataset():
    draw = torch.Generator().manual_seed(0)
    layout = grid(2, 3, pitch=0.01)
    x = torch.rand(12, 6, 2, generator=draw)
    y = torch.arange(12) % 2
    return StaticDataset.from_arrays(x, y, layout=layout, transform=Fold(), adjacency="original")


def test_a_new_transform_takes_all_samples_at_once(dataset):
    Fold.calls = 0
    folded = apply_transform(Fold(), dataset.data)
    assert Fold.calls == 1
    assert folded.x.shape == (12, 6, 2)


def test_a_new_transform_is_computed_once_in_a_predictor(dataset):
    predictor = Predictor(
        model_of(dataset), dataset.layout, transform=Heights(), adjacency="original"
    )
    Heights.calls = 0
    predictor(torch.rand(3, 6, 2))
    assert Heights.calls == 0  # the edges of all frames are known


def model_of(dataset):
    torch.manual_seed(0)
    return TaxelNet(dataset.layout, 2, in_channels=2, widths=(4,))


def test_a_new_transform_is_exported(dataset, tmp_path):
    onnxruntime = pytest.importorskip("onnxruntime", reason="needs the extra 'export'")
    pytest.importorskip("onnxscript", reason="needs the extra 'export'")
    from torch_geometric_tactile.predictor import export_onnx

    predictor = Predictor.from_dataset(model_of(dataset), dataset)
    export_onnx(predictor, tmp_path / "a.onnx")
    session = onnxruntime.InferenceSession(tmp_path / "a.onnx")
    frame = torch.rand(1, 6, 2)
    (found,) = session.run(["probability"], {"tactile": frame.numpy()})
    assert torch.allclose(torch.from_numpy(found), predictor(frame), atol=1e-5)


def test_a_new_transform_is_kept_in_a_file(dataset, tmp_path):
    predictor = Predictor.from_dataset(model_of(dataset), dataset)
    predictor.save(tmp_path / "a.predictor")
    again = Predictor.load(tmp_path / "a.predictor", transforms=[Fold()])
    frame = torch.rand(6, 2)
    assert again(frame).equal(predictor(frame))


def test_a_subclass_with_its_own_forward_declares_it_again():
    class Other(Fold):
        def forward(self, data):
            return data

    class Declared(Other):
        reads = ("x",)

        def forward(self, data):
            return data

    from torch_geometric_tactile.data._transform_rules import own_declaration

    assert own_declaration(Other(), "supports_static") is None
    assert own_declaration(Declared(), "supports_static") is True
