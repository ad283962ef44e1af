r"""Reader of recordings in MCAP files, including damaged and truncated files."""

import json
import logging
import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._limits import ARRAY_BYTES, EXPANSION, FRAME_BYTES
from torch_geometric_tactile._texts import parse_json, printable, short_list
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data import Annotation, Recording
from torch_geometric_tactile.data._annotations import MAX_ANNOTATIONS, checked_annotation
from torch_geometric_tactile.io._mcap_records import (
    CHANNEL,
    MESSAGE,
    METADATA,
    METADATA_NAME,
    SCHEMA,
    Scan,
    texts_checksum,
)
from torch_geometric_tactile.io._mcap_schemas import (
    EVENT,
    FRAME,
    SPAN_END,
    SPAN_START,
    decode,
    schema_problem,
)
from torch_geometric_tactile.io._recording_schema import recording_from_fields, recording_path
from torch_geometric_tactile.io.recording_mcap import VERSION

_log = logging.getLogger(__name__)
_MAX_LISTED_PROBLEMS = 5
_MAX_EVENTS, _MAX_EVENT_BYTES = 10_000, 4096  # further or longer events are left out


def read_mcap(path: PathLike, recover: bool = True, allow_large: bool = False) -> Recording:
    r"""Reads a recording from an MCAP file that :class:`McapWriter` or another program wrote.

    A file that is damaged, or truncated by a crash or a full disk, is read chunk by chunk. Chunks
    that do not match their checksum are left out, and a warning with the missing amount is logged.
    The other frames are returned unchanged.

    Args:
        path (str or PathLike): The file.
        recover (bool): Whether to read the intact part of a damaged or truncated file.
        allow_large (bool): Whether to read a file whose frames take more than 1 GiB and more than
            200 times its size, as in a hostile file.

    Returns:
        Recording: The time is in seconds since the anchor of the stream. Frames of a live stream
        have their numbers and device times as :obj:`"sequence"` and :obj:`"device_time"` in
        :obj:`extra`. Events, such as marks and new measurements of the rest, are a list of
        :obj:`{"time": ..., "kind": ..., "text": ...}` in :obj:`meta["events"]`, if there are any.
        Events at the start and the end of annotations become the :obj:`annotations` instead. An
        annotation without an end in the file lasts to the last frame.

    Raises:
        FileNotFoundError: If there is no such file.
        ImportError: If the extra :obj:`live` is missing.
        ValueError: If it is not an MCAP file, has no topic :obj:`tactile.Frame` or no readable
            frame, or is damaged and :obj:`recover` is false. The message names the file.

    Examples:
        >>> import tempfile
        >>> import numpy as np
        >>> from torch_geometric_tactile.io import write_mcap
        >>> recording = Recording(time=[0.0, 0.01], tactile=np.ones((2, 4, 3)))
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     write_mcap(recording, f"{folder}/grasp.mcap")
        ...     read_mcap(f"{folder}/grasp.mcap")
        Recording(num_frames=2, num_taxels=4, num_channels=3, rate=100)
    """
    path = recording_path(path)
    scan = Scan(path)
    content = _Content(path, _FrameRows(path.stat().st_size, allow_large))
    for kind, record in scan.records():
        content.add(kind, record)
    if not content.rows.num_frames:
        raise ValueError(content.empty_message(scan))
    problems = [*scan.damage, *content.problems()]
    if problems and not recover:
        raise ValueError(
            f"'{path}' is damaged or truncated: {join_problems(problems)}; read it with "
            "recover=True, or repair it with `tactile replay FILE --repair OUT`"
        )
    recording, gaps = content.recording()
    if problems:
        _log.warning(
            "'%s' is damaged or truncated: %s; %d frames were read%s",
            path,
            join_problems(problems),
            recording.num_frames,
            f", and {gaps}" if gaps else "",
        )
    return recording


def join_problems(problems: list[str]) -> str:
    r"""Returns the first problems of a list as one string."""
    return short_list(
        problems, _MAX_LISTED_PROBLEMS, printable, ending="; and {} more", separator="; "
    )


class _FrameArray:
    # An array with one row for each frame, which grows with the frames.

    def __init__(self, value: np.ndarray) -> None:
        self.template = value
        self.data = bytearray()
        self.num_rows = 0
        self.is_complete = True

    def accepts(self, value: np.ndarray) -> bool:
        is_text = self.template.dtype.kind == value.dtype.kind == "U"
        return self.template.shape == value.shape and (
            is_text or self.template.dtype == value.dtype
        )

    def set_row(self, row: int, value: np.ndarray) -> None:
        self.fill_missing(row)
        if value.dtype.itemsize > self.template.dtype.itemsize:  # a longer text needs wider rows
            self.data = bytearray(self.array().astype(value.dtype).tobytes())
            self.template = value
        self.data += value.astype(self.template.dtype, copy=False).tobytes()
        self.num_rows = row + 1

    def fill_missing(self, row: int) -> None:
        # Fills the rows of frames without this array with NaN, if its type has NaN.
        if self.num_rows < row:
            self.is_complete &= self.template.dtype.kind == "f"
            missing = np.full_like(self.template, math.nan if self.is_complete else 0)
            self.data += missing.tobytes() * (row - self.num_rows)
            self.num_rows = row

    def array(self) -> np.ndarray:
        return np.ndarray((self.num_rows, *self.template.shape), self.template.dtype, self.data)


class _FrameRows:
    r"""Collects the frames of a file.

    Args:
        file_size (int): Size of the file in bytes.
        allow_large (bool): Whether to accept frames far larger than the file.
    """

    def __init__(self, file_size: int, allow_large: bool) -> None:
        self.num_frames = 0
        self._limit = 2**63 if allow_large else max(ARRAY_BYTES, EXPANSION * file_size)
        self._columns: dict[str, _FrameArray] = {}
        self._widths: dict[str, int] = {}

    def add(self, data: bytes) -> None:
        r"""Adds the frame of a message.

        Raises:
            MemoryError: If the frames take too much memory.
            ValueError: If the message is not a frame, or differs from the previous frames.
        """
        values = _decode_frame(decode(FRAME, data))
        for name, value in values.items():
            column = self._columns.get(name)
            if column is not None and not column.accepts(value):
                raise ValueError(
                    f"'{name}' must have shape {column.template.shape} and type "
                    f"{column.template.dtype}, as in the previous frames (got {value.shape} and "
                    f"{value.dtype})"
                )
        for name, value in values.items():
            self._widths[name] = max(value.nbytes, self._widths.get(name, 0))
        if sum(self._widths.values()) * (self.num_frames + 1) > self._limit:
            raise MemoryError(
                f"its frames would take more than {self._limit / 2**30:.1f} GiB, as in a file "
                "made to exhaust the memory: pass allow_large=True if you trust it"
            )
        for name, value in values.items():
            self._columns.setdefault(name, _FrameArray(value)).set_row(self.num_frames, value)
        self.num_frames += 1

    def arrays(self) -> tuple[dict[str, np.ndarray], list[str]]:
        r"""Returns the arrays, and the names of arrays that some frames lack and whose type has no
        NaN.

        The arrays have the names of
        :func:`~torch_geometric_tactile.io._recording_schema.recording_to_arrays`, and
        :obj:`"sequence"`, :obj:`"received"` and :obj:`"device_time"`.
        """
        for column in self._columns.values():
            column.fill_missing(self.num_frames)
        incomplete = [name for name, column in self._columns.items() if not column.is_complete]
        complete = {name: column for name, column in self._columns.items() if column.is_complete}
        return {name: column.array() for name, column in complete.items()}, incomplete


def _decode_frame(frame: Any) -> dict[str, np.ndarray]:
    shape, tactile = tuple(frame.shape), np.array(frame.tactile, np.float32)
    joint, action = np.array(frame.joint, np.float32), np.array(frame.action, np.float32)
    if len(shape) != 2 or 0 in shape or math.prod(shape) != len(tactile):
        raise ValueError(
            f"'tactile' must have the shape declared in its frame (got {len(tactile)} numbers "
            f"for {shape[:4]})"
        )
    need(math.isfinite(frame.time), "'time' must be finite", frame.time)
    for name, values in (("tactile", tactile), ("joint", joint), ("action", action)):
        if np.isinf(values).any():
            raise ValueError(f"'{name}' must hold finite readings, or NaN for missing ones")
    arrays = {
        "time": np.array(frame.time),
        "sequence": np.array(frame.sequence),
        "received": np.array(frame.received),
        "device_time": np.array(frame.device_time if frame.HasField("device_time") else math.nan),
        "tactile": tactile.reshape(shape),
    }
    if len(joint):
        arrays["joint"] = joint
    if len(action):
        arrays["action"] = action
    arrays |= {f"extra/{signal.name}": _decode_signal(signal) for signal in frame.extra}
    arrays |= {f"privileged/{signal.name}": _decode_signal(signal) for signal in frame.privileged}
    if sum(value.nbytes for value in arrays.values()) > FRAME_BYTES:
        raise ValueError(f"a frame must take at most {FRAME_BYTES} bytes (got more)")
    return arrays


def _decode_signal(signal: Any) -> np.ndarray:
    name, dtype_name, shape, data = signal.name, signal.dtype, tuple(signal.shape), signal.data
    if not name or "/" in name:
        raise ValueError(f"a signal must have a name without '/' (got {name[:40]!r})")
    try:
        dtype = np.dtype(dtype_name[:20])
    except (TypeError, ValueError, SyntaxError) as error:
        raise ValueError(f"'{name}' must be of a known type (got {dtype_name[:20]!r})") from error
    if dtype.kind not in "biufU" or len(shape) > 8:
        raise ValueError(f"'{name}' must hold numbers or strings (got {dtype_name[:20]!r})")
    if math.prod(shape) * dtype.itemsize != len(data):
        raise ValueError(f"'{name}' must have shape {shape} (got {len(data)} bytes)")
    if dtype.itemsize == 0:
        return np.zeros(shape, dtype)
    array = np.frombuffer(data, dtype).reshape(shape)
    if dtype.kind == "U" and array.size and np.frombuffer(data, np.uint32).max() > 0x10FFFF:
        raise ValueError(f"'{name}' must hold strings (got invalid characters)")
    return array.astype(dtype.newbyteorder("="), copy=False)


@dataclass
class _Content:
    # The content of the records that were read so far.
    path: Path
    rows: _FrameRows
    channels: dict[int, Any] = field(default_factory=dict)
    schemas: dict[int, Any] = field(default_factory=dict)
    texts: dict[str, str] = field(default_factory=dict)
    topics: dict[int, str] = field(default_factory=dict)  # by channel
    events: list[dict[str, Any]] = field(default_factory=list)
    spans: list[Annotation] = field(default_factory=list)
    open_spans: dict[str, list[int]] = field(default_factory=dict)  # indices in `spans`, by label
    damage: list[str] = field(default_factory=list)
    num_invalid: int = 0

    def add(self, kind: int, record: Any) -> None:
        if kind == MESSAGE:
            self._add_message(record.channel_id, record.data)
        elif kind == CHANNEL:
            self.channels.setdefault(record.id, record)
        elif kind == SCHEMA:
            self.schemas.setdefault(record.id, record)
        elif kind == METADATA and record.name == METADATA_NAME and not self.texts:
            texts = dict(record.metadata)
            if texts.pop("crc32", "") == str(texts_checksum(texts)):
                self._check_version(texts)
                self.texts = texts
            else:
                self.damage.append("label and metadata differ from their checksum")

    def _check_version(self, texts: dict[str, str]) -> None:
        if texts.get("version") != str(VERSION):
            raise ValueError(
                f"'{self.path}' must be of format version {VERSION} (got "
                f"{printable(texts.get('version'))}): read it with the version of "
                "torch-geometric-tactile that wrote it"
            )

    def _add_message(self, channel: int, data: bytes) -> None:
        if channel not in self.topics:
            self.topics[channel] = self._find_topic(channel)
        if self.topics[channel] == EVENT:
            self._add_event(data)
        if self.topics[channel] != FRAME:
            return
        try:
            self.rows.add(data)
        except ValueError as error:
            self.num_invalid += 1
            if self.num_invalid == 1:
                self.damage.append(f"a message is not a frame of this recording: {error}")
        except MemoryError as error:
            raise ValueError(f"'{self.path}' cannot be read: {error}") from error

    def _add_event(self, data: bytes) -> None:
        if len(data) > _MAX_EVENT_BYTES:
            return
        try:
            event = decode(EVENT, data)
            if event.kind in (SPAN_START, SPAN_END):
                self._add_span(event.kind, checked_annotation((event.time, event.time, event.text)))
                return
        except ValueError:  # of another program with a topic or event of the same name
            return
        if math.isfinite(event.time) and len(self.events) < _MAX_EVENTS:
            self.events.append({"time": event.time, "kind": event.kind, "text": event.text})

    def _add_span(self, kind: str, event: Annotation) -> None:
        open_indices = self.open_spans.setdefault(event.label, [])
        if kind == SPAN_START and len(self.spans) < MAX_ANNOTATIONS:
            open_indices.append(len(self.spans))
            self.spans.append(event)
        elif kind == SPAN_END and open_indices:
            i = open_indices.pop()
            self.spans[i] = event._replace(start=min(self.spans[i].start, event.end))

    def _annotations(self, last_time: float, anchor: float) -> list[Annotation]:
        open_indices = {i for indices in self.open_spans.values() for i in indices}
        spans = [
            span._replace(end=max(span.start, last_time)) if i in open_indices else span
            for i, span in enumerate(self.spans)
        ]
        return [Annotation(s.start - anchor, s.end - anchor, s.label) for s in spans]

    def _find_topic(self, number: int) -> str:
        channel = self.channels.get(number)
        if channel is None:
            # Its description was in a damaged chunk, but the metadata of this package repeat it.
            channel_numbers = self._metadata_channels()
            return next(
                (topic for topic in (FRAME, EVENT) if channel_numbers.get(topic) == number), ""
            )
        if channel.topic == EVENT and channel.message_encoding == "protobuf":
            return EVENT
        schema = self.schemas.get(channel.schema_id)
        if channel.message_encoding != "protobuf" or FRAME not in (
            channel.topic,
            "" if schema is None else schema.name,
        ):
            return ""
        problem = "" if schema is None else schema_problem(schema.data)
        if problem:
            raise ValueError(
                f"'{self.path}' must have frames of the schema {FRAME} in the topic "
                f"'{printable(channel.topic)}': {printable(problem)}"
            )
        return FRAME

    def _metadata_channels(self) -> dict[str, Any]:
        try:
            channels = parse_json(self.texts.get("channels", "{}"))
        except ValueError:
            return {}
        return channels if isinstance(channels, dict) else {}

    def empty_message(self, scan: Scan) -> str:
        problems = [*scan.damage, *self.damage]
        reason = f" ({join_problems(problems)})" if problems else ""
        topics = sorted({printable(channel.topic) for channel in self.channels.values()})
        if FRAME in topics:
            return f"'{self.path}' must hold a readable frame (got none{reason})"
        return (
            f"'{self.path}' must have the topic '{FRAME}', or another topic of its schema (got "
            f"{', '.join(topics[:20]) or 'no topics'}{reason})"
        )

    def problems(self) -> list[str]:
        problems = [*self.damage]
        if self.num_invalid > 1:
            problems.append(f"{self.num_invalid} messages are not frames of this recording")
        channel_numbers = self._metadata_channels()
        if channel_numbers and not self.channels:
            problems.append("its table of topics is damaged")
        return problems

    def recording(self) -> tuple[Recording, str]:
        arrays, incomplete = self.rows.arrays()
        if incomplete:
            _log.warning(
                "'%s': left out %s, which some frames lack",
                self.path,
                ", ".join(printable(name) for name in incomplete),
            )
        order = _increasing_order(arrays["time"])
        if order is not None:
            _log.warning(
                "'%s': frames were out of order or duplicate; %d of %d were read",
                self.path,
                len(order),
                self.rows.num_frames,
            )
            arrays = {name: array[order] for name, array in arrays.items()}
        gaps = _describe_gaps(arrays["sequence"], arrays["time"])
        anchor = int(self.texts.get("monotonic_ns", "0")) / 1e9
        annotations = self._annotations(float(arrays["time"][-1]), anchor)
        if anchor:
            arrays["time"] = arrays["time"] - anchor
        clocks = {name: arrays.pop(name) for name in ("sequence", "received", "device_time")}
        if self.texts.get("live") == "1":
            arrays["extra/sequence"] = clocks["sequence"]
            if not np.isnan(clocks["device_time"]).all():
                arrays["extra/device_time"] = clocks["device_time"]
        texts = {"label": "null", "meta": "{}", **self.texts}
        texts["annotations"] = json.dumps(annotations, ensure_ascii=False)
        recording = recording_from_fields(self.path, arrays, texts)
        if self.events:
            events = [{**event, "time": event["time"] - anchor} for event in self.events]
            recording = replace(recording, meta={**recording.meta, "events": events})
        return recording, gaps


def _increasing_order(time: np.ndarray) -> np.ndarray | None:
    if (np.diff(time) > 0).all():
        return None
    order = np.argsort(time, kind="stable")
    is_later = np.r_[True, np.diff(time[order]) > 0]
    return order[is_later]


def _describe_gaps(sequence: np.ndarray, time: np.ndarray) -> str:
    steps = np.diff(sequence)
    gaps = np.flatnonzero(steps > 1)
    if not len(gaps):
        return ""
    seconds = float((time[gaps + 1] - time[gaps]).sum())
    return f"{int((steps[gaps] - 1).sum())} between them are missing, in {seconds:.2f} s"
