r"""Writes the glove recordings of tutorial 2 to ``glove/`` beside this file.

The numbers are simulated and no measurement. Three objects are held in three grasps, three times
each: 27 trials of 22 frames at 20 Hz. Each trial begins with an open hand (0.3 s). As in many real
gloves, each taxel has an offset that is drawn anew whenever the glove is put on (for each trial),
and some cells are empty.
"""

import csv
from pathlib import Path

import numpy as np

PATCHES = {"palm": 10, "thumb": 3, "index": 4, "middle": 4, "ring": 4, "little": 3}
GRASPS = {  # how firmly each patch presses
    "power": {"palm": 0.9, "thumb": 0.7, "index": 0.7, "middle": 0.8, "ring": 0.8, "little": 0.6},
    "pinch": {"thumb": 1.0, "index": 1.0},
    "tripod": {"thumb": 1.0, "index": 0.8, "middle": 0.8},
}
BEND = {
    "power": (40, 70, 75, 75, 70),
    "pinch": (30, 45, 15, 12, 10),
    "tripod": (32, 45, 48, 15, 12),
}
OBJECTS = ("ball", "mug", "pen")
FRAMES, OPEN = 22, 6  # frames of a trial, and those before the grasp
OFFSET, FORCE, NOISE, MISSING = 45.0, 60.0, 9.0, 0.01  # counts, and a share of the cells


def write_trial(path: Path, item: str, grasp: str, draw: np.random.Generator) -> None:
    r"""Writes one trial."""
    firmness = np.repeat([GRASPS[grasp].get(patch, 0.0) for patch in PATCHES], [*PATCHES.values()])
    touched = draw.random(len(firmness)) < 0.75  # no object touches every taxel
    strength = FORCE * draw.uniform(0.5, 1.2) * (0.7 if item == "pen" else 1.0)
    rest = 300 + draw.normal(0, OFFSET, len(firmness))
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        taxels = [f"{patch}_{i}" for patch, count in PATCHES.items() for i in range(count)]
        fingers = [f"bend_{patch}_deg" for patch in [*PATCHES][1:]]
        writer.writerow(["time_ms", *taxels, *fingers, "grasp"])
        for frame in range(FRAMES):
            closed = min(1.0, max(0.0, (frame - OPEN + 1) / 3))
            force = strength * closed * firmness * touched
            counts = np.maximum(0, rest + force + draw.normal(0, NOISE, len(rest)))
            cells = [str(round(count)) for count in counts]
            lost = draw.random(len(cells)) < MISSING
            cells = ["" if gone else cell for cell, gone in zip(cells, lost, strict=True)]
            bend = [round(closed * angle + draw.normal(5, 3)) for angle in BEND[grasp]]
            writer.writerow([50 * frame, *cells, *bend, grasp if frame >= OPEN else "open"])


def main() -> None:
    r"""Writes all trials."""
    folder = Path(__file__).with_name("glove")
    folder.mkdir(exist_ok=True)
    draw = np.random.default_rng(0)
    for item in OBJECTS:
        for number in range(9):
            write_trial(folder / f"{item}_{number}.csv", item, [*GRASPS][number % 3], draw)


if __name__ == "__main__":
    main()
