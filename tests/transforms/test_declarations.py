"""What transforms say of themselves holds, and is all that others ask of them."""

import copy

import pytest
import torch
from predictor.test_round_trip import windows
from transforms.test_transform_laws import ALL, EACH, ready, same

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
from torch_geometric_tactile.transforms import TactileTransform

NOT_RANDOM = pytest.mark.parametrize(
    ("make", "make_data"), [(make, make_data) for make, make_data in ALL if not make().is_random]
)
DRAWN = [
    transforms.DropTaxels(p=0.5),
    transforms.DropPatches(grid(2, 3, pitch=0.01), p=0.5),
    transforms.RandomGain(0.5),
    transforms.RandomNoise(0.5),
    transforms.RandomOffset(0.5),
]
PLACES = ("pos", "edge_index", "edge_attr", "edge_weight", "num_frames", "valid_frames")


@EACH
def test_only_what_is_declared_is_written(make, make_data):
    data = make_data()
    transform, before = ready(make, data), data.to_dict()
    after = transform(copy.copy(data)).to_dict()
    changed = {k for k in {*before, *after} if k not in after or not same(before.get(k), after[k])}
    assert changed <= {*transform.writes}


@EACH
def test_only_what_is_declared_is_read(make, make_data):
    data = make_data()
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


@NOT_RANDOM
def test_what_is_not_random_gives_the_same_again(make, make_data):
    data = make_data()
    transform = ready(make, data)
    first, again = (transform(copy.copy(data)).to_dict() for _ in range(2))
    assert all(same(first[key], again[key]) for key in first)


@NOT_RANDOM
def test_only_what_is_per_frame_does_the_same_to_each_frame(make, make_data):
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
def test_step_of_an_exported_graph_does_what_the_transform_does(make, make_data, shared):
    data = make_data()
    transform = ready(make, data)
    if getattr(transform, "key", None) is not None:
        return  # a graph is make_data the rest of the session
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
