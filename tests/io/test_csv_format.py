import numpy as np
import pytest

from torch_geometric_tactile.io import dataframe_to_recording, read_recording, write_recording
from torch_geometric_tactile.io._csv_format import CSV_OPTIONS, CsvFormat
from torch_geometric_tactile.io._csv_frames import normalized_name


def write_text(tmp_path, text, encoding="utf-8"):
    path = tmp_path / "glove.csv"
    path.write_bytes(text.encode(encoding))
    return path


def readings(recording):
    return recording.tactile[..., 0].tolist()


PLAIN = "time,thumb,index\n0,1.5,2\n0.01,3,4.25\n"
EXPECTED = [[1.5, 2.0], [3.0, 4.25]]


@pytest.mark.parametrize(
    ("text", "options"),
    [
        (PLAIN, {}),
        (PLAIN.replace(",", ";"), {}),
        (PLAIN.replace(",", "\t"), {}),
        (PLAIN.replace(",", "|"), {}),
        (PLAIN.replace(",", ";").replace(".", ","), {"decimal": ","}),
        (PLAIN.replace(",", ";").replace(".", ","), {"decimal": ",", "separator": "semicolon"}),
        (PLAIN.replace(",", "  ").replace("\n0", "\n 0"), {"separator": "blank"}),
        (PLAIN.replace(",", ":"), {"separator": ":"}),
        ("Glove 7\n\nfirmware, 1.2\n" + PLAIN, {"preamble": 3}),
        (PLAIN.replace("\n0,", "\ns,N,N\n0,"), {"unit_row": True}),
        (PLAIN.replace("\n", ",\n"), {}),
        (PLAIN.replace("\n", ",,,\n"), {}),
        ("time,thumb,index\n0,1.5,2,\n0.01,3,4.25,\n", {}),
        (PLAIN.replace("\n", "\r\n"), {}),
    ],
)
def test_text_of_other_programs_has_the_same_readings(tmp_path, text, options):
    recording = read_recording(write_text(tmp_path, text), **options)
    assert readings(recording) == EXPECTED
    assert recording.time.tolist() == [0.0, 0.01]


@pytest.mark.parametrize("encoding", ["cp1252", "utf-16"])
def test_encoding(tmp_path, encoding):
    path = write_text(tmp_path, "time,däumchen\n0,1\n", encoding)
    with pytest.raises(ValueError, match=r"cannot be read as CSV.*give its 'encoding', such as cp"):
        read_recording(path)
    recording = read_recording(path, encoding=encoding)
    assert recording.meta["column_names"] == {"tactile": ["däumchen"]}


def test_truncated_file_in_utf16_is_refused(tmp_path):
    path = write_text(tmp_path, "time,a\n0,1\n0.1,2", "utf-16")
    with pytest.raises(ValueError, match="line 3 must end with a line break"):
        read_recording(path, encoding="utf-16")


@pytest.mark.parametrize(
    ("unit", "value", "expected_unit"),
    [("N", 2.0, "newton"), ("mN", 0.002, "newton"), ("count", 2.0, "count"), ("kPa", 2.0, None)],
)
def test_row_of_units(tmp_path, unit, value, expected_unit):
    text = f"time,thumb,bend\n[ms],({unit}),°\n0,2,180\n20,2,90\n"
    recording = read_recording(write_text(tmp_path, text), unit_row=True, joint=["bend"])
    assert recording.time.tolist() == [0.0, 0.02]
    assert recording.joint[:, 0].tolist() == pytest.approx([np.pi, np.pi / 2])
    assert recording.tactile[0, 0, 0] == pytest.approx(value)
    assert recording.meta.get("unit") == expected_unit


def test_row_of_units_of_the_columns_of_this_package(tmp_path):
    text = "t,taxel_0_x,joint_0\nms,mN,deg\n0,2,180\n20,2,90\n"
    recording = read_recording(write_text(tmp_path, text), unit_row=True)
    assert recording.time.tolist() == [0.0, 0.02]
    assert recording.joint[0, 0] == pytest.approx(np.pi)
    assert (recording.tactile[0, 0, 0], recording.meta["unit"]) == (np.float32(0.002), "newton")


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("bend (deg)", "bend_deg"),
        ("Bend [°]", "bend_deg"),
        ("bend/deg", "bend_deg"),
        ("time [msec]", "time_ms"),
        ("t (h)", "time_h"),
        ("t_h", "t_h"),
        ("thumb", "thumb"),
    ],
)
def test_units_in_names(name, expected):
    assert normalized_name(name) == expected


def test_degrees_in_brackets_are_converted(tmp_path):
    path = write_text(tmp_path, "Time (ms),pad,bend (deg)\n0,1,180\n10,2,90\n")
    recording = read_recording(path, joint=["bend (deg)"])
    assert recording.joint[:, 0].tolist() == pytest.approx([np.pi, np.pi / 2])
    assert recording.time.tolist() == [0.0, 0.01]


@pytest.mark.parametrize(
    ("cells", "options", "seconds"),
    [
        (["2024-01-03T10:00:00.000", "2024-01-03T10:00:00.010"], {}, 1704276000.0),
        (["2024-01-03 10:00:00.000000123Z", "2024-01-03 10:00:00.010000456Z"], {}, 1704276000.0),
        (["2024-01-03T12:00:00,00+02:00", "2024-01-03T12:00:00,01+02:00"], {}, 1704276000.0),
        (["10:00:00.00", "10:00:00.01"], {}, 36000.0),
        (["23:59:59.995", "0:00:00.005"], {}, 86399.995),
        (
            ["03.01.2024 10:00:00,00", "03.01.2024 10:00:00,01"],
            {"time_format": "%d.%m.%Y %H:%M:%S,%f"},
            1704276000.0,
        ),
    ],
)
def test_dates_and_times_of_a_day(tmp_path, cells, options, seconds):
    lines = [f"{cell};{i}" for i, cell in enumerate(cells)]
    path = write_text(tmp_path, "\n".join(["time;a", *lines, ""]))
    time = read_recording(path, **options).time
    assert time[0] == pytest.approx(seconds, abs=1e-6)
    assert time[1] - time[0] == pytest.approx(0.01, abs=2e-6)


def test_dates_a_second_apart_are_not_taken_for_milliseconds(tmp_path, caplog):
    read_recording(write_text(tmp_path, "time,a\n10:00:00,1\n10:00:01,2\n"))
    assert not caplog.records
    read_recording(write_text(tmp_path, "time,a\n0,1\n1,2\n"))
    assert "in milliseconds" in caplog.text


def test_missing_readings(tmp_path):
    text = "time,a,b,bend,grip\n0,NA,4095,-1,-1\n1,-1.0,5,#N/A,-1\n2,,nan,3,-1\n"
    recording = read_recording(
        write_text(tmp_path, text),
        missing=["NA", "#N/A", -1, "4095"],
        joint=["bend"],
        label="grip",
        rate=1,
    )
    nan = np.nan
    np.testing.assert_array_equal(recording.tactile[..., 0], [[nan, nan], [nan, 5], [nan, nan]])
    np.testing.assert_array_equal(recording.joint, [[nan], [nan], [3]])
    assert recording.label == -1


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time,a\n0,NA\n", r"line 2, column 2: 'a' must be a number \(got 'NA'\).*'missing'"),
        ("time;a\n0;1,5\n", r"'a' must be a number \(got '1,5'\); .* comma, give 'decimal'"),
        ("time,a,b\nms,N,N\n0,1,2\n", r"line 2, .*units of the columns, give 'unit_row'"),
        ("Glove 7\ntime,a,b\n0,1,2\n", r"lines come before the header, .* 'preamble'"),
        (
            "time,a\n03.01.24,1\n",
            r"line 2, column 1: 'time' must be .*\(got '03.01.24'\): .*format'",
        ),
        ("time,a\n1,1\n1,2\n", r"line 3: 'time' must increase .*with 'ignore' and give the 'rate'"),
        ("time,a\n2,1\n1,2\n", r"line 3: 'time' must increase \(got 1.0 s after 2.0 s\)$"),
        ("time,a\n25:00:00,1\n", r"'time' must be .*\(got '25:00:00'\)"),
        ("time,a\nnan,1\n", r"'time' must be a number \(got 'nan'\)"),
    ],
)
def test_errors_name_the_option(tmp_path, text, message):
    with pytest.raises(ValueError, match=message):
        read_recording(write_text(tmp_path, text))


def test_row_of_units_that_holds_numbers(tmp_path):
    with pytest.raises(ValueError, match=r"line 2 must hold the units of 2 columns \(got '0', '1'"):
        read_recording(write_text(tmp_path, "time,a\n0,1\n1,2\n"), unit_row=True)


def test_readings_in_several_units(tmp_path):
    path = write_text(tmp_path, "time,a,b\ns,N,mN\n0,1,2\n")
    with pytest.raises(ValueError, match=r"all readings in one unit \(got \['mn', 'n'\]\)"):
        read_recording(path, unit_row=True)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"separator": "ab"}, "'separator' must be one character, or one of"),
        ({"separator": ",", "decimal": ","}, "'separator' must differ from the decimal sign ','"),
        ({"decimal": "x"}, r"'decimal' must be '.' or ',' \(got x\)"),
        ({"preamble": -1}, r"'preamble' must be the number of lines before the header"),
        ({"preamble": "2"}, r"'preamble' must be .*\(got '2'\)"),
        ({"unit_row": "yes"}, r"'unit_row' must be true or false \(got yes\)"),
        ({"encoding": "latin-99"}, r"'encoding' must be the name of an encoding"),
        ({"encoding": "hex"}, r"'encoding' must be the name of an encoding"),
    ],
)
def test_invalid_options(options, message):
    with pytest.raises(ValueError, match=message):
        CsvFormat(**options)


def test_options_do_not_belong_to_other_formats(tmp_path, full):
    write_recording(full, tmp_path / "a.npz")
    for option in CSV_OPTIONS:
        default = getattr(CsvFormat(), option)
        with pytest.raises(ValueError, match=f"'{option}' must be an option of the format npz"):
            read_recording(tmp_path / "a.npz", **{option: default})


def test_first_frames(tmp_path):
    path = write_text(tmp_path, "time;a;b\n0;1;2\n1;broken;3\n")
    assert readings(read_recording(path, num_frames=1)) == [[1.0, 2.0]]


def test_dataframe_is_its_csv_file(tmp_path):
    pd = pytest.importorskip("pandas", reason="the tests need pandas")
    frame = pd.DataFrame({"time": [0.0, 0.1], "a": [1 / 3, None], "bend": [3, 4], "grip": "cup"})
    recording = dataframe_to_recording(frame, joint=["bend"], label="grip", unit="count")
    frame.to_csv(tmp_path / "a.csv", index=False)
    expected = read_recording(tmp_path / "a.csv", joint=["bend"], label="grip", unit="count")
    np.testing.assert_array_equal(recording.tactile, expected.tactile)
    assert recording.tactile[0, 0, 0] == np.float32(1 / 3)
    assert (recording.label, recording.meta) == ("cup", expected.meta)


@pytest.mark.parametrize("name", [None, "when"])
@pytest.mark.parametrize(("kind", "start"), [("to_datetime", 1704276000.0), ("to_timedelta", 0.0)])
def test_index_of_times_is_the_time(name, kind, start):
    pd = pytest.importorskip("pandas", reason="the tests need pandas")
    index = getattr(pd, kind)([start, start + 0.01], unit="s").rename(name)
    recording = dataframe_to_recording(pd.DataFrame({"a": [1, 2]}, index=index))
    assert np.diff(recording.time) == pytest.approx(0.01, abs=1e-6)
    assert recording.num_taxels == 1


def test_dataframe_with_text_among_readings():
    pd = pytest.importorskip("pandas", reason="the tests need pandas")
    frame = pd.DataFrame({"time": [0, 1], "a": [1, "wet"]})
    with pytest.raises(ValueError, match=r"^the DataFrame, line 3, column 2: 'a' must be a number"):
        dataframe_to_recording(frame)
