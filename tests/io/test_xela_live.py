import copy
import json
from pathlib import Path

import numpy as np
import pytest
from fuzz.laws import Refused
from fuzz.oracles import xela_frame
from xela_server import message, sensor

from torch_geometric_tactile.io import parse_xela_message, parse_xela_text

REAL = Path(__file__).parents[3] / "shared/data/xela/ws_messages"


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
        {"data": "8056,806C,8C3C,7E75,8013,8d36"},
        {"data": "8056, 806C,8C3C,7E75,8013,8D36"},
        {"data": "8056,806C,8C3C,7E75,8013,8D36,"},
        {"data": "8056,\n806C,\n8C3C,\n7E75,\n8013,\n8D36"},
        {"data": "8056,\n806C,8C3C,7E75,8013,8D36"},
        {"data": "8056,806C,8C3C,7E75,8013,D36", "integer": ...},
        {"data": "8056,806C,8C3C,7E75,8013, D36", "integer": ...},
        {"data": "8056,806C,8C3C,7E75,8013,+D36"},
        {"data": "8056,806C,8C3C,7E75,8013,8O36"},
        {"data": "8056,806C,8C3C,7E75,8013,\uff18D36"},
        {"data": "8056,806C,8C3C,7E75,801380D36"},
        {"data": "8056;806C;8C3C;7E75;8013;8D36"},
        {"data": "8056,806C,8C3C", "integer": ...},
        {"data": "8056,806C,8C3C,7E75,8013", "integer": ...},
        {"data": "", "integer": ...},
        {"data": "," * 29},
        {"data": None},
        {"data": ["8056"]},
        {"taxels": ...},
        {"taxels": 3},
        {"taxels": 2.0},
        {"taxels": True},
        {"taxels": None},
        {"integer": ...},
        {"integer": None},
        {"integer": []},
        {"integer": [1] * 6},
        {"integer": [32854, 32876, 35900, 32373, 32787]},
        {"integer": [32854.0, 32876, 35900, 32373, 32787, 36150]},
        {"integer": ["32854", 32876, 35900, 32373, 32787, 36150]},
        {"integer": [32854 + 65536, 32876, 35900, 32373, 32787, 36150]},
        {"integer": [10**30, 32876, 35900, 32373, 32787, 36150]},
        {"integer": [32854, 32876, 35900, 32373, 32787, [36150]]},
    ],
    ids=range(33),
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


@pytest.mark.parametrize("part", [None, [], "a", 3])
@pytest.mark.parametrize("which", ["1", "2"])
def test_sensors_that_are_no_objects(part, which):
    with pytest.raises(ValueError, match=f"sensor '{which}'"):
        parse_xela_message({**usual(), which: part})


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
        ([1.5, 2, 3], [np.nan, np.nan]),
        (["1.5", 2], [np.nan, np.nan]),
        ([[1], 2], [np.nan, np.nan]),
        ([10**400, 2], [np.nan, np.nan]),
        ([None, "2"], [np.nan, np.nan]),
        ([1e39, 2], [np.nan, 2]),
        ([float("inf"), float("nan")], [np.nan, np.nan]),
        ("1.5", [np.nan, np.nan]),
        (None, [np.nan, np.nan]),
    ],
    ids=range(12),
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
        ("{", "a XELA message must be JSON"),
        (b"\xff\xfe", "a XELA message must be JSON"),
        ("[" * 100_000, "a XELA message must be JSON"),
        ("9" * 5000, "a XELA message must be JSON"),
        ("[]", r"a XELA message must be a JSON object \(got list\)"),
        ('{"message": "Welcome", "1": {}}', r"'message' .* must be an integer \(got 'Welcome'\)"),
        ('{"message": 3}', "'time' of XELA message 3 must be"),
        ('{"message": 3, "time": NaN}', "'time' of XELA message 3 must be"),
    ],
    ids=range(9),
)
def test_refuses(text, complaint):
    with pytest.raises(ValueError, match=complaint):
        parse_xela_text(text)
