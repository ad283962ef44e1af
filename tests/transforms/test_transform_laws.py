"""Laws of all transforms. The examples of every transform are in
``tests/predictor/test_round_trip.py``, which fails if a public transform lacks one."""

import copy
import pickle

import pytest
import torch
from predictor.test_round_trip import GRID, HAND, LAYOUT, OURS, WINDOWED, samples, windows

from torch_geometric_tactile import transforms
from torch_geometric_tactile.testing import assert_transform_static_equals_batched
from torch_geometric_tactile.transforms import FittedTransform

ALL = [(make, samples) for makes in OURS.values() for make in makes]
ALL += [(make, windows) for makes in WINDOWED.values() for make in makes]
IDS = [f"{make()!r}".replace("\n", "") for make, _ in ALL]
EACH = pytest.mark.parametrize(("make", "make_data"), ALL, ids=IDS)
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


def converted(data, dtype):
    """The samples with all their numbers that are not whole in one type."""
    for key, value in data.to_dict().items():
        if isinstance(value, torch.Tensor) and value.is_floating_point():
            data[key] = value.to(dtype)
    return data


@pytest.mark.parametrize("shared", [True, False], ids=["one for all", "one each"])
@pytest.mark.parametrize("dtype", [torch.float, torch.double])
@EACH
def test_samples_are_transformed_alike_alone_together_and_in_a_batch(
    make, make_data, dtype, shared
):
    data = converted(make_data(), dtype)
    transform = ready(make, data)
    data.x[0, 1] = torch.nan
    data.x[1, 2, 3::4] = torch.nan
    if not shared:
        keys = {"normal", "tangent", "edge_attr"}
        keys |= set() if isinstance(transform, transforms.KNNGraph) else {"pos"}
        for key in keys:
            factor = torch.arange(1, 9, dtype=dtype).view(8, *[1] * data[key].dim())
            data[key] = data[key] * factor
    for num_samples in (1, 5, 6):  # six samples of six taxels
        part = data.index_select(slice(0, num_samples))
        atol = 1e-6 if dtype == torch.float else 1e-12
        assert_transform_static_equals_batched(transform, part, atol)


@EACH
def test_what_follows_from_shared_attributes_is_shared(make, make_data):
    data = make_data()
    transform = ready(make, data)
    if not all(data.is_shared(key) for key in transform.reads if key in data):
        return
    out = transform(data)
    assert all(out.is_shared(key) for key in transform.writes if key in out), out


@EACH
def test_numbers_keep_their_type(make, make_data):
    for dtype in (torch.float, torch.double):
        data = converted(make_data(), dtype)
        transform = ready(make, data)
        out = transform(data)
        values = [getattr(out, key, None) for key in transform.writes]
        floats = [v for v in values if isinstance(v, torch.Tensor) and v.is_floating_point()]
        assert {value.dtype for value in floats} <= {dtype}


@EACH
def test_whole_counts_are_transformed_as_numbers(make, make_data):
    data = make_data()
    data.x = (100 * data.x).round()
    transform = ready(make, data)
    counts = copy.copy(data)
    counts.x = data.x.long()
    expected, out = transform(data), transform(counts)
    for key in {*transform.writes} & {*expected.keys()}:
        assert same(torch.as_tensor(out[key]).float(), torch.as_tensor(expected[key]).float()), key


@EACH
def test_pickles_and_copies_do_the_same(make, make_data):
    data = make_data()
    transform = ready(make, data)
    expected = transform(copy.copy(data)).to_dict()
    for again in (pickle.loads(pickle.dumps(transform)), copy.deepcopy(transform)):
        assert repr(again) == repr(transform)
        out = again(copy.copy(data)).to_dict()
        assert out.keys() == expected.keys()
        assert all(same(out[key], expected[key]) for key in expected)


@EACH
def test_the_caller_keeps_its_data(make, make_data):
    data = make_data()
    data.x[0, 1] = torch.nan
    data.dropped = torch.zeros(8, 6, dtype=torch.bool)
    before = copy.deepcopy(data.to_dict())
    ready(make, data)(data)
    assert {*data.keys()} == {*before}
    assert all(same(data[key], value) for key, value in before.items())


@EACH
def test_no_samples_stay_none(make, make_data):
    data = make_data()
    transform, indices = ready(make, data), torch.empty(0, dtype=torch.long)
    whole, empty = transform(copy.copy(data)), transform(data.index_select(indices))
    for key in transform.writes:
        if isinstance(getattr(whole, key, None), torch.Tensor):
            expected = whole[key] if whole.is_shared(key) else whole[key][:0]
            assert empty[key].shape == expected.shape, key


OPTIONAL = {("KNNGraph", "edge_index"), ("TaxelPose", "x")}


@EACH
def test_what_is_missing_is_named(make, make_data):
    transform = ready(make, make_data())
    for key in {"x", "pos", "normal", "tangent", "joint", "edge_index"} & {*transform.reads}:
        name = type(transform).__name__
        if (name, key) in OPTIONAL or getattr(transform, "attr", key) != key:
            continue
        data = make_data()
        del data[key]
        with pytest.raises(ValueError, match=rf"^{name} needs '{key}' \(got none\)"):
            transform(data)
