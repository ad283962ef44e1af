r"""Description of bytes of an unknown protocol."""

import re
from collections import defaultdict
from itertools import pairwise
from typing import NamedTuple

from torch_geometric_tactile.io.decoders._number_line import parse_line
from torch_geometric_tactile.io.decoders.lines import LinesDecoder

_NUM_SHOWN_BYTES = 40
_NUM_SEARCHED_BYTES = 4096
_MIN_REPEATS = 3
_MIN_GROWING_LINES = 10
_MAX_TEXT_COUNT = 255  # of the protocol `text`
_EMPTY_LINES = re.compile(rb"\n\r?(?:\n\r?)+")
_TEXT = re.compile(rb"[\t\n\r -~]+")


class BytesDescription(NamedTuple):
    r"""Description of the first bytes of a device, for a message.

    Args:
        text (str): The first bytes and what they look like.
        protocol (str): The protocol and settings that read them; empty if unknown.
        first_grows (bool): Whether the first number increases from line to line, as a time does.

    Examples:
        >>> description = describe_bytes(b"17,4\r\n512,17,4\r\n512,18,4\r\n513,18,4\r\n")
        >>> description.text
        "b'17,4\\r\\n512,17,4\\r\\n512,18,4\\r\\n513,18,4\\r\\n' (lines of 3 numbers)"
        >>> description.protocol
        'lines'
    """

    text: str
    protocol: str
    first_grows: bool


def describe_bytes(data: bytes) -> BytesDescription:
    r"""Describes bytes of an unknown protocol: lines or blocks of numbers, other text, or binary
    packets of a fixed length.

    Args:
        data (bytes): The first bytes of a device.
    """
    kind, protocol, first_grows = _kind(data)
    return BytesDescription(f"{data[:_NUM_SHOWN_BYTES]!r} ({kind})", protocol, first_grows)


def _kind(data: bytes) -> tuple[str, str, bool]:
    block = _block_shape(data)
    if block is not None:
        num_rows, num_columns, max_value = block
        kind = f"blocks of {num_rows} lines of {num_columns} numbers, separated by empty lines"
        shape = f"text&shape={num_rows}x{num_columns}"
        return kind, shape if max_value <= _MAX_TEXT_COUNT else "", False
    decoder = LinesDecoder()
    frames = decoder.feed(data, now=0)
    if len(frames) > decoder.counts.corrupt:
        first = [float(frame.tactile[0, 0]) for frame in frames]
        grows = all(a < b for a, b in pairwise(first)) and len(first) >= _MIN_GROWING_LINES
        return f"lines of {decoder.num_taxels} numbers", "lines", grows
    if _TEXT.fullmatch(data):
        return "text, but not lines with the same number of values", "", False
    repeat = _regular_pair(data[:_NUM_SEARCHED_BYTES])
    if repeat is None:
        return "binary, without a pair of bytes at regular distances", "", False
    pair, distance = repeat
    return f"binary, {pair.hex(' ').upper()} every {distance} bytes", "", False


def _block_shape(data: bytes) -> tuple[int, int, float] | None:
    r"""Returns the rows and columns of blocks of lines, and the largest number."""
    blocks = _EMPTY_LINES.split(data)[1:-1]  # the first and last blocks may be cut
    shapes, max_value = set(), 0.0
    for block in blocks:
        rows = [parse_line(line) for line in block.split(b"\n")]
        if len(rows) < 2 or any(row is None or len(row) != len(rows[0] or ()) for row in rows):
            return None
        shapes.add((len(rows), len(rows[0] or ())))
        max_value = max(max_value, *(value for row in rows for value in row or ()))
    return (*shapes.pop(), max_value) if len(shapes) == 1 else None


def _regular_pair(data: bytes) -> tuple[bytes, int] | None:
    r"""Returns the first pair of bytes that repeats at one distance only, and the distance."""
    positions: dict[bytes, list[int]] = defaultdict(list)
    for i in range(len(data) - 1):
        positions[data[i : i + 2]].append(i)
    for pair, places in positions.items():
        distances = {end - start for start, end in pairwise(places)}
        if len(places) >= _MIN_REPEATS and len(distances) == 1 and distances != {1}:
            return pair, distances.pop()
    return None
