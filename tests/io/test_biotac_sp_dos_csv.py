import numpy as np
import pytest

from torch_geometric_tactile.io import read_biotac_sp_dos_csv

NAMES = [f"ff_e{i}" for i in range(1, 25)]


def write(path, names=NAMES, frames=3, end="\n", change=lambda lines: lines):
    lines = [",".join(names)]
    lines += [",".join(str(3000 + 24 * t + i) for i in range(len(names))) for t in range(frames)]
    path.write_bytes("".join(f"{line}{end}" for line in change(lines)).encode())
    return path


def test_read_by_hand(tmp_path):
    rec = read_biotac_sp_dos_csv(write(tmp_path / "a.csv"))
    assert rec.tactile.shape == (3, 24, 1)
    assert rec.tactile[:, 0, 0].tolist() == [3000, 3024, 3048]
    assert rec.tactile[1, :, 0].tolist() == [3024 + i for i in range(24)]
    assert rec.time.tolist() == [0, 0.01, 0.02]
    assert rec.meta == {"sensor": "biotac_sp", "unit": "count", "rate": 100.0}
    assert rec.label is None


def test_columns_are_found_by_their_names(tmp_path):
    expected = read_biotac_sp_dos_csv(write(tmp_path / "a.csv")).tactile
    found = read_biotac_sp_dos_csv(write(tmp_path / "b.csv", NAMES[::-1])).tactile
    assert np.array_equal(found, expected[:, ::-1])


def test_two_more_fingers_are_left_out(tmp_path):
    names = NAMES + [f"{finger}_e{i}" for finger in ("mf", "th") for i in range(1, 25)]
    rec = read_biotac_sp_dos_csv(write(tmp_path / "a.csv", names))
    assert rec.tactile[2, :, 0].tolist() == [3048 + i for i in range(24)]


@pytest.mark.parametrize("end", ["\r\n", "\r"])
def test_other_line_ends_and_a_byte_order_mark(end, tmp_path):
    expected = read_biotac_sp_dos_csv(write(tmp_path / "a.csv")).tactile
    path = write(tmp_path / "b.csv", end=end)
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    assert np.array_equal(read_biotac_sp_dos_csv(path).tactile, expected)


def cell(text):
    def change(lines):
        return [*lines[:2], lines[2].replace("3027", text), *lines[3:]]

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (cell("x"), r"line 3, column 4: 'ff_e4' must be a number \(got 'x'\)"),
        (cell(""), r"line 3, column 4: 'ff_e4' must be a number \(got ''\)"),
        (cell("nan"), r"line 3, column 4: 'ff_e4' must be a number \(got 'nan'\)"),
        (cell("1e39"), r"line 3, column 4: 'ff_e4' must be finite"),
        (cell("1_0"), r"line 3, column 4: 'ff_e4' must be a number"),
        (lambda lines: lines[:1], r"at least one frame \(got a header only\)"),
        (lambda lines: [], r"at least one frame \(got an empty file\)"),
        (lambda lines: [*lines, ""], r"line 5 must not be empty"),
        (lambda lines: [*lines, "1,2"], r"line 5 must have 24 cells \(got 2\)"),
        (lambda lines: lines[1:], r"columns 'ff_e1' to 'ff_e24' only \(got '3000'\)"),
        (lambda lines: [f"{line},9" for line in lines], r"'ff_e24' only \(got '9'\)"),
        (lambda lines: [f",{line}" for line in lines], r"'ff_e24' only \(got ''\)"),
        (
            lambda lines: [line.rpartition(",")[0] for line in lines],
            r"must have the column 'ff_e24' \(1 of 24 columns are missing\)",
        ),
        (
            lambda lines: [lines[0] + ",th_e3", *(f"{line},1" for line in lines[1:])],
            r"must have the column 'mf_e1' \(47 of 72 columns are missing\)",
        ),
        (
            lambda lines: [lines[0].replace("ff_e5", "ff_e4"), *lines[1:]],
            r"must name each column once \(got 'ff_e4' twice\)",
        ),
    ],
)
def test_refuses(change, message, tmp_path):
    path = write(tmp_path / "a.csv", change=change)
    with pytest.raises(ValueError, match=message) as caught:
        read_biotac_sp_dos_csv(path)
    assert "a.csv'" in str(caught.value)


def test_cut_at_any_byte_is_refused_or_has_whole_frames(tmp_path):
    path = write(tmp_path / "a.csv")
    whole = path.read_bytes()
    expected = read_biotac_sp_dos_csv(path).tactile
    for size in range(len(whole)):
        path.write_bytes(whole[:size])
        frames = whole[:size].count(b"\n") - 1
        if frames > 0 and whole[:size].endswith(b"\n"):
            assert np.array_equal(read_biotac_sp_dos_csv(path).tactile, expected[:frames])
        else:
            with pytest.raises(ValueError, match=r"a.csv'"):
                read_biotac_sp_dos_csv(path)


def test_no_such_file(tmp_path):
    with pytest.raises(
        FileNotFoundError, match=r"gone.csv' does not exist; put the file of BioTac"
    ):
        read_biotac_sp_dos_csv(tmp_path / "gone.csv")


def test_no_text(tmp_path):
    (tmp_path / "a.csv").write_bytes(b"\xff\xfe\x00\n")
    with pytest.raises(ValueError, match=r"a.csv' cannot be read as CSV"):
        read_biotac_sp_dos_csv(tmp_path / "a.csv")
