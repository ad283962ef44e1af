r"""What the records of MCAP files hold."""

import importlib
import struct
import zlib
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

from torch_geometric_tactile._limits import RECORD_BYTES

HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX = range(1, 8)
METADATA, DATA_END = 0x0C, 0x0F
HEAD = struct.Struct("<BQ")
CHUNK_HEAD = struct.Struct("<QQQI")
_MESSAGE_HEAD = struct.Struct("<HIQQ")


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


class Damaged(Exception):  # noqa: N818 - never leaves the readers
    r"""A record is not what it was."""


def parsed(kind: int, content: bytes) -> Iterable[Record]:
    r"""Returns the records of a chunk after its checksum was compared, or the record itself."""
    try:
        if kind == CHUNK:
            return _chunk_records(content)
        record = record_of(kind, memoryview(content))
    except (struct.error, UnicodeDecodeError, IndexError) as error:
        raise Damaged(f"a record is damaged: {error}") from error
    return [] if record is None else [record]


def record_of(kind: int, content: memoryview) -> Record | None:
    r"""Returns a record, or :obj:`None` for those that readers need not know."""
    if kind == MESSAGE:
        channel, sequence, log_time, publish_time = _MESSAGE_HEAD.unpack_from(content)
        data = content[_MESSAGE_HEAD.size :]
        return Message(channel, sequence, log_time, publish_time, data)
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
        raise Damaged("a text is longer than its record")
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
    _, _, size, crc = CHUNK_HEAD.unpack_from(content)
    view = memoryview(content)
    compression, place = _text(view, CHUNK_HEAD.size)
    (length,) = struct.unpack_from("<Q", content, place)
    packed = view[place + 8 : place + 8 + length]
    if len(packed) < length or size > RECORD_BYTES:
        raise Damaged("the length of a chunk is damaged")
    data = _unpacked(compression, packed, size)
    if len(data) != size or (crc and zlib.crc32(data) != crc):
        raise Damaged("a chunk differs from its checksum")
    for kind, part in walk(data):
        if kind != MESSAGE:
            record_of(kind, part)
        elif len(part) < _MESSAGE_HEAD.size:
            raise Damaged("a message is shorter than its head")
    # One by one: a chunk of small messages would be many times its size as objects.
    records = (record_of(kind, part) for kind, part in walk(data))
    return (record for record in records if record is not None)


def walk(data: bytes) -> Iterator[tuple[int, memoryview]]:
    r"""Yields types and contents of records that are one behind the other."""
    view, place = memoryview(data), 0
    while place < len(data):
        kind, length = HEAD.unpack_from(data, place)
        place += HEAD.size + length
        if place > len(data):
            raise Damaged("a record is longer than its chunk")
        yield kind, view[place - length : place]


def _unpacked(compression: str, packed: memoryview, size: int) -> bytes:
    if compression == "":
        return bytes(packed)
    if compression not in ("zstd", "lz4"):
        raise Damaged(f"a chunk is compressed in an unknown way ({compression[:20]!r})")
    try:
        return _zstd(packed, size) if compression == "zstd" else _lz4(packed, size)
    except ImportError:
        raise
    except Exception as error:  # each library has its own
        raise Damaged(f"a chunk cannot be decompressed: {error}") from error


def _zstd(packed: memoryview, size: int) -> bytes:
    zstandard = _library("zstandard")
    # The frame names a size of its own, for which the memory would be taken.
    stated = zstandard.get_frame_parameters(packed).content_size
    if stated not in (size, zstandard.CONTENTSIZE_UNKNOWN, 0):
        raise Damaged("a chunk says two sizes")
    if not size:
        return b""
    limit = zstandard.ZstdDecompressor(max_window_size=RECORD_BYTES)
    return bytes(limit.decompress(packed, max_output_size=size))


def _lz4(packed: memoryview, size: int) -> bytes:
    return bytes(_library("lz4.frame").LZ4FrameDecompressor().decompress(packed, max_length=size))


def _library(name: str) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise ImportError(
            f"MCAP recordings need {name}: pip install 'torch-geometric-tactile[live]'"
        ) from error
