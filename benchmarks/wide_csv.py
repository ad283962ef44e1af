r"""Reading a wide CSV recording of full size, against `numpy.loadtxt` on the same file.

The readings are random numbers: 17 s of 384 taxels at 100 Hz with 16 joints. Both sides are
measured in turn; the figure is the ratio of their medians.

Examples:
    python benchmarks/wide_csv.py --rounds 5
"""

import statistics
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from shared import in_turns, parse

from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io._wide_csv import read_wide_csv, write_wide_csv


def main() -> None:
    rounds = parse(__doc__, {"--rounds": (3, "of both")}).rounds
    draw = np.random.default_rng(0)
    recording = Recording(
        np.arange(1700) / 100, draw.normal(size=(1700, 384, 3)), draw.normal(size=(1700, 16))
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "recording.csv"
        write_wide_csv(recording, path)
        sides: dict[str, Callable[[], object]] = {
            "read_wide_csv": lambda: read_wide_csv(path),
            "numpy.loadtxt": lambda: np.loadtxt(path, delimiter=",", skiprows=1),
        }
        times = in_turns(sides, rounds)
    medians = {name: statistics.median(values) for name, values in times.items()}
    for name, value in medians.items():
        print(f"{name:<14} {value:.2f} s (median of {rounds})")
    ratio = medians["read_wide_csv"] / medians["numpy.loadtxt"]
    print(f"ratio          {ratio:.2f} (below 1: faster than numpy.loadtxt)")


if __name__ == "__main__":
    main()
