import logging

import numpy as np
import pytest
import torch

from torch_geometric_tactile.data import split_frames
from torch_geometric_tactile.datasets import SamplesFile
from torch_geometric_tactile.sensors import grid

DRAW = np.random.default_rng(0)
X = DRAW.normal(size=(6, 6)).astype(np.float32)
Y = np.array([0, 1, 0, 1, 0, 1])


def samples(folder, options=None, **arrays):
    path = folder / "a.npz"
    np.savez(path, **{"x": X, "y": Y, **arrays})
    return SamplesFile(path, **({"grid": "2x3"} if options is None else options))


@pytest.mark.parametrize(
    "x",
    [
        X,
        X[:, :, None],
        X.reshape(6, 2, 3),
        X.reshape(6, 2, 3, 1),
        X.astype(np.float64),
    ],
)
def test_all_shapes_give_the_same_readings(tmp_path, x):
    dataset = samples(tmp_path, x=x)
    assert torch.equal(dataset.x, torch.from_numpy(X)[:, :, None])
    assert dataset.layout.matches(grid(2, 3, 0.005))


def test_further_dimensions_are_channels(tmp_path):
    x = DRAW.normal(size=(6, 6, 4, 2))
    found = samples(tmp_path, x=x).x
    assert found.shape == (6, 6, 8)
    assert np.array_equal(found.numpy(), x.reshape(6, 6, 8).astype(np.float32))


@pytest.mark.parametrize(
    ("y", "codes", "names"),
    [
        (np.array(["mug", "cup"] * 3), [1, 0] * 3, ["cup", "mug"]),
        (np.array([1000, -7] * 3), [1, 0] * 3, ["-7", "1000"]),
        (np.array([True, False] * 3), [1, 0] * 3, ["False", "True"]),
        (np.array([[3], [5]] * 3, dtype=np.uint8), [0, 1] * 3, ["3", "5"]),
        (np.array([2.0, 1.0] * 3), [1, 0] * 3, ["1", "2"]),
    ],
)
def test_labels_of_any_kind_are_numbered(tmp_path, y, codes, names):
    dataset = samples(tmp_path, y=y)
    assert dataset.y.tolist() == codes
    assert dataset.class_names == names


def test_whole_numbers_in_floating_point_are_classes_with_a_word(tmp_path, caplog):
    with caplog.at_level(logging.WARNING):
        samples(tmp_path, y=Y.astype(float))
    assert "2 different integers, which are used as classes" in caplog.text
    options = {"grid": "2x3", "task": "regression"}
    dataset = samples(tmp_path, options, y=Y.astype(float))
    assert dataset.y.dtype == torch.float
    assert dataset.class_names == []


@pytest.mark.parametrize(
    ("values", "times", "are_classes"), [(50, 2, True), (51, 2, False), (3, 1, False)]
)
def test_whole_numbers_that_are_many_or_never_repeat_are_numbers(
    tmp_path, values, times, are_classes
):
    y = np.arange(values).repeat(times).astype(float)
    dataset = samples(tmp_path, x=np.zeros((len(y), 6)), y=y)
    assert (dataset.y.dtype == torch.long) == are_classes
    assert dataset.num_classes == values if are_classes else dataset.class_names == []


def test_names_of_groups_in_floating_point(tmp_path):
    names = {"2": 2.0, "9007199254740991": 2.0**53 - 1}
    assert samples(tmp_path, group=[*names.values()] * 3).group_names == [*names]
    assert samples(tmp_path, group=[0.5, 2.0] * 3).group_names == ["0.5", "2"]
    assert samples(tmp_path, group=[2.0, 1e20] * 3).group_names == ["2", "1e+20"]


def test_windows_that_are_cut_already_have_their_frames(tmp_path):
    x = DRAW.normal(size=(6, 6, 2, 3)).astype(np.float32)
    for axis, frames in ((2, 2), (3, 3)):
        dataset = samples(tmp_path, {"grid": "2x3", "time_axis": axis}, x=x)
        found = split_frames(dataset.x, frames)
        assert dataset[0].num_frames == frames
        assert np.array_equal(found.numpy(), x.swapaxes(2, 3) if axis == 3 else x)


def test_numbers_stay_numbers(tmp_path):
    y = DRAW.normal(size=(6, 2))
    dataset = samples(tmp_path, y=y)
    assert torch.equal(dataset.y, torch.from_numpy(y).float())


def test_names_of_classes_are_taken_from_the_file(tmp_path):
    assert samples(tmp_path, class_names=["rest", "touch"]).class_names == ["rest", "touch"]
    assert samples(tmp_path, y=Y + 5, class_names=["a", "b"]).class_names == ["5", "6"]


def test_columns_may_be_names(tmp_path):
    names = np.array(["b", "b", "a", "a", "c", "c"])
    part = np.array(["train", "train", "val", "val", "test", "test"])
    joint = DRAW.normal(size=6)
    dataset = samples(tmp_path, trial=names, group=names, session=part, part=part, joint=joint)
    assert dataset.trial.tolist() == [1, 1, 0, 0, 2, 2]
    assert dataset.group_names == ["a", "b", "c"]
    assert dataset.part.tolist() == [0, 0, 1, 1, 2, 2]
    assert dataset.joint.shape == (6, 1)


def test_numbers_of_any_width_are_read(tmp_path):
    wide = {key: np.arange(6, dtype=np.longdouble) for key in ("joint", "time", "trial")}
    dataset = samples(tmp_path, x=X.astype(np.longdouble), **wide)
    assert dataset.joint.view(-1).tolist() == dataset.time.tolist() == [0, 1, 2, 3, 4, 5]
    assert (dataset.joint.dtype, dataset.time.dtype) == (torch.float, torch.double)


def test_layout_may_be_in_the_file(tmp_path):
    pos = grid(2, 3, 0.01).pos.numpy()
    edges = np.array([[0, 1], [1, 0]])
    dataset = samples(tmp_path, {}, pos=pos[:, :2], edge_index=edges)
    assert torch.equal(dataset.layout.pos, torch.from_numpy(pos))
    assert dataset[0].edge_index.tolist() == edges.tolist()


def test_missing_readings_stay_missing(tmp_path):
    x = X.copy()
    x[1, 2] = np.nan
    assert int(samples(tmp_path, x=x).x.isnan().sum()) == 1


@pytest.mark.parametrize(
    ("options", "arrays", "match"),
    [
        ({}, {}, "its taxels must be known: pass a 'layout' or a 'grid'"),
        ({"grid": "2x4"}, {}, r"'x' must have shape \(num_samples, 8, ...\) or \(num_samples, 2"),
        ({"grid": "2by3"}, {}, r"'grid' must be rows and columns such as 28x50 \(got '2by3'\)"),
        ({"grid": "0x3"}, {}, "'rows' and 'cols' must be at least 1"),
        ({"layout": "biotac"}, {}, r"'x' must have shape \(num_samples, 19, ...\)"),
        ({"layout": "biotac", "grid": "2x3"}, {}, "only one of 'layout' and 'grid'"),
        ({"grid": "2x3", "task": "guess"}, {}, "'task' must be one of"),
        (
            {"grid": "2x3", "time_axis": 0},
            {},
            r"'time_axis' must be a dimension of .* 1 to 1 \(got 0",
        ),
        (
            {"grid": "2x3", "time_axis": 2},
            {},
            r"'time_axis' must be a dimension of .* 1 to 1 \(got 2",
        ),
        ({"grid": "2x3", "time_axis": 2}, {"x": X[:, :, None]}, "at least 2 frames, from 1 to 2"),
        (None, {"x": X * np.inf}, "infinity in sample 0, taxel 0"),
        (None, {"y": np.full(6, np.nan)}, "'y' must be finite"),
        (None, {"y": np.zeros(6, int)}, r"'y' must have at least 2 classes \(got only '0'\)"),
        (None, {"y": np.eye(6, 3, dtype=int)}, r"write y.argmax\(axis=1\)"),
        (
            {"grid": "2x3", "task": "regression"},
            {"y": np.array(["a", "b"] * 3)},
            "'y' must hold one number or one row of numbers",
        ),
        (None, {"trial": np.zeros((6, 2))}, "'trial' must have one value per sample"),
        (None, {"trial": np.full(6, np.nan)}, "'trial' must be known for every sample"),
        (None, {"part": Y + 5}, r"'part' must hold 0 \(train\)"),
    ],
)
def test_what_does_not_fit_is_refused(tmp_path, options, arrays, match):
    with pytest.raises(ValueError, match=match):
        samples(tmp_path, options, **arrays)


@pytest.mark.parametrize("dtype", [np.int64, np.float64])
def test_samples_without_a_label_are_left_out(tmp_path, caplog, dtype):
    y = np.r_[[-1] * 5, np.arange(55) % 2].astype(dtype)
    x = np.arange(60.0)[:, None] * np.ones(6)
    np.savez(tmp_path / "a.npz", x=x, y=y, trial=np.arange(60))
    dataset = SamplesFile(tmp_path / "a.npz", grid="2x3")
    assert (dataset.class_names, len(dataset)) == (["0", "1"], 55)
    assert dataset.x[0].unique().tolist() == [5.0]
    assert len(dataset.trial.unique()) == 55
    assert "5 of 60 samples have the label -1, which means unlabelled" in caplog.text


@pytest.mark.parametrize("y", [[-1, 1], [-2, -1, 0], ["-1", "0"]])
def test_minus_one_is_a_class_elsewhere(tmp_path, y):
    np.savez(tmp_path / "a.npz", x=np.ones((12, 6)), y=np.resize(y, 12))
    dataset = SamplesFile(tmp_path / "a.npz", grid="2x3")
    assert (len(dataset), dataset.class_names[0]) == (12, str(sorted(y)[0]))


def test_spellings_of_one_class_in_a_file(tmp_path):
    np.savez(tmp_path / "a.npz", x=np.ones((4, 6)), y=["slip", "Slip ", "hold", "slip"])
    dataset = SamplesFile(tmp_path / "a.npz", grid="2x3")
    assert (dataset.class_names, dataset.y.tolist()) == (["hold", "slip"], [1, 1, 0, 1])
