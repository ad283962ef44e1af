import errno

import numpy as np
import pytest

from torch_geometric_tactile.datasets._frame_reader import FrameFiles


def test_rows_come_back_in_order_and_nothing_is_left(tmp_path):
    with FrameFiles(tmp_path / "new") as files:
        files.add("a", np.arange(6.0).reshape(2, 3))
        files.add("b", np.array([1, 2, 3]))
        files.add("a", np.arange(3, dtype=np.float32)[None])
        assert [*files] == ["a", "b"]
        assert files.shape("a") == (3, 3)
        assert files.shape("c") is None
        a, b = files.tensor("a"), files.tensor("b")
    assert a.tolist() == [[0, 1, 2], [3, 4, 5], [0, 1, 2]]
    assert a.dtype.is_floating_point
    assert a.element_size() == 8
    assert b.tolist() == [1, 2, 3]
    a[0] = 7  # in memory, not in the file
    assert a[0].tolist() == [7, 7, 7]
    assert list((tmp_path / "new").iterdir()) == []


def test_no_rows_and_rows_without_content():
    with FrameFiles() as files:
        files.add("a", np.zeros((0, 3)))
        files.add("b", np.zeros((4, 0)))
        assert files.tensor("a").shape == (0, 3)
        assert files.tensor("b").shape == (4, 0)


def test_rows_of_another_shape():
    with FrameFiles() as files:
        files.add("a", np.zeros((1, 3)))
        with pytest.raises(ValueError, match=r"'a' must have rows of shape \(3,\) \(got \(4,\)\)"):
            files.add("a", np.zeros((1, 4)))


def test_a_full_disk_names_the_folder(tmp_path, monkeypatch):
    with FrameFiles(tmp_path) as files:
        files.add("a", np.zeros(3))

        class Full:
            def write(self, data):
                raise OSError(errno.ENOSPC, "full")

        monkeypatch.setitem(files._files, "a", Full())
        with pytest.raises(OSError, match=r"No space left on device: '.*test_a_full_disk"):
            files.add("a", np.zeros(3))
