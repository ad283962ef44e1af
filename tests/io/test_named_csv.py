import numpy as np
import pytest

from torch_geometric_tactile.io import read_recording
from torch_geometric_tactile.io._named_csv import read_named_csv
from torch_geometric_tactile.io.recording_files import recording_format

HEADER = "Time,thumb,index,bend,grasp"


def test_read_by_hand(write):
    path = write(HEADER, "0,1,2,0.5,mug", "20,3,,0.25,mug")
    rec = read_named_csv(path, joint=["bend"], label="grasp", time_unit="ms", unit="count")
    assert rec.time.tolist() == [0.0, 0.02]
    assert np.array_equal(rec.tactile, [[[1], [2]], [[3], [np.nan]]], equal_nan=True)
    assert rec.joint.tolist() == [[0.5], [0.25]]
    assert rec.label == "mug"
    assert rec.meta == {"unit": "count", "column_names": {"tactile": ["thumb", "index"]}}


def test_order_of_taxels_is_that_of_the_argument(write):
    path = write("a_x,b_x,a_y,b_y", "1,2,3,4")
    rec = read_named_csv(path, tactile=["b_x", "b_y", "a_x", "a_y"], num_channels=2, rate=10)
    assert rec.tactile.tolist() == [[[2, 4], [1, 3]]]
    assert read_named_csv(path, tactile=r".*_x", rate=10).tactile.tolist() == [[[1], [2]]]


def test_columns_that_are_nothing_else_are_readings(write):
    path = write("t,f0,f1,note,j0,j1", "0,1,2,dry,3,4", "1,1,2,wet,3,4")
    rec = read_named_csv(path, joint=r"j\d", ignore=["note"])
    assert rec.tactile.shape == (2, 2, 1)
    assert rec.joint.tolist() == [[3, 4], [3, 4]]
    assert rec.label is None


def test_extra_columns_are_numbers_and_no_readings(write):
    path = write("t,thumb,fz,palm", "0,1,2.5,3", "1,1,,4")
    rec = read_recording(path, extra=["fz"])
    assert rec.tactile[..., 0].tolist() == [[1, 3], [1, 4]]
    np.testing.assert_array_equal(rec.extra["fz"], [2.5, np.nan])
    assert rec.meta["column_names"] == {"tactile": ["thumb", "palm"]}
    with pytest.raises(ValueError, match=r"must have the column 'fx' \(got t, thumb, fz, palm\)"):
        read_recording(path, extra=["fx"])
    with pytest.raises(ValueError, match=r"column 'fz' .* a single role"):
        read_recording(path, extra=["fz"], tactile=["thumb", "fz"])


def test_integer_labels_and_labels_frame_by_frame(write):
    assert read_named_csv(write(HEADER, "0,1,2,3,7", "1,1,2,3,7"), label="grasp").label == 7
    rec = read_named_csv(write(HEADER, "0,1,2,3,on", "1,1,2,3,off"), label="grasp")
    assert rec.label is None
    assert rec.privileged["grasp"].tolist() == ["on", "off"]


def test_read_recording_finds_the_format_by_header_or_options(write):
    path = write(HEADER, "0,1,2,0.5,4")
    assert recording_format(path) == "named CSV"
    assert read_recording(path).num_taxels == 4
    assert read_recording(path, label="grasp", joint=["bend"]).num_taxels == 2
    with pytest.raises(ValueError, match=r"line 1 must name the columns 'time', .*got 'thumb'\)"):
        read_recording(path, num_taxels=2, num_channels=1, num_joints=2)
    with pytest.raises(ValueError, match=r"line 1 must name the columns 'time', .*got 'thumb'\)"):
        read_recording(path, header=True)
    assert recording_format(write("time,taxel_0_x", "0,1")) == "wide CSV"
    assert recording_format(write("0,1")) == "wide CSV"
    assert recording_format(write(",".join(f"c{i}" for i in range(1168)), "1")) == "wide CSV"


@pytest.mark.parametrize(
    ("lines", "options", "message"),
    [
        ([HEADER, "0,1,2,3,mug"], {}, r"line 2, column 5: 'grasp' must be a number \(got 'mug'\)"),
        (
            [HEADER, ",1,2,3,4"],
            {},
            r"line 2, column 1: 'Time' must be a number \(got ''\)$",
        ),
        (
            [HEADER, "1,1,2,3,4", "1,1,2,3,4"],
            {},
            r"line 3: 'Time' must increase \(got 1.0",
        ),
        ([HEADER, "1,1,2,3,"], {"label": "grasp"}, r"label in every frame in 'grasp' .* frame 0"),
        ([HEADER, "1,1,2,3,4"], {"label": "y"}, r"must have the column 'y' \(got Time, thumb,"),
        (["a,b,c,d,e,f,g", "1"], {"label": "y"}, r"\(got a, b, c, d, e, f, \.\.\.\)"),
        (
            [HEADER, "1,1,2,3,4"],
            {"tactile": "pad.*"},
            r"'tactile' must match full .* \(got 'pad.*matches no name",
        ),
        ([HEADER, "1,1,2,3,4"], {"num_channels": 3}, r"of 3 channels \(got 4: thumb, index, "),
        (
            [HEADER, "1,1,2,3,4"],
            {"tactile": ["thumb"], "joint": ["thumb"]},
            r"column 'thumb' of .* must have a single role",
        ),
        ([HEADER, "1,1,2,3,4"], {"time_unit": "y"}, r"'time_unit' must be one of .* \(got y\)"),
        ([HEADER, "1,1,2,3,4"], {"rate": 0}, r"'rate' must be positive \(got 0\)"),
        ([HEADER, "1,1,2,3,4"], {"num_channels": 0}, r"'num_channels' must be at least 1"),
        ([HEADER, "1,1,2,3,4"], {"unit": "volt"}, r"'unit' in 'meta' must be one of"),
    ],
)
def test_read_rejects(write, lines, options, message):
    with pytest.raises(ValueError, match=message):
        read_named_csv(write(*lines), **options)


@pytest.mark.parametrize(
    ("name", "cell", "options", "seconds"),
    [
        ("time_ms", "9", {}, 0.009),
        ("Timestamp_ns", "1768398006957662101", {}, 1768398006.957662101),
        ("stamp_us", "3", {"time": "stamp_us"}, 3e-6),
        ("stamp", "9", {"time": "stamp", "time_unit": "ns"}, 9e-9),
        ("time_min", "0.1", {}, 6.0),
        ("stamp", "45292.4166666667", {"time": "stamp", "time_unit": "d"}, 3913264800.00000288),
    ],
)
def test_unit_of_the_time(write, name, cell, options, seconds):
    assert read_named_csv(write(f"{name},thumb", f"{cell},1"), **options).time.tolist() == [seconds]


def test_angles_in_degrees(write):
    rec = read_named_csv(write("t,a,bend_deg,turn", "0,1,90,0.5"), joint=["turn", "bend_deg"])
    assert rec.joint.tolist() == [[0.5, pytest.approx(np.pi / 2)]]


def test_numbers_as_names_are_columns_when_they_are_given(write):
    path = write("0,1,2", "7,8,9")
    assert read_named_csv(path, tactile=["2", "0"], rate=10).tactile.tolist() == [[[9], [7]]]
    with pytest.raises(ValueError, match=r"line 1 must hold names .* with tactile=\['0', ...\]"):
        read_named_csv(path)


def test_columns_without_meaning_may_be_ignored(write):
    path = write(",a,b,", "0,1,2,", "1,1,2,")
    with pytest.raises(ValueError, match=r"must name column 1 \(got '', .*index=False\)"):
        read_named_csv(path)
    with pytest.raises(ValueError, match=r"must name column 2 \(got 'Unnamed: 0', "):
        read_named_csv(write("a,Unnamed: 0", "1,0"))
    path = write("Unnamed: 0,a", "0,1")
    assert read_named_csv(path, ignore=["Unnamed: 0"], rate=10).num_taxels == 1
    assert read_named_csv(write("a,b,", "1,2,"), rate=10).num_taxels == 2
    assert read_named_csv(write("a,b,", "1,2,"), ignore=[""], rate=10).num_taxels == 2


def test_labels_stay_as_they_are(write):
    path = write("t,grasp,a", "0,=1+1,1", "1,'-mug,2")
    assert read_named_csv(path, label="grasp").privileged["grasp"].tolist() == ["=1+1", "'-mug"]
    long = "9" * 5000
    assert read_named_csv(write("t,a,g", f"0,1,{long[:1000]}"), label="g").label == long[:1000]
    assert read_named_csv(write("t,a,g", "0,1,\u0661"), label="g").label == "\u0661"
    with pytest.raises(ValueError, match=r"line 2 must have a label of up to 1000 .*got 1001\)"):
        read_named_csv(write("t,a,g", f"0,1,{long[:1001]}"), label="g")


def test_a_frame_without_readings_is_missing(write):
    rec = read_named_csv(write("a,b", "1,2", ",", "3,4"), rate=1)
    assert rec.missing.tolist() == [[False] * 2, [True] * 2, [False] * 2]
    with pytest.raises(ValueError, match=r"line 3 must not be empty"):
        read_named_csv(write("a,b", "1,2", "", "3,4"), rate=1)


@pytest.mark.parametrize(
    ("lines", "options", "message"),
    [
        (["0.5,0.25", "1,2"], {"tactile": ".*"}, r"column 1 must be the name of a column"),
        (["a,0.25", "1,2"], {}, r"line 1, column 2 must be the name of a column \(got '0.25'\)"),
        (["time,timestamp,a", "1,2,3"], {}, r"one time column \(got time, timestamp\)"),
        (
            ["time,timestamp,a", "1,2,3"],
            {"time": "time"},
            r"column 2 must be a reading .*stamp",
        ),
        (["time [x],a", "1,2"], {}, r"must be a reading or end in a unit .*\(got 'time \[x\]'"),
        (["timestamp.1,a", "1,2"], {}, r"column 1 must be .*got 'timestamp.1'\)"),
        (
            ["time_hours,a", "1,2"],
            {},
            r"unit of the time, one of \['s', 'ms', 'us', 'ns', 'min', 'h', 'd'\]",
        ),
        (
            ["time_ms,a", "1,2"],
            {"time_unit": "s"},
            r"'time_unit' must be 'ms', as in ",
        ),
        (
            ["time,a", "1768398006957,2"],
            {},
            r"line 2, column 1: 'time' must be in s \(got '1768398006957'",
        ),
        (["pad_1,a", "1,2"], {"tactile": "pad_(.*"}, r"'tactile' must be .* regular expression"),
        (["pad_1,a", "1,2"], {"joint": "*"}, r"'joint' must be .* \(got '\*': nothing to repeat"),
        (["\x1b[31m,a", "b,1"], {"rate": 1}, r"column 1: '\\x1b\[31m' must be a number"),
    ],
)
def test_read_rejects_what_would_be_wrong_in_silence(write, lines, options, message):
    with pytest.raises(ValueError, match=message):
        read_named_csv(write(*lines), **options)


def test_many_columns_are_quick_to_name(write):
    names = [f"c{i}" for i in range(20_000)]
    assert read_named_csv(write(",".join(names), "," * 19_999), rate=1).num_taxels == 20_000


def test_a_column_of_texts_that_nobody_named_comes_with_advice(write):
    path = write(HEADER, "0,1,2,3,mug")
    with pytest.raises(ValueError, match=r"'grasp' must be a number .* give it as 'label'"):
        read_named_csv(path)


@pytest.mark.parametrize(("step", "unit", "warns"), [(10, None, True), (10, "s", False)])
def test_frames_that_are_seconds_apart_are_noticed(write, caplog, step, unit, warns):
    read_named_csv(write("time,a", "0,1", f"{step},1"), time_unit=unit)
    assert ("give time_unit='ms'" in caplog.text) == warns


@pytest.mark.parametrize(
    ("size", "rate", "units"),
    [
        (86400, 100, ["d"]),
        (3600, 100, ["h"]),
        (60, 100, ["min"]),
        (60, 1000, ["min", "h"]),
        (1, 2200, None),  # vibration, as of a BioTac
    ],
)
def test_frames_that_are_too_close_are_noticed(write, caplog, size, rate, units):
    # Of a live recording three frames may have come at once.
    time = (np.arange(60) // 3 * 3 / rate + np.arange(60) % 3 * 1e-6) / size
    path = write("time,a", *(f"{t:.15f},1" for t in time))
    read_named_csv(path)
    if units is None:
        assert caplog.text == ""
        return
    found = 59 / (time[-1] - time[0])
    hints = "; or ".join(f"give time_unit='{u}' for" for u in units)
    for part in (
        f"has {found:.4g} frames per second if its time is in seconds",
        hints.split(";")[0],
    ):
        assert part in caplog.text
    assert caplog.text.count("give time_unit=") == len(units)
    caplog.clear()
    read_named_csv(path, time_unit=units[0])
    read_named_csv(path, rate=rate * size)
    assert caplog.text == ""
    assert read_named_csv(path, time_unit=units[0]).duration == pytest.approx(57 / rate, rel=1e-3)


def test_columns_that_may_be_no_time_are_readings(write):
    assert read_named_csv(write("t,t_h,t_d", "0,1,2")).num_taxels == 2


@pytest.mark.parametrize(
    "name",
    ["seconds", "ts", "Zeit", "host_time", "frame_number", "seq", "#"],
)
@pytest.mark.parametrize("options", [{}, {"rate": 10}])
def test_a_clock_of_another_name_is_no_reading(write, name, options):
    path = write(f"{name},thumb", "3,5", "5,6")
    message = rf"column 1 must be a reading .*\(got '{name}'\): give it as 'time' or 'ignore'"
    with pytest.raises(ValueError, match=message):
        read_named_csv(path, **options)
    assert read_named_csv(path, time=name).time.tolist() == [3, 5]
    assert read_named_csv(path, ignore=[name], rate=10).tactile.tolist() == [[[5]], [[6]]]


@pytest.mark.parametrize("options", [{}, {"tactile": ["thumb"]}, {"tactile": "th.*"}])
def test_no_rate_is_invented_for_a_file_without_time(write, options):
    path = write("horloge,thumb", "0.5,5", "0.75,6")
    with pytest.raises(ValueError, match=r"time column \(got horloge, thumb\): .* 'rate'"):
        read_named_csv(path, **options)
    assert read_named_csv(path, time="horloge", **options).time.tolist() == [0.5, 0.75]
    assert read_named_csv(path, rate=4, **options).time.tolist() == [0, 0.25]


@pytest.mark.parametrize("start", [0, 1, 40])
def test_a_column_that_counts_the_frames_is_no_reading(write, start):
    lines = ["time,index,thumb", *[f"{i},{start + i},7" for i in range(10)]]
    with pytest.raises(ValueError, match=rf"column 'index' \(got {start}, {start + 1}, .*'ignore'"):
        read_named_csv(write(*lines))
    assert read_named_csv(write(*lines[:-1])).num_taxels == 2
    assert read_named_csv(write(*lines), tactile=".*[mx]").num_taxels == 1


def test_an_expression_that_matches_no_joint_is_refused(write):
    with pytest.raises(ValueError, match=r"'joint' must match full .* \(got 'q', which matches"):
        read_named_csv(write(HEADER, "0,1,2,0.5,4"), joint="q")


def test_names_that_were_chosen_are_kept_and_those_of_a_list_are_not(write):
    path = write(HEADER, "0,1,2,0.5,4")
    recording = read_named_csv(path, tactile="thumb|index", joint="bend")
    assert recording.meta["column_names"] == {"tactile": ["thumb", "index"], "joint": ["bend"]}
    assert read_named_csv(path, tactile=["index"], joint=["bend"]).meta == {}
