"""Matrices of readings in CSV, npy, PNG and MAT files."""

import struct
import sys

import numpy as np
import pytest

from torch_geometric_tactile.io._matrix_files import (
    read_matrices,
    read_matrix_csv,
    read_matrix_npy,
    read_matrix_png,
)
from torch_geometric_tactile.io._matrix_mat import read_matrix_mat

SIZE = (3, 4)
MATRIX = np.arange(12.0).reshape(SIZE) / 4
STACK = np.stack([MATRIX, MATRIX + 1])


def csv(path, matrix=MATRIX, **kwargs):
    np.savetxt(path, matrix, delimiter=",", **kwargs)
    return path


def mat(path, variables=None, **kwargs):
    savemat = pytest.importorskip("scipy.io").savemat
    savemat(path, {"press": STACK} if variables is None else variables, **kwargs)
    return path


def png(path, pixels):
    image = pytest.importorskip("PIL.Image", reason="needs the extra 'io'")
    image.fromarray(pixels).save(path)
    return path


def test_csv(tmp_path):
    found = read_matrix_csv(csv(tmp_path / "a.csv"), SIZE)
    assert found.shape == (1, 3, 4)
    assert np.array_equal(found[0], MATRIX)
    path = tmp_path / "b.csv"
    path.write_text("1,,3\n4,nan,6\n")
    found = read_matrix_csv(path, (2, 3))
    assert np.isnan(found).tolist() == [[[False, True, False], [False, True, False]]]


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("1,2\n", r"must have 2 lines \(got 1\): is the file truncated"),
        ("1,2\n3,4\n5,6\n", r"must have 2 lines \(got more\)"),
        ("1,2\n3,4", "line 2 must end with a line break: is the file truncated"),
        ("1,2\n3\n", r"line 2 must have 2 cells \(got 1\)"),
        ("1,2\n3,4,5\n", r"line 2 must have 2 cells \(got 3\)"),
        ("1,2\n3,x\n", r"line 2, column 2: 'column 2' must be a number \(got 'x'\)"),
        ("1;2\n3;4\n", r"line 1 must have cells separated by commas"),
    ],
)
def test_bad_csv(tmp_path, text, match):
    path = tmp_path / "a.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=match) as error:
        read_matrix_csv(path, (2, 2))
    assert str(path) in str(error.value)


@pytest.mark.parametrize("dtype", ["f4", ">f8", "i2", "u1", ">u2", "f2"])
def test_npy(tmp_path, dtype):
    path = tmp_path / "a.npy"
    for array in (MATRIX, STACK, np.asfortranarray(STACK), STACK[:1]):
        np.save(path, array.astype(dtype))
        found = read_matrix_npy(path, SIZE)
        assert found.dtype == np.dtype(dtype).newbyteorder("=")
        assert np.array_equal(found, array.astype(dtype).reshape(-1, *SIZE))
    np.save(path, MATRIX)
    assert read_matrix_npy(path, (4,)).shape == (3, 4)
    np.save(path, MATRIX[0])
    assert read_matrix_npy(path, (4,)).shape == (1, 4)


@pytest.mark.parametrize(
    ("array", "match"),
    [
        (MATRIX[:2], r"a matrix of 3 x 4 numbers or a stack of them \(got shape \(2, 4\)\)"),
        (STACK[None], r"\(got shape \(1, 2, 3, 4\)\)"),
        (STACK[:0], r"\(got shape \(0, 3, 4\)\)"),
        (np.array(1.0), r"\(got shape \(\)\)"),
        (MATRIX.astype(complex), r"must hold numbers or strings \(got complex128"),
        (MATRIX > 1, r"must hold numbers \(got type bool\)"),
    ],
    ids=["rows", "4-D", "empty", "scalar", "complex", "bool"],
)
def test_bad_npy(tmp_path, array, match):
    path = tmp_path / "a.npy"
    np.save(path, array, allow_pickle=True)
    with pytest.raises(ValueError, match=match) as error:
        read_matrix_npy(path, SIZE)
    assert str(path) in str(error.value)


def test_damaged_npy(tmp_path):
    path = tmp_path / "a.npy"
    np.save(path, MATRIX)
    data = path.read_bytes()
    for other in (data[:-1], data + b"\0"):
        path.write_bytes(other)
        with pytest.raises(ValueError, match=r"must have 224 bytes for the shape \(3, 4\)"):
            read_matrix_npy(path, SIZE)
    for other in (data[:40], b"", b"PK\x03\x04", data.replace(b"'<f8'", b"'<q99")):
        path.write_bytes(other)
        with pytest.raises(ValueError, match=r"cannot be read as npy.*copy or write it again"):
            read_matrix_npy(path, SIZE)


def test_png(tmp_path):
    for dtype in (np.uint8, np.uint16):
        top = np.iinfo(dtype).max
        pixels = np.random.default_rng(0).integers(0, top, SIZE, endpoint=True).astype(dtype)
        pixels[0, :2] = 0, top
        found = read_matrix_png(png(tmp_path / "a.png", pixels), SIZE)
        assert found.dtype == dtype
        assert np.array_equal(found[0], pixels)


@pytest.mark.parametrize(
    ("pixels", "match"),
    [
        (np.zeros((4, 4), np.uint8), r"must have 3 x 4 pixels \(got 4 x 4\)"),
        (np.zeros((3, 4, 3), np.uint8), r"must be a grey image \(got RGB\): save it in grey"),
        (np.zeros((3, 4, 4), np.uint8), r"\(got RGB with transparency\)"),
        (np.zeros((3, 4, 2), np.uint8), r"\(got grey with transparency\)"),
        (np.zeros((3, 4), bool), r"must have 8 or 16 bits per pixel \(got 1\)"),
    ],
    ids=["size", "RGB", "RGBA", "LA", "bits"],
)
def test_bad_png(tmp_path, pixels, match):
    path = png(tmp_path / "a.png", pixels)
    with pytest.raises(ValueError, match=match) as error:
        read_matrix_png(path, SIZE)
    assert str(path) in str(error.value)


def test_damaged_png(tmp_path):
    path = png(tmp_path / "a.png", np.arange(12, dtype=np.uint8).reshape(SIZE))
    data = path.read_bytes()
    for content, match in (
        (data[: len(data) // 2], r"cannot be read as PNG: .*write it again"),
        (b"GIF89a", "must be a PNG image"),
        (data + bytes(2**22), "must have at most 4194304 bytes"),
    ):
        path.write_bytes(content)
        with pytest.raises(ValueError, match=rf"a\.png' {match}"):
            read_matrix_png(path, SIZE)


def test_png_without_pillow(tmp_path, monkeypatch):
    path = png(tmp_path / "a.png", np.zeros(SIZE, np.uint8))
    monkeypatch.setitem(sys.modules, "PIL", None)
    with pytest.raises(ImportError, match=r'Pillow: pip install "torch-geometric-tactile\[io\]"'):
        read_matrix_png(path, SIZE)


@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize("dtype", ["f8", "f4", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8"])
def test_mat_as_scipy_writes_it(tmp_path, dtype, packed):
    for array in (STACK, MATRIX, STACK[:1]):
        others = {"note": "text", "parts": {"deep": {"er": MATRIX}}}
        array = (8 * array).astype(dtype)
        path = mat(tmp_path / "a.mat", {**others, "press": array}, do_compression=packed)
        found = read_matrix_mat(path, SIZE)
        assert found.dtype == array.dtype
        assert np.array_equal(found, array.reshape(-1, *SIZE))


def big_endian(path, values, kind=6):
    """A file of one matrix, whose bytes stand for numbers of another type."""
    parts = struct.pack(">IIII", 6, 8, kind, 0) + struct.pack(">IIii", 5, 8, *SIZE)
    parts += struct.pack(">HH4s", 1, 1, b"x\0\0\0") + struct.pack(">II", 2, 12)
    parts += values.tobytes(order="F") + bytes(4)
    head = b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack(">H", 0x0100) + b"MI"
    path.write_bytes(head + struct.pack(">II", 14, len(parts)) + parts)
    return path


def test_mat_of_another_machine(tmp_path):
    """Big endian, and numbers stored in fewer bytes than they have in MATLAB."""
    values = np.arange(12, dtype=np.uint8).reshape(SIZE)
    path = big_endian(tmp_path / "a.mat", values)
    found = read_matrix_mat(path, SIZE)
    assert found.dtype == np.float64
    assert np.array_equal(found[0], values)
    loadmat = pytest.importorskip("scipy.io").loadmat
    assert np.array_equal(loadmat(path)["x"], values)


def test_numbers_of_mat_that_do_not_fit_their_type(tmp_path):
    path = big_endian(tmp_path / "a.mat", np.full(SIZE, 200, np.uint8), kind=8)
    with pytest.raises(ValueError, match="'x' has numbers that do not fit its type int8"):
        read_matrix_mat(path, SIZE)


@pytest.mark.parametrize(
    ("place", "number", "match"),
    [
        (136, 5, "a variable has no header"),  # another type
        (140, 4, "a variable has no header"),  # shorter
        (152, 6, "a variable has no size"),
        (156, 4, "a variable has no size"),  # of one dimension
        (156, 6, "a variable has no size"),  # of one and a half
        (160, -1, r"a variable has the size \(-1, 4\)"),
        (168, 0x00010002, "a variable has no name"),  # another type
        (172, -1, "a variable has no name"),  # not ASCII
        (168, 0x00050001, "a small part must have at most 4 bytes"),
        (176, 11, "'x' has numbers of the unknown type 11"),
        (180, 11, r"'x' must have 12 bytes of numbers \(got 11"),
        (180, 100, "a part must have 100 bytes"),
    ],
)
def test_parts_of_a_variable_of_mat_must_be_what_the_format_says(tmp_path, place, number, match):
    path = big_endian(tmp_path / "a.mat", np.zeros(SIZE, np.uint8))
    data = bytearray(path.read_bytes())
    struct.pack_into(">i", data, place, number)
    path.write_bytes(data)
    with pytest.raises(ValueError, match=match):
        read_matrix_mat(path, SIZE)


def test_packed_mat_that_ends_early(tmp_path):
    """The numbers are whole, but not the checksum behind them."""
    data = mat(tmp_path / "a.mat", do_compression=True).read_bytes()
    path = tmp_path / "b.mat"
    path.write_bytes(data[:132] + struct.pack("<I", len(data) - 136 - 4) + data[136:-4])
    with pytest.raises(ValueError, match="the size of a variable differs from its header"):
        read_matrix_mat(path, SIZE)


def test_variables_of_mat(tmp_path):
    path = mat(tmp_path / "a.mat", {"a": MATRIX, "b": STACK, "c": "text"})
    assert np.array_equal(read_matrix_mat(path, SIZE, "b"), STACK)
    with pytest.raises(ValueError, match=r"one numeric array \(got 'a', 'b'\): name it by 'var"):
        read_matrix_mat(path, SIZE)
    for name in ("c", "d"):
        with pytest.raises(ValueError, match=rf"must have one numeric array '{name}' \(got 'a'"):
            read_matrix_mat(path, SIZE, name)
    assert np.array_equal(read_matrices(path, SIZE, "a"), MATRIX[None])
    mat(path, dict.fromkeys("abcdefghijk", MATRIX))
    for name in (None, "z"):
        with pytest.raises(ValueError, match=r"\(got 'a', .*, 'i', 'j'\)"):  # ten of them
            read_matrix_mat(path, SIZE, name)


@pytest.mark.parametrize(
    ("variables", "match"),
    [
        ({"a": MATRIX.T}, r"'a' must be a matrix of 3 x 4 numbers .*\(got shape \(4, 3\)\)$"),
        ({"a": STACK.transpose(1, 2, 0)}, r"\(3, 4, 2\)\): put the matrices first by permute"),
        ({"a": MATRIX[0, 0]}, r"\(got shape \(1, 1\)\)"),
        ({"a": MATRIX[:0]}, r"\(got shape \(0, 4\)\)"),
        ({"a": MATRIX * 1j}, r"'a' must hold real numbers \(got complex or logical"),
        ({"a": MATRIX > 1}, r"'a' must hold real numbers \(got complex or logical"),
        ({"a": "text"}, r"one numeric array \(got none in 1 variables\)"),
        ({}, r"one numeric array \(got none in 0 variables\)"),
    ],
    ids=["transposed", "last", "scalar", "empty", "complex", "logical", "text", "none"],
)
def test_bad_mat(tmp_path, variables, match):
    path = mat(tmp_path / "a.mat", variables)
    with pytest.raises(ValueError, match=match) as error:
        read_matrix_mat(path, SIZE)
    assert str(path) in str(error.value)


def test_a_cube_of_mat_may_be_read_both_ways(tmp_path):
    cube = np.arange(64.0).reshape(4, 4, 4)
    path = mat(tmp_path / "a.mat", {"a": cube})
    with pytest.raises(
        ValueError, match=r"shape \(4, 4, 4\), in which the matrices may be first or last"
    ):
        read_matrix_mat(path, (4, 4))
    for part in (cube[:3], cube[:5:2], cube[0]):
        found = read_matrix_mat(mat(path, {"a": part}), (4, 4))
        assert np.array_equal(found, part.reshape(-1, 4, 4))


def test_other_versions_of_mat(tmp_path):
    path = mat(tmp_path / "a.mat", {"a": MATRIX}, format="4")
    with pytest.raises(
        ValueError, match=r"truncated, or not a MAT file of versions 5 to 7: try save"
    ):
        read_matrix_mat(path, SIZE)
    path.write_bytes(b"MATLAB 7.3 MAT-file".ljust(512) + b"\x89HDF\r\n\x1a\n" + bytes(9))
    with pytest.raises(ValueError, match=r"has version 7.3 \(HDF5\): write it with save.*'-v7'"):
        read_matrix_mat(path, SIZE)
    mat(path)
    path.write_bytes(path.read_bytes()[:124] + b"\0\2IM")
    with pytest.raises(ValueError, match=r"has version 0x200"):
        read_matrix_mat(path, SIZE)


def test_formats_by_suffix(tmp_path):
    csv(tmp_path / "a.CSV")
    np.save(tmp_path / "a.npy", STACK)
    assert read_matrices(tmp_path / "a.CSV", SIZE).shape == (1, 3, 4)
    assert read_matrices(tmp_path / "a.npy", SIZE).shape == (2, 3, 4)
    assert read_matrices(png(tmp_path / "a.png", np.zeros(SIZE, np.uint8)), SIZE).dtype == np.uint8
    assert read_matrices(mat(tmp_path / "a.mat"), SIZE).shape == (2, 3, 4)
    with pytest.raises(ValueError, match=r"a.txt' must have one of the suffixes .csv, .mat, .npy"):
        read_matrices(tmp_path / "a.txt", SIZE)
    with pytest.raises(ValueError, match=r"a.CSV' must have one of the suffixes .npy$"):
        read_matrices(tmp_path / "a.CSV", (12,))
