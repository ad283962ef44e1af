import numpy as np
import pytest

from torch_geometric_tactile.io._biotac_sp_csv import (
    GraspTable,
    read_biotac_sp_csv,
    read_biotac_sp_dos_csv,
)

FINGERS = ("ff", "mf", "th")
HEADER = ["object", "slipped", *(f"{f}_biotac_{i}" for f in FINGERS for i in range(1, 25))]
ROW = ["cup", "1", *(str(100 * f + i) for f in range(3) for i in range(1, 25))]
OTHER = ["box", "0", *("3000" for _ in range(72))]


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


@pytest.mark.parametrize("column", ["object", "slipped", "mf_biotac_7"])
def test_read_missing_column(write, column):
    rows = [[c for name, c in zip(HEADER, r, strict=True) if name != column] for r in (HEADER, ROW)]
    with pytest.raises(ValueError, match=rf"the column '{column}' \(1 of 74 columns are missing"):
        read_biotac_sp_csv(write(*rows))


@pytest.mark.parametrize(
    ("column", "cell", "message"),
    [
        ("slipped", "2", r"'slipped' must be 0 or 1 \(got '2'\)"),
        ("slipped", "0.5", r"'slipped' must be 0 or 1 \(got '0.5'\)"),
        ("slipped", "yes", r"'slipped' must be a number \(got 'yes'\)"),
    ],
)
def test_read_bad_cell_names_line_and_column(write, column, cell, message):
    with pytest.raises(ValueError, match=rf"hand\.csv', line 3(, column [0-9]+)?: {message}"):
        read_biotac_sp_csv(write(HEADER, OTHER, changed(column, cell), OTHER))


def test_many_columns_are_quick_to_name(write):
    more = [f"c{i}" for i in range(100_000)]
    rows = [[*HEADER, *more], [*ROW, *more]]
    assert read_biotac_sp_csv(write(*rows)).object_names == ["cup"]


def test_read_column_twice(write):
    with pytest.raises(ValueError, match=r"each column once \(got 'x' twice\)"):
        read_biotac_sp_csv(write([*HEADER, "x", "x"], [*ROW, "", ""]))
    assert len(read_biotac_sp_csv(write([*HEADER, "note"], [*ROW, "x"])).reading) == 1


NAMES = [f"ff_e{i}" for i in range(1, 25)]


def slips(write, names=NAMES, change=lambda lines: lines):
    """A file of directions of slip, of three frames of counts."""
    rows = [[str(3000 + 24 * t + i) for i in range(len(names))] for t in range(3)]
    return write(*change([",".join(row) for row in (names, *rows)]))


def test_slips_by_hand(write):
    rec = read_biotac_sp_dos_csv(slips(write))
    assert rec.tactile.shape == (3, 24, 1)
    assert rec.tactile[:, 0, 0].tolist() == [3000, 3024, 3048]
    assert rec.tactile[1, :, 0].tolist() == [3024 + i for i in range(24)]
    assert rec.time.tolist() == [0, 0.01, 0.02]
    assert rec.meta == {"sensor": "biotac_sp", "unit": "count", "rate": 100.0}
    assert rec.label is None


def test_columns_of_slips_are_found_by_their_names(write):
    expected = read_biotac_sp_dos_csv(slips(write)).tactile
    found = read_biotac_sp_dos_csv(slips(write, NAMES[::-1])).tactile
    assert np.array_equal(found, expected[:, ::-1])


def test_two_more_fingers_are_left_out(write):
    names = NAMES + [f"{finger}_e{i}" for finger in ("mf", "th") for i in range(1, 25)]
    rec = read_biotac_sp_dos_csv(slips(write, names))
    assert rec.tactile[2, :, 0].tolist() == [3048 + i for i in range(24)]


@pytest.mark.parametrize(
    ("change", "message"),
    [
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
    ],
)
def test_slips_refused(change, message, write):
    path = slips(write, change=change)
    with pytest.raises(ValueError, match=message) as caught:
        read_biotac_sp_dos_csv(path)
    assert "hand.csv'" in str(caught.value)
