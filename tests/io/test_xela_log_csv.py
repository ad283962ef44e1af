import numpy as np
import pytest

from torch_geometric_tactile.io._xela_log_csv import read_xela_log_csv

# The first columns and rows of a real log of a calibrated uSPa44 (github.com/matteogrisenti/
# Xela_uSP44, press_test.csv), in which unchanged readings come with new numbers and times.
REAL = """\
Receive time,Send time,Message number,1X,1Y,1Z,2X,2Y,2Z,Force 1X,Force 1Y,Force 1Z,\
Force 2X,Force 2Y,Force 2Z
1780409804.2941301,1780409804.2935727,1546289,33090,33186,37904,32809,32448,37452,\
-0.02315,-0.03525,0.0216,-0.01202,-0.03307,0.00229
1780409804.2959442,1780409804.2952921,1546290,33090,33186,37904,32809,32448,37452,\
-0.02315,-0.03525,0.0216,-0.01202,-0.03307,0.00229
1780409804.2992971,1780409804.2989731,1546292,33090,33186,37904,32811,32449,37451,\
-0.02315,-0.03525,0.0216,-0.00782,-0.03169,0.0017
"""
HEADER = "Receive time,Send time,Message number,1X,1Y,1Z"


@pytest.fixture
def write(tmp_path):
    """Writes a text as a file, and returns its path."""

    def write(text):
        (tmp_path / "log.csv").write_bytes(text.encode())
        return tmp_path / "log.csv"

    return write


def test_read_counts_of_a_real_log(write):
    rec = read_xela_log_csv(write(REAL))
    assert rec.time.tolist() == [1780409804.2935727, 1780409804.2989731]
    assert rec.tactile.tolist() == [
        [[33090, 33186, 37904], [32809, 32448, 37452]],
        [[33090, 33186, 37904], [32811, 32449, 37451]],
    ]
    assert rec.meta == {"sensor": "XELA uSkin", "unit": "count", "stale_rows": 1}


def test_read_forces_of_a_real_log(write):
    rec = read_xela_log_csv(write(REAL), forces=True)
    assert rec.meta == {"sensor": "XELA uSkin", "unit": "newton", "stale_rows": 1}
    expected = np.float32([[-0.02315, -0.03525, 0.0216], [-0.00782, -0.03169, 0.0017]])
    assert np.array_equal(rec.tactile[1], expected)


@pytest.mark.parametrize("num_taxels", [1, 16, 24])
def test_read_sizes_from_the_header_in_any_order(write, num_taxels):
    names = [f"{i}{axis}" for i in range(1, num_taxels + 1) for axis in "XYZ"]
    values = [str(i) for i in range(len(names))]
    order = np.random.default_rng(0).permutation(len(names))
    header = ",".join(["Message number", "Send time", "Note", *(names[i] for i in order)])
    row = ",".join(["1", "0.5", "7", *(values[i] for i in order)])
    rec = read_xela_log_csv(write(f"{header}\n{row}\n"))
    assert rec.tactile.shape == (1, num_taxels, 3)
    assert rec.tactile.ravel().tolist() == list(range(3 * num_taxels))


@pytest.mark.parametrize(
    ("rows", "times", "stale"),
    [
        (["0,1,1,1,1,1", "0,2,2,1,1,1", "0,3,3,1,1,2"], [1, 3], 1),  # the same readings
        (["0,1,1,1,1,1", "0,2,1,1,1,2", "0,3,2,1,1,3"], [1, 3], 1),  # the same number
        (["0,1,1,1,1,1", "0,1,2,1,1,2", "0,3,3,1,1,3"], [1, 3], 1),  # the same time
        (["0,1,1,1,,1", "0,2,2,1,,1", "0,3,3,1,1,1"], [1, 3], 1),  # the same, one missing
        (["0,1,1,1,1,1", "0,2,2,2,1,1", "0,3,3,1,1,1"], [1, 2, 3], 0),
    ],
)
def test_read_drops_and_counts_repeats(write, rows, times, stale):
    rec = read_xela_log_csv(write("\n".join([HEADER, *rows]) + "\n"))
    assert rec.time.tolist() == times
    assert rec.meta["stale_rows"] == stale


@pytest.mark.parametrize(
    ("text", "forces", "message"),
    [
        (
            "time,taxel_0_x\n0,1\n",
            False,
            r"must have the column 'Send time', as xela_log",
        ),
        (
            "Send time,1X,1Y,1Z\n",
            False,
            r"column 'Message number', .*\(got 'Send time', '1X', '1Y'\)",
        ),
        (HEADER[:-6] + "\n", False, r"must have the column '1Y', since it has taxel 1"),
        (f"{HEADER[:-9]},a,b,c,d\n", False, r"the column '1X' \(got 'Receive .*, 'a', 'b', 'c'\)"),
        (f"{HEADER},3X,3Y,3Z\n", False, r"the column '2X', since it has taxel 3 \(got 6 of 9"),
        (f"{HEADER}\n0,1,1,1,2,3\n", True, r"'Force 1X' for forces .* \(got counts only\)"),
        (f"{HEADER},Force 1X\n", False, r"must have the column 'Force 1Y'"),
        (
            f"{HEADER}\n0,2,1,1,2,3\n0,1,2,2,2,3\n",
            False,
            r"log.csv', line 3: 'Send time' must increase \(got 1.0 s after 2.0 s\)",
        ),
    ],
)
def test_read_refuses(write, text, forces, message):
    with pytest.raises(ValueError, match=message):
        read_xela_log_csv(write(text), forces=forces)


def test_six_columns_that_are_not_read_are_named(write, caplog):
    read_xela_log_csv(write(f"{HEADER},a,b,c,d,e,f,g\n0,1,1,1,2,3,4,5,6,7,8,9,10\n"))
    assert "columns that are not read: 'a', 'b', 'c', 'd', 'e', 'f'\n" in caplog.text


def test_read_columns_that_count_from_zero(write):
    header = "Receive time,Send time,Message number,0X,0Y,0Z,1X,1Y,1Z,Force 0X,Force 0Y,Force 0Z"
    path = write(f"{header}\n0,1,1,7,8,9,10,11,12,0.5,0.25,0\n")
    assert read_xela_log_csv(path).tactile.tolist() == [[[7, 8, 9], [10, 11, 12]]]
    assert read_xela_log_csv(path, forces=True).tactile.tolist() == [[[0.5, 0.25, 0]]]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (f"{HEADER},01x\n0,1,1,1,2,3,4\n", r"name each column once \(got '1X' and '01x'\)"),
        (
            f"{HEADER},99999999X\n0,1,1,1,2,3,4\n",
            r"the column '2X', since it has taxel 99999999 \(got 4 of 299999997 columns",
        ),
        (f"{HEADER.replace('1X', '0X')}\n0,1,1,1,2,3\n", r"must have the column '0Y'"),
        (f"{HEADER},\u0662X,2Y,2Z\n0,1,1,1,2,3,4,5,6\n", r"must have the column '2X'"),
    ],
)
def test_read_refuses_what_would_be_wrong_in_silence(write, text, message):
    with pytest.raises(ValueError, match=message):
        read_xela_log_csv(write(text))
