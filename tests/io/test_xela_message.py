import numpy as np
import pytest
from xela_server import message, sensor

from torch_geometric_tactile.io import XelaFrame, format_xela_message, parse_xela_message


def test_parse_by_hand():
    frame = parse_xela_message(message())
    assert isinstance(frame, XelaFrame)
    assert frame.reading.tolist() == [[0x8056, 0x806C, 0x8C3C], [0x7E75, 0x8013, 0x8D36]]
    assert frame.reading.dtype == np.float32
    assert frame._replace(reading=None) == (
        XelaFrame(7, 0.7, None, (2,), ("uSPa22",), ("right",), "1.8.0")
    )


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


@pytest.mark.parametrize(
    "data",
    [
        "8056,\n806C,\n8C3C,\n7E75,\n8013,\n8D36",
        " 8056, 806c , 8C3C\t7E75 8013,8D36,\r\n",
    ],
)
def test_parse_line_breaks_and_spaces_between_words(data):
    frame = parse_xela_message(message(**{"1": sensor(data=data)}))
    assert frame.reading.ravel().tolist() == sensor()["integer"]


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
        ({"message": True}, r"must be an integer \(got True\)"),
        ({"message": ...}, r"must be an integer \(got None\)"),
        ({"time": "now"}, r"'time' of XELA message 7 must be a number of seconds \(got 'now'\)"),
        ({"time": ..., "sendtime": ...}, r"'time' of XELA message 7 must .*\(got None\)"),
        ({"time": float("nan")}, r"'time' of XELA message 7 must .*\(got nan\)"),
        ({"sensors": 2}, r"XELA message 7 must hold 2 sensors \(got \['1'\]\)"),
        ({"sensors": ..., "1": ...}, r"XELA message 7 must hold 1 sensors \(got none\)"),
        ({"1": 3}, r"sensor '1' of XELA message 7 must be a JSON object \(got 3\)"),
        ({"1": {}}, r"'data' of sensor '1' of XELA message 7 must be a text .*\(got None\)"),
        ({"1": {"data": "8056,8O6C"}}, r"words of up to four digits \(got '8O6C'\)"),
        ({"1": {"data": "18056,1,2"}}, r"words of up to four digits \(got '18056'\)"),
        ({"1": {"data": "1,2,3,4"}}, r"must hold 3 words for each of 1 taxels \(got 4\)"),
        ({"1": {"data": ""}}, r"must hold 3 words for each of 1 taxels \(got 0\)"),
        ({"1": sensor(model={"a": 1})}, r"'model' of XELA message 7 must be a text \(got {'a': 1}"),
        ({"1": sensor(handedness=1)}, r"'handedness' of XELA message 7 must be a text \(got 1\)"),
        ({"version": 1.8}, r"'version' of XELA message 7 must be a text \(got 1.8\)"),
        ({"1": sensor(sensor="2")}, r"'sensor' of sensor '1' .* must be its key \(got '2'\)"),
        ({"1": sensor(sensor=2)}, r"'sensor' of sensor '1' .* must be its key \(got 2\)"),
        ({"1": sensor(sensor=True)}, r"'sensor' of sensor '1' .* must be its key \(got True\)"),
        ({"1": sensor(sensor=10**5000)}, r"must be its key \(got a int\)"),
        ({"1": sensor(taxels=3)}, r"must hold 3 words for each of 3 taxels \(got 6\)"),
        ({"1": sensor(taxels=None)}, r"'taxels' of sensor '1' .* positive integer \(got None\)"),
        ({"1": sensor(integer=[1])}, r"'integer' of sensor '1' .* must say the same as 'data'"),
    ],
)
def test_parse_refuses(changed, message_):
    with pytest.raises(ValueError, match=message_):
        parse_xela_message(message(**changed))


@pytest.mark.parametrize(
    ("part", "message_"),
    [
        (sensor(calibrated=[1.0]), r"'calibrated' of sensor '1' .* shape \(6,\) \(got \(1,\)\)"),
        (sensor(calibrated=["a"] * 6), r"'calibrated' of sensor '1' .* must hold numbers"),
        (sensor(calibrated=["1"] * 6), r"'calibrated' of sensor '1' .* must hold numbers or null"),
        (sensor(calibrated=[1e39] * 6), r"'calibrated' of sensor '1' .* must hold finite numbers"),
        (sensor(calibrated=[10**400] * 6), r"'calibrated' of sensor '1' .* must hold numbers \("),
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
        ({"counts": np.full((2, 3), 0.5)}, r"whole numbers .*\(got 0.5 in taxel 0, axis x\)"),
        ({"counts": np.full((2, 3), 65536)}, r"from 0 to 65535 \(got 65536 in taxel 0"),
        ({"counts": np.full((2, 3), -1)}, r"\(got -1 in taxel 0, axis x\)"),
        ({"counts": np.full((2, 3), np.nan)}, r"\(got nan .*cannot leave a taxel out"),
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
