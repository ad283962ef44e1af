r"""The other side of the cable, in a process of its own: boards on a pty, and XELA's server.

Each prints where it can be reached on its first line, sends, writes what it sent to the file of
``--log``, and ends. Readings follow from the number of their packet, such that the receiver can
compare them.
"""

import argparse
import asyncio
import json
import os
import random
import sys
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np

from torch_geometric_tactile.io import encode_packet
from torch_geometric_tactile.io._xela_message import format_xela_message

_XELA_BODIES = 500
_SENSORS = (16,) * 15 + (24,) * 6  # patches of 4 x 4, and of 4 x 6


def counts_of(sequence: int, taxels: int, channels: int = 3) -> np.ndarray:
    r"""Returns the counts of a packet."""
    number = np.arange(taxels * channels, dtype=np.int64)
    return ((sequence * 7919 + number * 104_729) % 32_003).reshape(taxels, channels)


def anyskin_of(sequence: int, magnetometers: int = 5) -> np.ndarray:
    r"""Returns temperature and field of a packet of AnySkin."""
    field = counts_of(sequence, magnetometers) / 64 - 250
    heat = np.full((magnetometers, 1), 25 + sequence % 8 / 8)
    return np.concatenate([heat, field], axis=1).astype("<f4")


def _anyskin_packet(sequence: int) -> bytes:
    return anyskin_of(sequence).tobytes() + b"\r\n"


def _cobs_packet(sequence: int, taxels: int, joints: int = 0) -> bytes:
    joint = np.full(joints, 0.1, dtype=np.float32) if joints else None
    clock = time.monotonic()  # of the device: here it is the host's, such that ages can be told
    counts = counts_of(sequence, taxels).astype(np.uint16)
    return encode_packet(sequence, counts, device_time=clock, joint=joint)


def _paced(rate: float, seconds: float) -> Iterator[int]:
    start, number = time.monotonic(), 0
    while number < rate * seconds:
        ahead = start + number / rate - time.monotonic()
        if ahead > 0:
            time.sleep(ahead)
        yield number
        number += 1


def _open_pty(link: Path | None) -> tuple[int, int, str]:
    master, slave = os.openpty()
    tty.setraw(slave)
    name = os.ttyname(slave)
    if link is not None:
        link.unlink(missing_ok=True)
        link.symlink_to(name)
    return master, slave, str(link or name)


def _write(master: int, data: bytes) -> None:
    while data:
        data = data[os.write(master, data) :]


def send_board(arguments: argparse.Namespace) -> None:
    r"""Sends packets on a pty, some of them damaged."""
    draw = random.Random(arguments.seed)
    master, slave, name = _open_pty(None)
    print(name, flush=True)
    sys.stdin.readline()  # until the receiver has opened it
    intact = np.zeros(int(arguments.rate * arguments.seconds) + 1, dtype=bool)
    sent = 0
    for number in _paced(arguments.rate, arguments.seconds):
        data = bytearray(
            _anyskin_packet(number)
            if arguments.protocol == "anyskin"
            else _cobs_packet(number, arguments.taxels, arguments.joints)
        )
        intact[number] = not _damaged(data, draw, arguments)
        _write(master, bytes(data))
        sent = number + 1
    np.save(arguments.log, intact[:sent])
    sys.stdin.readline()  # until all has been read: a pty forgets what it holds when it is closed
    os.close(master)
    os.close(slave)


def _damaged(data: bytearray, draw: random.Random, arguments: argparse.Namespace) -> bool:
    if arguments.bytes:
        hit = [i for i in range(len(data)) if draw.random() < arguments.damage]
    else:
        hit = [draw.randrange(len(data))] if draw.random() < arguments.damage else []
    for place in hit:
        data[place] ^= draw.randrange(1, 256)
    return bool(hit)


def send_unplugged(arguments: argparse.Namespace) -> None:
    r"""Sends packets on a pty that is gone and back many times."""
    draw = random.Random(arguments.seed)
    link = Path(arguments.link)
    master, slave, name = _open_pty(link)
    print(name, flush=True)
    sys.stdin.readline()
    number, returned = 0, []
    for _ in range(arguments.times):
        number = _send_for(master, number, arguments, 0.25 + 0.2 * draw.random())
        link.unlink()
        os.close(master)
        os.close(slave)
        gone = draw.uniform(0.02, 0.4)
        number += int(gone * arguments.rate)  # what the board measured while nobody listened
        time.sleep(gone)
        master, slave, _ = _open_pty(link)
        returned.append((time.monotonic(), number))
    number = _send_for(master, number, arguments, 2.5)
    np.save(arguments.log, np.array(returned))
    sys.stdin.readline()
    os.close(master)
    os.close(slave)


def _send_for(master: int, number: int, arguments: argparse.Namespace, seconds: float) -> int:
    os.set_blocking(master, False)
    for _ in _paced(arguments.rate, seconds):
        with suppress(BlockingIOError):  # nobody reads
            os.write(master, _cobs_packet(number, arguments.taxels))
        number += 1
    return number


def send_xela(arguments: argparse.Namespace) -> None:
    r"""Sends what XELA's server sends for a hand of 384 taxels."""
    bodies = []
    for number in range(_XELA_BODIES):
        counts = counts_of(number, sum(_SENSORS))
        text = json.dumps(format_xela_message(counts, 0, 0.0, taxels=_SENSORS))
        bodies.append(text[text.index('"sensors"') : text.rindex('"sendtime"')])
    asyncio.run(_serve_xela(arguments, bodies))


async def _serve_xela(arguments: argparse.Namespace, bodies: list[str]) -> None:
    from websockets.asyncio.server import ServerConnection, serve

    done = asyncio.Event()

    async def send(connection: ServerConnection) -> None:
        await connection.send('{"message": "Welcome"}')
        start, number = time.monotonic(), 0
        while number < arguments.rate * arguments.seconds:
            ahead = start + number / arguments.rate - time.monotonic()
            if ahead > 0:
                await asyncio.sleep(ahead)
            now = time.time()
            body = bodies[number % len(bodies)]
            text = f'{{"message": {number}, "time": {now}, {body}"sendtime": {now}}}'
            await connection.send(text)
            number += 1
        np.save(arguments.log, np.array([number]))
        await connection.close()
        done.set()

    async with serve(send, "127.0.0.1", 0, compression=None) as server:
        port = next(iter(server.sockets)).getsockname()[1]
        print(f"ws://127.0.0.1:{port}", flush=True)
        await done.wait()


SENDERS: dict[str, Callable[[argparse.Namespace], None]] = {
    "board": send_board,
    "unplugged": send_unplugged,
    "xela": send_xela,
}


def main() -> None:
    r"""Runs one sender."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("sender", choices=SENDERS)
    parser.add_argument("--log", required=True)
    parser.add_argument("--protocol", choices=("cobs", "anyskin"), default="cobs")
    parser.add_argument("--rate", type=float, default=900.0)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--taxels", type=int, default=16)
    parser.add_argument("--joints", type=int, default=0)
    parser.add_argument("--damage", type=float, default=0.0)
    parser.add_argument("--bytes", action="store_true", help="damage bytes, not packets")
    parser.add_argument("--link", default="board")
    parser.add_argument("--times", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    SENDERS[arguments.sender](arguments)


if __name__ == "__main__":
    main()
