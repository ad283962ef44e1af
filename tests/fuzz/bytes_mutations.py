"""Mutations that know nothing of a format."""

from collections.abc import Callable
from random import Random

NUMBERS = (
    *("1e999", "-1e999", "-0", "nan", "NaN", "inf", "-inf", "Infinity", "١٢", "0x10", "1_000"),
    *("99999999999999999999", "9" * 5000, "1e-400", "", " ", "NA", "null", "None", "true", "1,5"),
    *("1.", ".5", "+7", "--1", "1e", "1e308", "3.4e38", "3.5e38", "4294967296", "-1", "65536"),
    *("2147483648", "9223372036854775808", "1;5", "1 2", "=1+1", "1\x00", "½", "\u22123", "1e5e5"),
)
TOKENS = (
    *(b"\x00", b"\r", b"\n", b"\r\n", b"\n\n", b'"', b"'", b",", b";", b"\t", b"{", b"}", b"["),
    *(b"]", b":", b"\xef\xbb\xbf", b"\xff\xfe", b"\xff", b"\x80", b"\\", b"&a", b"*a", b"!!", b"#"),
    *(b"null", b"nan", b"1e999", b"-1", b"%", b"\x1a", b"\xe2\x80\xa8", b"<!ENTITY", b"PK\x03\x04"),
)

Mutation = Callable[[bytes, Random, bytes], bytes]


def flip_bit(data: bytes, draw: Random, _: bytes) -> bytes:
    place = draw.randrange(len(data))
    return data[:place] + bytes([data[place] ^ 1 << draw.randrange(8)]) + data[place + 1 :]


def set_byte(data: bytes, draw: Random, _: bytes) -> bytes:
    place = draw.randrange(len(data))
    value = draw.choice([0, 0xFF, 0x7F, 0x80, draw.randrange(256), draw.choice(data)])
    return data[:place] + bytes([value]) + data[place + 1 :]


def cut(data: bytes, draw: Random, _: bytes) -> bytes:
    return data[: draw.randrange(len(data))]


def behead(data: bytes, draw: Random, _: bytes) -> bytes:
    return data[draw.randrange(1, len(data) + 1) :]


def insert(data: bytes, draw: Random, _: bytes) -> bytes:
    place = draw.randrange(len(data) + 1)
    few = bytes(draw.randrange(256) for _ in range(draw.choice([1, 2, 8])))
    return data[:place] + draw.choice([few, draw.choice(TOKENS)]) + data[place:]


def delete(data: bytes, draw: Random, _: bytes) -> bytes:
    start, stop = _block(data, draw)
    return data[:start] + data[stop:]


def repeat(data: bytes, draw: Random, _: bytes) -> bytes:
    start, stop = _block(data, draw)
    return data[:stop] + data[start:]


def swap(data: bytes, draw: Random, _: bytes) -> bytes:
    a, b, c, d = sorted(draw.randrange(len(data) + 1) for _ in range(4))
    return data[:a] + data[c:d] + data[b:c] + data[a:b] + data[d:]


def zero(data: bytes, draw: Random, _: bytes) -> bytes:
    start, stop = _block(data, draw)
    return data[:start] + bytes([draw.choice([0, 0, 0xFF])]) * (stop - start) + data[stop:]


def splice(data: bytes, draw: Random, other: bytes) -> bytes:
    return data[: draw.randrange(len(data) + 1)] + other[draw.randrange(len(other) + 1) :]


def append(data: bytes, draw: Random, other: bytes) -> bytes:
    return data + draw.choice([b"\x00", b"\x00" * 512, b"x", data[-50:], other])


def write_over(data: bytes, draw: Random, _: bytes) -> bytes:
    """A number that a binary format may take for a size."""
    width = draw.choice([1, 2, 4, 8])
    place = draw.randrange(max(1, len(data) - width))
    values = [0, 1, 2**7, 2**15, 2**31 - 1, 2**31, 2**40, 2**63 - 1, 2**64 - 1]
    value = draw.choice(values) % 2 ** (8 * width)
    order = draw.choice(["little", "big"])
    return data[:place] + value.to_bytes(width, order) + data[place + width :]


def several(data: bytes, draw: Random, other: bytes) -> bytes:
    for _ in range(draw.choice([2, 3, 8])):
        if data:
            data = draw.choice(_ONE)(data, draw, other)
    return data


def _block(data: bytes, draw: Random) -> tuple[int, int]:
    start = draw.randrange(len(data))
    return start, min(len(data), start + draw.choice([1, 2, 8, 64, 512, len(data)]))


_ONE = (flip_bit, set_byte, cut, behead, insert, delete, repeat, swap, zero, splice, append)
_ONE += (write_over,)
BYTES: tuple[Mutation, ...] = (*_ONE, flip_bit, flip_bit, set_byte, several)
