"""Mutations inside of the chunks of MCAP files, with checksums that are right."""

import struct
import zlib
from pathlib import Path
from random import Random

from fuzz.bytes_mutations import BYTES
from fuzz.laws import JUDGED, REWRITTEN

_CHUNK = 6
_SIZES = (0, 1, 2**20, 2**27, 2**31, 2**40, 2**63)


def mutate(path: Path, data: bytes, draw: Random, other: bytes) -> str:
    if draw.random() < 0.5:
        path.write_bytes(draw.choice(BYTES)(data, draw, other))
        return JUDGED
    path.write_bytes(with_another_chunk(data, draw))
    return REWRITTEN


def with_another_chunk(data: bytes, draw: Random) -> bytes:
    """The file with one chunk mutated, and with its right CRC-32; without the one of the file."""
    import zstandard

    records = list(_records(data))
    place = draw.choice([i for i, (kind, _) in enumerate(records) if kind == _CHUNK])
    _, content = records[place]
    start, stop, size, _ = struct.unpack_from("<QQQI", content)
    inside = zstandard.decompress(content[44:])
    for _ in range(draw.choice([1, 1, 2])):
        inside = draw.choice(BYTES)(inside, draw, inside) or b"\x05"
    packed = zstandard.compress(inside)
    size = len(inside) if draw.random() < 0.8 else draw.choice(_SIZES)
    head = struct.pack("<QQQI", start, stop, size, zlib.crc32(inside))
    records[place] = (
        _CHUNK,
        head + b"\x04\x00\x00\x00zstd" + struct.pack("<Q", len(packed)) + packed,
    )
    records = [(kind, bytes(4) if kind == 0x0F else part) for kind, part in records]
    body = b"".join(struct.pack("<BQ", kind, len(part)) + part for kind, part in records)
    return data[:8] + body + data[-8:]


def _records(data: bytes):
    place = 8
    while place < len(data) - 8:
        kind, length = struct.unpack_from("<BQ", data, place)
        yield kind, data[place + 9 : place + 9 + length]
        place += 9 + length
