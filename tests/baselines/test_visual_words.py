import builtins
import pickle

import numpy as np
import pytest
import torch
from scipy.ndimage import gaussian_filter, shift
from sklearn.base import clone

pytest.importorskip("cv2")
pytest.importorskip("mahotas")

import cv2
from mahotas.features import surf

from torch_geometric_tactile.baselines import SIFTSVM, SURFSVM
from torch_geometric_tactile.baselines._visual_words import enlarge
from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.experiments._estimators import (
    class_scores,
    count_parameters,
    estimator_input,
    seeded_estimator,
)
from torch_geometric_tactile.sensors import TaxelLayout, grid, letter_array

MODELS = pytest.mark.parametrize("model", [SIFTSVM, SURFSVM], ids=["sift", "surf"])
WIDE = {"SIFTSVM": {}, "SURFSVM": {"spacing": 16}}  # fewer points, for time
NUM_CLASSES = 4


def drawn(label: int, draw: np.random.Generator) -> np.ndarray:
    # A bar, a cross, a frame or a triangle with blurred edges, at a random place.
    image = np.zeros((32, 32))
    if label < 2:
        image[14:17, 6:26] = 1
    if label == 1:
        image[6:26, 14:17] = 1
    if label == 2:
        image[8:24, 8:24] = 1
        image[11:21, 11:21] = 0
    if label == 3:
        image[8:24, 8:24] = np.tri(16)
    image = shift(image, draw.uniform(-4, 4, size=2), order=1)
    image = draw.uniform(0.4, 0.8) * gaussian_filter(image, 1.0)
    return image + draw.normal(0, 0.005, size=image.shape)


def samples(num: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    draw = np.random.default_rng(seed)
    y = np.arange(num) % NUM_CLASSES
    return np.stack([drawn(label, draw) for label in y]).reshape(num, 1024, 1), y


X, Y = samples(60, 0)
X_TEST, Y_TEST = samples(40, 1)
BARE = TaxelLayout("bare", torch.eye(3))


@pytest.fixture(scope="module", params=[SIFTSVM, SURFSVM], ids=["sift", "surf"])
def fitted(request):
    model = request.param
    return model(num_words=40, random_state=0, **WIDE[model.__name__]).fit(X, Y)


def test_blurred_shapes_are_told_apart(fitted):
    assert fitted.score(X_TEST, Y_TEST) > 0.8  # 0.25 by chance
    assert fitted.decision_function(X_TEST).shape == (40, NUM_CLASSES)
    assert class_scores(fitted, X_TEST, NUM_CLASSES).shape == (40, NUM_CLASSES)


def test_histograms_have_unit_length(fitted):
    histograms = fitted.transform(X_TEST)
    assert histograms.shape == (40, 40)
    length = np.linalg.norm(histograms, axis=1)
    assert np.allclose(length[length > 0], 1)
    assert (length > 0).mean() > 0.8
    plain = clone(fitted).set_params(root=False).fit(X, Y).transform(X_TEST)
    assert np.allclose(plain / np.maximum(plain.sum(axis=1, keepdims=True), 1e-9), histograms**2)


def test_same_seed_gives_the_same_words(fitted):
    again = clone(fitted).fit(X, Y)
    assert np.array_equal(again.words_, fitted.words_)
    assert np.array_equal(again.decision_function(X_TEST), fitted.decision_function(X_TEST))
    other = clone(fitted).set_params(random_state=1).fit(X, Y)
    assert not np.array_equal(other.words_, fitted.words_)


def test_a_step_of_one_taxel_changes_little(fitted):
    images = X_TEST.reshape(-1, 32, 32)
    moved = np.roll(images, 1, axis=2).reshape(X_TEST.shape)
    first, second = fitted.transform(X_TEST), fitted.transform(moved)
    across = (first * np.roll(first, 1, axis=0)).sum(axis=1).mean()
    assert (first * second).sum(axis=1).mean() > across + 0.1
    assert (fitted.predict(moved) == fitted.predict(X_TEST)).mean() > 0.8


def test_images_without_words_are_counted(fitted):
    x = X_TEST[:6].copy()
    x[[1, 4]] = [[[0.0]], [[0.7]]]  # no pressure, and the same everywhere
    histograms = fitted.transform(x)
    assert fitted.num_without_words_ == 2
    assert np.flatnonzero(~histograms.any(axis=1)).tolist() == [1, 4]
    assert np.isin(fitted.predict(x), range(NUM_CLASSES)).all()
    again = clone(fitted).fit(np.concatenate([X, 0 * X[:3]]), [*Y, 0, 1, 2])
    assert again.num_without_words_ == (~fitted.transform(X).any(axis=1)).sum() + 3
    again.predict(x[:2])
    assert again.num_without_words_ == 1


def test_values_beyond_the_scale_are_cut(fitted):
    x = np.clip(3 * X_TEST - 0.5, -2, 2)
    assert np.array_equal(fitted.images(x), fitted.images(x.clip(0, 1)))
    assert fitted.images(np.full((1, 1024, 1), 0.5))[0, 3, 5] == 128
    assert fitted.images(X_TEST)[0].dtype == np.uint8


def test_taxels_are_placed_by_the_image_map(fitted):
    order = np.random.default_rng(0).permutation(1024)
    layout = letter_array()
    mixed = TaxelLayout("mixed", layout.pos[order], image_map=layout.image_map[order])
    again = clone(fitted).set_params(layout=mixed)
    assert np.array_equal(again.images(X_TEST[:, order]), fitted.images(X_TEST))


def test_cells_without_a_taxel_are_zero(fitted):
    layout = TaxelLayout("two", torch.eye(3)[:2], image_map=torch.tensor([[0, 1], [2, 0]]))
    images = clone(fitted).set_params(layout=layout).images(np.ones((1, 2, 1)))
    assert images.tolist() == [[[0, 255], [0, 0], [255, 0]]]


def test_no_images_give_no_labels(fitted):
    assert fitted.predict(X[:0]).shape == (0,)
    assert fitted.transform(X[:0]).shape == (0, 40)
    assert fitted.decision_function(X[:0]).shape == (0, NUM_CLASSES)
    assert fitted.num_without_words_ == 0


def test_two_classes_have_one_score(fitted):
    two = Y < 2
    again = clone(fitted).set_params(num_words=20).fit(X[two], Y[two])
    x = X_TEST[Y_TEST < 2]
    assert again.decision_function(x).shape == (len(x),)
    assert again.decision_function(x[:0]).shape == (0,)
    assert np.array_equal(again.predict(x), (again.decision_function(x) > 0).astype(int))


def test_labels_may_be_names(fitted):
    names = np.array(["bar", "cross", "frame", "triangle"])
    again = clone(fitted).fit(X, names[Y])
    assert np.array_equal(again.predict(X_TEST), names[fitted.predict(X_TEST)])


def test_samples_and_a_pickled_machine_give_the_same(fitted):
    data = StaticData(x=torch.from_numpy(X_TEST))
    loaded = pickle.loads(pickle.dumps(fitted))
    assert np.array_equal(loaded.predict(data), fitted.predict(X_TEST))


@pytest.mark.parametrize("kernel", ["linear", "rbf"])
@MODELS
def test_experiments_fill_layout_and_seed_and_count_numbers(model, kernel):
    path, wide = f"torch_geometric_tactile.baselines.{model.__name__}", WIDE[model.__name__]
    described = {"class_path": path, "init_args": {"num_words": 40, "kernel": kernel} | wide}
    estimator = seeded_estimator(described, letter_array(), 3)
    assert estimator.random_state == 3
    assert estimator.layout.name == "letter_array"
    data = StaticData(x=torch.from_numpy(X))
    assert estimator_input(estimator, data).shape == X.shape
    estimator.fit(X, Y)
    svm = estimator.svm_
    if kernel == "linear":
        expected = NUM_CLASSES * (40 + 1)
    else:
        expected = svm.support_vectors_.size + svm.dual_coef_.size + NUM_CLASSES * 3 // 2
    assert count_parameters(estimator) == estimator.words_.size + expected


@MODELS
def test_numbers_of_threads_are_left_alone(model):
    before = cv2.getNumThreads(), torch.get_num_threads()
    estimator = model(num_words=20, random_state=0, **WIDE[model.__name__])
    estimator.fit(X[:20], Y[:20]).predict(X_TEST[:8])
    assert (cv2.getNumThreads(), torch.get_num_threads()) == before


@MODELS
def test_more_descriptors_than_needed_are_left_out_of_the_words(model, monkeypatch):
    module = "torch_geometric_tactile.baselines._visual_words"
    monkeypatch.setattr(f"{module}._IMAGE_BLOCK", 16)
    monkeypatch.setattr(f"{module}._MAX_DESCRIPTORS", 60)
    few = model(num_words=20, random_state=0, **WIDE[model.__name__]).fit(X, Y)
    assert few.score(X_TEST, Y_TEST) > 0.6


def test_detector_of_surf_finds_nothing_on_images_of_the_array():
    images = SURFSVM().images(X)
    assert sum(len(surf.surf(image, threshold=1e-4)) for image in images) == 0
    larger = enlarge(images, 3)
    assert np.mean([len(surf.surf(image)) for image in larger]) < 3


def test_points_of_surf_are_those_of_its_dense_raster():
    model = SURFSVM(factor=1, spacing=8, scale=2.0, contrast=0.0)
    image = np.random.default_rng(0).integers(0, 255, (128, 128), dtype=np.uint8)
    ours = next(model.describe(image[None])).reshape(16, 16, 64)
    inside = surf.dense(image, 8, 2.0, include_interest_point=True)
    rows, cols = ((inside[:, i] - 4).astype(int) // 8 for i in range(2))
    assert len(inside) > 50
    assert np.allclose(ours[rows, cols], inside[:, 6:], atol=1e-6)


def test_images_are_enlarged_linearly():
    image = np.array([[[0, 90]]], dtype=np.uint8)
    assert enlarge(image, 3)[0].tolist() == [[0, 0, 30, 60, 90, 90]] * 3
    assert enlarge(image, 1) is image


@MODELS
def test_repr_is_short(model):
    assert repr(model()) == f"{model.__name__}()"
    assert repr(model(num_words=7, C=2.0)) == f"{model.__name__}(C=2.0, num_words=7)"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"num_words": 0}, r"'num_words' must be at least 1 \(got 0\)"),
        ({"factor": 0}, r"'factor' must be at least 1 \(got 0\)"),
        ({"kernel": "poly"}, r"'kernel' must be one of \['linear', 'rbf'\] \(got 'poly'\)"),
        (
            {"layout": grid(2, 2, pitch=1.0)},
            r"shape \(num_samples, 4, 1\), one grey value .*'grid_",
        ),
        (
            {"layout": BARE},
            "needs a layout with an image map .*'bare'",
        ),
    ],
)
@MODELS
def test_bad_arguments_are_refused(model, change, message):
    with pytest.raises(ValueError, match=message):
        model(**change).fit(X, Y)


@MODELS
def test_fewer_descriptors_than_words_are_refused(model):
    message = r"'num_words' must not exceed the number .*got 500 words and \d+ .* 4 images\)"
    with pytest.raises(ValueError, match=message):
        model(num_words=500, **WIDE[model.__name__]).fit(X[:4], Y[:4])
    with pytest.raises(ValueError, match="and 0 descriptors in 4 images"):
        model().fit(0 * X[:4], Y[:4])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"spacing": 0}, r"'spacing' must be at least 1 \(got 0\)"),
        ({"scale": 0.5}, r"'scale' must be at least 1 \(got 0.5\)"),
        ({"contrast": -0.1}, r"'contrast' must be between 0 and 1 \(got -0.1\)"),
        ({"scale": float("nan")}, r"'scale' must be at least 1 \(got nan\)"),
    ],
)
def test_bad_rasters_are_refused(change, message):
    with pytest.raises(ValueError, match=message):
        SURFSVM(**change).fit(X, Y)


def test_bad_threshold_is_refused():
    with pytest.raises(ValueError, match=r"'contrast_threshold' must not be negative \(got -1\)"):
        SIFTSVM(contrast_threshold=-1).fit(X, Y)


@pytest.mark.parametrize(
    ("x", "message"),
    [
        (X[:, :1000], r"'x' must have shape \(num_samples, 1024, 1\).*\(got \(60, 1000, 1\)\)"),
        (np.repeat(X, 2, axis=2), r"one grey value for each taxel of layout 'letter_array' \(got"),
        (X[:, :, 0], "'x' must have shape \\(num_samples, num_taxels, num_channels\\)"),
        (np.where(np.arange(1024)[:, None] == 3, np.nan, X), "'x' must hold finite readings only"),
    ],
    ids=["taxels", "channels", "rows", "nan"],
)
def test_bad_readings_are_refused(fitted, x, message):
    with pytest.raises(ValueError, match=message):
        fitted.predict(x)
    with pytest.raises(ValueError, match=message):
        clone(fitted).fit(x, Y)


def test_labels_of_other_samples_are_refused(fitted):
    with pytest.raises(ValueError, match=r"'y' must have shape \(60,\), like 'x' \(got \(59,\)\)"):
        clone(fitted).fit(X, Y[1:])


@MODELS
def test_missing_extra_is_named(model, monkeypatch):
    plain = builtins.__import__

    def without(name, *args, **kwargs):
        if name.startswith(("cv2", "mahotas")):
            raise ImportError(name)
        return plain(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(ImportError, match=r"pip install 'torch-geometric-tactile\[baselines\]'"):
        model()
