r"""Records of MCAP files, chunk by chunk: complete ones with their checksums compared, and what is
left of truncated and damaged files.

The `format <https://mcap.dev/spec>`_ is a row of records (type, length, content). Messages are in
chunks, compressed, each with its CRC-32. The end of the file says where each chunk is, and a
truncated file has no end: readers that begin there read nothing.
"""

import os
import struct
import zlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

from torch_geometric_tactile._limits import RECORD_BYTES
from torch_geometric_tactile.io._mcap_content import (
    CHANNEL,
    CHUNK,
    CHUNK_HEAD,
    DATA_END,
    FOOTER,
    HEAD,
    HEADER,
    MESSAGE,
    MESSAGE_INDEX,
    METADATA,
    SCHEMA,
    Channel,
    Damaged,
    Record,
    Schema,
    parsed,
    record_of,
    walk,
)

MAGIC = b"\x89MCAP0\r\n"
_LAST_KNOWN = 0x0F
# What is behind the head of a chunk: how it is compressed. Looked for where the way is lost.
_MARKS = (b"\x04\x00\x00\x00zstd", b"\x03\x00\x00\x00lz4")
_BLOCK = 2**20
_READ = {HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, METADATA, DATA_END}


@dataclass
class Scan:
    r"""The records of a file in their order, and what was wrong with it."""

    path: Path
    damage: list[str] = field(default_factory=list)
    finished: bool = False
    skipped: int = 0
    chunks: int = 0

    def batches(self) -> Iterator[Iterable[Record]]:
        r"""Yields records: those of a chunk together, all others alone."""
        with self.path.open("rb") as file:
            size = os.fstat(file.fileno()).st_size
            start = file.read(len(MAGIC))
            if start != MAGIC:
                # A file that is damaged at its beginning still has its chunks.
                place = _next_chunk(file, 0, size)
                if place is None:
                    raise ValueError(f"'{self.path}' is no MCAP file (it begins with {start!r})")
                self._lost(0, place, "its beginning is damaged")
                yield from self._records(file, place, size, None)
            else:
                yield from self._records(file, len(MAGIC), size, zlib.crc32(start))

    def _lost(self, start: int, stop: int, why: str) -> None:
        self.skipped += stop - start
        self.damage.append(f"{why} ({stop - start} bytes from byte {start})")

    def _records(
        self, file: BinaryIO, place: int, size: int, crc: int | None
    ) -> Iterator[Iterable[Record]]:
        while place < size:
            file.seek(place)
            head = file.read(HEAD.size)
            why = _implausible(head, size - place)
            content = b""
            if not why:
                kind, length = HEAD.unpack(head)
                if kind == DATA_END:
                    self._end(file, place, size, crc)
                    return
                if kind in _READ:
                    content = file.read(length)
                    why = "" if len(content) == length else "it is truncated"
                if crc is not None:
                    crc = zlib.crc32(content, zlib.crc32(head, crc))
                    if kind not in _READ:
                        crc = _crc_of(file, length, crc)
            if not why:
                stop = place + HEAD.size + length
                try:
                    batch = parsed(kind, content)
                except Damaged as error:
                    crc = None
                    # Its length may be what is damaged.
                    file.seek(stop)
                    if _implausible(file.read(HEAD.size), size - stop) and stop < size:
                        stop = _next_chunk(file, place + 1, size) or size
                    self._lost(place, stop, str(error))
                else:
                    self.chunks += kind == CHUNK
                    yield batch
            else:
                crc = None
                stop = _next_chunk(file, place + 1, size) or size
                self._lost(place, stop, why)
            place = stop
        self.damage.append("it is truncated, or still being written")

    def _end(self, file: BinaryIO, place: int, size: int, crc: int | None) -> None:
        self.finished = True
        file.seek(place)
        try:
            kind, content = _next_record(file)
            expected = int.from_bytes(content, "little") if len(content) == 4 else 0
            if crc is not None and expected not in (0, crc):
                self.damage.append("its records differ from their checksum")
            kind, summary_start, summary = 0, file.tell(), 0
            while kind != FOOTER:
                footer = file.tell()
                kind, content = _next_record(file)
                if kind != FOOTER:
                    summary = zlib.crc32(HEAD.pack(kind, len(content)), summary)
                    summary = zlib.crc32(content, summary)
            stated, _, expected = struct.unpack("<QQI", content)
            summary = zlib.crc32(content[:16], zlib.crc32(HEAD.pack(FOOTER, 20), summary))
            if stated not in (0, summary_start) or expected not in (0, summary):
                self.damage.append(f"its index differs from its checksum (from byte {place})")
            if file.read(len(MAGIC)) != MAGIC or file.read(1):
                self.damage.append(f"something else is behind its end (from byte {footer})")
        except (Damaged, struct.error) as error:
            self.damage.append(f"its index cannot be read ({error})")


def _next_record(file: BinaryIO) -> tuple[int, bytes]:
    head = file.read(HEAD.size)
    if len(head) < HEAD.size:
        raise Damaged("it is truncated")
    kind, length = HEAD.unpack(head)
    if length > RECORD_BYTES:
        raise Damaged("a length is absurd")
    content = file.read(length)
    if len(content) < length:
        raise Damaged("it is truncated")
    return kind, content


def _implausible(head: bytes, room: int) -> str:
    if len(head) < HEAD.size:
        return "it is truncated"
    kind, length = HEAD.unpack(head)
    if not (1 <= kind <= _LAST_KNOWN or kind >= 0x80):
        return "a record is damaged"
    if length > room - HEAD.size:
        return "a record is truncated or damaged"
    return "a record is too large" if kind in _READ and length > RECORD_BYTES else ""


def _crc_of(file: BinaryIO, length: int, crc: int) -> int:
    while length:
        part = file.read(min(length, _BLOCK))
        if not part:
            break
        crc, length = zlib.crc32(part, crc), length - len(part)
    return crc


def _next_chunk(file: BinaryIO, start: int, size: int) -> int | None:
    # Where a record begins that looks like a compressed chunk. Its checksum decides.
    before = HEAD.size + CHUNK_HEAD.size
    place = start
    while place < size:
        file.seek(place)
        block = file.read(_BLOCK + before + 8)
        for at in sorted(_found(block)):
            head = block[at - before : at - before + HEAD.size]
            if head[0] == CHUNK and not _implausible(head, size - place - at + before):
                return place + at - before
        place += _BLOCK
    return None


def _found(block: bytes) -> Iterator[int]:
    before = HEAD.size + CHUNK_HEAD.size
    for mark in _MARKS:
        at = block.find(mark, before)
        while at >= 0:
            yield at
            at = block.find(mark, at + 1)


def summary_records(path: Path) -> list[Record]:
    r"""Returns the topics thx, if it is there and whole: for a file whose
    beginning is damaged.
    """
    footer_size = HEAD.size + 20 + len(MAGIC)
    with path.open("rb") as file:
        size = os.fstat(file.fileno()).st_size
        if size < footer_size:
            return []
        file.seek(size - footer_size)
        footer = file.read()
        start, _, crc = struct.unpack_from("<QQI", footer, HEAD.size)
        length = size - footer_size - start
        if footer[0] != FOOTER or not 0 < length <= RECORD_BYTES or not start:
            return []
        file.seek(start)
        content = file.read(length)
    if zlib.crc32(footer[: HEAD.size + 16], zlib.crc32(content)) != crc:
        return []
    try:
        records = [record_of(kind, part) for kind, part in walk(content)]
    except (Damaged, struct.error, UnicodeDecodeError):
        return []
    return [record for record in records if isinstance(record, Channel | Schema)]


def count_messages(path: Path) -> dict[int, int]:
    r"""Returns how many messages the indices behind the chunks of a file tell of, by channel.

    Only heads are read, and nothing is checked: for the memory to reserve.
    """
    counts: dict[int, int] = {}
    with path.open("rb") as file:
        size = os.fstat(file.fileno()).st_size
        place = len(MAGIC)
        while place < size:
            file.seek(place)
            head = file.read(HEAD.size + 2)
            if _implausible(head[: HEAD.size], size - place) or head[0] == DATA_END:
                break
            kind, length = HEAD.unpack_from(head)
            if kind == MESSAGE_INDEX and length >= 6:
                channel = int.from_bytes(head[HEAD.size :], "little")
                counts[channel] = counts.get(channel, 0) + (length - 6) // 16
            place += HEAD.size + length
    return counts
