r"""Recordings whose writer is killed, and files that are cut anywhere."""

import logging
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

_TESTS = Path(__file__).resolve().parents[1] / "tests" / "live"
sys.path.insert(0, str(_TESTS))

from numbered import NumberedSource, contents  # noqa: E402

from torch_geometric_tactile.io import read_recording  # noqa: E402
from torch_geometric_tactile.live import Recorder, Stream  # noqa: E402

_RATE = 500.0


def measure_kills(number: int) -> dict[str, Any]:
    r"""Returns what recorders lose that are killed with SIGKILL, one process each."""
    command = [sys.executable, str(_TESTS / "recorder_kills.py")]
    command += ["--kills", str(number), "--rate", str(_RATE)]
    told = subprocess.run(command, capture_output=True, text=True, check=False).stdout
    summary = re.search(r"(\d+) kills, at most ([\d.]+) s lost, (\d+) wrong frames", told)
    if summary is None:
        raise RuntimeError(f"the kills failed: {told}")
    return {
        "kills": int(summary[1]),
        "frames a second": _RATE,
        "most lost (s)": float(summary[2]),
        "wrong frames": int(summary[3]),
    }


def measure_cuts(folder: Path, number: int) -> dict[str, Any]:
    r"""Returns what is lost of a recording that is cut at a random byte."""
    whole = folder / "whole.mcap"
    stream = Stream(NumberedSource(_RATE, count=int(10 * _RATE)))
    with Recorder(whole, stream), stream:
        for _ in stream.subscribe("newest"):
            pass
    data = whole.read_bytes()
    places = np.random.default_rng(0).integers(1, len(data), size=number)
    wrong, lost, unreadable = 0, [], 0
    first = data.index(b"tactile.Frame")
    logging.getLogger("torch_geometric_tactile").setLevel(logging.ERROR)  # each cut is told
    for place in places.tolist():
        cut = folder / "cut.mcap"
        cut.write_bytes(data[:place])
        try:
            found = read_recording(cut)
        except ValueError:
            unreadable += 1
            lost.append(place / len(data) * 10 if place > first else 0.0)
            continue
        numbers = found.extra["sequence"].tolist()
        wrong += sum(
            number != at or not (found.tactile[at] == contents(number)).all()
            for at, number in enumerate(numbers)
        )
        # What the bytes up to the cut could have held, at the rate of the whole file.
        lost.append(max(0.0, place / len(data) * 10 - len(numbers) / _RATE))
    return {
        "cuts": number,
        "most lost (s)": max(lost),
        "wrong frames": wrong,
        "cut before the first frames": unreadable,
    }
