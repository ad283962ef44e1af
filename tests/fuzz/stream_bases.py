"""Small streams of serial packets, which the mutations start from, and how they are read."""

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from random import Random
from typing import Any

import numpy as np

PACKETS = 8
_LONGEST = 2**18  # bytes that any decoder may keep


def cobs(folder: Path) -> None:
    from torch_geometric_tactile.io import encode_packet

    draw = np.random.default_rng(0)
    for name, kind in (("a", np.uint16), ("b", np.float32), ("c", np.int16)):
        packets = [
            encode_packet(
                2**32 - 3 + i,
                draw.integers(0, 300, (3, 2)).astype(kind),
                None if name == "c" else i / 128,
                draw.normal(size=2) if name == "b" else None,
            )
            for i in range(PACKETS)
        ]
        (folder / f"{name}.bin").write_bytes(b"".join(packets))


def anyskin(folder: Path) -> None:
    draw = np.random.default_rng(0)
    for name, bits in (("a", 0), ("b", 0x0A0D)):
        values = draw.normal(30, 5, (PACKETS, 2, 4)).astype("<f4")
        if bits:  # a terminator inside of a float, always at the same place
            values.view("<u4")[:, 1, 2] = values.view("<u4")[:, 1, 2] & 0xFFFF0000 | bits
        (folder / f"{name}.bin").write_bytes(b"".join(v.tobytes() + b"\r\n" for v in values))


def m1616(folder: Path) -> None:
    draw = np.random.default_rng(0)
    for name, tail in (("a", b"\0\1\2\3"), ("b", b"\0\0\xaa\xab")):
        counts = draw.integers(0, 4096, (4, 256)).astype(">u2")
        packets = [b"\xaa\xab\xac" + part.tobytes() + tail for part in counts]
        (folder / f"{name}.bin").write_bytes(b"".join(packets))


def flexitac(folder: Path) -> None:
    draw = np.random.default_rng(0)
    for name, pair in (("a", None), ("b", 3)):
        made = draw.integers(0, 256, (PACKETS, 6)).astype(np.uint8)
        if pair is not None:  # readings that look like a header, in every other frame
            made[::2, pair : pair + 2] = 0xAA, 0x55
        (folder / f"{name}.bin").write_bytes(b"".join(b"\xaa\x55" + row.tobytes() for row in made))


def paxini(folder: Path) -> None:
    draw = np.random.default_rng(0)
    for name in "ab":
        made = b"\xaa\x56\x00\x01\x00\x00\xff"  # the answer to the start
        for _ in range(PACKETS):
            body = b"\xaa\x56\x00\x16\x00\x00" + draw.integers(0, 256, 21, np.uint8).tobytes()
            made += body + bytes([-sum(body) % 256])
        (folder / f"{name}.bin").write_bytes(made)


def text(folder: Path) -> None:
    draw = np.random.default_rng(0)
    for name, end in (("a", "\r\n"), ("b", "\n")):
        made = end
        for counts in draw.integers(0, 256, (PACKETS, 2, 3)).tolist():
            made += "".join(" ".join(map(str, row)) + " " + end for row in counts) + end
        (folder / f"{name}.txt").write_bytes(made.encode())


def lines(folder: Path) -> None:
    draw = np.random.default_rng(0)
    counts = draw.integers(0, 1024, (PACKETS, 6)).tolist()
    rows = [[20 * i, *row] for i, row in enumerate(counts)]
    commas = "".join(",".join(map(str, row)) + "\r\n" for row in rows)
    (folder / "a.txt").write_bytes(("Ready\r\n" + commas).encode())
    labels = "".join(
        "\t".join(f"{'tabcdef'[i]}:{value / 4:g}" for i, value in enumerate(row)) + "\n"
        for row in rows
    )
    (folder / "b.txt").write_bytes(("12\n" + labels).encode())


def robotiq(folder: Path) -> None:
    draw = np.random.default_rng(0)
    for name, stamp in (("a", 8), ("b", 2)):
        made = b""
        for i in range(PACKETS):
            for finger in (0, 1):
                counts = draw.integers(0, 2**16, 28).astype(">u2").tobytes()
                blocks = bytes([0x10 | finger << 2]) + counts
                made += b"\x9a\x00\x58" + bytes([len(blocks)]) + blocks
            imu = b"\x30\0\1\0\2\0\3\x54\0\4\0\5\0\6"
            blocks = bytes([0x70]) + i.to_bytes(stamp, "big") + b"\x24\0\1" + imu
            made += b"\x9a\x00\x58" + bytes([len(blocks)]) + blocks
        (folder / f"{name}.bin").write_bytes(made)


def letter_array(folder: Path) -> None:
    from torch_geometric_tactile.io import encode_letter_array

    draw = np.random.default_rng(0)
    for name in "ab":
        counts = draw.integers(0, 2**16, (3, 32, 32))
        packets = [encode_letter_array(2**32 - 2 + i, part) for i, part in enumerate(counts)]
        (folder / f"{name}.bin").write_bytes(b"".join(packets))


SETTINGS: dict[str, dict[str, Any]] = {
    "cobs": {"max_size": 400},
    "anyskin": {"num_magnetometers": 2},
    "flexitac": {"shape": (2, 3)},
    "m1616": {},
    "paxini": {"points": (2, 1)},
    "text": {"shape": (2, 3)},
    "lines": {"time": "ms", "num_channels": 2},
    "robotiq": {},
    "letter_array": {},
}


def reader(protocol: str) -> Callable[[Path], Any]:
    """A reader of files of a protocol: the frames and counts, the same in whatever pieces."""

    def read(path: Path) -> Any:
        data = path.read_bytes()
        try:
            whole = _fed(protocol, [data])
            draw = Random(len(data))
            for most in (1, 7, 300):
                pieces = []
                place = 0
                while place < len(data):
                    size = draw.randint(1, most)
                    pieces.append(data[place : place + size])
                    place += size
                found = _fed(protocol, pieces)
                if found != whole:
                    raise AssertionError(f"in pieces it is {found!r:.200} and not {whole!r:.200}")
        except (ValueError, OSError) as error:  # of files these are allowed, of a wire they are not
            raise AssertionError(f"a decoder raised {error!r}") from error
        return whole

    return read


def _fed(protocol: str, pieces: list[bytes]) -> Any:
    from torch_geometric_tactile.io import decoder_of

    decoder: Any = decoder_of(protocol, **SETTINGS[protocol])
    frames = []
    for now, piece in enumerate(pieces):
        frames += decoder.feed(piece, now)
        assert len(decoder._buffer) <= _LONGEST + len(piece)
    last = -1
    for frame in frames:
        assert frame.sequence > last
        last = frame.sequence
    counts = decoder.counts
    assert counts.good == len(frames)
    # What a gap in the numbers says is what is counted.
    gaps = sum(b.sequence - a.sequence - 1 for a, b in pairwise(frames))
    assert counts.lost == gaps
    assert 0 <= counts.skipped <= sum(map(len, pieces))
    return [plain(frame) for frame in frames]


def plain(frame: Any) -> Any:
    return [
        frame.device_time,
        frame.tactile.tobytes(),
        None if frame.joint is None else frame.joint.tobytes(),
        *[value.tobytes() for value in frame.extra.values()],
    ]
