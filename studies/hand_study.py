r"""Shape and width of an object from one frame of the simulated hand: our models and plain ones, by
what is held out, with dead taxels, on other devices, on another hand, and with fewer trials.

Nothing here is a result on a real hand. Each training is a file in the folder of runs, so that a
run that was stopped goes on; the page, its numbers and its pictures are made from these files.

Examples:
    tactile simulate --out shapes --objects shapes --num-objects 40 --trials 15 --spread wide \\
      --seconds 5 --preset ci --seed 0
    tactile simulate --out shapes240 --objects shapes --num-objects 40 --trials 3 --spread wide \\
      --seconds 5 --preset ci --seed 0 --hand allegro_uskin_240
    PYTHONPATH=benchmarks python studies/hand_study.py --shapes shapes --shapes240 shapes240 --runs runs
    PYTHONPATH=benchmarks python studies/hand_study_report.py --runs runs
"""

import json
import sys
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from hand_study_data import (
    Frames,
    on_layout,
    other_devices,
    read,
    some_trials,
    split,
    with_dead_taxels,
    with_readings,
)
from hand_study_models import make
from hand_study_numbers import score
from shared import parse, write

from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.transforms import TaxelPose

DEAD = (15, 30, 45, 60)  # percent
FEWER = (60, 150, 300)
_FIRST = ("flat_forest", "fnn", "posed_forest", "taxel_net", "posed")
_SHAPE = (*_FIRST, "open", "fnn_touch", "flat_forest_touch")
_WIDTH = ("posed", "open", "fnn", "flat_forest", "posed_forest", "posed_ridge")


@dataclass(frozen=True)
class Run:
    """One training."""

    task: str
    by: str
    fold: int
    model: str
    trials: int | None = None

    @property
    def key(self) -> str:
        few = "" if self.trials is None else f"-{self.trials}"
        return f"{self.task}-{self.by}{few}-{self.fold}-{self.model}"


def all_runs() -> Iterator[Run]:
    """Yields all trainings, those that matter most first."""
    for fold in range(5):
        yield from (Run("shape", "trial", fold, name) for name in _SHAPE)
    for fold in range(3):
        for by in ("trial", "placement"):
            yield from (Run("width", by, fold, name) for name in _WIDTH)
    for fold in range(3):
        for trials in FEWER:
            yield from (Run("shape", "trial", fold, name, trials) for name in _FIRST)
    for fold in range(3):
        yield from (Run("shape", "placement", fold, name) for name in _SHAPE)
    for fold in (3, 4):
        yield from (Run("width", "trial", fold, name) for name in _WIDTH)
    yield from (Run("width", "size", 0, name) for name in _WIDTH)
    for fold in range(3):
        yield from (Run(task, "trial", fold, "taxel_net_joint") for task in ("shape", "width"))
    # The same augmentation for the others as PosedTaxelNet has.
    for by, folds in (("trial", 5), ("placement", 3)):
        for task in ("shape", "width"):
            yield from (Run(task, by, fold, "fnn_dropped") for fold in range(folds))
    for fold in range(3):
        for name in ("fnn_dropped", "taxel_net_dropped"):
            yield from (Run("shape", "trial", fold, name, trials) for trials in FEWER)
    for by, folds in (("trial", 5), ("placement", 3)):
        yield from (Run("shape", by, fold, "taxel_net_dropped") for fold in range(folds))


@dataclass
class Tests:
    """What a model is tested on."""

    frames: Frames
    devices: dict[int, torch.Tensor]
    other: Frames

    def answers(self, model: Any, rows: torch.Tensor, run: Run) -> dict[str, Any]:
        """What a model says of the rows, and of what becomes of them."""
        data = self.frames.data[rows]
        found = {"test": model.predict(data)}
        if run.by == "trial" and run.trials is None:
            for part in DEAD:
                found[f"dead{part}"] = model.predict(
                    with_dead_taxels(data, part / 100, 100 * run.fold + part)
                )
            for seed, x in self.devices.items():
                found[f"device{seed}"] = model.predict(with_readings(data, x[rows]))
        return {key: listed(value) for key, value in found.items()}

    def other_hand(self, model: Any, names: np.ndarray, task: str) -> dict[str, Any]:
        """What it says of the trials of the other hand whose twins it was not trained on."""
        other = self.other
        kept = torch.from_numpy(np.isin(other.names, names)).nonzero().view(-1)
        data = other.data[kept]
        x = on_layout(data, other.layout, self.frames.layout)
        moved = TaxelPose(self.frames.layout, tangent=True)(
            StaticData(x=x, joint=data.joint, trial=data.trial)
        )
        found = {"moved": listed(model.predict(moved))}
        if model.any_layout:
            found["own"] = listed(model.on(other.layout).predict(data))
        found["y"] = listed(other.y(task)[kept].numpy())
        found["names"] = other.names[kept.numpy()].tolist()
        return found


def listed(values: np.ndarray) -> list[float]:
    """Classes as they are, millimetres to a thousandth."""
    return np.round(np.asarray(values, dtype=np.float64), 3).tolist()


def answer(run: Run, tests: Tests) -> dict[str, Any]:
    """Trains once and looks at the test part."""
    frames = tests.frames
    train, test = split(frames, run.by, run.fold)
    if run.trials is not None:
        train = some_trials(frames, train, run.trials, run.fold)
    y, model = frames.y(run.task), make(run.model)
    start = time.perf_counter()
    model.fit(frames.data[train], y[train], frames.layout, run.task, run.fold)
    seconds = time.perf_counter() - start
    names = frames.names[test.numpy()]
    out = {
        **asdict(run),
        "seconds": round(seconds, 1),
        "size": model.size,
        "train": [frames.trial_count(train), len(train)],
        "names": names.tolist(),
        "y": listed(y[test].numpy()),
        "answers": tests.answers(model, test, run),
    }
    if run.by == "trial" and run.trials is None:
        out["other_hand"] = tests.other_hand(model, names, run.task)
    return out


OPTIONS = {
    "--shapes": (..., "folder of trials, 384 taxels"),
    "--shapes240": (..., "folder of trials, 240 taxels"),
    "--runs": (..., "a file for each training; goes on"),
    "--only": ("", "beginning of the names of runs"),
    "--models": (sorted({run.model for run in all_runs()}), "which"),
    "--stride": (40, "use every n-th frame"),
}


def main(argv: list[str] | None = None) -> int:
    arguments = parse(__doc__, OPTIONS, argv)
    torch.set_num_threads(1)
    folder = Path(arguments.runs)
    folder.mkdir(parents=True, exist_ok=True)
    frames = read(arguments.shapes, arguments.stride)
    print(f"{len(frames.names)} frames of {frames.trial_count()} trials", flush=True)
    devices = other_devices(arguments.shapes, frames, folder / "devices.npz")
    other = read(arguments.shapes240, arguments.stride, "allegro_uskin_240")
    tests = Tests(frames, devices, other)
    for run in all_runs():
        file = folder / f"{run.key}.json"
        wanted = run.model in arguments.models
        if file.exists() or not wanted or not run.key.startswith(arguments.only):
            continue
        found = answer(run, tests)
        write(file, json.dumps(found))
        reached = score(run.task, found["y"], found["answers"]["test"])
        print(f"{run.key}: {reached:.2f} ({found['seconds']} s)", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
