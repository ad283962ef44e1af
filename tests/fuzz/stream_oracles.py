"""Reference decoders of serial packets: short and slow, a byte or a place after the other."""

import re
import struct
import zlib
from itertools import pairwise
from typing import Any

import numpy as np


def _uncobbed(piece: bytes) -> bytes | None:
    out, place = b"", 0
    while place < len(piece):
        code = piece[place]
        block = piece[place + 1 : place + code]
        if len(block) < code - 1:
            return None
        out += block
        place += code
        if code < 255 and place < len(piece):
            out += b"\0"
    return out


def cobs(data: bytes) -> Any:
    """Every piece between zeros that its CRC32 proves to be whole."""
    frames = []
    for piece in data.split(b"\0")[:-1]:
        found = _uncobbed(piece) if 0 < len(piece) <= 400 else None
        if found is None or len(found) < 14:
            continue
        if zlib.crc32(found[:-4]).to_bytes(4, "little") != found[-4:]:
            continue
        _, flags, kind, channels, taxels, _ = struct.unpack("<BBBBHI", found[:10])
        rest = found[10:-4]
        time = joint = None
        if flags & 1:
            time, rest = struct.unpack("<I", rest[:4])[0] / 1e6, rest[4:]
        if flags & 2:
            count = rest[0]
            joint, rest = np.frombuffer(rest[1 : 1 + 4 * count], "<f4"), rest[1 + 4 * count :]
        values = np.frombuffer(rest, ("<i2", "<u2", "<f4")[kind]).astype("f4")
        assert len(values) == taxels * channels
        frames.append([time, values.tobytes(), None if joint is None else joint.tobytes()])
    return frames


def anyskin(data: bytes) -> Any:
    """At each end of a frame that may be: whether there is one."""
    frames, size, begin = [], 34, 0
    for end in range(size, len(data) + 1):
        start = end - size
        ahead = start - begin
        if ahead < 0 or data[end - 2 : end] != b"\r\n":
            continue
        if not (ahead in (0, size, 2 * size, 3 * size) or data[begin:start].endswith(b"\r\n")):
            continue
        values = struct.unpack("<8f", data[start : end - 2])
        most = [1000, 5e5, 5e5, 5e5] * 2
        if all(v == 0 or np.float32(1e-6) < abs(v) < m for v, m in zip(values, most, strict=True)):
            value = np.float32(values).reshape(2, 4)
            frames.append([None, value[:, 1:].tobytes(), None, value[:, 0].tobytes()])
            begin = end
    return frames


def flexitac(data: bytes) -> Any:
    """Eight bytes from a header on: where the frame before ended if none is inside, else if another
    header follows."""
    header, frames, place, follows = b"\xaa\x55", [], 0, False
    while place + 8 <= len(data):
        told = data[place + 8 : place + 10]
        doubt = not follows or header in data[place + 1 : place + 9]
        doubt = doubt or (not told and data[place + 7] == 0xAA)
        if not data.startswith(header, place) or (doubt and not header.startswith(told)):
            place, follows = place + 1, False
            continue
        if doubt and told != header:  # it may still come
            break
        counts = np.frombuffer(data, np.uint8, 6, place + 2).astype("f4")
        frames.append([None, counts.tobytes(), None])
        place, follows = place + 8, True
    return frames


def _force(b: bytes) -> list[Any]:
    signed = [value - 256 if value > 127 else value for value in b[:2]]
    return [np.float32(value) * np.float32(0.1) for value in (*signed, b[2])]


def paxini(data: bytes) -> Any:
    """Every place from which on the bytes are one of both lengths, and their sum is zero."""
    frames, place = [], 0
    while place + 7 <= len(data):
        length = int.from_bytes(data[place + 3 : place + 5], "little")
        size = 6 + length
        found = data[place : place + size]
        if not data.startswith(b"\xaa\x56", place) or length not in (1, 22):
            place += 1
            continue
        if len(found) < size:  # the rest may come
            break
        if sum(found) % 256:
            place += 1
            continue
        place += size
        if length == 22:
            points = [_force(found[i : i + 3]) for i in (12, 15, 24)]
            whole = [_force(found[i : i + 6 : 2]) for i in (6, 18)]
            arrays = [np.float32(points), np.float32(whole), np.float32([found[5]])]
            tactile, *extra = [array.tobytes() for array in arrays]
            frames.append([None, tactile, None, *extra])
    return frames


def m1616(data: bytes) -> Any:
    """Every header with 516 bytes behind it, and no other header that begins among them."""
    header, size = b"\xaa\xab\xac", 519
    frames, place = [], 0
    while place + size <= len(data):
        inside = data.find(header, place + 1, place + size + 2)
        tail = data[place + size - 2 : place + size + 2]
        cut = place + size + 2 > len(data)  # the next header may still come
        waits = cut and any(tail[i:] == header[: len(tail) - i] for i in (0, 1) if tail[i:])
        if data.startswith(header, place) and inside < 0 and not waits:
            counts = np.frombuffer(data, ">u2", 256, place + 3).astype("f4")
            frames.append([None, counts.tobytes(), None])
            place += size
        else:
            place += 1
    return frames


def text(data: bytes) -> Any:
    """Two rows of three numbers, between empty rows."""
    frames = []
    lines = data.split(b"\n")[:-1]
    ends = [i for i, line in enumerate(lines) if line in (b"", b"\r")]
    if lines and not lines[0].strip(b"\r"):
        ends = sorted({0, *ends})
    for a, b in pairwise(ends):
        whole = (b"\n".join(lines[a + 1 : b]) + b"\n").lstrip(b"\r\n")
        rows = whole.split(b"\n")[:-1]
        if len(rows) != 2 or len(whole) > 34:
            continue
        if all(re.fullmatch(rb"\s*\d{1,3}(\s+\d{1,3}){2}\s*", row, re.ASCII) for row in rows):
            if re.search(rb"[\x0b\x0c]", whole):
                continue
            counts = np.float32([int(cell) for row in rows for cell in row.split()])
            if counts.max() <= 255:
                frames.append([None, counts.tobytes(), None])
    return frames


_NUMBER = rb"[+-]?(?:(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?|[nN][aA][nN]|[iI][nN][fF]|ovf)"
_CELL = rb"(?:[A-Za-z_]\w*:[ \t]*)*(" + _NUMBER + rb")?[ \t]*"


def _line_values(line: bytes) -> list[float] | None:
    line = line.rstrip(b"\r").strip(b" \t")
    mark = b"," if b"," in line else b";" if b";" in line else None
    if mark is None:
        line = re.sub(rb"(?<![\w.+-])[A-Za-z_]\w*:[ \t]*", b"", line)
        cells = re.findall(rb"[^ \t]+", line)
    else:
        cells = [cell.strip(b" \t") for cell in line.split(mark)]
    found = [re.fullmatch(_CELL, cell) for cell in cells]
    if found and mark is not None and found[-1] is not None and found[-1][1] is None:
        found.pop()
    if not found or any(cell is None or cell[1] is None for cell in found):
        return None
    return [float(cell[1].replace(b"ovf", b"inf")) for cell in found if cell is not None]


def lines(data: bytes) -> Any:
    """A time and pairs of readings: as many as in the first three lines in a row that agree."""
    frames: list[Any] = []
    first: list[list[float]] = []
    size = 0
    for line in data.split(b"\n")[1:-1]:
        if not line.strip(b"\r"):
            continue
        values = _line_values(line)
        if values is None or not abs(values[0]) <= 2**53 or len(values) < 3 or not len(values) % 2:
            first = []
            continue
        if size and len(values) != size:
            continue
        first = [*first, values] if first and len(values) == len(first[0]) else [values]
        if size or len(first) == 3:
            size = len(values)
            for row in first:
                with np.errstate(over="ignore"):
                    tactile = np.array(row[1:]).astype(np.float32)
                tactile[np.isinf(tactile)] = np.nan
                frames.append([row[0] * 1e-3, tactile.tobytes(), None])
            first = []
    return frames


def letter_array(data: bytes) -> Any:
    """Every place from which on 2060 bytes are a header, readings and their CRC32."""
    frames, place = [], 0
    while place + 2060 <= len(data):
        found = data[place : place + 2060]
        if found[:4] == b"\xa5ZLA" and zlib.crc32(found[:-4]).to_bytes(4, "little") == found[-4:]:
            frames.append([None, np.frombuffer(found, "<u2", 1024, 8).astype("f4").tobytes(), None])
            place += 2060
        else:
            place += 1
    return frames


_WORDS = {0x10: 28, 0x20: 1, 0x30: 3, 0x40: 3, 0x50: 3, 0x60: 1, 0x70: 4}
_KINDS = (0x20, 0x30, 0x40, 0x50, 0x60)


def _robotiq_blocks(body: bytes, stamp: int) -> Any:
    found = []
    while body:
        words = stamp if body[0] & 0xF0 == 0x70 else _WORDS.get(body[0] & 0xF0, 0)
        values, rest = body[1 : 1 + 2 * words], body[1 + 2 * words :]
        if not words or len(values) < 2 * words or body[0] & 8:
            return None
        found.append((body[0] & 0xF0, body[0] >> 2 & 1, values))
        body = rest
    return found


def robotiq(data: bytes) -> Any:
    """Packets that their blocks fill, one after another, or with another one behind."""
    frames: list[Any] = []
    extra = {k: np.full((2, _WORDS[k]), np.nan, "f4") for k in _KINDS}
    static: dict[int, np.ndarray] = {}
    time: list[float | None] = [None]

    def finish() -> None:
        none = np.full(28, np.nan, "f4")
        tactile = np.concatenate([static.get(0, none), static.get(1, none)])
        frames.append(
            [time[0], tactile.tobytes(), None, *[value.tobytes() for value in extra.values()]]
        )
        static.clear()
        time[0] = None

    place, follows = 0, False
    while place + 4 <= len(data):
        head, length = data[place : place + 4], data[place + 3]
        end = place + 4 + length
        body = data[place + 4 : end]
        found = None
        if head[0] == 0x9A and head[2] in (0x58, 0x59, 0x61) and length:
            doubt = re.search(rb"\x9a(.[\x58\x59\x61]|.?\Z)", body, re.DOTALL)
            if len(data) < end or ((doubt or not follows) and len(data) == end):
                break
            if (not doubt and follows) or data[end] == 0x9A:
                found = _robotiq_blocks(body, 4) or _robotiq_blocks(body, 1)
        if found is None:
            place, follows = place + 1, False
            continue
        place, follows = end, True
        for kind, finger, values in found:
            if kind == 0x10:
                if finger in static or (finger == 0 and static):
                    finish()
                static[finger] = np.frombuffer(values, ">u2").astype("f4")
            elif kind in extra:
                extra[kind][finger] = np.frombuffer(values, ">i2")
            elif kind == 0x70 and len(values) == 8:
                time[0] = int.from_bytes(values, "big") / 1000
        if len(static) == 2:
            finish()
    return frames
