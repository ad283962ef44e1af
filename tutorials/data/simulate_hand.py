r"""Simulates the grasps of tutorials 5 and 7 and keeps a few frames of each in small files.

python tutorials/data/simulate_hand.py --work FOLDER      (about ten minutes of one core)

Kept are two frames of each trial, at 75 and 95 % of its time, when the object is lifted or held.
Readings are tared by the hover frames of their trial and rounded to 40 counts (0.02 N of pressure;
the noise has a standard deviation of 10 counts), and joint angles to half precision, so that the
two files are small.
"""

import argparse
from pathlib import Path

import numpy as np

from torch_geometric_tactile.datasets import AllegroUSkin
from torch_geometric_tactile.sim import GraspSpread, simulate

HERE = Path(__file__).parent
STEP = 40  # counts
MOMENTS = (0.75, 0.95)
COLUMNS = ("trial", "group", "placement")


def frames(folder: Path, more: tuple[str, ...]) -> dict[str, np.ndarray]:
    r"""Returns the arrays of one file."""
    dataset = AllegroUSkin(folder, "object", split=None, tare="hover")
    trial, time = dataset.data.trial, dataset.data.time
    rows = []
    for number in trial.unique():
        mine = (trial == number).nonzero().view(-1)
        end = time[mine[-1]]
        rows += [int(mine[(time[mine] - part * end).abs().argmin()]) for part in MOMENTS]
    data = dataset.batch(rows)
    out = {name: data[name].numpy() for name in (*COLUMNS, *more)}
    out["x"] = (STEP * (data.x / STEP).round()).numpy().astype(np.int16)
    out["joint"] = data.joint.numpy().astype(np.float16)
    out["group_names"] = np.array(dataset.group_names)
    return out


def main() -> None:
    r"""Simulates what is not there yet, and writes the files."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--work", type=Path, required=True, help="folder of the recordings")
    parser.add_argument("--jobs", type=int, default=1)
    arguments = parser.parse_args()
    common = {"preset": "ci", "plan": GraspSpread.wide(), "seconds": 5, "jobs": arguments.jobs}
    shapes, paper8 = arguments.work / "shapes", arguments.work / "paper8"
    list(simulate(shapes, "shapes", 8, seed=0, num_objects=40, **common))
    list(simulate(paper8, "paper8", 30, seed=1, **common))
    columns = frames(shapes, ("shape", "width"))
    columns["width"] = columns["width"].astype(np.float32)
    columns["shape_names"] = np.array(["box", "cylinder", "ellipsoid", "sphere"])
    np.savez_compressed(HERE / "hand_shapes.npz", **columns)
    columns = frames(paper8, ("property",))
    np.savez_compressed(HERE / "hand_paper8.npz", **columns)


if __name__ == "__main__":
    main()
