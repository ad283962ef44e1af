r"""The JSON messages of XELA's server, one by one from its WebSocket and in files.

A message is ``{"message": 2987, "time": ..., "sensors": 1, "type": "routine", "version": ..., "1":
{...}, "sendtime": ...}`` with one key for each sensor, and in it ``data`` (three hexadecimal words
for each taxel: x, y, z), ``integer`` (the same as numbers), on some models ``calibrated``
(newtons), ``model``, ``taxels`` and ``handedness``, which says "right" in captures of left hands
too.
"""

import json
import logging
import math
import re
from bisect import bisect_right
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.files import atomic_path
from torch_geometric_tactile.io.recording_schema import checked_file
from torch_geometric_tactile.typing import PathLike

_log = logging.getLogger(__name__)

_WORD = re.compile(r"[0-9A-Fa-f]{1,4}")
_HIGHEST = 0xFFFF
_VERSION = "1.8.0"


class XelaFrame(NamedTuple):
    r"""One message.

    :obj:`reading` are counts or newtons :math:`(N, 3)` of all sensors, one after another by their
    number; :obj:`taxels`, :obj:`models` and :obj:`handedness` have one entry for each sensor;
    :obj:`time` are seconds since 1970.
    """

    number: int
    time: float
    reading: np.ndarray
    taxels: tuple[int, ...]
    models: tuple[str, ...]
    handedness: tuple[str, ...]
    version: str


def parse_xela_message(message: Mapping[str, Any], forces: bool = False) -> XelaFrame:
    r"""Reads one message.

    Args:
        message (Mapping): The message, as :func:`json.loads` gives it; with
            :obj:`strict=False`, because some servers break lines inside of texts.
        forces (bool): Whether to read the forces in newtons instead of the counts.

    Raises:
        ValueError: If something is missing, ``data`` and ``integer`` differ, a number of taxels or
            sensors is wrong, or a sensor has no forces and they are wanted.
    """
    if not isinstance(message, Mapping):
        raise ValueError(f"a XELA message must be a JSON object (got {type(message).__name__})")
    number, time = message.get("message"), message.get("time", message.get("sendtime"))
    if isinstance(number, bool) or not isinstance(number, int):
        raise ValueError(f"'message' of a XELA message must be an integer (got {number!r})")
    where = f"XELA message {number}"
    if isinstance(time, bool) or not isinstance(time, int | float) or not math.isfinite(time):
        raise ValueError(f"'time' of {where} must be a number of seconds (got {time!r})")
    keys = sorted((key for key in message if isinstance(key, str) and key.isdecimal()), key=int)
    count = message.get("sensors", len(keys))
    if not keys or count != len(keys):
        raise ValueError(f"{where} must hold {count or 1} sensors (got {keys or 'none'})")
    readings = [_sensor_reading(f"sensor '{key}' of {where}", message[key], forces) for key in keys]
    sensors = [message[key] for key in keys]
    return XelaFrame(
        number=number,
        time=float(time),
        reading=np.concatenate(readings),
        taxels=tuple(len(reading) for reading in readings),
        models=tuple(str(sensor.get("model", "")) for sensor in sensors),
        handedness=tuple(str(sensor.get("handedness", "")) for sensor in sensors),
        version=str(message.get("version", "")),
    )


def _sensor_reading(where: str, sensor: Any, forces: bool) -> np.ndarray:
    if not isinstance(sensor, Mapping):
        raise ValueError(f"{where} must be a JSON object (got {sensor!r})")
    data = sensor.get("data")
    if not isinstance(data, str):
        raise ValueError(f"'data' of {where} must be a text of hexadecimal words (got {data!r})")
    words = [word for word in re.split(r"[,\s]+", data) if word]
    for word in words:
        if not _WORD.fullmatch(word):
            raise ValueError(
                f"'data' of {where} must hold hexadecimal words of up to four digits (got '{word}')"
            )
    taxels = sensor.get("taxels", max(1, len(words) // 3))
    if isinstance(taxels, bool) or not isinstance(taxels, int) or taxels < 1:
        raise ValueError(f"'taxels' of {where} must be a positive integer (got {taxels!r})")
    if taxels * 3 != len(words):
        raise ValueError(
            f"'data' of {where} must hold 3 words for each of {taxels} taxels (got {len(words)})"
        )
    counts = [int(word, 16) for word in words]
    integer = sensor.get("integer", counts)
    if integer != counts:
        raise ValueError(f"'integer' of {where} must say the same as 'data' (got other numbers)")
    if not forces:
        return np.asarray(counts, dtype=np.float32).reshape(-1, 3)
    if "calibrated" not in sensor:
        raise ValueError(
            f"{where}, model '{sensor.get('model', '')}', must have 'calibrated' for forces in "
            "newtons (got counts only): read counts with forces=False"
        )
    try:
        calibrated = np.asarray(sensor["calibrated"], dtype=np.float32)  # null becomes NaN
    except (TypeError, ValueError) as error:
        raise ValueError(f"'calibrated' of {where} must hold numbers ({error})") from error
    if calibrated.shape != (len(words),):
        raise ValueError(
            f"'calibrated' of {where} must have shape ({len(words)},) (got {calibrated.shape})"
        )
    return calibrated.reshape(-1, 3)


def read_xela_messages(path: PathLike, forces: bool = False) -> Recording:
    r"""Reads a file of messages.

    There may be one message a line, or one over several lines, with lines of a log between them.
    A greeting (``{"message": "Welcome"}``) is skipped. A message with the number of the one before
    is left out, and counted as :obj:`"repeated_messages"` in the metadata, which also hold
    :obj:`"models"`, :obj:`"taxels"` and :obj:`"handedness"` of the sensors (what the server says,
    and hence :obj:`"handedness_reliable"` is false) and :obj:`"server_version"`.

    Args:
        path (str or PathLike): The file.
        forces (bool): Whether to read the forces in newtons instead of the counts.

    Returns:
        Recording: The time of the messages in seconds since 1970, and the readings of all sensors,
        one after another by their number.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If the file is cut, holds no message or one that cannot be read, the sensors
            change, or the time does not increase. The message names the line.
    """
    path = checked_file(path)
    frames: list[XelaFrame] = []
    repeated = 0
    for line, message in _messages(path):
        if isinstance(message.get("message"), str):
            continue
        try:
            frame = parse_xela_message(message, forces)
        except ValueError as error:
            raise ValueError(f"'{path}', line {line}: {error}") from error
        if frames:
            before = frames[-1]
            if frame.number == before.number:
                repeated += 1
                continue
            if frame.taxels != before.taxels:
                raise ValueError(
                    f"'{path}', line {line}: message {frame.number} must have sensors of "
                    f"{list(before.taxels)} taxels, as those before (got {list(frame.taxels)})"
                )
            if frame.time <= before.time:
                raise ValueError(
                    f"'{path}', line {line}: 'time' must increase (got {frame.time} s in message "
                    f"{frame.number} after {before.time} s in message {before.number})"
                )
        frames.append(frame)
    if not frames:
        raise ValueError(f"'{path}' must hold at least one XELA message (got none)")
    first = frames[0]
    return Recording(
        time=np.array([frame.time for frame in frames]),
        tactile=np.stack([frame.reading for frame in frames]),
        meta={
            "sensor": "XELA uSkin",
            "unit": "newton" if forces else "count",
            "models": first.models,
            "taxels": first.taxels,
            "handedness": first.handedness,
            "handedness_reliable": False,
            "server_version": first.version,
            "repeated_messages": repeated,
        },
    )


def _messages(path: Path) -> Iterator[tuple[int, dict[str, Any]]]:
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise ValueError(f"'{path}' cannot be read as text: {error}") from error
    # Some servers send line breaks inside of texts, which strict JSON forbids.
    decoder = json.JSONDecoder(strict=False)
    ends = [match.start() for match in re.finditer("\n", text)]
    start = text.find("{")
    while start >= 0:
        line = bisect_right(ends, start) + 1
        try:
            message, end = decoder.raw_decode(text, start)
        except (json.JSONDecodeError, RecursionError) as error:
            raise ValueError(
                f"'{path}', line {line}: the message that begins here cannot be read as JSON "
                f"({error}): is the file cut? Delete what is left of it"
            ) from error
        yield line, message
        start = text.find("{", end)


def format_xela_message(
    counts: np.ndarray,
    number: int,
    time: float,
    *,
    taxels: Sequence[int] | None = None,
    models: Sequence[str] | None = None,
    handedness: Sequence[str] | None = None,
    forces: np.ndarray | None = None,
    version: str = _VERSION,
) -> dict[str, Any]:
    r"""Returns one message as XELA's server sends it, ready for :func:`json.dumps`.

    Args:
        counts (numpy.ndarray): Counts of all taxels :math:`(N, 3)`, whole numbers from 0 to 65535.
        number (int): Number of the message.
        time (float): Its time in seconds since 1970.
        taxels (sequence of int, optional): Number of taxels of each sensor; one sensor if left out.
        models (sequence of str, optional): Model of each sensor.
        handedness (sequence of str, optional): What the server says about each sensor.
        forces (numpy.ndarray, optional): Forces in newtons :math:`(N, 3)`.
        version (str): Version of the server.

    Raises:
        ValueError: If an argument has another length or shape, or a count does not fit.
    """
    counts = np.asarray(counts)
    if counts.ndim != 2 or counts.shape[1] != 3 or len(counts) == 0:
        raise ValueError(f"'counts' must have shape (num_taxels, 3) (got {counts.shape})")
    wrong = np.argwhere(~((counts >= 0) & (counts <= _HIGHEST) & (counts == np.floor(counts))))
    if len(wrong):
        taxel, axis = wrong[0].tolist()
        raise ValueError(
            f"'counts' must be whole numbers from 0 to {_HIGHEST} (got {counts[taxel, axis]} in "
            f"taxel {taxel}, axis {'xyz'[axis]}); XELA messages cannot leave a taxel out"
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
            # JSON has no NaN.
            message[str(i + 1)]["calibrated"] = [
                None if math.isnan(value) else value
                for value in np.asarray(forces)[start:stop].ravel().tolist()
            ]
    message["sendtime"] = float(time)
    return message


def write_xela_messages(
    recording: Recording, path: PathLike, forces: Recording | None = None, first_number: int = 1
) -> None:
    r"""Writes a recording as messages, one a line; whole or not at all.

    Sensors, models, handedness and version are those that :meth:`read_xela_messages` leaves in the
    metadata. Joints, label, other metadata and what only a simulator knows have no place in the
    file; a warning is logged when there are any.

    Args:
        recording (Recording): Counts, with three channels.
        path (str or PathLike): The file.
        forces (Recording, optional): The same frames in newtons.
        first_number (int): Number of the first message.

    Raises:
        ValueError: If there is no frame, the readings are no counts from 0 to 65535, one is
            missing, or :obj:`forces` has other frames.
    """
    if recording.num_frames == 0:
        raise ValueError("'recording' must hold at least one frame to be XELA messages (got none)")
    if recording.meta.get("unit", "count") != "count" or recording.num_channels != 3:
        raise ValueError(
            "'recording' must hold counts of 3 channels to be XELA messages (got "
            f"{recording.num_channels} channels, unit '{recording.meta.get('unit')}')"
        )
    if forces is not None and (
        forces.tactile.shape != recording.tactile.shape
        or not np.array_equal(forces.time, recording.time)
        or forces.meta.get("unit") != "newton"
    ):
        raise ValueError(f"'forces' must hold the same frames in newtons (got {forces})")
    meta = recording.meta
    kept = {"models", "taxels", "handedness", "server_version"}
    implied = {"sensor", "unit", "handedness_reliable", "repeated_messages"}
    lost = [*(meta.keys() - kept - implied), *recording.privileged]
    lost += [] if recording.label is None else ["label"]
    lost += [] if recording.joint is None else ["joint"]
    if lost:
        _log.warning("'%s' is XELA messages and cannot hold %s", path, ", ".join(sorted(lost)))
    with atomic_path(path) as temporary, temporary.open("w", encoding="utf-8") as file:
        for i, time in enumerate(recording.time.tolist()):
            try:
                message = format_xela_message(
                    recording.tactile[i],
                    first_number + i,
                    time,
                    taxels=meta.get("taxels"),
                    models=meta.get("models"),
                    handedness=meta.get("handedness"),
                    forces=None if forces is None else forces.tactile[i],
                    version=meta.get("server_version", _VERSION),
                )
            except ValueError as error:
                raise ValueError(f"frame {i} cannot be a XELA message: {error}") from error
            file.write(json.dumps(message, ensure_ascii=False) + "\n")
