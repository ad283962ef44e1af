r"""Repair of truncated or damaged MCAP files."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from torch_geometric_tactile._files import atomic_path
from torch_geometric_tactile._texts import parse_json
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.io._mcap_output import McapOutput, require_mcap
from torch_geometric_tactile.io._mcap_records import (
    CHANNEL,
    MESSAGE,
    METADATA,
    METADATA_NAME,
    SCHEMA,
    Scan,
    texts_checksum,
)
from torch_geometric_tactile.io._mcap_schemas import FRAME, TOPICS, frame_schema, message_schema
from torch_geometric_tactile.io._recording_schema import recording_path
from torch_geometric_tactile.io.mcap_reader import join_problems


@dataclass(frozen=True)
class RepairReport:
    r"""The number of messages and chunks that :func:`repair_mcap` saved, and the damage it found.

    Args:
        messages (dict of str to int): Number of messages saved, by topic.
        chunks (int): Number of chunks saved.
        skipped_bytes (int): Number of unreadable bytes.
        damage (tuple of str): Descriptions of the damage; empty for an intact file.
        seconds (float): Time from the first to the last saved message in seconds.

    Examples:
        >>> report = RepairReport({"tactile.Frame": 20}, 1, 0, damage=(), seconds=0.19)
        >>> print(report)
        saved 20 tactile.Frame (0.19 s, 1 chunks); left out 0 bytes: no damage
    """

    messages: dict[str, int]
    chunks: int
    skipped_bytes: int
    damage: tuple[str, ...]
    seconds: float

    def __str__(self) -> str:
        saved = ", ".join(f"{count} {topic}" for topic, count in self.messages.items())
        damage = join_problems([*self.damage]) if self.damage else "no damage"
        return (
            f"saved {saved or 'nothing'} ({self.seconds:.2f} s, {self.chunks} chunks); left out "
            f"{self.skipped_bytes} bytes: {damage}"
        )


def repair_mcap(path: PathLike, out: PathLike) -> RepairReport:
    r"""Repairs an MCAP file: copies all readable messages of all topics to a new file. Attachments
    are left out.

    Args:
        path (str or PathLike): The damaged file, which is not changed.
        out (str or PathLike): The new file, which is either complete or absent.

    Raises:
        FileNotFoundError: If there is no such file.
        ImportError: If the extra :obj:`live` is missing.
        OSError: If the disk is full.
        ValueError: If it is not an MCAP file, no message can be saved, or :obj:`out` is the same
            file.

    Examples:
        >>> import tempfile
        >>> from pathlib import Path
        >>> import numpy as np
        >>> from torch_geometric_tactile.data import Recording
        >>> from torch_geometric_tactile.io import write_mcap
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = Path(folder) / "cut.mcap"
        ...     write_mcap(Recording(time=[0.0, 0.01], tactile=np.ones((2, 4, 3))), path)
        ...     _ = path.write_bytes(path.read_bytes()[:-40])  # as after a crash
        ...     report = repair_mcap(path, f"{folder}/whole.mcap")
        >>> report.messages["tactile.Frame"]
        2
    """
    library = require_mcap()
    path, out = recording_path(path), Path(out)
    if out.exists() and out.samefile(path):
        raise ValueError(f"'out' must be a new file (got the damaged file '{path}')")
    scan = Scan(path)
    with atomic_path(out) as temporary:
        output = McapOutput(temporary, overwrite=True, lock=False)
        try:
            writer = library.Writer(output, enable_data_crcs=True)
            writer.start(library="torch_geometric_tactile")
            copier = _RecordCopier(writer)
            for kind, record in scan.records():
                copier.add(kind, record)
            if not copier.counts:
                raise ValueError(
                    f"'{path}' holds no readable message ({join_problems(scan.damage)})"
                )
            writer.finish()
        except OSError as error:
            raise OSError(error.errno, os.strerror(error.errno or 0), str(out)) from error
        finally:
            output.close()
    return RepairReport(
        messages=dict(sorted(copier.counts.items())),
        chunks=scan.chunks,
        skipped_bytes=scan.skipped,
        damage=tuple(scan.damage),
        seconds=(copier.last_time - copier.first_time) / 1e9,
    )


class _RecordCopier:
    # Copies records to another file, which assigns new numbers to the channels.

    def __init__(self, writer: Any) -> None:
        self.writer = writer
        self.counts: dict[str, int] = {}
        self.first_time = self.last_time = 0
        self._channels: dict[int, Any] = {}
        self._schemas: dict[int, Any] = {}
        # Topic and new number of a channel, by its old number.
        self._written: dict[int, tuple[str, int]] = {}
        self._schema_numbers: dict[int, int] = {}

    def add(self, kind: int, record: Any) -> None:
        if kind == MESSAGE:
            self._add_message(record)
        elif kind == CHANNEL:
            self._channels.setdefault(record.id, record)
        elif kind == SCHEMA:
            self._schemas.setdefault(record.id, record)
        elif kind == METADATA:
            self._add_metadata(record)

    def _add_metadata(self, record: Any) -> None:
        if record.name == METADATA_NAME:
            texts = dict(record.metadata)
            if texts.pop("crc32", "") != str(texts_checksum(texts)):
                return
            # In the order of `McapWriter`, so that the channel numbers in the metadata stay valid.
            topics = {number: topic for topic, number in parse_json(texts["channels"]).items()}
            for number, topic in sorted(topics.items()):
                if topic in TOPICS:
                    has_actions = texts.get("has_actions") == "1"
                    schema = frame_schema(has_actions) if topic == FRAME else message_schema(topic)
                    schema_number = self.writer.register_schema(topic, "protobuf", schema)
                    new_number = self.writer.register_channel(topic, "protobuf", schema_number)
                    self._written[number] = topic, new_number
        self.writer.add_metadata(record.name, record.metadata)

    def _register(self, channel: Any) -> tuple[str, int]:
        schema = self._schemas.get(channel.schema_id)
        if schema is not None and schema.id not in self._schema_numbers:
            self._schema_numbers[schema.id] = self.writer.register_schema(
                schema.name, schema.encoding, schema.data
            )
        schema_number = self._schema_numbers.get(channel.schema_id, 0)
        encoding = channel.message_encoding
        new_number = self.writer.register_channel(
            channel.topic, encoding, schema_number, channel.metadata
        )
        return channel.topic, new_number

    def _add_message(self, message: Any) -> None:
        number = message.channel_id
        if number not in self._written:
            if number not in self._channels:
                return
            self._written[number] = self._register(self._channels[number])
        topic, new_number = self._written[number]
        self.writer.add_message(
            channel_id=new_number,
            log_time=message.log_time,
            publish_time=message.publish_time,
            sequence=message.sequence,
            data=message.data,
        )
        self.first_time = (
            min(self.first_time, message.log_time) if self.counts else message.log_time
        )
        self.last_time = max(self.last_time, message.log_time)
        self.counts[topic] = self.counts.get(topic, 0) + 1
