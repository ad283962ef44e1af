import json
import random

import numpy as np
import pytest

from torch_geometric_tactile.io.xela_live import parse_xela_text
from torch_geometric_tactile.io.xela_message import format_xela_message
from torch_geometric_tactile.io.xela_reader import XelaReader

SIGNS = b'0123456789abcdefABCDEF ,.:-+eE[]{}"\\\n\0x'


def message(number, counts=None, spread=False, floats=True):
    """A message of two sensors, as two kinds of servers write it."""
    draw = np.random.default_rng(number)
    counts = draw.integers(30_000, 34_000, (5, 3)) if counts is None else counts
    content = format_xela_message(counts, number, 1.7e9 + number / 7, taxels=(2, 3))
    for key, count in (("1", 2), ("2", 3)):
        if floats:
            content[key]["temp"] = (300 + draw.random(count)).round(3).tolist()
            content[key]["ups"] = [58.5] * count
    text = json.dumps(content, indent=0 if spread else None)
    if spread:  # line breaks inside of texts, which strict JSON forbids
        for i in (1, 2):
            data = content[str(i)]["data"]
            text = text.replace(data, data.replace(",", ",\n"))
    return text.encode()


def said(read, text):
    try:
        frame = read(text)
    except ValueError as error:
        return str(error)
    return None if frame is None else [np.asarray(part) for part in frame]


def assert_same(text, reader):
    found, wanted = said(reader.read, text), said(parse_xela_text, text)
    if not isinstance(wanted, list):
        assert found == wanted
        return
    assert isinstance(found, list)
    for one, other in zip(found, wanted, strict=True):
        np.testing.assert_array_equal(one, other)
        assert one.dtype == other.dtype


@pytest.mark.parametrize("spread", [False, True])
@pytest.mark.parametrize("floats", [False, True])
def test_messages_one_after_another(spread, floats):
    reader = XelaReader()
    for number in range(20):
        assert_same(message(number, spread=spread, floats=floats), reader)
        assert reader._form is not None
    form = reader._form
    small = np.arange(15).reshape(5, 3)  # of fewer digits
    assert_same(message(21, small, spread, floats), reader)
    assert reader._form is form


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (b'"message": 7', b'"message": 07'),
        (b'"message": 7', b'"message": -7'),
        (b'"message": 7', b'"message": 7.0'),
        (b'"message": 7', b'"message": 99999999999999999999'),
        (b'"message": 7', b'"message": "Welcome"'),
        (b'"message": 7', b'"message": 7, "message": 8'),
        (b'"time": 17', b'"time": 017'),
        (b'"time": 17', b'"time": 9e99, "x": 17'),
        (b'"time": 17', b'"time": [17], "x": 17'),
        (b'"integer": [', b'"integer": [1, '),
        (b'"integer": [', b'"integer": [ '),
        (b'"integer": [3', b'"integer": [03'),
        (b'"integer": [3', b'"integer": [3 '),
        (b'"integer": [3', b'"integer": [4'),
        (b'"temp": [', b'"temp": [null, '),
        (b'"temp": [', b'"temp": [['),
        (b'"temp": [3', b'"temp": [03'),
        (b'"temp": [3', b'"temp": [-3e2'),
        (b'"temp"', b'"warm"'),
        (b'"data": "', b'"data": "FF,'),
        (b'"data": "', b'"data": "x'),
        (b'"data": "', b'"data": "0'),
        (b'"taxels": 2', b'"taxels": 3'),
        (b'"model": ""', b'"model": "\0"'),
        (b'"model": ""', b'"model": "\xff"'),
        (b'"1":', b'"3":'),
        (b'"sensors": 2', b'"sensors": 2, "time": 3'),
    ],
)
def test_strange_messages_are_read_as_they_are_alone(old, new):
    usual = message(7)
    assert old in usual
    strange = usual.replace(old, new, 1)
    reader = XelaReader()
    for text in (usual, strange, usual, strange, strange, message(8), strange):
        assert_same(text, reader)


def test_damaged_messages_are_read_as_they_are_alone():
    draw = random.Random(0)
    reader = XelaReader()
    for number in range(3000):
        spread = bool(number // 100 % 2)
        text = bytearray(message(number % 50, spread=spread))
        if number % 3:
            place = draw.randrange(len(text))
            text[place : place + draw.choice((0, 1, 1, 1, 5))] = bytes(
                draw.choices(SIGNS, k=draw.choice((0, 1, 1, 2)))
            )
        assert_same(bytes(text), reader)


def test_forces_are_read_as_json():
    forces = np.arange(15, dtype=float).reshape(5, 3)
    content = format_xela_message(np.zeros((5, 3)), 3, 0.5, taxels=(2, 3), forces=forces)
    reader = XelaReader(forces=True)
    for _ in range(2):
        frame = reader.read(json.dumps(content).encode())
        assert frame is not None
        assert (frame.reading == forces).all()
    with pytest.raises(ValueError, match="must have 'calibrated'"):
        reader.read(message(1))
