import hashlib
import json
import math
import os
import pickle

import numpy as np
import pytest
import torch
from torch.nn import Linear, Module

from torch_geometric_tactile import Predictor
from torch_geometric_tactile.baselines import TemperatureScaling, flat_forest, rbf_svm
from torch_geometric_tactile.data import ContactRule, StaticData
from torch_geometric_tactile.datasets import RecordingFrames
from torch_geometric_tactile.io import read_recording
from torch_geometric_tactile.nn import TactileFNN
from torch_geometric_tactile.predictor import AverageModel, EstimatorModel, _content
from torch_geometric_tactile.predictor._plain_data import _check_state, load_weights
from torch_geometric_tactile.predictor._tensor_file import read_tensors, write_tensors
from torch_geometric_tactile.sensors import grid
from torch_geometric_tactile.transforms import SessionZScore, ZScore

LAYOUT = grid(2, 2, pitch=0.01)
X = torch.randn(6, 4, 3, generator=torch.Generator().manual_seed(0))
KEY = "torch_geometric_tactile.predictor"
SHA256 = "torch_geometric_tactile.sha256"


def predictor(model=None, transform=None):
    torch.manual_seed(0)
    model = TactileFNN(4, 2, widths=(5,), pools=(1,)) if model is None else model
    transform = ZScore().fit(StaticData(x=X)) if transform is None else transform
    return Predictor(model, LAYOUT, transform, ("soft", "hard"), num_channels=3)


@pytest.fixture
def path(tmp_path):
    predictor().save(tmp_path / "a.predictor")
    return tmp_path / "a.predictor"


def test_tensors_of_every_type_are_read_again(tmp_path):
    tensors = {
        f"a.{i}": torch.tensor([[0, 1, 1]]).to(dtype)
        for i, dtype in enumerate(
            [
                *(torch.bool, torch.uint8, torch.int8, torch.int16, torch.int32, torch.int64),
                *(torch.float16, torch.bfloat16, torch.float32, torch.float64),
            ]
        )
    }
    tensors |= {"none": torch.zeros(0, 3), "one": torch.tensor(2.5), "t": torch.rand(3, 2).t()}
    write_tensors(tensors, {"text": "Grüße"}, tmp_path / "a")
    found, texts, has_checksum = read_tensors(tmp_path / "a")
    assert has_checksum
    assert texts == {"text": "Grüße"}
    assert found.keys() == tensors.keys()
    for name, value in tensors.items():
        assert found[name].dtype == value.dtype
        assert found[name].equal(value)
    with pytest.raises(ValueError, match=r"'a' must be a dense tensor of .*got torch.complex64"):
        write_tensors({"a": torch.zeros(2, dtype=torch.complex64)}, {}, tmp_path / "b")
    assert not (tmp_path / "b").exists()


def test_the_file_is_in_the_format_of_safetensors(path):
    safetensors = pytest.importorskip("safetensors.torch")
    found, _, _ = read_tensors(path)
    for name, value in safetensors.load_file(path).items():
        assert found[name].equal(value)


def test_save_and_load_and_save_give_the_same_file(path, tmp_path):
    again = Predictor.load(path)
    assert repr(again) == repr(predictor())
    assert again(X).equal(predictor()(X))
    again.save(tmp_path / "b")
    assert (tmp_path / "b").read_bytes() == path.read_bytes()
    assert again.layout.matches(LAYOUT)
    with pytest.raises(ValueError, match=r"'reading' must have shape \(4, 3\)"):
        again(X[..., :2])


def test_an_adapted_session_is_saved(tmp_path):
    scaler = SessionZScore().fit(StaticData(x=X, session=torch.zeros(6)))
    adapted = predictor(transform=scaler)
    adapted.adapt(3 * X)
    adapted.save(tmp_path / "a")
    assert Predictor.load(tmp_path / "a")(X).equal(adapted(X))


def test_precision_of_the_weights_is_kept(tmp_path):
    double = predictor(TactileFNN(4, 2, widths=(5,), pools=(1,)).double())
    double.save(tmp_path / "a")
    again = Predictor.load(tmp_path / "a")
    assert again(X).dtype == torch.double
    assert again(X).equal(double(X))


@pytest.mark.parametrize(
    ("change", "kind"),
    [
        (lambda value: value.to(torch.complex64), "complex numbers of torch.complex64"),
        (lambda value: value.to(torch.int32), "integers of torch.int32"),
        (torch.Tensor.to_sparse, "a torch.sparse_coo tensor of torch.float32"),
    ],
    ids=["complex", "integers", "sparse"],
)
def test_weights_of_another_kind_are_refused(change, kind):
    model = predictor().model
    weights = {name: change(value) for name, value in model.state_dict().items()}
    with pytest.raises(ValueError, match=rf"must hold real numbers, like the model \(got {kind}\)"):
        load_weights(model, weights)


class Mine(Module):
    def __init__(self, width=2):
        super().__init__()
        self.lin = Linear(3, width)

    def forward(self, x, edge_index):
        return self.lin(x).mean(dim=1)


def test_a_model_of_ones_own_is_given_again(tmp_path):
    mine = predictor(Mine())
    mine.save(tmp_path / "a")
    given = Mine()
    before = given.lin.weight.clone()
    assert Predictor.load(tmp_path / "a", model=given)(X).equal(mine(X))
    assert given.lin.weight.equal(before)  # a copy has the weights
    with pytest.raises(
        ValueError, match=r"a' cannot be read as a predictor.*'model' must be given.*Mine"
    ):
        Predictor.load(tmp_path / "a")
    with pytest.raises(ValueError, match=r"'model' must be of class Mine \(got Linear\)"):
        Predictor.load(tmp_path / "a", model=Linear(3, 2))
    text = r"'model' must have 'lin.weight' of shape \(2, 3\), like the file \(got \(4, 3\)\)"
    with pytest.raises(ValueError, match=text):
        Predictor.load(tmp_path / "a", model=Mine(4))
    more = Mine()
    more.other = Linear(1, 1)
    with pytest.raises(ValueError, match=r"\('other.weight': model only\)"):
        Predictor.load(tmp_path / "a", model=more)


def changed(path, change):
    """The file with another header: change(header of the file, header of the predictor)."""
    content = path.read_bytes()
    length = int.from_bytes(content[:8], "little")
    header = json.loads(content[8 : 8 + length])
    inner = json.loads(header["__metadata__"][KEY])
    change(header, inner)
    if KEY in header["__metadata__"]:
        header["__metadata__"][KEY] = json.dumps(inner)
    digest = header["__metadata__"].get(SHA256, "none")
    zeros = json.dumps(header).replace(digest, "0" * 64).encode()
    start, data = len(zeros).to_bytes(8, "little"), content[8 + length :]
    text = zeros.replace(b"0" * 64, hashlib.sha256(start + zeros + data).hexdigest().encode(), 1)
    path.write_bytes(start + text + data)
    return path


GONE = object()
PROBABILITY = "its threshold must be a probability"
CONTACT = ContactRule(5.0).to_dict()
HOSTILE = [  # a place in the header of the predictor, what it becomes, and the error
    ("format", 99, "its format must be 3 .got 99"),
    ("format", GONE, "its format must be 3 .got None"),
    ("task", "x", "its task must be one of"),
    ("threshold", 1.001, PROBABILITY),
    ("threshold", -0.001, PROBABILITY),
    ("threshold", "0.5", PROBABILITY),
    ("", {"threshold": 0.5, "task": "multilabel"}, PROBABILITY),
    ("window", [3], "a window must have 'length', 'hop' and 'ragged'"),
    ("window", {"length": 10**12, "hop": 1, "ragged": "error"}, "'length' must be a number of fr"),
    ("read_options", {"allow_large": True}, r"its 'read_options' .* \(got 'allow_large': True\)"),
    ("read_options", {"tactile": "(a+)+"}, "names as lists of texts .*got 'tactile': "),
    ("read_options", ["tactile"], "must be a mapping"),
    ("read_options", {"joint": [1]}, "got 'joint'"),
    ("read_options", {"num_channels": True}, "got 'num_channels': True"),
    ("file_names", {"form": "(a+)+{y}", "target": "y"}, r"its 'file_names' must be plain .*a\+"),
    ("file_names", {"form": "{a}{b}{c}{d}{e}{y}", "target": "y"}, "with up to 5 names in braces"),
    ("file_names", {"form": "{y}" + "_" * 200, "target": "y"}, "its 'file_names' must be plain"),
    ("file_names", {"form": "{x}_{trial}", "target": "y"}, "including the target"),
    ("file_names", {"form": 3, "target": "y"}, "its 'file_names' must be plain text"),
    ("file_names", {"form": "{y}"}, "its 'file_names' must have 'form' and 'target'"),
    ("layout", GONE, "KeyError: 'layout'"),
    ("layout.taxels", [], "at least one taxel"),
    ("layout.taxels.3", GONE, "'pos' must have shape|joins?"),
    ("model.class", "os.system", "there is no model 'os.system' in this version"),
    ("model.arguments.spam", 1, "model 'TactileFNN' rejects its arguments"),
    ("model.arguments.widths", [10**7], "must not be larger than its weights in the file"),
    ("model.arguments.widths", [10**15], "cannot be read as a predictor"),
    ("model.arguments.widths", [6], r"'model' must have 'head.* of shape \(5"),
    ("transform.class", "builtins.exec", "there is no transform 'builtins.exec'"),
    ("transform", {"class": "Compose", "arguments": {"transforms": [3.0]}}, r"forms \(got 3.0\)"),
    ("transform.state.scale", 1.0, "the state of ZScore"),
    ("transform.state.scale", {"$tensor": "x"}, "it must hold the tensor 'x'"),
    ("contact", 5, "'contact' must have"),
    ("contact", {**CONTACT, "more": 1}, "'contact' must have"),
    ("contact", {**CONTACT, "threshold": 0}, "'threshold' must be a positive"),
    ("contact", {**CONTACT, "rest": [[0.0] * 3] * 5}, "'rest' of the contact rule must have shape"),
    ("contact", {**CONTACT, "rest": [[{}]]}, "'rest' must be lists of numbers"),
    ("contact", {**CONTACT, "noise": [[1.0]]}, "'noise' must have the shape of 'rest'"),
]
HOSTILE_TENSORS = [  # the same of the header of the file: of its first tensor, or of all
    ({"dtype": "OBJECT"}, "must have a dtype"),
    ({"shape": [-1]}, "must have a dtype, a shape"),
    ({"shape": [10**9, 10**9]}, "must have its .* bytes in the file"),
    ({"shape": [0, 2**62, 2**62], "data_offsets": [0, 0]}, "cannot be read as a predictor"),
    (lambda h: shift(first(h)), "damaged or truncated|must fill it"),
    (lambda h: h.update(dict.fromkeys("abc", first(h))), "its tensors must fill it"),
    (lambda h: h.update(a=3), "'a' must have a JSON object"),
    (lambda h: h["__metadata__"].clear(), "it was not written by Predictor.save"),
]


def put(header, place, value):
    *path, last = (int(key) if key.isdigit() else key for key in place.split("."))
    for key in path:
        header = header[key]
    if value is GONE:
        del header[last]
    elif last:
        header[last] = value
    else:
        header.update(value)


def first(header):
    return next(entry for name, entry in header.items() if name != "__metadata__")


def shift(entry):
    size = math.prod(entry["shape"]) * 8
    entry["data_offsets"] = [10**9, 10**9 + size]


def assert_is_refused(path, text):
    with pytest.raises(ValueError, match=text) as caught:
        Predictor.load(path)
    assert str(caught.value).startswith(f"'{path}' cannot be read as a predictor: ")


@pytest.mark.parametrize(("place", "value", "text"), HOSTILE)
def test_hostile_headers_are_refused(path, place, value, text):
    assert_is_refused(changed(path, lambda header, inner: put(inner, place, value)), text)


@pytest.fixture(scope="module")
def estimators(tmp_path_factory):
    """A forest, and a machine of three classes."""
    folder = tmp_path_factory.mktemp("estimators")
    rows, y = X.repeat(3, 1, 1) + torch.arange(18.0).view(18, 1, 1), [0, 1, 2] * 6
    machine = rbf_svm(C=10.0)
    machine.steps[-1] = ("machine", TemperatureScaling(machine[-1]))
    for name, pipeline in (("forest", flat_forest(num_trees=3)), ("machine", machine)):
        model = EstimatorModel.of(pipeline.fit(rows.numpy(), y), 3)
        Predictor(model, LAYOUT, class_names="abc", num_channels=3).save(folder / name)
    return folder


STEP = "model.arguments.steps.1"
OF_ESTIMATORS = [
    ("forest", "model.arguments.steps", [], "'steps' must be features and a model"),
    ("forest", "model.arguments.steps", {"a": 1}, "'steps' must be features and a model"),
    ("forest", "model.arguments.steps.0.step", "os.system", "the first step must be one of Readi"),
    ("forest", f"{STEP}.step", "eval", "a step must be one of Affine, Linear"),
    ("forest", f"{STEP}.spam", 1, "model 'EstimatorModel' rejects its arguments"),
    ("forest", f"{STEP}.roots", [1, 2], "'roots' must be a tensor with 1 dimensions"),
    ("forest", f"{STEP}.num_features", 1, "'feature' must be from 0 to 0"),
    ("forest", f"{STEP}.num_features", 10**30, "cannot be read as a predictor"),
    ("forest", f"{STEP}.num_features", "12", "'num_features' must hold whole numbers"),
    ("forest", f"{STEP}.left", {"$tensor": "tensor.0"}, "'left' must be a tensor with 1 dim"),
    ("forest", "model.arguments.steps.2.num_classes", 2, "'classes' must increase and be below 2"),
    ("forest", "model.arguments.steps.2.num_classes", 10**9, "'num_classes' must be at most"),
    ("forest", "model.arguments.steps.2.classes", [0, -1, 2], "'classes' must hold whole numbers"),
    ("forest", "model.arguments.steps.2.classes", [0, 2], "Logits must take 3 numbers .got 2"),
    ("machine", f"{STEP}.counts", [1, 2, 10**9], "'counts' must add up to"),
    ("machine", f"{STEP}.counts", [0.5], "'counts' must hold whole numbers"),
    ("machine", f"{STEP}.vectors", GONE, "model 'EstimatorModel' rejects its argume"),
    ("machine", "model.arguments.steps.2.bias", {"$tensor": "tensor.0"}, "'bias' must be a tensor"),
    ("machine", "model.arguments.steps.3.factor", "x", "cannot be read as a predictor"),
    ("machine", "model.arguments.steps.3.factor", -1.0, "'factor' must be above 0"),
    ("forest", "score", {"mean": 1.0}, "a score must have model, metric, mean"),
    ("forest", "score", 3, "a score must have"),
]


@pytest.mark.parametrize(("name", "place", "value", "text"), OF_ESTIMATORS)
def test_hostile_numbers_of_estimators_are_refused(estimators, tmp_path, name, place, value, text):
    path = tmp_path / "a.predictor"
    path.write_bytes((estimators / name).read_bytes())
    Predictor.load(path)
    assert_is_refused(changed(path, lambda header, inner: put(inner, place, value)), text)


def test_trees_without_end_are_refused(estimators, tmp_path):
    tensors, texts, _ = read_tensors(estimators / "forest")
    header = json.loads(texts[KEY])
    name = header["model"]["arguments"]["steps"][1]["right"]["$tensor"]
    before = tensors[name].clone()
    tensors[name][1:3] = 0  # back to the root
    write_tensors(tensors, texts, tmp_path / "a")
    assert_is_refused(tmp_path / "a", "'left' and 'right' must come after their parent")
    tensors[name] = before.clone()
    tensors[name][0] = len(before)
    write_tensors(tensors, texts, tmp_path / "a")
    assert_is_refused(tmp_path / "a", f"'right' must be from 0 to {len(before) - 1}")


def test_models_within_models_are_built_by_name_only(tmp_path):
    average = AverageModel([TactileFNN(4, 2, widths=(5,), pools=(1,)) for _ in range(2)])
    predictor(average).save(tmp_path / "a")
    assert Predictor.load(tmp_path / "a")(X).equal(predictor(average)(X))
    inner = "model.arguments.models.0.$model"
    for place, value, text in (
        (f"{inner}.class", "os.system", "there is no model 'os.system'"),
        (
            inner,
            {"own": "Mine", "text": "x"},
            "'model' must be given: .* 'Mine' cannot be built",
        ),
        (f"{inner}.arguments.widths", [10**7], "must not be larger than its weights in the file"),
        ("model.arguments.models", [3.0], "'models' must hold at least one model"),
    ):
        predictor(average).save(tmp_path / "b")
        hostile = changed(tmp_path / "b", lambda header, whole, p=place, v=value: put(whole, p, v))
        assert_is_refused(hostile, text)


@pytest.mark.parametrize(("change", "text"), HOSTILE_TENSORS)
def test_hostile_headers_of_tensors_are_refused(path, change, text):
    if isinstance(change, dict):
        changed(path, lambda header, inner: first(header).update(change))
    else:
        changed(path, lambda header, inner: change(header))
    assert_is_refused(path, text)


def test_damaged_files_are_refused(path):
    content = path.read_bytes()
    for cut in (0, 4, 8, 100, len(content) // 2, len(content) - 1):
        path.write_bytes(content[:cut])
        with pytest.raises(ValueError, match="cannot be read as a predictor"):
            Predictor.load(path)
    path.write_bytes(content + b"x")
    with pytest.raises(ValueError, match="it differs from its checksum"):
        Predictor.load(path)
    changed(path, lambda h, p: None)  # with the checksum of the longer file
    with pytest.raises(ValueError, match="its tensors must fill it"):
        Predictor.load(path)
    path.write_bytes((2**40).to_bytes(8, "little") + content[8:])
    with pytest.raises(ValueError, match="it has no header"):
        Predictor.load(path)
    deep = b"[" * 100_000
    path.write_bytes(len(deep).to_bytes(8, "little") + deep)
    with pytest.raises(ValueError, match="its header is not JSON"):
        Predictor.load(path)
    path.write_bytes(bytes(1000))
    with pytest.raises(ValueError, match="its header is not JSON"):
        Predictor.load(path)


def test_every_flipped_bit_of_a_small_file_is_refused(tmp_path):
    tensors = {"a": torch.arange(3.0), "b": torch.tensor([1, 2])}
    write_tensors(tensors, {"text": "0" * 64}, tmp_path / "a")
    content = (tmp_path / "a").read_bytes()
    for place in range(0, 8 * len(content), 11):
        flipped = bytearray(content)
        flipped[place // 8] ^= 1 << place % 8
        (tmp_path / "b").write_bytes(flipped)
        try:
            found = read_tensors(tmp_path / "b")
        except ValueError:
            continue
        # One that hides the checksum changes nothing else, and Predictor.load misses it.
        assert not found.has_checksum, place
        assert found.tensors["a"].equal(tensors["a"])


def test_a_checksum_is_missed_and_not_needed_by_older_files(path, caplog):
    def hide(header, inner):
        header["__metadata__"]["other"] = header["__metadata__"].pop(SHA256)

    changed(path, hide)
    with pytest.raises(ValueError, match=r"it must have a checksum \(got none\)"):
        Predictor.load(path)
    changed(path, lambda header, inner: inner.update(format=1))
    assert Predictor.load(path)(X).equal(predictor()(X))
    (record,) = caplog.records
    assert record.getMessage() == f"'{path}' has no checksum: save it again with this version"


class Attack:
    def __reduce__(self):
        return os.mkdir, ("attacked",)


def test_pickles_are_not_run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a").write_bytes(pickle.dumps(Attack()))
    torch.save({"predictor": Attack()}, tmp_path / "b")
    for name in ("a", "b"):
        with pytest.raises(ValueError, match=rf"'{name}' "):
            Predictor.load(name)
        with pytest.raises(ValueError, match=rf"'{name}' cannot be read as a checkpoint"):
            Predictor.from_checkpoint(name)
    assert not (tmp_path / "attacked").exists()


def test_missing_files_are_named(tmp_path):
    with pytest.raises(
        FileNotFoundError, match=r"there is no predictor or checkpoint '.*a': give the"
    ):
        Predictor.load(tmp_path / "a")
    with pytest.raises(FileNotFoundError, match=r"the checkpoint .* does not exist"):
        Predictor.from_checkpoint(tmp_path / "a")
    torch.save({"state_dict": {}}, tmp_path / "b")
    with pytest.raises(ValueError, match=r"is a checkpoint: read it with Predictor\.from_"):
        Predictor.load(tmp_path / "b")
    with pytest.raises(ValueError, match=r"it contains no predictor: .*train again"):
        Predictor.from_checkpoint(tmp_path / "b")


def test_a_state_that_is_no_tensor_is_refused(tmp_path):
    class Extra(Mine):
        def get_extra_state(self):
            return "text"

    with pytest.raises(ValueError, match=r"'model' must have tensors only .*_extra_state"):
        predictor(Extra()).save(tmp_path / "a")
    assert not (tmp_path / "a").exists()


@pytest.mark.parametrize(("key", "least"), [("num_channels", 1), ("num_joints", 0)])
@pytest.mark.parametrize("number", [[0], "3", 1.5, True, -1, 100_001])
def test_a_header_with_other_than_numbers_of_channels(path, key, least, number):
    preparation, network = _content.load(path)
    header, tensors = _content.describe_predictor(preparation, network)
    weights = network.model.state_dict()
    for allowed in (least, 100_000, None):
        _content.build_predictor({**header, key: allowed}, tensors, weights)
    message = f"its '{key}' must be a number from {least} to 100000 or null"
    for refused in (number, least - 1):
        with pytest.raises(ValueError, match=message):
            _content.build_predictor({**header, key: refused}, tensors, weights)


@pytest.mark.parametrize("threshold", [0.0, 1.0])
def test_thresholds_from_zero_to_one_are_kept(threshold, tmp_path):
    Predictor(predictor().model, LAYOUT, threshold=threshold).save(tmp_path / "a")
    assert Predictor.load(tmp_path / "a").threshold == threshold


def test_a_scaler_that_was_never_fitted_is_no_part_of_a_predictor():
    with pytest.raises(ValueError, match=r"'ZScore\(\)' must be fitted before it is part"):
        Predictor(Linear(4, 2), grid(2, 2, 0.01), ZScore())


def test_weights_of_two_precisions_are_refused_where_the_model_has_one():
    model = torch.nn.Sequential(Linear(2, 3), Linear(3, 1))
    weights = {name: value.double() for name, value in model.state_dict().items()}
    load_weights(model, weights)
    assert model[1].weight.dtype == torch.double
    with pytest.raises(ValueError, match=r"one precision, .*\['torch.float32', 'torch.float64'\]"):
        load_weights(model, {**weights, "1.bias": torch.zeros(1)})
    mixed = torch.nn.Sequential(Linear(2, 3), Linear(3, 1).double())
    load_weights(mixed, mixed.state_dict())
    assert mixed[0].weight.dtype == torch.float


@pytest.mark.parametrize(
    ("scaler", "shape"),
    [
        (ZScore(), (1, 4)),
        (ZScore(), (1,)),
        (ZScore(per="channel"), (1, 3)),
        (ZScore(attr="joint", per="channel"), (1,)),
    ],
)
def test_state_of_a_scaler_with_too_few_dimensions(scaler, shape):
    state = {"center": torch.zeros(shape), "scale": torch.ones(shape), "key_values": torch.zeros(1)}
    with pytest.raises(ValueError, match=r"must have a centre and a scale for each key"):
        _check_state(scaler, state)
    more = (*shape, *[2] * (3 - len(shape)))
    _check_state(scaler, {**state, "center": torch.ones(more), "scale": torch.ones(more)})


def test_a_scaler_of_other_joints_than_the_header_says_is_refused():
    scaler = ZScore(attr="joint").fit(StaticData(x=torch.zeros(3, 4, 1), joint=torch.rand(3, 5)))
    predictor = Predictor(Linear(4, 2), grid(2, 2, 0.01), scaler, num_joints=5)
    header, tensors = _content.describe_predictor(predictor.preparation, predictor.network)
    weights = predictor.model.state_dict()
    _content.build_predictor(header, tensors, weights, model=Linear(4, 2))
    with pytest.raises(ValueError, match=r"fitted on 4 joints, as 'num_joints' says \(got 5\)"):
        _content.build_predictor({**header, "num_joints": 4}, tensors, weights, model=Linear(4, 2))


def test_form_of_csv_files_is_kept(tmp_path):
    options = {"decimal": ",", "preamble": 1, "unit_row": True, "missing": ["NA", -1, 0.5]}
    (tmp_path / "a_1.csv").write_text("Glove\ntime;p\ns;N\n0;1,5\n1;NA\n")
    (tmp_path / "b_2.csv").write_text("Glove\ntime;p\ns;N\n0;-1\n1;2\n")
    frames = RecordingFrames(tmp_path, layout=grid(1, 1, 0.01), read_options=options)
    predictor = Predictor.from_dataset(
        TactileFNN(1, 2, channels={"tactile": 1}, widths=(2,), pools=(1,)), frames
    )
    predictor.save(tmp_path / "a.predictor")
    loaded = Predictor.load(tmp_path / "a.predictor")
    assert {key: loaded.read_options[key] for key in options} == options
    recording = read_recording(tmp_path / "a_1.csv", **loaded.read_options)
    np.testing.assert_array_equal(recording.tactile, [[[1.5]], [[np.nan]]])
