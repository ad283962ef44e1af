r"""Records of MCAP files, one by one: complete ones with their checksums compared, and what is left
of truncated and damaged files.

The `format <https://mcap.dev/spec>`_ is a row of records (type, length, content). Messages are in
chunks, compressed, each with its CRC-32. The end of the file says where each chunk is, and a
truncated file has no end: readers that begin there read nothing.

The library reads each record from its own bytes, so that no length inside of it reaches beyond.
Its readers of whole files are not used: they take the memory that compressed data claim to need,
make objects of all messages of a chunk at once, and end at the first damage.
"""

import json
import os
import struct
import zlib
from bisect import bisect
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._limits import RECORD_BYTES
from torch_geometric_tactile.io._mcap_output import require_mcap

MAGIC = b"\x89MCAP0\r\n"
METADATA_NAME = "torch_geometric_tactile"
FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK = range(2, 7)
CHUNK_INDEX, METADATA, DATA_END = 0x08, 0x0C, 0x0F
_HEAD = struct.Struct("<BQ")
_FOOTER = struct.Struct("<QQI")  # of the summary: where it begins, its second part, its checksum
_END_SIZE = _HEAD.size + _FOOTER.size + len(MAGIC)


class Damaged(Exception):  # noqa: N818 - never leaves the readers
    r"""A record is not what it was."""


@dataclass
class Scan:
    r"""The records of a file in their order, and what was wrong with it."""

    path: Path
    damage: list[str] = field(default_factory=list)
    skipped: int = 0
    chunks: int = 0

    def records(self) -> Iterator[tuple[int, Any]]:
        r"""Yields the library's records and their types. Those that the end of the file repeats
        come first: for a file whose first chunk is damaged.
        """
        with self.path.open("rb") as file:
            size = os.fstat(file.fileno()).st_size
            start = file.read(len(MAGIC))
            summary, problem = _summary(file, size)
            starts = sorted(one.chunk_start_offset for kind, one in summary if kind == CHUNK_INDEX)
            crc: int | None = zlib.crc32(start)
            place = len(MAGIC)
            if start != MAGIC:
                need(starts, f"'{self.path}' is no MCAP file (it begins with {start!r})")
                crc, place = None, starts[0]
                self._lost(0, place, "its beginning is damaged")
            yield from summary
            while place < size:
                file.seek(place)
                head = file.read(_HEAD.size)
                why = _implausible(head, size - place)
                kind, length = (0, 0) if why else _HEAD.unpack(head)
                stop = place + _HEAD.size + length
                content = b"" if length > RECORD_BYTES else file.read(length)
                if kind == DATA_END:
                    if crc is not None and int.from_bytes(content, "little") not in (0, crc):
                        self.damage.append("its records differ from their checksum")
                    self.damage += [problem] if problem else []
                    return
                try:
                    if why:
                        # Where the next record begins, only the index knows, and that of chunks.
                        after = bisect(starts, place)
                        stop = starts[after] if after < len(starts) else size
                        raise Damaged(why)
                    yield from self._parts(kind, content)
                    crc = None if crc is None else zlib.crc32(content, zlib.crc32(head, crc))
                except Damaged as error:
                    crc = None
                    self._lost(place, stop, str(error))
                if length > RECORD_BYTES:  # was not read
                    crc = None
                place = stop
        self.damage.append("it is truncated, or still being written")

    def _lost(self, start: int, stop: int, why: str) -> None:
        self.skipped += stop - start
        self.damage.append(f"{why} ({stop - start} bytes from byte {start})")

    def _parts(self, kind: int, content: bytes) -> Iterator[tuple[int, Any]]:
        record = _record(kind, content)
        if kind != CHUNK:
            yield kind, record
            return
        # One by one: a chunk of small messages would be many times its size as objects.
        for inner, part in _walk(_unpacked(record)):
            yield inner, _record(inner, part)
        self.chunks += 1


def _implausible(head: bytes, room: int) -> str:
    if len(head) < _HEAD.size:
        return "it is truncated"
    kind, length = _HEAD.unpack(head)
    if not (1 <= kind <= DATA_END or kind >= 0x80):
        return "a record is damaged"
    if length > room - _HEAD.size:
        return "a record is truncated or damaged"
    # Readers do not need the others, such as files that are attached.
    return "a record is too large" if kind in _readers() and length > RECORD_BYTES else ""


@cache
def _readers() -> dict[int, Any]:
    require_mcap()
    from mcap import records

    return {
        SCHEMA: records.Schema.read,
        CHANNEL: records.Channel.read,
        MESSAGE: records.Message.read,
        CHUNK: records.Chunk.read,
        CHUNK_INDEX: records.ChunkIndex.read,
        METADATA: records.Metadata.read,
    }


@cache
def _stream() -> tuple[Any, tuple[type[Exception], ...]]:
    # What the readers take, and what they raise.
    from mcap.data_stream import ReadDataStream
    from mcap.exceptions import McapError

    return ReadDataStream, (McapError, OverflowError, UnicodeDecodeError, struct.error)


def _record(kind: int, content: bytes | memoryview) -> Any | None:
    # None for those that readers need not know.
    read = _readers().get(kind)
    if read is None:
        return None
    stream, errors = _stream()
    try:
        of_bytes = stream(BytesIO(content))
        return read(of_bytes, len(content)) if kind == MESSAGE else read(of_bytes)
    except errors as error:
        raise Damaged(f"a record is damaged: {error}") from error


def _walk(data: bytes) -> Iterator[tuple[int, memoryview]]:
    view, place = memoryview(data), 0
    while place < len(data):
        if len(data) - place < _HEAD.size:
            raise Damaged("a chunk ends in half a record")
        kind, length = _HEAD.unpack_from(data, place)
        place += _HEAD.size + length
        if place > len(data):
            raise Damaged("a record is longer than its chunk")
        yield kind, view[place - length : place]


def _unpacked(chunk: Any) -> bytes:
    size, packed = chunk.uncompressed_size, chunk.data
    if size > RECORD_BYTES:
        raise Damaged("the length of a chunk is damaged")
    if chunk.compression not in ("", "zstd", "lz4"):
        raise Damaged(f"a chunk is compressed in an unknown way ({chunk.compression[:20]!r})")
    try:
        unpack = {"zstd": _zstd, "lz4": _lz4}.get(chunk.compression)
        data = packed if unpack is None else unpack(packed, size)
    except (Damaged, ImportError):
        raise
    except Exception as error:  # each library has its own
        raise Damaged(f"a chunk cannot be decompressed: {error}") from error
    if len(data) != size or chunk.uncompressed_crc not in (0, zlib.crc32(data)):
        raise Damaged("a chunk differs from its checksum")
    return data


def _zstd(packed: bytes, size: int) -> bytes:
    zstandard = _library("zstandard")
    # The frame names a size of its own, for which the memory would be taken.
    stated = zstandard.get_frame_parameters(packed).content_size
    if stated not in (size, zstandard.CONTENTSIZE_UNKNOWN, 0):
        raise Damaged("a chunk says two sizes")
    if not size:
        return b""
    limit = zstandard.ZstdDecompressor(max_window_size=RECORD_BYTES)
    return bytes(limit.decompress(packed, max_output_size=size))


def _lz4(packed: bytes, size: int) -> bytes:
    return bytes(_library("lz4.frame").LZ4FrameDecompressor().decompress(packed, max_length=size))


def _library(name: str) -> Any:
    try:
        return import_module(name)
    except ImportError as error:
        raise ImportError(
            f"MCAP recordings need {name}: pip install 'torch-geometric-tactile[live]'"
        ) from error


def _summary(file: BinaryIO, size: int) -> tuple[list[tuple[int, Any]], str]:
    # What the end of a file repeats, if it has a right checksum, and what is wrong with it.
    footer = b""
    if size >= _END_SIZE:
        file.seek(size - _END_SIZE)
        footer = file.read(_END_SIZE)
    if footer[: _HEAD.size] != _HEAD.pack(FOOTER, _FOOTER.size) or footer[-len(MAGIC) :] != MAGIC:
        return [], "its end is damaged, or something else is behind it"
    start, _, expected = _FOOTER.unpack_from(footer, _HEAD.size)
    length = size - _END_SIZE - start if start else 0
    if not 0 <= length <= RECORD_BYTES:
        return [], "its index cannot be read"
    file.seek(start)
    content = file.read(length)
    crc = zlib.crc32(footer[: -len(MAGIC) - 4], zlib.crc32(content))
    if expected not in (0, crc):
        return [], f"its index differs from its checksum (from byte {start})"
    try:
        records = [(kind, _record(kind, part)) for kind, part in _walk(content)] if expected else []
    except Damaged as error:
        return [], f"its index cannot be read ({error})"
    return records, ""


def texts_checksum(texts: Mapping[str, str]) -> int:
    r"""Returns the CRC-32 of the texts in the metadata of a recording, and of their names."""
    return zlib.crc32(json.dumps(sorted(texts.items())).encode())
