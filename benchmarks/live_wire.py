r"""What comes over a cable: damaged packets, a port that is gone and back, XELA's server."""

import contextlib
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from live_senders import anyskin_of, counts_of

from torch_geometric_tactile.data import LiveFrame
from torch_geometric_tactile.live import Stream, Subscription, open_source

_SENDERS = Path(__file__).with_name("live_senders.py")


class Sender:
    r"""A sender in a second process: :obj:`name` is where it can be reached."""

    def __init__(self, kind: str, log: Path, *options: str) -> None:
        self.log = log
        self._process = subprocess.Popen(
            [sys.executable, str(_SENDERS), kind, "--log", str(log), *options],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert self._process.stdout is not None
        self.name = self._process.stdout.readline().strip()

    def say(self) -> None:
        r"""Tells it to go on."""
        assert self._process.stdin is not None
        with contextlib.suppress(OSError):
            self._process.stdin.write("\n")
            self._process.stdin.flush()

    @property
    def ended(self) -> bool:
        r"""Whether the process has ended."""
        return self._process.poll() is not None

    def close(self) -> None:
        r"""Ends the process."""
        self._process.kill()
        self._process.communicate()


@contextlib.contextmanager
def sender(kind: str, *options: object) -> Iterator[Sender]:
    r"""Starts a sender, and ends it at last."""
    with tempfile.TemporaryDirectory() as folder:
        other = Sender(kind, Path(folder) / "log.npy", *map(str, options))
        try:
            yield other
        finally:
            other.close()


def _until_silent(subscription: Subscription, other: Sender) -> list[LiveFrame]:
    frames: list[LiveFrame] = []
    while True:
        try:
            frames.append(subscription.get(timeout=1.0))
        except TimeoutError:
            if other.log.exists() or other.ended:
                return frames


def measure_packets(seconds: float) -> dict[str, Any]:
    r"""Returns how many intact packets came, of 900 a second with 1 % damaged."""
    options = ("--seconds", seconds, "--damage", 0.01, "--taxels", 16)
    with sender("board", *options) as other:
        stream = Stream(open_source(f"serial:{other.name}?protocol=cobs"))
        subscription = stream.subscribe("all", size=100_000)
        with stream:
            other.say()
            spent = time.process_time()
            frames = _until_silent(subscription, other)
            spent = time.process_time() - spent
            health = stream.health()
        intact = np.load(other.log)
    got = [frame.sequence for frame in frames]
    right = sum((f.tactile == counts_of(f.sequence, 16)).all() for f in frames)
    return {
        "packets": len(intact),
        "intact": int(intact.sum()),
        "delivered": len(frames),
        "in order": got == sorted(got),
        "missing": len(set(np.flatnonzero(intact).tolist()) - set(got)),
        "wrong": len(frames) - int(right),
        "corrupt": health.corrupt,
        "lost": health.lost,
        "core": spent / seconds,
    }


def measure_bytes(seconds: float) -> dict[str, Any]:
    r"""Returns how many intact packets of AnySkin came, with 1 % of the bytes damaged, and how many
    readings were wrong.
    """
    options = ("--seconds", seconds, "--protocol", "anyskin", "--damage", 0.01, "--bytes")
    with sender("board", *options) as other:
        stream = Stream(open_source(f"serial:{other.name}?protocol=anyskin"))
        subscription = stream.subscribe("all", size=100_000)
        with stream:
            other.say()
            frames = _until_silent(subscription, other)
        intact = np.load(other.log)
    sent = [anyskin_of(number)[:, 1:].tobytes() for number in range(len(intact))]
    place, found, wrong = 0, 0, 0
    for frame in frames:
        content = np.ascontiguousarray(frame.tactile, dtype="<f4").tobytes()
        near = range(place, min(place + 2000, len(sent)))
        at = next((i for i in near if sent[i] == content), None)
        if at is None:
            wrong += 1
        else:
            place = at + 1
            found += bool(intact[at])
    return {
        "packets": len(intact),
        "intact": int(intact.sum()),
        "delivered": len(frames),
        "intact delivered (%)": 100 * found / max(int(intact.sum()), 1),
        "wrong readings": wrong,
    }


def measure_returns(times: int) -> dict[str, Any]:
    r"""Returns after how many seconds frames came, of a port that was gone and back."""
    with tempfile.TemporaryDirectory() as folder:
        link = Path(folder) / "board"
        options = ("--times", times, "--link", link, "--rate", 200)
        with sender("unplugged", *options) as other:
            stream = Stream(open_source(f"serial:{link}?protocol=cobs"))
            subscription = stream.subscribe("all", size=1_000_000)
            with stream:
                other.say()
                frames = _until_silent(subscription, other)
                health = stream.health()
            returned = np.load(other.log)
    received = np.array([frame.received for frame in frames]) / 1e9
    after = np.array([received[received >= at][0] - at for at, _ in returned])
    wrong = sum((f.tactile != counts_of(f.sequence, 16)).any() for f in frames)
    missing = frames[-1].sequence - frames[0].sequence + 1 - len(frames)
    return {
        "times": times,
        "slowest return (s)": float(after.max()),
        "median return (s)": float(np.median(after)),
        "reconnects": health.reconnects,
        "missing": missing,
        "counted as lost": health.lost,
        "wrong": int(wrong),
    }


def measure_xela(seconds: float) -> dict[str, Any]:
    r"""Returns how many messages of 384 taxels came, of 500 a second, and the part of a core."""
    with sender("xela", "--rate", 500, "--seconds", seconds) as other:
        stream = Stream(open_source(other.name))
        subscription = stream.subscribe("all", size=100_000)
        with stream:
            frames = [subscription.get(timeout=10)]
            spent, start = time.process_time(), time.monotonic()
            frames += _until_silent(subscription, other)
            wall = frames[-1].received / 1e9 - start
            spent = time.process_time() - spent
        sent = int(np.load(other.log)[0])
    numbers = [frame.sequence for frame in frames]
    wrong = sum((f.tactile != counts_of(f.sequence % 500, len(f.tactile))).any() for f in frames)
    return {
        "messages": sent,
        "delivered": len(frames),
        "in order": numbers == list(range(sent)),
        "wrong": int(wrong),
        "taxels": len(frames[0].tactile),
        "core (%)": 100 * spent / wall,
    }


PARTS = {
    "packets": measure_packets,
    "bytes": measure_bytes,
    "returns": lambda times: measure_returns(int(times)),
    "xela": measure_xela,
}


def measured(part: str, amount: float) -> dict[str, Any]:
    r"""Returns what a part measures in a process of its own, without PyTorch, as on a robot."""
    command = [sys.executable, __file__, part, str(amount)]
    told = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True).stdout
    found: dict[str, Any] = json.loads(told)
    return found


if __name__ == "__main__":
    print(json.dumps(PARTS[sys.argv[1]](float(sys.argv[2]))))
