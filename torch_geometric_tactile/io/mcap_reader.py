r"""MCAP files of recordings, read whole or as far as they can be."""

import json
import logging
import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from torch_geometric_tactile._texts import parse_json, printable, short_list
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data import Annotation, Recording
from torch_geometric_tactile.data._annotations import MAX_ANNOTATIONS, checked_annotation
from torch_geometric_tactile.io._mcap_frames import FrameRows
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
    check_schema,
    decode,
)
from torch_geometric_tactile.io._recording_schema import checked_file, recording_from_fields
from torch_geometric_tactile.io.recording_mcap import VERSION

_log = logging.getLogger(__name__)
_MOST_TOLD = 5
_MOST_EVENTS, _LARGEST_EVENT = 10_000, 4096  # events, and bytes of one: others are left out


def read_mcap(path: PathLike, recover: bool = True, allow_large: bool = False) -> Recording:
    r"""Reads a recording from an MCAP file, of :class:`McapWriter` or of others.

    A file that was cut, by a crash or a full disk, or is damaged is read chunk by chunk: each chunk
    with its checksum, those that are not whole are left out, and a warning is logged that tells how
    much is missing. A frame that is read is as it was written.

    Args:
        path (str or PathLike): The file.
        recover (bool): Whether to read what can be read of a file that is not whole.
        allow_large (bool): Whether to read a file whose frames take more than 1 GiB and more than
            200 times its own size, as a hostile one does.

    Returns:
        Recording: The time is in seconds since the anchor of the stream, and the frames of a live
        stream have their numbers and the times of their device as :obj:`"sequence"` and
        :obj:`"device_time"` in :obj:`extra`. Events, such as marks and new rests, are a list of
        :obj:`{"time": ..., "kind": ..., "text": ...}` in :obj:`meta["events"]`, if there are any;
        those between which annotations lie are the :obj:`annotations` instead. An annotation whose
        end is not in the file lasts to the last frame.

    Raises:
        FileNotFoundError: If there is no such file.
        ImportError: If the extra :obj:`live` is missing.
        ValueError: If it is no MCAP file, has no topic :obj:`tactile.Frame` or no frame that can be
            read, or is not whole and :obj:`recover` is false. The message names the file.

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
    path = checked_file(path)
    scan = Scan(path)
    content = _Content(path, FrameRows(path.stat().st_size, allow_large))
    for kind, record in scan.records():
        content.add(kind, record)
    if not content.rows.num_frames:
        raise ValueError(content.why_empty(scan))
    problems = [*scan.damage, *content.problems()]
    if problems and not recover:
        raise ValueError(
            f"'{path}' is not whole: {first_problems(problems)}; read it with recover=True, or "
            "repair it with `tactile replay FILE --repair OUT`"
        )
    recording, gaps = content.recording()
    if problems:
        _log.warning(
            "'%s' is not whole: %s; %d frames were read%s",
            path,
            first_problems(problems),
            recording.num_frames,
            f", and {gaps}" if gaps else "",
        )
    return recording


def first_problems(problems: list[str]) -> str:
    r"""Returns the first few of some problems as one text."""
    return short_list(problems, _MOST_TOLD, printable, rest="; and {} more", joint="; ")


@dataclass
class _Content:
    # What the records of a file say.
    path: Path
    rows: FrameRows
    channels: dict[int, Any] = field(default_factory=dict)
    schemas: dict[int, Any] = field(default_factory=dict)
    texts: dict[str, str] = field(default_factory=dict)
    known: dict[int, str] = field(default_factory=dict)
    events: list[dict[str, Any]] = field(default_factory=list)
    spans: list[Annotation] = field(default_factory=list)
    open_spans: dict[str, list[int]] = field(default_factory=dict)  # their places, by label
    wrong: list[str] = field(default_factory=list)
    num_wrong: int = 0

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
                self.wrong.append("label and metadata differ from their checksum")

    def _check_version(self, texts: dict[str, str]) -> None:
        if texts.get("version") != str(VERSION):
            raise ValueError(
                f"'{self.path}' must be of format version {VERSION} (got "
                f"{printable(texts.get('version'))}): read it with the version of "
                "torch-geometric-tactile that wrote it"
            )

    def _add_message(self, channel: int, data: bytes) -> None:
        if channel not in self.known:
            self.known[channel] = self._topic(channel)
        if self.known[channel] == EVENT:
            self._add_event(data)
        if self.known[channel] != FRAME:
            return
        try:
            self.rows.add(data)
        except ValueError as error:
            self.num_wrong += 1
            if self.num_wrong == 1:
                self.wrong.append(f"a message is no frame of this recording: {error}")
        except MemoryError as error:
            raise ValueError(f"'{self.path}' cannot be read: {error}") from error

    def _add_event(self, data: bytes) -> None:
        if len(data) > _LARGEST_EVENT:
            return
        try:
            event = decode(EVENT, data)
            if event.kind in (SPAN_START, SPAN_END):
                self._add_span(event.kind, checked_annotation((event.time, event.time, event.text)))
                return
        except ValueError:  # of another program, that calls a topic or an event so
            return
        if math.isfinite(event.time) and len(self.events) < _MOST_EVENTS:
            self.events.append({"time": event.time, "kind": event.kind, "text": event.text})

    def _add_span(self, kind: str, moment: Annotation) -> None:
        opened = self.open_spans.setdefault(moment.label, [])
        if kind == SPAN_START and len(self.spans) < MAX_ANNOTATIONS:
            opened.append(len(self.spans))
            self.spans.append(moment)
        elif kind == SPAN_END and opened:
            i = opened.pop()
            self.spans[i] = moment._replace(start=min(self.spans[i].start, moment.end))

    def _annotations(self, last: float, anchor: float) -> list[Annotation]:
        left = {i for opened in self.open_spans.values() for i in opened}
        ended = [
            span._replace(end=max(span.start, last)) if i in left else span
            for i, span in enumerate(self.spans)
        ]
        return [Annotation(s.start - anchor, s.end - anchor, s.label) for s in ended]

    def _topic(self, number: int) -> str:
        channel = self.channels.get(number)
        if channel is None:
            # Its description was in a chunk that is damaged; ours is in the metadata too.
            stated = self._stated_channels()
            return next((topic for topic in (FRAME, EVENT) if stated.get(topic) == number), "")
        if channel.topic == EVENT and channel.message_encoding == "protobuf":
            return EVENT
        schema = self.schemas.get(channel.schema_id)
        if channel.message_encoding != "protobuf" or FRAME not in (
            channel.topic,
            "" if schema is None else schema.name,
        ):
            return ""
        problem = "" if schema is None else check_schema(schema.data)
        if problem:
            raise ValueError(
                f"'{self.path}' must have frames of our schema in the topic "
                f"'{printable(channel.topic)}': {printable(problem)}"
            )
        return FRAME

    def _stated_channels(self) -> dict[str, Any]:
        try:
            found = parse_json(self.texts.get("channels", "{}"))
        except ValueError:
            return {}
        return found if isinstance(found, dict) else {}

    def why_empty(self, scan: Scan) -> str:
        problems = [*scan.damage, *self.wrong]
        why = f" ({first_problems(problems)})" if problems else ""
        topics = sorted({printable(channel.topic) for channel in self.channels.values()})
        if FRAME in topics:
            return f"'{self.path}' must hold a frame that can be read (got none{why})"
        return (
            f"'{self.path}' must have the topic '{FRAME}', or another one of its schema (got "
            f"{', '.join(topics[:20]) or 'no topics'}{why})"
        )

    def problems(self) -> list[str]:
        out = [*self.wrong]
        if self.num_wrong > 1:
            out.append(f"{self.num_wrong} messages are no frames of this recording")
        stated = self._stated_channels()
        if stated and not self.channels:
            out.append("its table of topics is damaged")
        return out

    def recording(self) -> tuple[Recording, str]:
        arrays, lost = self.rows.arrays()
        if lost:
            _log.warning(
                "'%s': left out %s, which some frames do not have",
                self.path,
                ", ".join(printable(name) for name in lost),
            )
        order = _increasing(arrays["time"])
        if order is not None:
            _log.warning(
                "'%s': frames were not in the order of their time, or twice; %d of %d are kept",
                self.path,
                len(order),
                self.rows.num_frames,
            )
            arrays = {name: array[order] for name, array in arrays.items()}
        gaps = _gaps(arrays["sequence"], arrays["time"])
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


def _increasing(time: np.ndarray) -> np.ndarray | None:
    if (np.diff(time) > 0).all():
        return None
    order = np.argsort(time, kind="stable")
    keep = np.r_[True, np.diff(time[order]) > 0]
    return order[keep]


def _gaps(sequence: np.ndarray, time: np.ndarray) -> str:
    step = np.diff(sequence)
    holes = np.flatnonzero(step > 1)
    if not len(holes):
        return ""
    seconds = float((time[holes + 1] - time[holes]).sum())
    return f"{int((step[holes] - 1).sum())} between them are missing, in {seconds:.2f} s"
