r"""Records of MCAP files, chunk by chunk: whole ones with their checksums compared, of cut and
damaged files what is left.

The `format <https://mcap.dev/spec>`_ is a row of records (type, length, content). Messages are in
chunks, compressed, each with its CRC-32. The end of the file says where each chunk is, and a file
that was cut has no end: readers that begin there read nothing.
"""

import os
import struct
import zlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

MAGIC = b"\x89MCAP0\r\n"
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX = range(1, 8)
METADATA, DATA_END = 0x0C, 0x0F
_LAST_KNOWN = 0x0F
_HEAD = struct.Struct("<BQ")
_CHUNK_HEAD = struct.Struct("<QQQI")
_MESSAGE_HEAD = struct.Struct("<HIQQ")
# What is behind the head of a chunk: how it is compressed. Looked for where the way is lost.
_MARKS = (b"\x04\x00\x00\x00zstd", b"\x03\x00\x00\x00lz4")
_MOST_RECORD = 2**27  # bytes that are read of a record, and that a chunk may become
_BLOCK = 2**20
_READ = {HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, METADATA, DATA_END}


class Message(NamedTuple):
    r"""A message: its times in nanoseconds since 1970, and its bytes."""

    channel: int
    sequence: int
    log_time: int
    publish_time: int
    data: memoryview


class Channel(NamedTuple):
    r"""A topic, and what its messages are."""

    id: int
    schema: int
    topic: str
    encoding: str
    metadata: dict[str, str]


class Schema(NamedTuple):
    r"""What messages of a channel hold."""

    id: int
    name: str
    encoding: str
    data: bytes


class Metadata(NamedTuple):
    r"""Texts by their names."""

    name: str
    values: dict[str, str]


Record = Message | Channel | Schema | Metadata


@dataclass
class Scan:
    r"""The records of a file in their order, and what was wrong with it.

    Args:
        path (Path): The file.

    Attributes:
        damage (list of str): What cannot be read; filled while :meth:`batches` goes on.
        finished (bool): Whether the file has its end.
        skipped (int): Bytes in which nothing could be read.
        chunks (int): Chunks that were whole.
    """

    path: Path
    damage: list[str] = field(default_factory=list)
    finished: bool = False
    skipped: int = 0
    chunks: int = 0

    def batches(self) -> Iterator[Iterable[Record]]:
        r"""Yields records: those of a chunk together, all others alone.

        Raises:
            ValueError: If it is no MCAP file.
        """
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
            head = file.read(_HEAD.size)
            why = _implausible(head, size - place)
            content = b""
            if not why:
                kind, length = _HEAD.unpack(head)
                if kind == DATA_END:
                    self._end(file, place, size, crc)
                    return
                if kind in _READ:
                    content = file.read(length)
                    why = "" if len(content) == length else "it was cut"
                if crc is not None:
                    crc = zlib.crc32(content, zlib.crc32(head, crc))
                    if kind not in _READ:
                        crc = _crc_of(file, length, crc)
            if not why:
                stop = place + _HEAD.size + length
                try:
                    batch = _parsed(kind, content)
                except _Damaged as error:
                    crc = None
                    # Its length may be what is damaged.
                    file.seek(stop)
                    if _implausible(file.read(_HEAD.size), size - stop) and stop < size:
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
        self.damage.append("it has no end: it was cut, or is still being written")

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
                    summary = zlib.crc32(_HEAD.pack(kind, len(content)), summary)
                    summary = zlib.crc32(content, summary)
            stated, _, expected = struct.unpack("<QQI", content)
            summary = zlib.crc32(content[:16], zlib.crc32(_HEAD.pack(FOOTER, 20), summary))
            if stated not in (0, summary_start) or expected not in (0, summary):
                self.damage.append(f"its index differs from its checksum (from byte {place})")
            if file.read(len(MAGIC)) != MAGIC or file.read(1):
                self.damage.append(f"something else is behind its end (from byte {footer})")
        except (_Damaged, struct.error) as error:
            self.damage.append(f"its index cannot be read ({error})")


class _Damaged(Exception):  # noqa: N818 - never leaves this file
    pass


def _next_record(file: BinaryIO) -> tuple[int, bytes]:
    head = file.read(_HEAD.size)
    if len(head) < _HEAD.size:
        raise _Damaged("it was cut")
    kind, length = _HEAD.unpack(head)
    if length > _MOST_RECORD:
        raise _Damaged("a length is absurd")
    content = file.read(length)
    if len(content) < length:
        raise _Damaged("it was cut")
    return kind, content


def _implausible(head: bytes, room: int) -> str:
    if len(head) < _HEAD.size:
        return "it was cut"
    kind, length = _HEAD.unpack(head)
    if not (1 <= kind <= _LAST_KNOWN or kind >= 0x80):
        return "a record is damaged"
    if length > room - _HEAD.size:
        return "a record is cut or damaged"
    return "a record is too large" if kind in _READ and length > _MOST_RECORD else ""


def _crc_of(file: BinaryIO, length: int, crc: int) -> int:
    while length:
        part = file.read(min(length, _BLOCK))
        if not part:
            break
        crc, length = zlib.crc32(part, crc), length - len(part)
    return crc


def _next_chunk(file: BinaryIO, start: int, size: int) -> int | None:
    # Where a record begins that looks like a compressed chunk. Its checksum decides.
    before = _HEAD.size + _CHUNK_HEAD.size
    place = start
    while place < size:
        file.seek(place)
        block = file.read(_BLOCK + before + 8)
        for at in sorted(_found(block)):
            head = block[at - before : at - before + _HEAD.size]
            if head[0] == CHUNK and not _implausible(head, size - place - at + before):
                return place + at - before
        place += _BLOCK
    return None


def _found(block: bytes) -> Iterator[int]:
    before = _HEAD.size + _CHUNK_HEAD.size
    for mark in _MARKS:
        at = block.find(mark, before)
        while at >= 0:
            yield at
            at = block.find(mark, at + 1)


def _parsed(kind: int, content: bytes) -> Iterable[Record]:
    try:
        if kind == CHUNK:
            return _chunk_records(content)
        record = _record(kind, memoryview(content))
    except (struct.error, UnicodeDecodeError, IndexError) as error:
        raise _Damaged(f"a record is damaged: {error}") from error
    return [] if record is None else [record]


def _record(kind: int, content: memoryview) -> Record | None:
    if kind == MESSAGE:
        head = _MESSAGE_HEAD.unpack_from(content)
        return Message(*head, content[_MESSAGE_HEAD.size :])
    if kind == CHANNEL:
        number, schema = struct.unpack_from("<HH", content)
        topic, place = _text(content, 4)
        encoding, place = _text(content, place)
        return Channel(number, schema, topic, encoding, _texts(content, place))
    if kind == SCHEMA:
        (number,) = struct.unpack_from("<H", content)
        name, place = _text(content, 2)
        encoding, place = _text(content, place)
        return Schema(number, name, encoding, bytes(_part(content, place)[0]))
    if kind == METADATA:
        name, place = _text(content, 0)
        return Metadata(name, _texts(content, place))
    return None


def _part(content: memoryview, place: int) -> tuple[memoryview, int]:
    (length,) = struct.unpack_from("<I", content, place)
    stop = place + 4 + length
    if stop > len(content):
        raise _Damaged("a text is longer than its record")
    return content[place + 4 : stop], stop


def _text(content: memoryview, place: int) -> tuple[str, int]:
    part, place = _part(content, place)
    return str(part, "utf-8"), place


def _texts(content: memoryview, place: int) -> dict[str, str]:
    part, _ = _part(content, place)
    out, place = {}, 0
    while place < len(part):
        key, place = _text(part, place)
        out[key], place = _text(part, place)
    return out


def _chunk_records(content: bytes) -> Iterator[Record]:
    _, _, size, crc = _CHUNK_HEAD.unpack_from(content)
    view = memoryview(content)
    compression, place = _text(view, _CHUNK_HEAD.size)
    (length,) = struct.unpack_from("<Q", content, place)
    packed = view[place + 8 : place + 8 + length]
    if len(packed) < length or size > _MOST_RECORD:
        raise _Damaged("the length of a chunk is damaged")
    data = _unpacked(compression, packed, size)
    if len(data) != size or (crc and zlib.crc32(data) != crc):
        raise _Damaged("a chunk differs from its checksum")
    for kind, part in _walk(data):
        if kind != MESSAGE:
            _record(kind, part)
        elif len(part) < _MESSAGE_HEAD.size:
            raise _Damaged("a message is shorter than its head")
    # One by one: a chunk of small messages would be many times its size as objects.
    records = (_record(kind, part) for kind, part in _walk(data))
    return (record for record in records if record is not None)


def _walk(data: bytes) -> Iterator[tuple[int, memoryview]]:
    view, place = memoryview(data), 0
    while place < len(data):
        kind, length = _HEAD.unpack_from(data, place)
        place += _HEAD.size + length
        if place > len(data):
            raise _Damaged("a record is longer than its chunk")
        yield kind, view[place - length : place]


def _unpacked(compression: str, packed: memoryview, size: int) -> bytes:
    if compression == "":
        return bytes(packed)
    if compression not in ("zstd", "lz4"):
        raise _Damaged(f"a chunk is compressed in an unknown way ({compression[:20]!r})")
    try:
        return _zstd(packed, size) if compression == "zstd" else _lz4(packed, size)
    except ImportError:
        raise
    except Exception as error:  # each library has its own
        raise _Damaged(f"a chunk cannot be decompressed: {error}") from error


def _zstd(packed: memoryview, size: int) -> bytes:
    zstandard = _library("zstandard")
    # The frame names a size of its own, for which the memory would be taken.
    stated = zstandard.get_frame_parameters(packed).content_size
    if stated not in (size, zstandard.CONTENTSIZE_UNKNOWN, 0):
        raise _Damaged("a chunk says two sizes")
    if not size:
        return b""
    limit = zstandard.ZstdDecompressor(max_window_size=_MOST_RECORD)
    return bytes(limit.decompress(packed, max_output_size=size))


def _lz4(packed: memoryview, size: int) -> bytes:
    return bytes(_library("lz4.frame").LZ4FrameDecompressor().decompress(packed, max_length=size))


def _library(name: str) -> Any:
    import importlib

    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise ImportError(
            f"MCAP recordings need {name}: pip install 'torch-geometric-tactile[live]'"
        ) from error


def count_messages(path: Path) -> dict[int, int]:
    r"""Returns how many messages the indices behind the chunks of a file tell of, by channel.

    Only heads are read, and nothing is checked: for the memory to reserve.

    Args:
        path (Path): The file.
    """
    counts: dict[int, int] = {}
    with path.open("rb") as file:
        size = os.fstat(file.fileno()).st_size
        place = len(MAGIC)
        while place < size:
            file.seek(place)
            head = file.read(_HEAD.size + 2)
            if _implausible(head[: _HEAD.size], size - place) or head[0] == DATA_END:
                break
            kind, length = _HEAD.unpack_from(head)
            if kind == MESSAGE_INDEX and length >= 6:
                channel = int.from_bytes(head[_HEAD.size :], "little")
                counts[channel] = counts.get(channel, 0) + (length - 6) // 16
            place += _HEAD.size + length
    return counts
