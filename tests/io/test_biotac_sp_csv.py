import numpy as np
import pytest

from torch_geometric_tactile.io import GraspTable, read_biotac_sp_csv

FINGERS = ("ff", "mf", "th")
HEADER = ["object", "slipped", *(f"{f}_biotac_{i}" for f in FINGERS for i in range(1, 25))]
ROW = ["cup", "1", *(str(100 * f + i) for f in range(3) for i in range(1, 25))]
OTHER = ["box", "0", *("3000" for _ in range(72))]


@pytest.fixture
def write(tmp_path):
    """Writes rows of cells as a file, and returns its path."""

    def write(*rows, end="\n", last=True, encoding="utf-8"):
        text = end.join(",".join(row) for row in rows) + (end if last else "")
        (tmp_path / "grasps.csv").write_bytes(text.encode(encoding))
        return tmp_path / "grasps.csv"

    return write


def changed(column, cell):
    return [cell if name == column else old for name, old in zip(HEADER, ROW, strict=True)]


def test_read_finger_and_electrode_order_by_hand(write):
    table = read_biotac_sp_csv(write(HEADER, ROW, OTHER))
    assert isinstance(table, GraspTable)
    assert table.reading.shape == (2, 24, 3)
    assert table.reading[0, 0].tolist() == [1.0, 101.0, 201.0]
    assert table.reading[0, 23].tolist() == [24.0, 124.0, 224.0]
    assert table.reading[0, :, 1].tolist() == [100.0 + i for i in range(1, 25)]
    assert table.reading[1].tolist() == [[3000.0] * 3] * 24
    assert table.slipped.tolist() == [1, 0]
    assert table.object_names == ["cup", "box"]
    assert (table.reading.dtype, table.slipped.dtype) == (np.float32, np.int64)
    assert table.reading.flags.c_contiguous


def test_read_single_grasp(write):
    assert read_biotac_sp_csv(write(HEADER, ROW)).slipped.tolist() == [1]


@pytest.mark.parametrize(
    "style",
    [
        {"end": "\r\n"},
        {"encoding": "utf-8-sig"},
        {"end": "\r"},
    ],
)
def test_read_is_the_same_in_every_style(write, style):
    plain = read_biotac_sp_csv(write(HEADER, ROW, OTHER))
    table = read_biotac_sp_csv(write(HEADER, ROW, OTHER, **style))
    assert np.array_equal(table.reading, plain.reading)
    assert table.slipped.tolist() == plain.slipped.tolist()
    assert table.object_names == plain.object_names


def test_read_columns_in_another_order_and_further_ones(write):
    order = np.random.default_rng(0).permutation(len(HEADER))
    shuffled = [[f" {row[i]} " for i in order] for row in (HEADER, ROW)]
    shuffled[0].insert(5, "note")
    shuffled[1].insert(5, "wet")
    table, plain = read_biotac_sp_csv(write(*shuffled)), read_biotac_sp_csv(write(HEADER, ROW))
    assert np.array_equal(table.reading, plain.reading)
    assert table.object_names == ["cup"]


def test_read_missing_file(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"gone\.csv' does not exist; put the file"):
        read_biotac_sp_csv(tmp_path / "gone.csv")


def test_read_folder(tmp_path):
    with pytest.raises(FileNotFoundError, match="does not exist"):
        read_biotac_sp_csv(tmp_path)


@pytest.mark.parametrize("column", ["object", "slipped", "mf_biotac_7"])
def test_read_missing_column(write, column):
    rows = [[c for name, c in zip(HEADER, r, strict=True) if name != column] for r in (HEADER, ROW)]
    with pytest.raises(ValueError, match=rf"the column '{column}' \(1 of 74 columns are missing"):
        read_biotac_sp_csv(write(*rows))


def test_read_empty_file(write):
    with pytest.raises(ValueError, match=r"line 1 must not be empty"):
        read_biotac_sp_csv(write([]))
    with pytest.raises(ValueError, match=r"must hold at least one frame \(got an empty file\)"):
        read_biotac_sp_csv(write([], last=False))
    with pytest.raises(ValueError, match=r"the column 'object' \(74 of 74 columns are missing\)"):
        read_biotac_sp_csv(write(["a", "b"]))


def test_read_header_only(write):
    with pytest.raises(ValueError, match=r"at least one grasp \(got a header only\)"):
        read_biotac_sp_csv(write(HEADER))


@pytest.mark.parametrize("cells", [1, 40, 73, 75])
def test_read_cut_line(write, cells):
    with pytest.raises(
        ValueError,
        match=rf"grasps\.csv', line 3 must have 74 cells \(got {cells}\): is the file truncated",
    ):
        read_biotac_sp_csv(write(HEADER, ROW, [*ROW, "1"][:cells], last=False))


@pytest.mark.parametrize(
    ("column", "cell", "message"),
    [
        ("mf_biotac_7", "abc", r"'mf_biotac_7' must be a number \(got 'abc'\)"),
        ("th_biotac_24", "", r"'th_biotac_24' must be a number \(got ''\)"),
        ("ff_biotac_1", "nan", r"'ff_biotac_1' must be a number \(got 'nan'\)"),
        ("ff_biotac_1", "-inf", r"'ff_biotac_1' must be finite \(got '-inf'\)"),
        ("ff_biotac_1", "1e39", r"'ff_biotac_1' must be finite \(got '1e39'\)"),
        ("ff_biotac_1", "3_000", r"'ff_biotac_1' must be a number \(got '3_000'\)"),
        ("slipped", "2", r"'slipped' must be 0 or 1 \(got '2'\)"),
        ("slipped", "0.5", r"'slipped' must be 0 or 1 \(got '0.5'\)"),
        ("slipped", "yes", r"'slipped' must be a number \(got 'yes'\)"),
    ],
)
def test_read_bad_cell_names_line_and_column(write, column, cell, message):
    with pytest.raises(ValueError, match=rf"grasps\.csv', line 3(, column [0-9]+)?: {message}"):
        read_biotac_sp_csv(write(HEADER, OTHER, changed(column, cell), OTHER))


def test_read_refuses_an_empty_line(write):
    with pytest.raises(ValueError, match=r"grasps\.csv', line 3 must not be empty"):
        read_biotac_sp_csv(write(HEADER, ROW, [], OTHER))
    with pytest.raises(ValueError, match=r"grasps\.csv', line 3 must not be empty"):
        read_biotac_sp_csv(write(HEADER, ROW, []))


@pytest.mark.parametrize("cut", [1, 2, 3])
def test_read_refuses_a_last_line_without_end(write, cut):
    path = write(HEADER, ROW, [*OTHER[:-1], "2908"])
    path.write_bytes(path.read_bytes()[:-cut])
    with pytest.raises(ValueError, match=r"grasps\.csv', line 3 must end with a line break: is th"):
        read_biotac_sp_csv(path)


def test_many_columns_are_quick_to_name(write):
    more = [f"c{i}" for i in range(100_000)]
    rows = [[*HEADER, *more], [*ROW, *more]]
    assert read_biotac_sp_csv(write(*rows)).object_names == ["cup"]


def test_read_column_twice(write):
    with pytest.raises(ValueError, match=r"each column once \(got 'mf_biotac_7' twice\)"):
        read_biotac_sp_csv(write([*HEADER, "mf_biotac_7"], [*ROW, "5"]))
    with pytest.raises(ValueError, match=r"each column once \(got '' twice\)"):
        read_biotac_sp_csv(write([*HEADER, "", ""], [*ROW, "", ""]))  # as ',,' for ',' leaves
    assert len(read_biotac_sp_csv(write([*HEADER, "note"], [*ROW, "x"])).reading) == 1


def test_read_what_is_no_text_names_the_file(write):
    path = write(HEADER, changed("object", "caf\xe9"), encoding="latin-1")
    with pytest.raises(ValueError, match=r"grasps\.csv' cannot be read as CSV"):
        read_biotac_sp_csv(path)
    with pytest.raises(ValueError, match=r"grasps\.csv' cannot be read as CSV"):
        read_biotac_sp_csv(write(HEADER, changed("object", "a" * 200_000)))
