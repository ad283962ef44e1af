import logging

import numpy as np
import pytest

from torch_geometric_tactile.io import read_samples_npz

X = np.arange(12.0).reshape(4, 3)
Y = np.array([0, 1, 0, 1])


def write(path, **arrays):
    np.savez(path, **arrays)
    return path


def test_arrays_are_read_by_their_names(tmp_path):
    path = write(tmp_path / "a.npz", x=X, y=Y, trial=["a", "a", "b", "b"], pos=np.zeros((3, 3)))
    found = read_samples_npz(path)
    assert set(found) == {"x", "y", "trial", "pos"}
    assert np.array_equal(found["x"], X)
    assert found["trial"].tolist() == ["a", "a", "b", "b"]


def test_other_usual_names_are_found(tmp_path, caplog):
    path = write(tmp_path / "a.npz", data=X, labels=Y, trial_id=Y, objects=Y, note=np.array("n"))
    with caplog.at_level(logging.WARNING):
        assert set(read_samples_npz(path)) == {"x", "y", "trial", "group"}
    assert "ignored the arrays 'note'" in caplog.text
    write(path, x=X, y=Y, **dict.fromkeys("abcdefghijk", Y[:1]))
    with caplog.at_level(logging.WARNING):
        read_samples_npz(path)
    assert caplog.text.endswith("'i', 'j'\n")  # ten of them


def test_persons_are_groups_if_there_are_no_others(tmp_path, caplog):
    assert set(read_samples_npz(write(tmp_path / "a.npz", x=X, y=Y, subject_id=Y))) == {
        *("x", "y", "group", "subject_id"),
    }
    assert caplog.text == ""
    path = write(tmp_path / "b.npz", x=X, y=Y, object=Y + 5, person=Y)
    assert np.array_equal(read_samples_npz(path)["group"], Y + 5)


def test_further_names_of_the_samples_are_units(tmp_path, caplog):
    path = tmp_path / "a.npz"
    write(path, x=X, y=Y, object=Y + 5, person=list("aabb"), height=Y / 2, day=Y[:2])
    found = read_samples_npz(path)
    assert set(found) == {"x", "y", "group", "person"}
    assert found["person"].tolist() == ["a", "a", "b", "b"]
    assert "ignored the arrays 'day', 'height'" in caplog.text


def test_ten_arrays_that_are_no_data_set_are_listed(tmp_path):
    path = write(tmp_path / "a.npz", **dict.fromkeys("abcdefghijk", Y))
    with pytest.raises(ValueError, match=r"'x' is missing \(got 'a', .*, 'i', 'j'\)"):
        read_samples_npz(path)


@pytest.mark.parametrize(
    ("arrays", "match"),
    [
        ({"y": Y}, r"an array 'x' is missing \(got 'y'\)"),
        ({"x": X}, r"an array 'y' is missing \(got 'x'\)"),
        ({"x": X, "y": Y, "labels": Y}, r"must have only one of \['y', 'labels'\]"),
        ({"x": X[0], "y": Y}, r"'x' must have shape \(num_samples, num_taxels, ...\)"),
        ({"x": X, "y": Y[:3]}, r"'y' must have 4 rows, one for each of 'x' \(got \(3,\)\)"),
        ({"x": X.astype(str), "y": Y}, r"'x' must hold numbers \(got strings\)"),
        ({"format": np.array("f"), "tactile": X}, r"a recording is not a data set"),
    ],
)
def test_what_is_no_data_set_is_refused(tmp_path, arrays, match):
    path = write(tmp_path / "a.npz", **arrays)
    with pytest.raises(ValueError, match=match) as error:
        read_samples_npz(path)
    assert str(path) in str(error.value)


def test_arrays_of_more_than_a_gibibyte_and_200_times_the_file_must_be_allowed(
    tmp_path, monkeypatch
):
    monkeypatch.setattr("torch_geometric_tactile.io._npz_arrays.ARRAY_BYTES", 10_000)
    path = tmp_path / "a.npz"
    np.savez_compressed(path, x=np.zeros((100_000, 3)), y=np.zeros(100_000))
    with pytest.raises(ValueError, match="allow_large=True"):
        read_samples_npz(path)
    assert read_samples_npz(path, allow_large=True)["x"].shape == (100_000, 3)
