"""Every estimator of the package says the same as a predictor, through its file and as a graph."""

import numpy as np
import pytest
import torch
from sklearn.ensemble import ExtraTreesClassifier, ExtraTreesRegressor
from sklearn.linear_model import LinearRegression, LogisticRegression
from sklearn.naive_bayes import GaussianNB
from sklearn.neighbors import KNeighborsClassifier
from sklearn.pipeline import Pipeline, make_pipeline
from sklearn.preprocessing import FunctionTransformer, MinMaxScaler, StandardScaler
from sklearn.svm import SVC
from torch_geometric.transforms import Compose

from torch_geometric_tactile import Predictor, baselines
from torch_geometric_tactile.baselines import TemperatureScaling, flat_forest, rbf_svm
from torch_geometric_tactile.data import StaticData, StaticDataset, apply_transform
from torch_geometric_tactile.predictor import EstimatorModel, estimator_predictor, export_onnx
from torch_geometric_tactile.sensors import TaxelLayout, grid
from torch_geometric_tactile.transforms import FillMissing, ZScore, fit_transform

PLAIN = grid(3, 4, pitch=0.01)
LAYOUT = TaxelLayout(
    "skin",
    pos=PLAIN.pos,
    normal=torch.nn.functional.normalize(PLAIN.pos + 0.01, dim=1),
    patch=torch.arange(12) % 3,
    patch_names=("a", "b", "c"),
)
NAMES = {
    "flat_forest": {"num_trees": 20},
    "descriptor_forest": {"num_trees": 20},
    "descriptor_svm": {"C": 100.0},
    "posed_forest": {"num_trees": 20},
    "posed_ridge": {},
    "linear_svm": {"C": 0.1},
    "rbf_svm": {"C": 100.0, "width": 0.3},
    "signal_svm": {"num_channels": 2},
    "constant": {},
}
BALANCED = {"class_weight": "balanced"}


def dataset(classes=3, num_frames=None, seed=0, **more):
    """Presses of noise: of class c, taxel c feels more."""
    draw = torch.Generator().manual_seed(seed)
    y = torch.arange(120) % max(classes, 2)
    x = 300 + 20 * torch.randn(120, 12, 2 * (num_frames or 1), generator=draw)
    x[torch.arange(120), y] += 25
    if not classes:
        y = torch.stack([x[:, 0, 0], 1e-3 * x[:, 1, 1]], dim=1)
    data = StaticData(x=x, y=y, pos=LAYOUT.pos, trial=torch.arange(120) // 4, **more)
    if num_frames is not None:
        data.num_frames = num_frames
    names = {} if not classes else {"class": [f"class {i}" for i in range(classes)]}
    return StaticDataset._from_samples((data, names), LAYOUT, None, None, None)


def fitted(name, samples, transform=None, task="multiclass", **more):
    """The pipeline, what it says of the samples, and the fitted transform."""
    layout = {"layout": LAYOUT} if name.startswith(("posed", "descriptor")) else {}
    pipeline = getattr(baselines, name)(task=task, **layout, **NAMES[name], **more)
    open_states = [k for k, v in pipeline.get_params().items() if k.endswith("random_state")]
    pipeline.set_params(**dict.fromkeys(open_states, 0))
    if task == "multiclass" and not hasattr(pipeline, "predict_proba"):
        *first, (last, model) = pipeline.steps
        pipeline = Pipeline([*first, (last, TemperatureScaling(model))])
    seen = fit_transform(transform, samples.data)
    return pipeline.fit(seen, samples.data.y.numpy()), seen


def scaled(**more):
    return Compose([ZScore(scale_per="channel", **more), FillMissing()])


def said_by(predictor, samples):
    return predictor(samples.data.x).double().numpy()


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("classes", [2, 3])
def test_probabilities_and_labels_are_those_of_scikit_learn(name, classes, tmp_path):
    num_frames = 6 if name == "signal_svm" else None
    samples = dataset(classes, num_frames)
    transform = None if name.startswith("posed") else scaled()
    pipeline, _ = fitted(name, samples, transform, **({} if name == "constant" else BALANCED))
    predictor = estimator_predictor(pipeline, samples, transform)
    predictor.save(tmp_path / "a")
    again = Predictor.load(tmp_path / "a")
    again.save(tmp_path / "b")
    assert (tmp_path / "b").read_bytes() == (tmp_path / "a").read_bytes()
    others = dataset(classes, num_frames, seed=1)
    seen = others.data if transform is None else apply_transform(transform, others.data)
    expected = pipeline.predict_proba(seen)
    found = said_by(again, others)
    np.testing.assert_allclose(found, expected, atol=1e-6)
    assert found.tolist() == said_by(predictor, others).tolist()
    labels = [f"class {i}" for i in pipeline.predict(seen)]
    assert [label for (label,) in again.labels(torch.from_numpy(found))] == labels


@pytest.mark.parametrize("name", NAMES)
def test_numbers_are_those_of_scikit_learn(name, tmp_path):
    num_frames = 6 if name == "signal_svm" else None
    samples = dataset(0, num_frames)
    transform = None if name.startswith("posed") else scaled()
    pipeline, _ = fitted(name, samples, transform, "regression")
    estimator_predictor(pipeline, samples, transform).save(tmp_path / "a")
    others = dataset(0, num_frames, seed=1)
    seen = others.data if transform is None else apply_transform(transform, others.data)
    found = said_by(Predictor.load(tmp_path / "a"), others)
    expected = pipeline.predict(seen).reshape(found.shape)
    np.testing.assert_allclose(found, expected, rtol=2e-6, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[pytest.mark.full] * (name not in ("flat_forest", "rbf_svm")))
        for name in NAMES
    ],
)
@pytest.mark.parametrize(
    "task",
    [
        pytest.param("two", marks=pytest.mark.full),
        "three",
        pytest.param("numbers", marks=pytest.mark.full),
    ],
)
def test_exported_graphs_say_what_predictors_say(name, task, tmp_path):
    onnxruntime = pytest.importorskip("onnxruntime", reason="needs the extra 'export'")
    pytest.importorskip("onnxscript", reason="needs the extra 'export'")
    num_frames = 6 if name == "signal_svm" else None
    samples = dataset({"two": 2, "three": 3, "numbers": 0}[task], num_frames)
    transform = None if name.startswith("posed") else scaled()
    kind = "regression" if task == "numbers" else "multiclass"
    pipeline, _ = fitted(name, samples, transform, kind)
    predictor = estimator_predictor(pipeline, samples, transform)
    exported = export_onnx(
        predictor, tmp_path / "a.onnx", num_channels=None if not num_frames else 12
    )
    assert exported.difference <= 1e-5
    assert exported.metadata["model"] == "EstimatorModel"
    session = onnxruntime.InferenceSession(tmp_path / "a.onnx")
    x = samples.data.x[:10]
    found = [session.run(["probability"], {"tactile": one[None].numpy()})[0][0] for one in x]
    np.testing.assert_allclose(found, predictor(x).numpy(), rtol=1e-5, atol=1e-5)


def test_missing_readings_are_as_in_scikit_learn():
    samples = dataset()
    for name in ("flat_forest", "descriptor_svm", "posed_forest"):
        pipeline, _ = fitted(name, samples)
        x = samples.data.x.clone()
        x[::3, 4] = torch.nan
        expected = pipeline.predict_proba(StaticData(x=x))
        found = estimator_predictor(pipeline, samples)(x).numpy()
        np.testing.assert_allclose(found, expected, atol=1e-6)


@pytest.mark.parametrize("name", ["posed_ridge", "descriptor_svm"])
def test_taxels_that_move_are_where_they_are(name):
    draw = torch.Generator().manual_seed(2)
    around = torch.randn(120, 12, 3, generator=draw)
    places = {
        "pos": LAYOUT.pos + 0.01 * around,
        "normal": torch.nn.functional.normalize(around, dim=2),
        "tangent": torch.randn(120, 12, 2, 3, generator=draw),
    }
    samples = dataset()
    data = StaticData(x=torch.randn(120, 12, 3, generator=draw), y=samples.data.y, **places)
    moving = StaticDataset._from_samples(
        (data, {"class": list(samples.class_names)}), LAYOUT, None, None, None
    )
    pipeline, seen = fitted(name, moving)
    expected = pipeline.predict_proba(seen)
    fixed = StaticData(x=data.x)
    assert not np.allclose(pipeline.predict_proba(fixed), expected, atol=1e-3)
    predictor = estimator_predictor(pipeline, moving)
    prepared = predictor.preparation.apply_sample_transforms(data)
    found = predictor.probability(predictor.logits(prepared))
    np.testing.assert_allclose(found.numpy(), expected, atol=1e-6)


def test_classes_that_the_training_part_lacks_are_not_told():
    samples = dataset(4)
    some = samples[samples.data.y != 2]
    pipeline, _ = fitted("rbf_svm", some)
    found = estimator_predictor(pipeline, samples)(samples.data.x).numpy()
    assert found.shape == (120, 4)
    assert found[:, 2].max() < 1e-20
    expected = pipeline.predict_proba(samples.data.x.numpy())
    np.testing.assert_allclose(found[:, [0, 1, 3]], expected, atol=1e-6)


@pytest.mark.parametrize("classes", [2, 3])
@pytest.mark.parametrize("model", [ExtraTreesClassifier(9), LogisticRegression(max_iter=1000)])
def test_other_classifiers_behind_the_features_are_taken(model, classes):
    samples = dataset(classes)
    x, y = samples.data.x.numpy(), samples.data.y.numpy()
    pipeline = make_pipeline(baselines.FlatReadings(), StandardScaler(), model).fit(x, y)
    found = estimator_predictor(pipeline, samples)(samples.data.x).numpy()
    np.testing.assert_allclose(found, pipeline.predict_proba(x), atol=1e-6)


@pytest.mark.parametrize("model", [ExtraTreesRegressor(9), LinearRegression()])
def test_other_regressors_behind_the_features_are_taken(model):
    samples = dataset(0)
    x, y = samples.data.x.numpy(), samples.data.y.numpy()
    pipeline = make_pipeline(baselines.FlatReadings(), model).fit(x, y)
    found = estimator_predictor(pipeline, samples)(samples.data.x).numpy()
    np.testing.assert_allclose(found, pipeline.predict(x), rtol=1e-4, atol=1e-6)


def refused(pipeline, text, num_classes=2):
    with pytest.raises(ValueError, match=text):
        EstimatorModel.of(pipeline, num_classes)


def test_what_has_no_such_form_is_refused():
    x, y = dataset(2).data.x.numpy(), np.arange(120) % 2
    refused(flat_forest(), "not fitted|is not fitted yet")
    scores_only = "_SubsampledSVC, which has only scores.: wrap it in TemperatureScaling"
    refused(rbf_svm().fit(x, y), scores_only)
    refused(baselines.GraspSVM(num_fingers=2).fit(x, y), r"must be a pipeline .* \(got GraspSVM\)")
    flat = ("flat", baselines.FlatReadings())
    for parts, text in (
        ([flat, ("a", KNeighborsClassifier())], r"only a forest, .* \(got KNeighborsClassifier\)"),
        ([flat, ("s", MinMaxScaler()), ("a", GaussianNB())], "must be StandardScaler"),
        ([flat, ("a", TemperatureScaling(SVC(kernel="poly")))], r"must be 'rbf' .* \(got 'poly'\)"),
        ([flat, ("a", LogisticRegression(solver="liblinear"))], "must not be 'liblinear'"),
        ([("p", FunctionTransformer(rows)), ("a", GaussianNB())], "must begin with FlatReadings"),
    ):
        refused(Pipeline(parts).fit(x, y), text)


def rows(x):
    return x.reshape(len(x), -1)


def test_other_readings_than_those_of_the_fit_are_refused():
    pipeline, _ = fitted("flat_forest", dataset())
    model = EstimatorModel.of(pipeline, 3)
    with pytest.raises(ValueError, match=r"each sample must have 24 numbers, .* \(got 36\)"):
        model(torch.zeros(2, 12, 3))


def test_estimators_show_their_steps():
    pipeline, _ = fitted("rbf_svm", dataset())
    model = EstimatorModel.of(pipeline, 3)
    assert "Readings, Kernel, Votes, Probability, Logits" in repr(model)
    assert model.float() is model


def test_every_compared_estimator_is_tested():
    pytest.importorskip("lightning", reason="needs the extra 'train'")
    from torch_geometric_tactile.experiments._compared_models import MODELS

    pipelines = {model.class_name for model in MODELS if hasattr(baselines, model.class_name)}
    assert pipelines - {"minirocket"} == set(NAMES)


def test_minirocket_is_refused_by_name():
    pytest.importorskip("sktime")
    samples = dataset(num_frames=9)
    pipeline = baselines.minirocket(num_channels=2, num_kernels=84)
    pipeline.fit(samples.data, samples.data.y.numpy())
    with pytest.raises(ValueError, match=r"_RandomConvolutions"):
        estimator_predictor(pipeline, samples, None)


def test_repeated_descriptors_of_a_large_layout():
    pad = grid(24, 20, pitch=0.01)
    draw = torch.Generator().manual_seed(0)
    y = torch.arange(40) % 2
    x = torch.rand(40, 480, 1, generator=draw)
    x[:, :240] += y.view(-1, 1, 1)
    samples = StaticDataset._from_samples(
        (StaticData(x=x, y=y, pos=pad.pos), {"class": ["low", "high"]}), pad, None, None, None
    )
    pipeline = baselines.descriptor_forest(pad, num_trees=5)
    assert pipeline.fit(samples.data, y.numpy())[0].transform(x.numpy()).shape[1] > 700
    predictor = estimator_predictor(pipeline, samples, None)
    expected = pipeline.predict_proba(x.numpy())
    np.testing.assert_allclose(predictor(x).numpy(), expected, atol=1e-6)
