import logging

import numpy as np
import pytest

from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io import read_wide_csv, write_wide_csv

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
    with pytest.raises(ValueError, match=r"'num_joints' must be 1, as '.*hand.csv' has \(got 16\)"):
        read_wide_csv(write(HEADER, f"0,{ROW}"), num_joints=16)


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
        "a.csv' is CSV and cannot hold label, object, object_pose, pac, phase, pressure"
        in caplog.text
    )
    caplog.clear()
    with caplog.at_level(logging.WARNING):
        write_wide_csv(Recording(full.time, full.tactile, full.joint), tmp_path / "a.csv")
    assert not caplog.text


def test_write_refuses_no_frame(tmp_path):
    with pytest.raises(ValueError, match=r"at least one frame to be a CSV file \(got none\)"):
        write_wide_csv(Recording([], np.zeros((0, 1, 1))), tmp_path / "a.csv")


def test_read_full_size(tmp_path):
    tactile = np.random.default_rng(0).normal(size=(1700, 384, 3))
    rec = Recording(np.arange(1700) / 100, tactile, np.zeros((1700, 16)))
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
        ([ROW, "1,2,x,4,5,6,7"], r"line 2, column 3: 'taxel_0_z' must be a number \(got 'x'\)"),
        (["1,2,x,4,5,6,7"], r"line 1, column 3: 'taxel_0_z' must be a number \(got 'x'\)"),
        ([ROW, "1,inf,3,4,5,6,7"], r"line 2, column 2: 'taxel_0_y' must be finite, .*'inf'\)"),
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
