r"""Recordings as files of JSON messages, as the WebSocket of XELA's server sends them."""

import json
import logging
import re
from bisect import bisect_right
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._files import atomic_path
from torch_geometric_tactile._texts import each_key_once, short_repr
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io._recording_schema import new_recording, recording_path
from torch_geometric_tactile.io._xela_message import (
    XELA_VERSION,
    XelaFrame,
    format_xela_message,
    parse_xela_message,
    sensor_keys,
)

_log = logging.getLogger(__name__)


def read_xela_messages(path: PathLike, forces: bool = False) -> Recording:
    r"""Reads a recording from a file of messages of XELA's server.

    A message may take one or several lines, and log lines may be between messages. A greeting
    (``{"message": "Welcome"}``) is skipped. Two kinds of messages are left out, and the metadata
    have their numbers: messages with the number of the previous message
    (:obj:`"repeated_messages"`), and messages with sensors and a string instead of a number
    (:obj:`"skipped_messages"`). The metadata also have :obj:`"models"`, :obj:`"taxels"` and
    :obj:`"handedness"` of the sensors, and :obj:`"server_version"`. The handedness of the server
    may be wrong, so :obj:`"handedness_reliable"` is false.

    Args:
        path (str or PathLike): The file.
        forces (bool): Whether to read the forces in newtons instead of the counts.

    Returns:
        Recording: The readings of all sensors in the order of their numbers, with the times of the
        messages in seconds since 1970.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If the file is truncated, holds no message or an invalid message, the sensors or
            their models change, or the time does not increase. The message names the line.

    Examples:
        >>> import json
        >>> import tempfile
        >>> from pathlib import Path
        >>> counts = np.full((4, 3), 30000)
        >>> messages = [format_xela_message(counts, i, 1.5e9 + i / 100) for i in range(5)]
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = Path(folder) / "grasp.jsonl"
        ...     _ = path.write_text("".join(json.dumps(message) + "\n" for message in messages))
        ...     read_xela_messages(path)
        Recording(num_frames=5, num_taxels=4, num_channels=3, rate=100)
    """
    path = recording_path(path)
    frames: list[XelaFrame] = []
    sensors: list[str] = []
    num_repeated = num_skipped = 0
    for line, message in _read_messages(path):
        if isinstance(message.get("message"), str):
            num_skipped += bool(sensor_keys(message))
            continue
        try:
            frame = parse_xela_message(message, forces)
        except ValueError as error:
            raise ValueError(f"'{path}', line {line}: {error}") from error
        if frames:
            previous = frames[-1]
            if frame.number == previous.number:
                num_repeated += 1
                continue
            if sensor_keys(message) != sensors or frame.models != previous.models:
                raise ValueError(
                    f"'{path}', line {line}: message {frame.number} must have sensors {sensors} of "
                    f"models {short_repr(list(previous.models))}, as in earlier messages (got "
                    f"{sensor_keys(message)} of models {short_repr(list(frame.models))})"
                )
            if frame.taxels != previous.taxels:
                raise ValueError(
                    f"'{path}', line {line}: message {frame.number} must have sensors of "
                    f"{list(previous.taxels)} taxels, as in earlier messages (got "
                    f"{list(frame.taxels)})"
                )
            if frame.time <= previous.time:
                raise ValueError(
                    f"'{path}', line {line}: 'time' must increase (got {frame.time} s in message "
                    f"{frame.number} after {previous.time} s in message {previous.number})"
                )
        frames.append(frame)
        sensors = sensor_keys(message)
    need(frames, f"'{path}' must hold at least one XELA message (got none)")
    first_frame = frames[0]
    meta = {
        "sensor": "XELA uSkin",
        "unit": "newton" if forces else "count",
        "models": first_frame.models,
        "taxels": first_frame.taxels,
        "handedness": first_frame.handedness,
        "handedness_reliable": False,
        "server_version": first_frame.version,
        "repeated_messages": num_repeated,
        "skipped_messages": num_skipped,
    }
    return new_recording(
        path,
        time=np.array([frame.time for frame in frames]),
        tactile=np.stack([frame.reading for frame in frames]),
        meta=meta,
    )


_MESSAGE_PART = re.compile(r'}|"\s*:')


def _read_messages(path: Path) -> Iterator[tuple[int, dict[str, Any]]]:
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise ValueError(f"'{path}' cannot be read as text: {error}") from error
    # Some servers send line breaks within strings, which strict JSON forbids.
    decoder = json.JSONDecoder(strict=False, object_pairs_hook=each_key_once)
    # Sorted, so that the line of a position is found by bisection.
    line_ends = [match.start() for match in re.finditer("\n", text)]
    start, previous_end = text.find("{"), 0
    while start >= 0:
        _check_between_messages(path, text, previous_end, start)
        line = bisect_right(line_ends, start) + 1
        try:
            message, end = decoder.raw_decode(text, start)
        except (
            ValueError,
            RecursionError,
        ) as error:  # ValueError also for a number with thousands of digits
            raise ValueError(
                f"'{path}', line {line}: the message that begins here cannot be read as JSON "
                f"({error}): is the file truncated? Delete the rest of this message"
            ) from error
        yield line, message
        start, previous_end = text.find("{", end), end
    _check_between_messages(path, text, previous_end, len(text))


def _check_between_messages(path: Path, text: str, start: int, stop: int) -> None:
    # Log lines may be between messages, but not parts of a message.
    part = _MESSAGE_PART.search(text, start, stop)
    if part is not None:
        raise ValueError(
            f"'{path}', line {text.count(chr(10), 0, part.start()) + 1}: the end of a message "
            "must follow its beginning (got none): is the file truncated? Delete this end"
        )


def write_xela_messages(
    recording: Recording, path: PathLike, forces: Recording | None = None, first_number: int = 1
) -> None:
    r"""Writes a recording as messages of XELA's server, one per line. The file is either complete
    or absent.

    Sensors, models, handedness and version are taken from the metadata of
    :meth:`read_xela_messages`. Joints, actions, label, other metadata, further and privileged
    signals are not stored, and a warning lists them.

    Args:
        recording (Recording): Readings in counts, with three channels.
        path (str or PathLike): The file.
        forces (Recording, optional): The same frames in newtons.
        first_number (int): Number of the first message.

    Raises:
        ValueError: If there is no frame, the readings are not counts from 0 to 65535, a reading is
            missing, or :obj:`forces` does not hold the same frames.

    Examples:
        >>> import tempfile
        >>> recording = Recording(time=[0.0, 0.01], tactile=np.full((2, 4, 3), 30000))
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     write_xela_messages(recording, f"{folder}/grasp.jsonl")
        ...     read_xela_messages(f"{folder}/grasp.jsonl").num_taxels
        4
    """
    if recording.num_frames == 0:
        raise ValueError(
            "'recording' must hold at least one frame to be written as XELA messages (got none)"
        )
    if recording.meta.get("unit", "count") != "count" or recording.num_channels != 3:
        raise ValueError(
            "'recording' must hold counts of 3 channels to be written as XELA messages (got "
            f"{recording.num_channels} channels, unit '{recording.meta.get('unit')}')"
        )
    if forces is not None and (
        forces.tactile.shape != recording.tactile.shape
        or not np.array_equal(forces.time, recording.time)
        or forces.meta.get("unit") != "newton"
    ):
        raise ValueError(f"'forces' must hold the same frames in newtons (got {forces})")
    meta = recording.meta
    written_keys = {"models", "taxels", "handedness", "server_version"}
    implied_keys = {
        "sensor",
        "unit",
        "handedness_reliable",
        "repeated_messages",
        "skipped_messages",
    }
    unsupported = [
        *(meta.keys() - written_keys - implied_keys),
        *recording.privileged,
        *recording.extra,
    ]
    unsupported += [] if recording.label is None else ["label"]
    unsupported += [] if recording.joint is None else ["joint"]
    unsupported += [] if recording.action is None else ["action"]
    unsupported += ["annotations"] if recording.annotations else []
    if unsupported:
        _log.warning(
            "'%s' is a file of XELA messages and cannot store %s",
            path,
            ", ".join(sorted(unsupported)),
        )
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
                    version=meta.get("server_version", XELA_VERSION),
                )
            except ValueError as error:
                raise ValueError(
                    f"frame {i} cannot be written as a XELA message: {error}"
                ) from error
            file.write(json.dumps(message, ensure_ascii=False) + "\n")
