"""Mutations of files of matrices, with right checksums."""

import gzip
import io
import struct
import zlib
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
from fuzz.bytes_mutations import BYTES
from fuzz.laws import JUDGED, REFUSED, REWRITTEN
from fuzz.torch_mutations import Hostile

_HUGE = ("(1000000000000, 4, 3)", "(2000000000, 4, 3)", "(-1, 4, 3)", "(3.5, 4, 3)", "(" * 200)
_HUGE += ("(0, 4, 3)", "(99999999999999999999, 4, 3)", "(2, 4, 2)", "(3,)")
_START = 128  # of a MAT file


def npy(path: Path, data: bytes, draw: Random, other: bytes) -> str:
    """There is no checksum: what is flipped may read as another number."""
    kind = draw.randrange(6)
    if kind < 3:
        path.write_bytes(draw.choice(BYTES)(data, draw, other))
        return REWRITTEN
    if kind == 3:
        head = f"{{'descr': '<f4', 'fortran_order': False, 'shape': {draw.choice(_HUGE)}, }}\n"
        text = b"\x93NUMPY\x01\x00" + len(head).to_bytes(2, "little") + head.encode()
        path.write_bytes(text + bytes(draw.choice([0, 4, 4096])))
        return REFUSED
    array = np.load(io.BytesIO(data))
    if kind == 4:
        forms: list[Any] = [complex, "V4", "f4,f4", "S3", "U2", "datetime64[s]", bool]
        array = np.zeros(array.shape, draw.choice(forms))
        if draw.random() < 0.3:
            array = np.array([Hostile(draw)], dtype=object)
        np.save(path, array, allow_pickle=True)
        return REFUSED
    forms = [array[..., :-1], array[:0], array[None, None], array.reshape(-1), array[0, 0]]
    np.save(path, draw.choice(forms))
    return REFUSED


def png(path: Path, data: bytes, draw: Random, other: bytes) -> str:
    if draw.random() < 0.5:
        path.write_bytes(draw.choice(BYTES)(data, draw, other))
        return JUDGED
    parts = _chunks(data)
    allowed = REWRITTEN
    kind = draw.randrange(6)
    head = bytearray(parts[0][1])
    if kind == 0:  # another size
        place = draw.choice([0, 4])
        size = draw.choice([0, 1, 31, 33, 64, 2**16, 2**31 - 1, 2**32 - 1])
        head[place : place + 4] = struct.pack(">I", size)
        allowed = REFUSED
    elif kind == 1:  # another depth, colour, compression, filter or interlacing
        place = draw.randrange(8, 13)
        head[place] = draw.choice([0, 1, 2, 3, 4, 6, 16, 255])
    elif kind == 2:  # pixels that are too many, too few or none
        size = draw.choice([0, 5, 1055, 1056, 1057, 2**22])
        pixels = draw.choice([bytes(size), b"\xff" * size])
        parts = [part for part in parts if part[0] != b"IDAT"]
        parts.insert(1, (b"IDAT", zlib.compress(pixels)))
    elif kind == 3:  # a part that is far larger than it seems
        name = draw.choice([b"zTXt", b"iTXt", b"iCCP", b"eXIf"])
        packed = zlib.compress(bytes(2**24), 9)
        before = b"a\0\0" if name != b"iTXt" else b"a\0\1\0\0\0"
        parts.insert(1, (name, before + packed))
    elif kind == 4:  # a second header, frames, or a palette
        size = draw.choice([32, 64, 2**15])
        extra = [
            (b"IHDR", struct.pack(">II", size, size) + bytes(head[8:])),
            (b"acTL", struct.pack(">II", draw.choice([1, 2, 2**31]), 0)),
            (b"fcTL", struct.pack(">IIIIIHHBB", 0, size, size, 0, 0, 1, 1, 0, 0)),
            (b"PLTE", bytes(9)),
            (b"tRNS", bytes(draw.choice([0, 2, 300]))),
        ]
        parts.insert(draw.choice([1, len(parts) - 1]), draw.choice(extra))
    else:
        parts.insert(draw.randrange(len(parts)), draw.choice(parts))
    if kind < 2:
        parts[0] = (b"IHDR", bytes(head))
    path.write_bytes(data[:8] + b"".join(_chunk(*part) for part in parts))
    return allowed


def _chunks(data: bytes) -> list[tuple[bytes, bytes]]:
    parts, place = [], 8
    while place < len(data):
        (size,) = struct.unpack_from(">I", data, place)
        parts.append((data[place + 4 : place + 8], data[place + 8 : place + 8 + size]))
        place += 12 + size
    return parts


def _chunk(name: bytes, content: bytes) -> bytes:
    code = zlib.crc32(name + content)
    return struct.pack(">I", len(content)) + name + content + struct.pack(">I", code)


def mat(path: Path, data: bytes, draw: Random, other: bytes) -> str:
    """What is not packed has no checksum. What is packed is unpacked, changed and packed again."""
    kind = draw.randrange(6)
    if kind < 2:
        path.write_bytes(draw.choice(BYTES)(data, draw, other))
        return REWRITTEN
    parts = _variables(data)
    place = draw.randrange(len(parts))
    part = bytearray(parts[place])
    if kind == 2:  # another size, as of a matrix that fills the memory
        count = draw.choice([0, 1, 3, 2**20, 2**28, 2**31 - 1, 2**32 - 1])
        where = draw.choice([4, 16, 32, 36, 40])
        part[where : where + 4] = struct.pack("<I", count)
    elif kind == 3:  # another class, or complex numbers
        part[draw.choice([16, 17])] = draw.randrange(256)
    elif kind == 4:
        part = bytearray(draw.choice(BYTES)(bytes(part), draw, other))
    elif draw.random() < 0.1:
        part += bytes(2**26)
    parts[place] = bytes(part)
    if draw.random() < 0.1:
        parts[place] = _packed(parts[place])
    if draw.random() < 0.2:
        parts.insert(draw.randrange(len(parts)), draw.choice(parts))
    path.write_bytes(data[:_START] + b"".join(map(draw.choice([_packed, bytes]), parts)))
    return REWRITTEN


def _variables(data: bytes) -> list[bytes]:
    parts, place = [], _START
    while place < len(data):
        kind, size = struct.unpack_from("<II", data, place)
        whole = data[place : place + 8 + size]
        parts.append(zlib.decompress(whole[8:]) if kind == 15 else whole)
        place += 8 + size
    return parts


def _packed(part: bytes) -> bytes:
    content = zlib.compress(part)
    return struct.pack("<II", 15, len(content)) + content


def idx(path: Path, data: bytes, draw: Random, other: bytes) -> str:
    if draw.random() < 0.5:
        path.write_bytes(draw.choice(BYTES)(data, draw, other))
        return JUDGED
    content = gzip.decompress(data)
    kind = draw.randrange(4)
    allowed = REWRITTEN
    if kind == 0:  # more numbers than there are
        place = draw.choice([4, 8, 12])
        size = struct.pack(">I", draw.choice([99, 2**16, 2**31, 2**32 - 1]))
        content, allowed = content[:place] + size + content[place + 4 :], REFUSED
    elif kind == 1:
        content = draw.choice(BYTES)(content, draw, content)
    elif kind == 2:  # another type or number of dimensions
        content = (
            b"\0\0" + bytes([draw.choice([8, 9, 11, 13, 14]), draw.randrange(256)]) + content[4:]
        )
    else:
        content, allowed = content + bytes(2**24), REFUSED
    path.write_bytes(gzip.compress(content, mtime=0) if draw.random() < 0.5 else content)
    return allowed
