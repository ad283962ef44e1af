r"""Parsing of single JSON messages of XELA's server, fast enough for a live hand.

A message is ``{"message": 2987, "time": ..., "sensors": 1, "type": "routine", "version": ..., "1":
{...}, "sendtime": ...}`` with one key for each sensor. The value of a sensor has these keys:

* ``data``: three hexadecimal words for each taxel (x, y, z);
* ``integer``: the same as numbers;
* ``calibrated``: forces in newtons, on some models;
* ``temp`` and ``ups``: the temperature and the updates per second of each taxel;
* ``model``, ``taxels`` and ``handedness``, which is "right" even in captures of left hands.
"""

import json
import math
import re
import sys
from array import array
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from torch_geometric_tactile._texts import quoted, short_repr

_orjson: Any
try:
    import orjson as _orjson
except ImportError:  # part of the extra `live`; without it, parsing takes twice as long
    _orjson = None

# Some servers send line breaks within strings, which strict JSON forbids.
_JSON = json.JSONDecoder(strict=False)
_HEX_WORD = re.compile(r"[0-9A-Fa-f]{1,4}")
_MAX_COUNT = 0xFFFF
_SENSOR_KEY = re.compile(r"[0-9]{1,9}")
_MAX_MESSAGE_NUMBER = 2**63 - 1
_MAX_SECONDS = 1e11  # since 1970: the year 5138
XELA_VERSION = "1.8.0"


class XelaFrame(NamedTuple):
    r"""The content of one message of XELA's server.

    :obj:`reading` holds counts or newtons :math:`(N, 3)` of all sensors in the order of their
    numbers. :obj:`taxels`, :obj:`models` and :obj:`handedness` have one entry for each sensor.
    :obj:`time` is in seconds since 1970. :obj:`temp` and :obj:`ups` are the temperature in kelvins
    and the updates per second of each taxel :math:`(N,)`. They are NaN for unreadable values, and
    :obj:`None` if the message does not hold them.

    Examples:
        >>> message = format_xela_message(np.full((4, 3), 30000), 7, time=1.5e9, taxels=[1, 3])
        >>> frame = parse_xela_message(message)
        >>> frame.number, frame.time, frame.reading.shape
        (7, 1500000000.0, (4, 3))
    """

    number: int
    time: float
    reading: np.ndarray
    taxels: tuple[int, ...]
    models: tuple[str, ...]
    handedness: tuple[str, ...]
    version: str
    temp: np.ndarray | None = None
    ups: np.ndarray | None = None


def parse_xela_message(message: Mapping[str, Any], forces: bool = False) -> XelaFrame:
    r"""Parses one message of XELA's server.

    Args:
        message (Mapping): The message from :func:`json.loads`, with :obj:`strict=False`, since some
            servers send line breaks within strings.
        forces (bool): Whether to read the forces in newtons instead of the counts.

    Raises:
        ValueError: If a field is missing, ``data`` and ``integer`` differ, a sensor differs from
            its key, a number of taxels or sensors is wrong, or a sensor has no forces although
            :obj:`forces` is set.

    Examples:
        >>> message = format_xela_message(np.full((4, 3), 30000), 7, time=1.5e9, taxels=[1, 3])
        >>> frame = parse_xela_message(message)
        >>> frame.taxels, frame.reading.shape
        ((1, 3), (4, 3))
    """
    if not isinstance(message, Mapping):
        raise ValueError(f"a XELA message must be a JSON object (got {type(message).__name__})")
    number, time = message.get("message"), message.get("time", message.get("sendtime"))
    if isinstance(number, bool) or not isinstance(number, int) or abs(number) > _MAX_MESSAGE_NUMBER:
        raise ValueError(
            f"'message' of a XELA message must be an integer (got {short_repr(number)})"
        )
    where = f"XELA message {number}"
    if not _is_number(time) or not abs(time) < _MAX_SECONDS:
        raise ValueError(f"'time' of {where} must be a number of seconds (got {short_repr(time)})")
    keys = sensor_keys(message)
    count = message.get("sensors", len(keys))
    if not keys or isinstance(count, bool) or count != len(keys):
        raise ValueError(
            f"{where} must hold {short_repr(count or 1)} sensors (got {keys or 'none'})"
        )
    sensors = [message[key] for key in keys]
    readings = [
        _parse_sensor(f"sensor '{key}' of {where}", key, sensor, forces)
        for key, sensor in zip(keys, sensors, strict=True)
    ]
    taxels = tuple([len(reading) // 3 for reading in readings])
    numbers = np.frombuffer(b"".join(readings), dtype=np.float32 if forces else np.uint16)
    return XelaFrame(
        number=number,
        time=float(time),
        reading=numbers.astype(np.float32).reshape(-1, 3),
        taxels=taxels,
        models=tuple([_text_field(where, sensor, "model") for sensor in sensors]),
        handedness=tuple([_text_field(where, sensor, "handedness") for sensor in sensors]),
        version=_text_field(where, message, "version"),
        temp=_taxel_values(sensors, taxels, "temp"),
        ups=_taxel_values(sensors, taxels, "ups"),
    )


def parse_xela_text(text: str | bytes, forces: bool = False) -> XelaFrame | None:
    r"""Parses the JSON text of one message of XELA's server.

    Args:
        text (str or bytes): The text of a message of the WebSocket.
        forces (bool): Whether to read the forces in newtons instead of the counts.

    Returns:
        XelaFrame: The content of the message, or :obj:`None` for a greeting
        (:obj:`{"message": "Welcome"}`), which has no sensors.

    Raises:
        ValueError: If the text is not JSON, or :meth:`parse_xela_message` raises an error.

    Examples:
        >>> parse_xela_text('{"message": "Welcome"}') is None
        True
        >>> text = '{"message": 7, "time": 0.5, "1": {"data": "0001,0002,00FF", "temp": [25.5]}}'
        >>> frame = parse_xela_text(text)
        >>> frame.reading.tolist(), frame.temp.tolist()
        ([[1.0, 2.0, 255.0]], [25.5])
    """
    if _orjson is not None:
        encoded = text.encode("utf-8", "replace") if isinstance(text, str) else text
        for content in (encoded, encoded.replace(b",\n", b",")):
            try:
                return _parse_unless_greeting(_orjson.loads(content), forces)
            except ValueError:  # Python's parser accepts more, and its messages are better
                continue
    try:
        message = _JSON.decode(text if isinstance(text, str) else text.decode("utf-8-sig"))
    except (
        ValueError,
        RecursionError,
    ) as error:  # ValueError also for a number with thousands of digits
        raise ValueError(
            f"a XELA message must be JSON (got {short_repr(text)}: {error})"
        ) from error
    return _parse_unless_greeting(message, forces)


def _parse_unless_greeting(message: Any, forces: bool) -> XelaFrame | None:
    if (
        isinstance(message, dict)
        and isinstance(message.get("message"), str)
        and not sensor_keys(message)
    ):
        return None
    return parse_xela_message(message, forces)


def sensor_keys(message: Mapping[str, Any]) -> list[str]:
    r"""Returns the keys of the sensors in a message in the order of their numbers."""
    return sorted([n for n in message if isinstance(n, str) and _SENSOR_KEY.fullmatch(n)], key=int)


def _text_field(where: str, content: Mapping[str, Any], key: str) -> str:
    text = content.get(key, "")
    if not isinstance(text, str):
        raise ValueError(f"'{key}' of {where} must be a string (got {short_repr(text)})")
    return text


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _taxel_values(sensors: Sequence[Any], taxels: Sequence[int], key: str) -> np.ndarray | None:
    if not any(key in sensor for sensor in sensors):
        return None
    all_values = array("d")
    for sensor, count in zip(sensors, taxels, strict=True):
        sensor_values = sensor.get(key)
        padded_values: list[Any] = (
            sensor_values
            if type(sensor_values) is list and len(sensor_values) == count
            else [None] * count
        )
        try:  # faster than NumPy, but accepts only numbers
            all_values.fromlist(padded_values)
        except (TypeError, OverflowError):
            all_values.extend(_numbers_or_nan(padded_values))
    with np.errstate(over="ignore"):
        numbers = np.frombuffer(all_values).astype(np.float32)
    numbers[np.isinf(numbers)] = np.nan
    return numbers


def _numbers_or_nan(values: list[Any]) -> "array[float]":
    # Nulls become NaN. If a value is not a number, all values become NaN.
    try:
        return array("d", [math.nan if value is None else value for value in values])
    except (TypeError, OverflowError):
        return array("d", [math.nan] * len(values))


def _parse_sensor(where: str, key: str, sensor: Any, forces: bool) -> "array[Any]":
    if not isinstance(sensor, Mapping):
        raise ValueError(f"{where} must be a JSON object (got {short_repr(sensor)})")
    counts = _parse_counts(where, sensor.get("data"))
    taxels = sensor.get("taxels", max(1, len(counts) // 3))
    if isinstance(taxels, bool) or not isinstance(taxels, int) or taxels < 1:
        raise ValueError(
            f"'taxels' of {where} must be a positive integer (got {short_repr(taxels)})"
        )
    if taxels * 3 != len(counts):
        raise ValueError(
            f"'data' of {where} must hold 3 words for each of {short_repr(taxels)} taxels (got "
            f"{len(counts)})"
        )
    if "integer" in sensor and sensor["integer"] != counts.tolist():
        raise ValueError(f"'integer' of {where} must equal 'data' (got different numbers)")
    stated_key = sensor.get("sensor", key)
    is_number = stated_key == key or _SENSOR_KEY.fullmatch(short_repr(stated_key).strip("'"))
    if not is_number or int(stated_key) != int(key):
        raise ValueError(f"'sensor' of {where} must be its key (got {short_repr(stated_key)})")
    return _parse_forces(where, sensor, len(counts)) if forces else counts


def _parse_counts(where: str, data: Any) -> "array[int]":
    if not isinstance(data, str):
        raise ValueError(
            f"'data' of {where} must be a string of hexadecimal words (got {short_repr(data)})"
        )
    regular_counts = _parse_regular_words(data.replace(",\n", ","))
    if regular_counts is not None:
        return regular_counts
    words = [word for word in re.split(r"[,\s]+", data) if word]
    for word in words:
        if not _HEX_WORD.fullmatch(word):
            raise ValueError(
                f"'data' of {where} must hold hexadecimal words of up to four digits (got "
                f"{quoted(word)})"
            )
    return array("H", [int(word, 16) for word in words])


def _parse_regular_words(data: str) -> "array[int] | None":
    # Words of four digits, the usual case: ten times as fast as parsing single words.
    num_words = (len(data) + 1) // 5
    if data[4::5] != "," * (num_words - 1):
        return None
    try:
        counts = array("H", bytes.fromhex(data.replace(",", " ")))
    except ValueError:
        return None
    if sys.byteorder == "little":
        counts.byteswap()
    return counts if len(counts) == num_words else None


def _parse_forces(where: str, sensor: Mapping[str, Any], count: int) -> "array[float]":
    if "calibrated" not in sensor:
        model = quoted(str(sensor.get("model", "")))
        raise ValueError(
            f"{where}, model {model}, must have 'calibrated' for forces in newtons (got counts "
            "only): read counts with forces=False"
        )
    values = sensor["calibrated"]
    if not isinstance(values, list) or not all(v is None or _is_number(v) for v in values):
        raise ValueError(
            f"'calibrated' of {where} must hold numbers or null (got {short_repr(values)})"
        )
    try:
        with np.errstate(over="ignore"):
            calibrated = np.asarray(values, dtype=np.float32)  # null becomes NaN
    except OverflowError as error:
        raise ValueError(f"'calibrated' of {where} must hold numbers ({error})") from error
    if np.isinf(calibrated).any():
        raise ValueError(f"'calibrated' of {where} must hold finite numbers or null (got infinity)")
    if calibrated.shape != (count,):
        raise ValueError(
            f"'calibrated' of {where} must have shape ({count},) (got {calibrated.shape})"
        )
    return array("f", calibrated.tobytes())


def format_xela_message(
    counts: np.ndarray,
    number: int,
    time: float,
    *,
    taxels: Sequence[int] | None = None,
    models: Sequence[str] | None = None,
    handedness: Sequence[str] | None = None,
    forces: np.ndarray | None = None,
    version: str = XELA_VERSION,
) -> dict[str, Any]:
    r"""Returns one message in the format of XELA's server, ready for :func:`json.dumps`.

    Args:
        counts (numpy.ndarray): Counts of all taxels :math:`(N, 3)`, integers from 0 to 65535.
        number (int): Number of the message.
        time (float): Time of the message in seconds since 1970.
        taxels (sequence of int, optional): Number of taxels of each sensor. Defaults to one sensor.
        models (sequence of str, optional): Model of each sensor.
        handedness (sequence of str, optional): Handedness of each sensor.
        forces (numpy.ndarray, optional): Forces in newtons :math:`(N, 3)`.
        version (str): Version of the server.

    Raises:
        ValueError: If an argument has an invalid length or shape, or a count is out of range.

    Examples:
        >>> message = format_xela_message(np.array([[30000, 30001, 30002]]), number=7, time=1.5e9)
        >>> parse_xela_message(message).reading.tolist()
        [[30000.0, 30001.0, 30002.0]]
    """
    counts = np.asarray(counts)
    if counts.ndim != 2 or counts.shape[1] != 3 or len(counts) == 0:
        raise ValueError(f"'counts' must have shape (num_taxels, 3) (got {counts.shape})")
    invalid = np.argwhere(~((counts >= 0) & (counts <= _MAX_COUNT) & (counts == np.floor(counts))))
    if len(invalid):
        taxel, axis = invalid[0].tolist()
        raise ValueError(
            f"'counts' must be integers from 0 to {_MAX_COUNT} (got {counts[taxel, axis]} in "
            f"taxel {taxel}, axis {'xyz'[axis]}); XELA messages cannot have missing taxels"
        )
    if forces is not None and np.shape(forces) != counts.shape:
        raise ValueError(f"'forces' must have shape {counts.shape} (got {np.shape(forces)})")
    taxels = [len(counts)] if taxels is None else list(taxels)
    if sum(taxels) != len(counts) or min(taxels, default=0) < 1:
        raise ValueError(f"'taxels' must add up to {len(counts)} (got {taxels})")
    models = [""] * len(taxels) if models is None else list(models)
    handedness = ["right"] * len(taxels) if handedness is None else list(handedness)
    for name, texts in (("models", models), ("handedness", handedness)):
        if len(texts) != len(taxels):
            raise ValueError(f"'{name}' must have {len(taxels)} entries (got {len(texts)})")
    message: dict[str, Any] = {
        "message": int(number),
        "time": float(time),
        "sensors": len(taxels),
        "type": "routine",
        "version": version,
    }
    stop = 0
    for i, count in enumerate(taxels):
        start, stop = stop, stop + count
        integer = [int(value) for value in counts[start:stop].ravel()]
        message[str(i + 1)] = {
            "time": float(time),
            "sensor": str(i + 1),
            "data": ",".join(f"{value:04X}" for value in integer),
            "model": models[i],
            "taxels": count,
            "integer": integer,
            "handedness": handedness[i],
        }
        if forces is not None:
            # JSON has no NaN, so missing forces are null.
            message[str(i + 1)]["calibrated"] = [
                None if math.isnan(value) else value
                for value in np.asarray(forces)[start:stop].ravel().tolist()
            ]
    message["sendtime"] = float(time)
    return message
