import copy
import json
from pathlib import Path

import numpy as np
import pytest
from fuzz.laws import Refused
from fuzz.oracles import xela_frame
from xela_server import message, sensor

from torch_geometric_tactile.io._xela_message import (
    XelaFrame,
    _parse_regular_words,
    format_xela_message,
    parse_xela_message,
    parse_xela_text,
)

REAL = Path(__file__).parents[3] / "shared/data/xela/ws_messages"


def test_parse_by_hand():
    frame = parse_xela_message(message())
    assert isinstance(frame, XelaFrame)
    assert frame.reading.tolist() == [[0x8056, 0x806C, 0x8C3C], [0x7E75, 0x8013, 0x8D36]]
    assert frame.reading.dtype == np.float32
    assert frame._replace(reading=None) == (
        XelaFrame(7, 0.7, None, (2,), ("uSPa22",), ("right",), "1.8.0")
    )


@pytest.mark.parametrize("sign", [1, -1])
def test_parse_takes_numbers_of_eight_bytes_and_times_up_to_the_year_5000(sign):
    number, time = sign * (2**63 - 1), sign * (1e11 - 1)
    frame = parse_xela_message(message(message=number, time=time))
    assert (frame.number, frame.time) == (number, time)


def test_parse_forces_with_a_missing_one():
    reading = parse_xela_message(message(), forces=True).reading
    assert np.array_equal(reading, np.float32([[0.5, -0.25, 1], [np.nan, 0, 2]]), equal_nan=True)


def test_parse_sensors_in_numeric_order():
    parts = {
        str(i): sensor(data=f"{i:X},0,0", taxels=1, integer=..., model=f"m{i}") for i in (10, 9, 1)
    }
    for part in parts.values():
        del part["integer"]
    frame = parse_xela_message(message(**{**parts, "sensors": 3}))
    assert frame.reading[:, 0].tolist() == [1, 9, 10]
    assert frame.models == ("m1", "m9", "m10")


def test_parse_takes_what_may_be_left_out():
    frame = parse_xela_message({"message": 1, "sendtime": 2.5, "1": {"data": "1,2,3"}})
    assert frame.time == 2.5
    assert (frame.models, frame.handedness, frame.version) == (("",), ("",), "")
    two = parse_xela_message({"message": 1, "sendtime": 2.5, "1": {"data": "1,2,3,4,5,6"}})
    assert two.taxels == (2,)
    assert two.reading.tolist() == [[1, 2, 3], [4, 5, 6]]


@pytest.mark.parametrize(
    ("changed", "message_"),
    [
        ({"message": "Welcome"}, r"'message' of a XELA message must be an integer \(got 'Welcome'"),
        ({"message": 2**63}, r"must be an integer \(got 9223372036854775808\)"),
        ({"message": -(2**63)}, r"must be an integer \(got -9223372036854775808\)"),
        ({"time": 1e11}, r"'time' of XELA message 7 must be a number of seconds"),
        ({"time": -1e11}, r"'time' of XELA message 7 must be a number of seconds"),
        ({"time": "now"}, r"'time' of XELA message 7 must be a number of seconds \(got 'now'\)"),
        ({"time": ..., "sendtime": ...}, r"'time' of XELA message 7 must .*\(got None\)"),
        ({"sensors": 2}, r"XELA message 7 must hold 2 sensors \(got \['1'\]\)"),
        ({"sensors": ..., "1": ...}, r"XELA message 7 must hold 1 sensors \(got none\)"),
        ({"1": 3}, r"sensor '1' of XELA message 7 must be a JSON object \(got 3\)"),
        ({"1": {}}, r"'data' of sensor '1' of XELA message 7 must be a string .*\(got None\)"),
        ({"1": {"data": "8056,8O6C"}}, r"words of up to four digits \(got '8O6C'\)"),
        ({"1": {"data": "1,2,3,4"}}, r"must hold 3 words for each of 1 taxels \(got 4\)"),
        (
            {"1": sensor(model={"a": 1})},
            r"'model' of XELA message 7 must be a string \(got {'a'",
        ),
        ({"1": sensor(handedness=1)}, r"'handedness' of XELA message 7 must be a string \(got 1\)"),
        ({"version": 1.8}, r"'version' of XELA message 7 must be a string \(got 1.8\)"),
        ({"1": sensor(sensor="2")}, r"'sensor' of sensor '1' .* must be its key \(got '2'\)"),
        ({"1": sensor(sensor=True)}, r"'sensor' of sensor '1' .* must be its key \(got True\)"),
        ({"1": sensor(sensor=10**5000)}, r"must be its key \(got a int\)"),
        ({"1": sensor(taxels=3)}, r"must hold 3 words for each of 3 taxels \(got 6\)"),
        ({"1": sensor(taxels=None)}, r"'taxels' of sensor '1' .* positive integer \(got None\)"),
        ({"1": sensor(integer=[1])}, r"'integer' of sensor '1' .* must equal 'data'"),
    ],
)
def test_parse_refuses(changed, message_):
    with pytest.raises(ValueError, match=message_):
        parse_xela_message(message(**changed))


@pytest.mark.parametrize(
    ("part", "message_"),
    [
        (sensor(calibrated=[1.0]), r"'calibrated' of sensor '1' .* shape \(6,\) \(got \(1,\)\)"),
        (sensor(calibrated=["1"] * 6), r"'calibrated' of sensor '1' .* must hold numbers or null"),
        (sensor(calibrated=[1e39] * 6), r"'calibrated' of sensor '1' .* must hold finite numbers"),
        (sensor(calibrated=3), r"'calibrated' of sensor '1' .* must hold numbers or null \(got 3"),
        ({"data": "1,2,3", "model": "USPA35"}, r"model 'USPA35', must have 'calibrated' .*counts"),
    ],
)
def test_parse_forces_refuses(part, message_):
    parse_xela_message(message(**{"1": part}))
    with pytest.raises(ValueError, match=message_):
        parse_xela_message(message(**{"1": part}), forces=True)


def test_parse_refuses_what_is_no_object():
    with pytest.raises(ValueError, match=r"must be a JSON object \(got list\)"):
        parse_xela_message([])


def test_format_by_hand():
    counts = np.array([[1, 2, 3], [0x8000, 0xABCD, 0xFFFF], [0, 0, 0]])
    forces = np.array([[0.5, np.nan, 1.0], [0, 0, 0], [0, 0, 0]])
    made = format_xela_message(
        counts, 5, 2.5, taxels=[2, 1], models=["a", "b"], forces=forces, version="v"
    )
    assert made == {
        "message": 5,
        "time": 2.5,
        "sensors": 2,
        "type": "routine",
        "version": "v",
        "1": {
            "time": 2.5,
            "sensor": "1",
            "data": "0001,0002,0003,8000,ABCD,FFFF",
            "model": "a",
            "taxels": 2,
            "integer": [1, 2, 3, 0x8000, 0xABCD, 0xFFFF],
            "handedness": "right",
            "calibrated": [0.5, None, 1.0, 0.0, 0.0, 0.0],
        },
        "2": {
            "time": 2.5,
            "sensor": "2",
            "data": "0000,0000,0000",
            "model": "b",
            "taxels": 1,
            "integer": [0, 0, 0],
            "handedness": "right",
            "calibrated": [0.0, 0.0, 0.0],
        },
        "sendtime": 2.5,
    }


@pytest.mark.parametrize(
    ("arguments", "message_"),
    [
        ({"counts": np.zeros(3)}, r"'counts' must have shape \(num_taxels, 3\) \(got \(3,\)\)"),
        ({"counts": np.full((2, 3), 0.5)}, r"integers from .*\(got 0.5 in taxel 0, axis x\)"),
        ({"counts": np.full((2, 3), 65536)}, r"from 0 to 65535 \(got 65536 in taxel 0"),
        ({"counts": np.full((2, 3), np.nan)}, r"\(got nan .*cannot have missing taxels"),
        ({"forces": np.zeros((1, 3))}, r"'forces' must have shape \(2, 3\) \(got \(1, 3\)\)"),
        ({"taxels": [1]}, r"'taxels' must add up to 2 \(got \[1\]\)"),
        ({"taxels": [2, 0]}, r"'taxels' must add up to 2 \(got \[2, 0\]\)"),
        ({"models": ["a", "b"]}, r"'models' must have 1 entries \(got 2\)"),
    ],
)
def test_format_refuses(arguments, message_):
    with pytest.raises(ValueError, match=message_):
        format_xela_message(**{"counts": np.zeros((2, 3)), "number": 1, "time": 0.0, **arguments})


@pytest.mark.parametrize("said", ["1", 1, "01"])
def test_a_sensor_may_say_its_key(said):
    assert parse_xela_message(message(**{"1": sensor(sensor=said)})).taxels == (2,)


def is_read_as_by_the_reference(content):
    """Whether a message is taken; its counts are those of the slow reader of the fuzz run."""
    try:
        expected = xela_frame(content)
    except Refused:
        with pytest.raises(ValueError, match="of XELA message 7"):
            parse_xela_message(content)
        return False
    frame = parse_xela_message(content)
    assert frame.reading.dtype == np.float32
    assert frame.reading.tolist() == expected["counts"].tolist()
    assert frame.taxels == tuple(expected["taxels"])
    return True


def usual():
    return message(
        sensors=2, **{"1": sensor(temp=[30.5, 31], ups=[2.5, None]), "2": sensor(temp=[1, 2])}
    )


def test_a_message_by_hand():
    frame = parse_xela_text(json.dumps(usual()))
    counts = [[0x8056, 0x806C, 0x8C3C], [0x7E75, 0x8013, 0x8D36]]
    assert frame.reading.tolist() == [*counts, *counts]
    assert (frame.number, frame.time, frame.taxels) == (7, 0.7, (2, 2))
    assert frame.temp.tolist() == [30.5, 31, 1, 2]
    assert np.array_equal(frame.ups, np.float32([2.5] + [np.nan] * 3), equal_nan=True)
    assert frame.reading.dtype == frame.temp.dtype == frame.ups.dtype == np.float32
    newtons = parse_xela_text(json.dumps(message()), forces=True).reading
    assert newtons.tolist()[0] == [0.5, -0.25, 1]
    none = parse_xela_text(json.dumps(message()).encode())
    assert none.temp is none.ups is None


def test_usual_words_are_read_at_once():
    assert _parse_regular_words("0001,ABCD,fFfF").tolist() == [1, 0xABCD, 65535]
    assert _parse_regular_words("1,2,3") is _parse_regular_words("0001, 002,0003") is None


@pytest.mark.skipif(not REAL.is_dir(), reason="needs the captured messages")
def test_real_messages():
    paths = sorted(REAL.glob("*.json"))
    assert len(paths) == 7
    for path in paths:
        text = path.read_text()
        text = text[text.index("{") :].strip()  # one has a line of a log before it
        content = json.loads(text, strict=False)
        assert is_read_as_by_the_reference(content)
        frame = parse_xela_text(text)
        sensors = [content[key] for key in sorted(filter(str.isdecimal, content), key=int)]
        for name in ("temp", "ups"):
            values = [value for sensor in sensors for value in sensor[name]]
            assert getattr(frame, name).tolist() == np.float32(values).tolist()


@pytest.mark.parametrize(
    "changed",
    [
        {"data": " 8056, 806c , 8C3C\t7E75 8013,8D36,\r\n"},
        {"data": "8056,806C,8C3C,7E75,8013,\uff18D36"},
        {"data": "", "integer": ...},
        {"data": ["8056"]},
        {"taxels": ...},
        {"taxels": 2.0},
        {"taxels": True},
        {"taxels": None},
        {"integer": ...},
        {"integer": []},
        {"integer": [32854, 32876, 35900, 32373, 32787]},
        {"integer": [32854.0, 32876, 35900, 32373, 32787, 36150]},
        {"integer": [32854 + 65536, 32876, 35900, 32373, 32787, 36150]},
        {"integer": [10**30, 32876, 35900, 32373, 32787, 36150]},
        {"integer": [32854, 32876, 35900, 32373, 32787, [36150]]},
    ],
)
@pytest.mark.parametrize("which", ["1", "2"])
def test_hostile_sensors_are_as_the_reference_says(changed, which):
    content = usual()
    content[which].update(changed)
    content[which] = {key: value for key, value in content[which].items() if value is not ...}
    is_read_as_by_the_reference(content)


def test_integers_in_the_list_of_another_sensor_are_refused():
    content = usual()
    content["2"]["integer"].insert(0, content["1"]["integer"].pop())
    assert not is_read_as_by_the_reference(content)


def test_random_changes_are_as_the_reference_says():
    draw = np.random.default_rng(0)
    kinds = set()
    for _ in range(1500):
        content = copy.deepcopy(usual())
        part = content[str(draw.integers(1, 3))]
        text = part["data"]
        place = int(draw.integers(len(text)))
        new = str(draw.choice([*"0aF,; \n-x", "", "ff", ",,"]))
        part["data"] = text[:place] + new + text[place + int(draw.integers(2)) :]
        if draw.random() < 0.5:
            del part["integer"]
        kinds.add(is_read_as_by_the_reference(content))
    assert kinds == {True, False}


@pytest.mark.parametrize(
    ("temp", "found"),
    [
        ([1.5, 2], [1.5, 2]),
        ([None, 2], [np.nan, 2]),
        ([1.5], [np.nan, np.nan]),
        ([[1], 2], [np.nan, np.nan]),
        ([None, "2"], [np.nan, np.nan]),
        ([1e39, 2], [np.nan, 2]),
        ([float("inf"), float("nan")], [np.nan, np.nan]),
        (None, [np.nan, np.nan]),
    ],
)
def test_temperatures_that_cannot_be_read_are_missing(temp, found):
    content = usual()
    content["1"]["temp"] = temp
    frame = parse_xela_text(json.dumps(content))
    assert np.array_equal(frame.temp, np.float32([*found, 1, 2]), equal_nan=True)
    assert frame.reading.shape == (4, 3)


def test_a_greeting_is_no_frame():
    assert parse_xela_text('{"message": "Welcome"}') is None
    assert parse_xela_text(b'{"message": "Welcome", "version": "1.8"}') is None


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", "a XELA message must be JSON"),
        (b"\xff\xfe", "a XELA message must be JSON"),
        ("[" * 100_000, "a XELA message must be JSON"),
        ("[]", r"a XELA message must be a JSON object \(got list\)"),
        ('{"message": "Welcome", "1": {}}', r"'message' .* must be an integer \(got 'Welcome'\)"),
        ('{"message": 3}', "'time' of XELA message 3 must be"),
    ],
)
def test_refuses(text, complaint):
    with pytest.raises(ValueError, match=complaint):
        parse_xela_text(text)
