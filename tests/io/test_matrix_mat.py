"""Variables of MAT files by their names; matrices are tested with those of other formats."""

import struct

import numpy as np
import pytest
from published_files import cell, glove_mat

from torch_geometric_tactile.io._matrix_mat import read_mat_variables

pytest.importorskip("scipy.io")
NUMBERS = np.arange(24, dtype=np.uint16).reshape(2, 3, 4)


@pytest.mark.parametrize("packed", [True, False])
def test_numbers_and_texts_by_hand(tmp_path, packed):
    content = {
        "pressure": NUMBERS,
        "valid": np.array([[True, False]]),
        "names": cell("mug", "", "tür é"),
        "column": cell("a", "b").T,
        "none": np.zeros((1, 0), dtype=object),
        "deep": {"a": 1.0},
        "text": "a press",
    }
    path = glove_mat(tmp_path / "a.mat", content, packed)
    names = ["pressure", "valid", "names", "column", "none"]
    found = read_mat_variables(path, names)
    assert [*found] == names
    assert np.array_equal(found["pressure"], NUMBERS)
    assert found["pressure"].dtype == np.uint16
    assert found["valid"].tolist() == [[1, 0]]
    assert (found["names"], found["column"], found["none"]) == (
        ["mug", "", "tür é"],
        ["a", "b"],
        [],
    )


def test_texts_as_matlab_writes_them(tmp_path):
    """With two bytes a character, which scipy does not write."""
    path = glove_mat(tmp_path / "a.mat", {"names": cell("mug", "ball")}, packed=False)
    data = path.read_bytes()
    small = struct.pack("<HH4s", 16, 3, b"mug\0")  # type and size in one number
    wide = struct.pack("<II", 4, 6) + "mug".encode("utf-16-le") + b"\0\0"
    assert small in data
    place = data.index(small)
    data = data[:place] + wide + data[place + 8 :]
    for where in (132, data.rindex(struct.pack("<I", 14), 0, place) + 4):  # sizes around it
        (size,) = struct.unpack_from("<I", data, where)
        data = data[:where] + struct.pack("<I", size + 8) + data[where + 4 :]
    path.write_bytes(data)
    assert read_mat_variables(path, ["names"]) == {"names": ["mug", "ball"]}


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (None, r"must have one array 'a' of numbers or strings \(got 'b'\)"),
        ({"c": 1.0}, r"must have one array 'a' of numbers or strings"),
        (np.array([1 + 2j]), r"'a' must hold real numbers \(got complex\)"),
        (
            np.array([["x", 1.0]], dtype=object),
            r"must hold strings \(got an array of class 6\)",
        ),
        (np.array([["x", "y"]] * 2, dtype=object), r"'a' must be one row or column of strings"),
        (cell("x", cell("y")), r"'a' must hold strings \(got an array of class 1\)"),
        (
            cell("x", np.array(["yz", "uv"])),
            r"'a' has a string of 4 characters for the size \(2, 2\)",
        ),
        (cell(*["x" * 1000] * 1100), "'a' has too many strings|size of a variable differs from"),
    ],
)
@pytest.mark.parametrize("packed", [True, False])
def test_refused(tmp_path, value, message, packed):
    content = {"b": NUMBERS} | ({} if value is None else {"a": value})
    path = glove_mat(tmp_path / "press.mat", content, packed)
    with pytest.raises(ValueError, match=rf"press.mat' cannot be read as MAT: .*({message})"):
        read_mat_variables(path, ["a"])


def test_a_size_that_fills_the_memory(tmp_path):
    path = glove_mat(tmp_path / "a.mat", {"a": NUMBERS}, packed=False)
    data = bytearray(path.read_bytes())
    place = bytes(data).index(struct.pack("<3i", 2, 3, 4))
    data[place : place + 12] = struct.pack("<3i", 2**20, 2**10, 4)
    path.write_bytes(data)
    with pytest.raises(ValueError, match=r"'a' would take \d+ bytes, far more than the file"):
        read_mat_variables(path, ["a"])
    # One that is not asked for is not looked at.
    assert read_mat_variables(path, []) == {}


def test_cells_that_are_more_than_their_size(tmp_path):
    path = glove_mat(tmp_path / "a.mat", {"a": cell("mug", "ball")}, packed=False)
    data = path.read_bytes()
    path.write_bytes(data.replace(struct.pack("<2i", 1, 2), struct.pack("<2i", 1, 1), 1))
    with pytest.raises(ValueError, match="'a' has bytes after its strings"):
        read_mat_variables(path, ["a"])
