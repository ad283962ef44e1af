import logging

import numpy as np
import pytest

from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io import read_recording
from torch_geometric_tactile.io._csv_frames import READING_UNITS
from torch_geometric_tactile.io._wide_csv import read_wide_csv, write_wide_csv

SMALL = {"num_taxels": 2, "num_channels": 3, "num_joints": 1}
ROW = "1,2,3,4,5,6,0.5"
HEADER = "time,taxel_0_x,taxel_0_y,taxel_0_z,taxel_1_x,taxel_1_y,taxel_1_z,joint_0"


def test_read_order_of_columns_by_hand(write):
    rec = read_wide_csv(write(ROW, "7,8,9,10,11,12,-1"), **SMALL, rate=50)
    assert rec.tactile.tolist() == [[[1, 2, 3], [4, 5, 6]], [[7, 8, 9], [10, 11, 12]]]
    assert rec.joint.tolist() == [[0.5], [-1]]
    assert rec.time.tolist() == [0, 0.02]


def test_read_time_in_front(write):
    rec = read_wide_csv(write(f"0.5,{ROW}", f"0.75,{ROW}"), **SMALL)
    assert rec.time.tolist() == [0.5, 0.75]
    assert rec.tactile[1].tolist() == [[1, 2, 3], [4, 5, 6]]


@pytest.mark.parametrize(
    "lines",
    [
        [HEADER, f"0,{ROW}"],
        [HEADER.removeprefix("time,"), ROW],
        [f"0.0,{ROW}"],
        [ROW],
    ],
)
@pytest.mark.parametrize("style", [{}, {"end": "\r\n"}, {"mark": "\ufeff"}])
def test_read_headers_and_styles(write, lines, style):
    rec = read_wide_csv(write(*lines, **style), **SMALL)
    assert rec.tactile.tolist() == [[[1, 2, 3], [4, 5, 6]]]
    assert rec.joint.tolist() == [[0.5]]


def test_read_our_header_tells_the_sizes(write):
    rec = read_wide_csv(write(HEADER, f"0,{ROW}"))
    assert (rec.num_taxels, rec.num_channels, rec.num_joints) == (2, 3, 1)
    with pytest.raises(ValueError, match=r"'num_joints' must be 1, as in '.*hand.csv' \(got 16\)"):
        read_wide_csv(write(HEADER, f"0,{ROW}"), num_joints=16)


def test_actions_come_back_in_any_order_of_columns(write, assert_same, tmp_path):
    rec = Recording(
        [0.0, 0.1], [[[1.0]], [[2.0]]], joint=[[3.0], [4.0]], action=[[50.0, 6.0], [np.nan, 7.0]]
    )
    write_wide_csv(rec, tmp_path / "a.csv")
    header, *_ = (tmp_path / "a.csv").read_text().splitlines()
    assert header == "time,taxel_0_x,joint_0,action_0,action_1"
    assert_same(read_wide_csv(tmp_path / "a.csv"), rec)
    mixed = write("action_1,time,action_0,taxel_0_x,joint_0", "6,0,50,1,3", "7,0.1,,2,4")
    assert_same(read_wide_csv(mixed), rec)
    with pytest.raises(ValueError, match="must have the column 'action_1'"):
        read_wide_csv(write("time,taxel_0_x,action_0,action_2", "0,1,2,3"))


def test_read_missing_cells(write):
    rec = read_wide_csv(write("1,,nan,4, ,NaN,", ROW), **SMALL)
    assert np.isnan(rec.tactile[0]).tolist() == [[False, True, True], [False, True, True]]
    assert np.isnan(rec.joint[0]).tolist() == [True]
    assert rec.tactile[1].tolist() == [[1, 2, 3], [4, 5, 6]]


def test_read_without_joints(write):
    assert read_wide_csv(write("1,2"), num_taxels=2, num_channels=1, num_joints=0).joint is None


@pytest.mark.parametrize("num_joints", [0, 2])
@pytest.mark.parametrize("num_channels", [1, 3, 5])
@pytest.mark.parametrize("num_taxels", [1, 3])
def test_round_trip_gives_equal_numbers(
    num_taxels, num_channels, num_joints, assert_same, tmp_path
):
    draw = np.random.default_rng(num_taxels)
    tactile = draw.normal(size=(30, num_taxels, num_channels)) * 10.0 ** draw.integers(-30, 30)
    tactile[draw.random(tactile.shape) > 0.8] = np.nan
    joint = draw.normal(size=(30, num_joints)) if num_joints else None
    rec = Recording(1.78e9 + np.cumsum(draw.random(30) + 0.001), tactile, joint)
    write_wide_csv(rec, tmp_path / "a.csv")
    assert_same(read_wide_csv(tmp_path / "a.csv"), rec)


def test_write_by_hand(tmp_path):
    write_wide_csv(
        Recording([0.0, 0.1], [[[33090.0], [np.nan]], [[0.5], [-1.0]]]), tmp_path / "a.csv"
    )
    assert (tmp_path / "a.csv").read_text() == (
        "time,taxel_0_x,taxel_1_x\n0.0,33090,nan\n0.1,0.5,-1\n"
    )


def test_write_says_what_is_lost(full, caplog, tmp_path):
    write_wide_csv(full, tmp_path / "a.csv")
    assert (
        "a.csv' is CSV and cannot store label, object, object_pose, pac, phase, pressure"
        in caplog.text
    )
    caplog.clear()
    with caplog.at_level(logging.WARNING):
        write_wide_csv(Recording(full.time, full.tactile, full.joint), tmp_path / "a.csv")
    assert not caplog.text


def test_write_refuses_no_frame(tmp_path):
    with pytest.raises(ValueError, match=r"at least one frame to be written as CSV \(got none\)"):
        write_wide_csv(Recording([], np.zeros((0, 1, 1))), tmp_path / "a.csv")


def test_read_full_size(tmp_path):
    tactile = np.random.default_rng(0).normal(size=(300, 384, 3))
    rec = Recording(np.arange(300) / 100, tactile, np.zeros((300, 16)))
    write_wide_csv(rec, tmp_path / "a.csv")
    lines = (tmp_path / "a.csv").read_text().splitlines()
    (tmp_path / "a.csv").write_text("".join(line.partition(",")[2] + "\n" for line in lines[1:]))
    assert np.array_equal(read_wide_csv(tmp_path / "a.csv").tactile, rec.tactile)


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ([ROW, "1,2,3"], r"line 2 must have 7 cells \(got 3\): is the file truncated"),
        ([ROW, ROW, f"{ROW},1"], r"line 3 must have 7 cells \(got 8\)"),
        (["1,2,3"], r"line 1 must have 7 cells for 2 taxels of 3 channels and 1 joints, or 8 with"),
        (["1,2,x,4,5,6,7"], r"line 1, column 3: 'taxel_0_z' must be a number \(got 'x'\)"),
        (
            [HEADER, f"0.2,{ROW}", f"0.2,{ROW}"],
            r"line 3: 'time' must increase \(got 0.2 s after 0.2 s\)",
        ),
        ([f"0.5,{ROW}", f"0.25,{ROW}"], r"line 2: 'time' must increase \(got 0.25 s after 0.5 s"),
        ([HEADER, f",{ROW}"], r"line 2, column 1: 'time' must be a number \(got ''\)"),
    ],
)
def test_read_bad_lines(write, lines, message):
    with pytest.raises(ValueError, match=rf"hand\.csv', {message}"):
        read_wide_csv(write(*lines), **SMALL)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"rate": 0}, r"'rate' must be positive \(got 0\)"),
        ({"num_taxels": 0}, r"'num_taxels' must be at least 1 \(got 0\)"),
        ({"num_joints": -1}, r"'num_joints' must be at least 0 \(got -1\)"),
    ],
)
def test_read_bad_arguments(write, arguments, message):
    with pytest.raises(ValueError, match=message):
        read_wide_csv(write(ROW), **{**SMALL, **arguments})


@pytest.mark.parametrize(("name", "warns"), [("time", True), ("time_ms", False)])
def test_frames_that_are_seconds_apart_are_noticed(tmp_path, caplog, name, warns):
    (tmp_path / "a.csv").write_text(f"{name},taxel_0_x\n0,1\n10,1\n")
    read_wide_csv(tmp_path / "a.csv")
    assert ("name the column time_ms" in caplog.text) == warns


# Two taxels of three axes and two joints: the value of a column tells which one it is.
VALUES = {
    "time": "0.5",
    "taxel_0_x": "1",
    "taxel_0_y": "2",
    "taxel_0_z": "3",
    "taxel_1_x": "4",
    "taxel_1_y": "5",
    "taxel_1_z": "6",
    "joint_0": "-0.25",
    "joint_1": "0.75",
}
TAXELS = [name for name in VALUES if name.startswith("taxel")]
JOINTS = ["joint_0", "joint_1"]
TWO_JOINTS = {**SMALL, "num_joints": 2}


@pytest.mark.parametrize(
    "order",
    [
        ["time", *sorted(TAXELS, key=lambda name: name[-1]), *JOINTS],  # axis by axis
        ["time", *sorted(TAXELS, key=lambda name: (name[6], -ord(name[-1]))), *JOINTS],  # z, y, x
        ["time", *TAXELS[3:], *TAXELS[:3], *JOINTS],
        ["time", *JOINTS[::-1], *TAXELS],
        [*TAXELS, "time", *JOINTS],
        [*JOINTS, *TAXELS, "time"],
    ],
)
def test_columns_are_read_by_name(write, order):
    rec = read_wide_csv(write(",".join(order), ",".join(VALUES[name] for name in order)))
    assert rec.tactile.tolist() == [[[1, 2, 3], [4, 5, 6]]]
    assert rec.joint.tolist() == [[-0.25, 0.75]]
    assert rec.time.tolist() == [0.5]


def test_written_columns_are_read_in_any_order(tmp_path, assert_same):
    draw = np.random.default_rng(0)
    rec = Recording([0.25, 0.5], draw.normal(size=(2, 12, 4)), draw.normal(size=(2, 11)))
    write_wide_csv(rec, tmp_path / "a.csv")
    rows = [line.split(",") for line in (tmp_path / "a.csv").read_text().splitlines()]
    order = draw.permutation(len(rows[0]))
    (tmp_path / "b.csv").write_text("".join(",".join(r[i] for i in order) + "\n" for r in rows))
    assert_same(read_wide_csv(tmp_path / "b.csv"), rec)


@pytest.mark.parametrize(
    ("name", "cell", "seconds"),
    [
        ("time_s", "0.3", 0.3),
        ("time_s", "100000000000", 1e11),
        ("Time", "0.3", 0.3),
        ("timestamp_us", "3", 3e-6),
        ("timestamp_ns", "1768398006957662101", 1768398006.957662101),
        ("time_ns", " 7 ", 7e-9),
    ],
)
def test_units_of_the_time(write, name, cell, seconds):
    assert read_wide_csv(write(f"{name},taxel_0_x", f"{cell},1")).time.tolist() == [seconds]


def test_units_of_joints_and_readings(write):
    rec = read_wide_csv(write("joint_1_rad,taxel_0_x_mn,joint_0_deg", "0.5,250,90", ",,45"))
    assert rec.joint.tolist() == pytest.approx(
        np.float32([[np.pi / 2, 0.5], [np.pi / 4, np.nan]]), nan_ok=True
    )
    assert rec.tactile[0].tolist() == [[0.25]]
    assert rec.meta == {"unit": "newton"}
    assert read_wide_csv(write("taxel_0_x_n", "250")).tactile.tolist() == [[[250]]]
    assert read_wide_csv(write("taxel_0_x_count", "250")).meta == {"unit": "count"}
    assert read_wide_csv(write("taxel_0_x", "250")).meta == {}


@pytest.mark.parametrize(
    "names",
    [
        "time_minutes,taxel_0_x",
        "taxel_0_x,joint_0_turns",
        "taxel_0_x_kg,joint_0",
        "taxel_0_w,joint_0",
        "taxel_0_x,note",
        "a,b",
    ],
)
def test_names_that_are_not_understood(write, names):
    with pytest.raises(
        ValueError,
        match=r"line 1 must name the columns 'time', 'taxel_0_x', .* \(got '.*'\): rename .* "
        r"read_named_csv\(path, tactile=.* options of tactile convert",
    ):
        read_wide_csv(write(names, "1,2"), num_taxels=1, num_channels=1, num_joints=1)


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (
            "taxel_1_x,taxel_2_x",
            r"have the column 'taxel_0_x': taxels, joints and actions count from",
        ),
        ("taxel_0_x,joint_999999999", r"have the column 'joint_0'"),
        ("taxel_0_x,taxel_0_y,taxel_1_x", r"have the column 'taxel_1_y'"),
        ("taxel_0_z", r"have the axes x for taxels of 1 channels \(got z\)"),
        ("taxel_0_0,taxel_0_1", r"have the axes x, y for taxels of 2 channels \(got 0, 1\)"),
        ("taxel_0_x,taxel_0_x", r"name each column once \(got 'taxel_0_x' twice\)"),
        ("taxel_0_x,TAXEL_00_X", r"name each column once \(got 'taxel_0_x' and 'TAXEL_00_X'\)"),
        (
            "taxel_0_x,joint_0,joint_0_deg",
            r"name each column once \(got 'joint_0' and 'joint_0_deg'",
        ),
        ("taxel_0_x,time,timestamp", r"have one time column \(got time, timestamp\)"),
        ("taxel_0_x,taxel_0_y_n", r"have all readings in one unit \(got \['None', 'n'\]\)"),
    ],
)
def test_names_that_contradict(write, names, message):
    with pytest.raises(ValueError, match=rf"hand.csv', line 1 must {message}"):
        read_wide_csv(write(names, "1"))


@pytest.mark.parametrize("cell", ["1768398006957662101", "100000000001", "-100000000001"])
def test_a_time_without_its_unit(write, cell):
    with pytest.raises(
        ValueError, match=rf"line 2, column 1: 'timestamp' must be in s \(got '{cell}'.*time_ns"
    ):
        read_wide_csv(write("timestamp,taxel_0_x", f"{cell},1"))


@pytest.mark.parametrize("line", ["0,1,2,3,4,5,6,7", "0,1,2,3,4,5,6,7,8", ",0,1,2,3,4,5,6,7"])
def test_header_of_numbers_by_pandas(write, line):
    path = write(line, line)
    with pytest.raises(
        ValueError, match=r"line 1 must hold names .* to_csv\(header=False, index=F"
    ):
        read_wide_csv(path, **TWO_JOINTS)


def test_a_frame_that_counts_is_read_when_it_is_said_to_be_one(write):
    rec = read_wide_csv(write("0,1,2,3,4,5,6,7"), **TWO_JOINTS, header=False)
    assert rec.tactile.tolist() == [[[0, 1, 2], [3, 4, 5]]]


@pytest.mark.parametrize("first", ["", "Unnamed: 0"])
def test_index_of_pandas_under_names(write, first):
    path = write(f"{first},{','.join(VALUES)}", f"0,{','.join(VALUES.values())}")
    with pytest.raises(ValueError, match=r"must name column 1 .* to_csv\(index=False\)"):
        read_wide_csv(path)
    with pytest.raises(ValueError, match=r"must name column 1 .* to_csv\(index=False\)"):
        read_recording(path)


def test_index_of_pandas_without_names(write):
    rows = [f"{i},1,2,3,4,5,6,0.5,0.5" for i in range(3)]
    with pytest.raises(ValueError, match=r"time in seconds in its first column .*index=False"):
        read_wide_csv(write(*rows), **TWO_JOINTS)
    with pytest.raises(ValueError, match=r"time in seconds in its first column .*index=False"):
        read_wide_csv(write(*rows), **TWO_JOINTS, header=False)
    assert read_wide_csv(write("0.0" + rows[0][1:], *rows[1:]), **TWO_JOINTS).time.tolist() == [
        0,
        1,
        2,
    ]


def test_without_names_only_with_sizes_or_as_the_hand(write):
    with pytest.raises(ValueError, match=r"line 1 must have 1168 cells .* or give num_taxels, num"):
        read_wide_csv(write("1,2,3"))
    numbers = ",".join(str(i % 7) for i in range(1168))
    rec = read_wide_csv(write(numbers))
    assert (rec.num_taxels, rec.num_channels, rec.num_joints) == (384, 3, 16)
    with pytest.raises(ValueError, match=r"line 1 must name the columns 'time'"):
        read_wide_csv(write(",".join(f"c{i}" for i in range(1168)), numbers))


def test_header_told_to_be_there_or_not(write):
    with pytest.raises(ValueError, match=r"line 1, column 1: 'taxel_0_x' must be a number \(got"):
        read_wide_csv(write(*[",".join(list(VALUES)[1:])] * 2), **TWO_JOINTS, header=False)
    with pytest.raises(ValueError, match=r"line 1 must name the columns .*\(got '1'\)"):
        read_wide_csv(write("1,2,3,4,5,6,7,8"), **TWO_JOINTS, header=True)


def test_a_frame_without_readings_is_missing(write):
    names = ",".join(list(VALUES)[:7])
    rec = read_wide_csv(write(names, "0,1,2,3,4,5,6", "1,,,,,,", "2,1,2,3,4,5,6"))
    assert rec.time.tolist() == [0, 1, 2]
    assert rec.missing.tolist() == [[False] * 2, [True] * 2, [False] * 2]
    rec = read_wide_csv(write(",,,,,", "1,2,3,4,5,6", ",,,,,"), 2, 3, 0)
    assert rec.missing.tolist() == [[True] * 2, [False] * 2, [True] * 2]


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (["", "taxel_0_x,time", "1,0.5"], r"line 1 must not be empty"),
        (
            ["taxel_0_x,time", ",", "1,0.75"],
            r"line 2, column 2: 'time' must be a number",
        ),
        ([":".join(VALUES), "1"], r"line 1 must name the columns"),
    ],
)
def test_lines_refused(write, lines, message):
    with pytest.raises(ValueError, match=rf"hand\.csv'.*{message}"):
        read_wide_csv(write(*lines))


def test_a_first_line_of_na_is_no_header_that_vanishes(write):
    line = ",".join(["NA"] * 1168)
    with pytest.raises(ValueError, match=r"line 1 must name the columns .*\(got 'NA'\)"):
        read_recording(write(line, ",".join(["1"] * 1168)))


def test_many_names_are_quick_to_understand(write):
    names = ["time", *(f"taxel_{i}_{i}" for i in range(30_000))]
    with pytest.raises(ValueError, match=r"must have the column 'taxel_0_1'"):
        read_wide_csv(write(",".join(names), "1"))
    names = [f"note_{i}" for i in range(30_000)]
    with pytest.raises(ValueError, match=r"must name the columns .*\(got 'note_0'\)"):
        read_wide_csv(write(",".join(["taxel_0_x", *names]), "1"))


@pytest.mark.parametrize(
    ("suffix", "unit", "expected"),
    [
        ("_n", "newton", 1.5),
        ("_newton", "newton", 1.5),
        ("_mn", "newton", 0.0015),
        ("_count", "count", 1.5),
        ("_counts", "count", 1.5),
        ("", None, 1.5),
    ],
)
def test_units_of_columns_and_their_factors(tmp_path, suffix, unit, expected):
    (tmp_path / "a.csv").write_text(f"time,taxel_0_x{suffix}\n0,1.5\n0.5,1.5\n")
    recording = read_wide_csv(tmp_path / "a.csv")
    assert recording.meta.get("unit") == unit
    assert recording.tactile.reshape(-1).tolist() == pytest.approx([expected, expected])


def test_every_unit_of_columns_is_tested():
    names = {"n", "newton", "mn", "count", "counts"}
    assert set(READING_UNITS) == names
