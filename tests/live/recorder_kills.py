"""Kills recorders at random moments, and compares what they kept. By hand:

python tests/live/recorder_kills.py --kills 10 --rate 500
"""

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from live.numbered import contents

from torch_geometric_tactile.io import read_recording

CHILD = Path(__file__).with_name("record_in_child.py")


class Kill(NamedTuple):
    """What a killed recorder had taken and kept, and the seconds that are lost."""

    taken: int
    kept: int
    seconds: float
    wrong: int


def kill_once(path: Path, rate: float, frames: int) -> Kill:
    """Kills a recorder after it has taken some frames."""
    command = [sys.executable, str(CHILD), str(path), str(rate)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None
        lines = [child.stdout.readline() for _ in range(frames)]
        child.kill()
        lines += child.stdout.readlines()
    words = [line.split() for line in lines if line.endswith("\n")]
    received = {int(number): int(when) for number, when in words}
    found = read_recording(path.with_suffix(".mcap"))
    numbers = found.extra["sequence"].tolist()
    wrong = sum(
        number != place or not (found.tactile[place] == contents(number)).all()
        for place, number in enumerate(numbers)
    )
    lost = [when for number, when in received.items() if number >= len(numbers)]
    seconds = (max(lost) - min(lost)) / 1e9 if lost else 0.0
    return Kill(len(received), len(numbers), seconds, wrong)


def kills(number: int, rate: float, suffix: str = ".mcap", seed: int = 0) -> list[Kill]:
    """Kills recorders of a stream after one to two seconds of it."""
    draw = np.random.default_rng(seed)
    with tempfile.TemporaryDirectory() as folder:
        return [
            kill_once(Path(folder) / f"{i}{suffix}", rate, int(rate * draw.uniform(0.4, 2)))
            for i in range(number)
        ]


def main() -> int:
    """Prints what each kill cost."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=10)
    parser.add_argument("--rate", type=float, default=500.0)
    arguments = parser.parse_args()
    found = kills(arguments.kills, arguments.rate)
    for kill in found:
        sys.stdout.write(f"{kill}\n")
    sys.stdout.write(
        f"{len(found)} kills, at most {max(kill.seconds for kill in found):.3f} s lost, "
        f"{sum(kill.wrong for kill in found)} wrong frames\n"
    )
    return int(any(kill.wrong or kill.seconds > 0.3 for kill in found))


if __name__ == "__main__":
    sys.exit(main())
