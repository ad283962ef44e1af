r"""Sequential reading of the records of MCAP files, including truncated and damaged files.

The `format <https://mcap.dev/spec>`_ is a sequence of records (type, length, content). Messages are
in compressed chunks, each with its CRC-32. An index of the chunks is at the end of the file. A
truncated file has no index, so readers that start with the index cannot read it.

The library parses single records from their bytes, so a wrong length in a record cannot reach
beyond the record. The library's file readers are not used, because they allocate the memory that
compressed data declare, create objects for all messages of a chunk at once, and stop at the first
damage.
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
_RECORD_HEADER = struct.Struct("<BQ")
_FOOTER_CONTENT = struct.Struct("<QQI")  # of the summary: start, start of the second part, checksum
_END_SIZE = _RECORD_HEADER.size + _FOOTER_CONTENT.size + len(MAGIC)


class Damaged(Exception):  # noqa: N818 - never leaves the readers
    r"""Raised for a damaged record."""


@dataclass
class Scan:
    r"""Reads the records of a file in order, and collects descriptions of damage.

    Args:
        path (Path): The file.
        damage (list of str): Descriptions of the damage found so far.
        skipped (int): Number of bytes skipped so far.
        chunks (int): Number of intact chunks read so far.
    """

    path: Path
    damage: list[str] = field(default_factory=list)
    skipped: int = 0
    chunks: int = 0

    def records(self) -> Iterator[tuple[int, Any]]:
        r"""Yields the type and the parsed content of each record. Records that are repeated in the
        summary at the end of the file come first, in case the first chunk is damaged.
        """
        with self.path.open("rb") as file:
            size = os.fstat(file.fileno()).st_size
            magic = file.read(len(MAGIC))
            summary, summary_problem = _read_summary(file, size)
            chunk_starts = sorted(
                record.chunk_start_offset for kind, record in summary if kind == CHUNK_INDEX
            )
            crc: int | None = zlib.crc32(magic)
            position = len(MAGIC)
            if magic != MAGIC:
                need(chunk_starts, f"'{self.path}' is not an MCAP file (it begins with {magic!r})")
                crc, position = None, chunk_starts[0]
                self._skip(0, position, "its beginning is damaged")
            yield from summary
            while position < size:
                file.seek(position)
                header = file.read(_RECORD_HEADER.size)
                header_problem = _header_problem(header, size - position)
                kind, length = (0, 0) if header_problem else _RECORD_HEADER.unpack(header)
                stop = position + _RECORD_HEADER.size + length
                content = b"" if length > RECORD_BYTES else file.read(length)
                if kind == DATA_END:
                    if crc is not None and int.from_bytes(content, "little") not in (0, crc):
                        self.damage.append("its records differ from their checksum")
                    self.damage += [summary_problem] if summary_problem else []
                    return
                try:
                    if header_problem:
                        # The next record is unknown, so continue at the next chunk of the index.
                        next_chunk = bisect(chunk_starts, position)
                        stop = chunk_starts[next_chunk] if next_chunk < len(chunk_starts) else size
                        raise Damaged(header_problem)
                    yield from self._expand_record(kind, content)
                    crc = None if crc is None else zlib.crc32(content, zlib.crc32(header, crc))
                except Damaged as error:
                    crc = None
                    self._skip(position, stop, str(error))
                if length > RECORD_BYTES:  # its content was not read
                    crc = None
                position = stop
        self.damage.append("it is truncated, or still being written")

    def _skip(self, start: int, stop: int, problem: str) -> None:
        self.skipped += stop - start
        self.damage.append(f"{problem} ({stop - start} bytes from byte {start})")

    def _expand_record(self, kind: int, content: bytes) -> Iterator[tuple[int, Any]]:
        record = _parse_record(kind, content)
        if kind != CHUNK:
            yield kind, record
            return
        # Parsed one by one: as objects, small messages take many times the size of their chunk.
        for inner_kind, inner_content in _split_records(_decompress_chunk(record)):
            yield inner_kind, _parse_record(inner_kind, inner_content)
        self.chunks += 1


def _header_problem(header: bytes, num_bytes_left: int) -> str:
    if len(header) < _RECORD_HEADER.size:
        return "it is truncated"
    kind, length = _RECORD_HEADER.unpack(header)
    if not (1 <= kind <= DATA_END or kind >= 0x80):
        return "a record is damaged"
    if length > num_bytes_left - _RECORD_HEADER.size:
        return "a record is truncated or damaged"
    # Other types, such as attached files, are not parsed and may be large.
    return "a record is too large" if kind in _record_parsers() and length > RECORD_BYTES else ""


@cache
def _record_parsers() -> dict[int, Any]:
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
def _stream_and_errors() -> tuple[Any, tuple[type[Exception], ...]]:
    # The input type of the library's parsers, and the errors that they raise.
    from mcap.data_stream import ReadDataStream
    from mcap.exceptions import McapError

    return ReadDataStream, (McapError, OverflowError, UnicodeDecodeError, struct.error)


def _parse_record(kind: int, content: bytes | memoryview) -> Any | None:
    # None for types of records that readers ignore.
    parse = _record_parsers().get(kind)
    if parse is None:
        return None
    stream, errors = _stream_and_errors()
    try:
        content_stream = stream(BytesIO(content))
        return parse(content_stream, len(content)) if kind == MESSAGE else parse(content_stream)
    except errors as error:
        raise Damaged(f"a record is damaged: {error}") from error


def _split_records(data: bytes) -> Iterator[tuple[int, memoryview]]:
    view, position = memoryview(data), 0
    while position < len(data):
        if len(data) - position < _RECORD_HEADER.size:
            raise Damaged("a chunk ends within a record")
        kind, length = _RECORD_HEADER.unpack_from(data, position)
        position += _RECORD_HEADER.size + length
        if position > len(data):
            raise Damaged("a record is longer than its chunk")
        yield kind, view[position - length : position]


def _decompress_chunk(chunk: Any) -> bytes:
    size, compressed = chunk.uncompressed_size, chunk.data
    if size > RECORD_BYTES:
        raise Damaged("the length of a chunk is damaged")
    if chunk.compression not in ("", "zstd", "lz4"):
        raise Damaged(f"a chunk is compressed in an unknown way ({chunk.compression[:20]!r})")
    try:
        decompress = {"zstd": _decompress_zstd, "lz4": _decompress_lz4}.get(chunk.compression)
        data = compressed if decompress is None else decompress(compressed, size)
    except (Damaged, ImportError):
        raise
    except Exception as error:  # each library raises different errors
        raise Damaged(f"a chunk cannot be decompressed: {error}") from error
    if len(data) != size or chunk.uncompressed_crc not in (0, zlib.crc32(data)):
        raise Damaged("a chunk differs from its checksum")
    return data


def _decompress_zstd(compressed: bytes, size: int) -> bytes:
    zstandard = _import_library("zstandard")
    # The compressed frame declares a size too, for which the library would allocate memory.
    declared_size = zstandard.get_frame_parameters(compressed).content_size
    if declared_size not in (size, zstandard.CONTENTSIZE_UNKNOWN, 0):
        raise Damaged("a chunk declares two sizes")
    if not size:
        return b""
    decompressor = zstandard.ZstdDecompressor(max_window_size=RECORD_BYTES)
    return bytes(decompressor.decompress(compressed, max_output_size=size))


def _decompress_lz4(compressed: bytes, size: int) -> bytes:
    return bytes(
        _import_library("lz4.frame").LZ4FrameDecompressor().decompress(compressed, max_length=size)
    )


def _import_library(name: str) -> Any:
    try:
        return import_module(name)
    except ImportError as error:
        raise ImportError(
            f"MCAP recordings need {name}: pip install 'torch-geometric-tactile[live]'"
        ) from error


def _read_summary(file: BinaryIO, size: int) -> tuple[list[tuple[int, Any]], str]:
    # The records repeated at the end of a file, if their checksum is correct, and their problem.
    footer = b""
    if size >= _END_SIZE:
        file.seek(size - _END_SIZE)
        footer = file.read(_END_SIZE)
    if (
        footer[: _RECORD_HEADER.size] != _RECORD_HEADER.pack(FOOTER, _FOOTER_CONTENT.size)
        or footer[-len(MAGIC) :] != MAGIC
    ):
        return [], "its end is damaged, or followed by other bytes"
    start, _, expected = _FOOTER_CONTENT.unpack_from(footer, _RECORD_HEADER.size)
    length = size - _END_SIZE - start if start else 0
    if not 0 <= length <= RECORD_BYTES:
        return [], "its index cannot be read"
    file.seek(start)
    content = file.read(length)
    crc = zlib.crc32(footer[: -len(MAGIC) - 4], zlib.crc32(content))
    if expected not in (0, crc):
        return [], f"its index differs from its checksum (from byte {start})"
    try:
        records = (
            [(kind, _parse_record(kind, part)) for kind, part in _split_records(content)]
            if expected
            else []
        )
    except Damaged as error:
        return [], f"its index cannot be read ({error})"
    return records, ""


def texts_checksum(texts: Mapping[str, str]) -> int:
    r"""Returns the CRC-32 of the strings and their names in the metadata of a recording."""
    return zlib.crc32(json.dumps(sorted(texts.items())).encode())
