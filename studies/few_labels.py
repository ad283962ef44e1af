r"""Few labels: all models of a comparison on ten labels a class, by several draws of the labels.

Each draw of each data set is a file of samples with a training and a test part, which holds whole
objects, persons, trials or presses that no label is of, and is compared as `tactile compare --by
given` compares it. `chosen` is the model that it recommends, by the scores on validation parts of
the labels themselves (or the best by these, if it recommends none). Every run is a file, so that a
benchmark that was stopped goes on. Simulated data is made here if its folder is missing: `tactile
simulate`.

Examples:
    PYTHONPATH=benchmarks python studies/few_labels.py --data shared/data --out few_labels
    PYTHONPATH=benchmarks python studies/few_labels.py --data shared/data --out few_labels --sets digits bts3 --draws 2
"""

import json
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from shared import describe_machine, parse

from torch_geometric_tactile._files import atomic_path
from torch_geometric_tactile.experiments.advice import recommended
from torch_geometric_tactile.experiments.compared_windows import data_source
from torch_geometric_tactile.experiments.comparison import (
    ComparisonSettings,
    comparison_plan,
    summarize,
)
from torch_geometric_tactile.experiments.run_plan import run_plan
from torch_geometric_tactile.sensors import TaxelLayout, grid, letter_array, stock_layout

_MOST_TESTED = 1000
_MAT_PITCH = 0.05  # metres: not stated, and without meaning for the models


class Samples(NamedTuple):
    """Readings (S, N, C), labels (S,), and what is held out together (S,)."""

    x: np.ndarray
    y: np.ndarray
    unit: np.ndarray
    layout: TaxelLayout


def digits(data: Path, made: Path) -> Samples:
    """The 1797 digits of scikit-learn; nothing is held out together."""
    from sklearn.datasets import load_digits

    found = load_digits()
    x = found.data.reshape(-1, 64, 1)
    return Samples(x, found.target, np.arange(len(x)), grid(8, 8, 0.004))


def bts3(data: Path, made: Path) -> Samples:
    """The training files of BTS3, scaled by palm pose; an object is held out."""
    from torch_geometric_tactile.datasets import BioTacSP
    from torch_geometric_tactile.transforms import SessionZScore

    raw = made / "biotacsp" / "raw"
    if not raw.is_dir():  # what the data set processes stays out of `data`
        shutil.copytree(data / "biotacsp" / "raw", raw)
    dataset = BioTacSP(str(raw.parent))
    samples = SessionZScore().fit(dataset.data)(dataset.data)
    return Samples(*map(np.asarray, (samples.x, samples.y, samples.group)), dataset.layout)


def letters(data: Path, made: Path) -> Samples:
    """Simulated letters, 30 presses each; a press is held out."""
    folder = _simulated(made / "letters", "--objects", "letters", "--presses", "30")
    x, y = [], []
    for number, letter in enumerate(sorted(path.name for path in folder.glob("[A-Z]"))):
        for path in sorted((folder / letter).glob("*.npy")):
            presses = np.load(path).reshape(-1, 32 * 32, 1)
            x.append(presses)
            y += [number] * len(presses)
    return Samples(np.concatenate(x), np.array(y), np.arange(len(y)), letter_array())


def hand(data: Path, made: Path) -> Samples:
    """Twenty simulated objects, six held frames of a trial, less its rest; a trial is held out."""
    from torch_geometric_tactile.io import read_recording

    options = ("--objects", "twenty", "--preset", "ci", "--trials", "8")
    folder = _simulated(made / "hand", *options)
    x, y, unit = [], [], []
    for number, path in enumerate(sorted(folder.glob("*.h5"))):
        recording = read_recording(path)
        phase = list(recording.meta["phase_names"]).index("hold")
        held = np.flatnonzero(recording.privileged["phase"] == phase)
        rows = held[np.linspace(0, len(held) - 1, 6).astype(int)]
        x.append(recording.tactile[rows] - recording.tactile[:10].mean(axis=0))
        y += [recording.label] * 6
        unit += [number] * 6
    return Samples(
        np.concatenate(x), np.array(y), np.array(unit), stock_layout("allegro_uskin_240")
    )


def mat(data: Path, made: Path) -> Samples:
    """Seventeen postures on a mat, pooled by two, every eighth frame; a person is held out."""
    x, y, unit = [], [], []
    with zipfile.ZipFile(data / "pressure_mat/pmd-1.0.0.zip") as file:
        names = [name for name in file.namelist() if "experiment-i/" in name]
        for name in sorted(name for name in names if name.endswith(".txt")):
            person, posture = name.split("/")[-2:]
            frames = np.loadtxt(file.read(name).decode().splitlines())[3::8]
            frames = frames.reshape(-1, 32, 2, 16, 2).mean(axis=(2, 4)).reshape(-1, 512, 1)
            x.append(frames)
            y += [int(posture.removesuffix(".txt")) - 1] * len(frames)
            unit += [int(person[1:])] * len(frames)
    return Samples(np.concatenate(x), np.array(y), np.array(unit), grid(32, 16, _MAT_PITCH))


SETS: dict[str, Callable[[Path, Path], Samples]] = {
    "digits": digits,
    "bts3": bts3,
    "letters": letters,
    "hand": hand,
    "mat": mat,
}


def _simulated(folder: Path, *options: str) -> Path:
    if not (folder / "simulation.json").is_file():
        command = [sys.executable, "-m", "torch_geometric_tactile", "simulate", "--out"]
        subprocess.run([*command, str(folder), "--seed", "0", *options], check=True)
    return folder


def drawn(samples: Samples, labels: int, draw: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns the samples that have a label, from as many units as there are, and those tested.

    A third of the units is tested: of each class, if a unit has one."""
    rng = np.random.default_rng(draw)
    is_tested = _held_out(samples, rng)
    chosen = _labelled(samples, ~is_tested, labels, rng)
    return chosen, rng.permutation(np.flatnonzero(is_tested))[:_MOST_TESTED]


def _held_out(samples: Samples, rng: np.random.Generator) -> np.ndarray:
    """Returns which samples are of a unit that is tested (S,)."""
    units = np.unique(samples.unit)
    of_one_class = all(len({*samples.y[samples.unit == u]}) == 1 for u in units)
    groups = [samples.y == label for label in np.unique(samples.y)]
    groups = groups if of_one_class else [samples.y == samples.y]
    is_tested = np.zeros(len(samples.y), dtype=bool)
    for group in groups:
        units = rng.permutation(np.unique(samples.unit[group]))
        is_tested |= group & np.isin(samples.unit, units[: max(1, len(units) // 3)])
    return is_tested


def _labelled(
    samples: Samples, may_be: np.ndarray, labels: int, rng: np.random.Generator
) -> np.ndarray:
    """Returns so many samples of each class, from as many units as there are."""
    chosen: list[int] = []
    for label in np.unique(samples.y):
        rows = rng.permutation(np.flatnonzero((samples.y == label) & may_be))
        order = np.zeros(len(rows), dtype=int)
        for unit in np.unique(samples.unit[rows]):
            same = np.flatnonzero(samples.unit[rows] == unit)
            order[same] = np.arange(len(same))
        chosen += rows[np.argsort(order, kind="stable")][:labels].tolist()
    return np.array(chosen)


def compared(name: str, samples: Samples, draw: int, options: Any) -> dict[str, float]:
    """Returns the accuracy of each model in percent."""
    train, test = drawn(samples, options.labels, draw)
    path = options.out / f"{name}_{options.labels}_{draw}.npz"
    layout = options.out / f"{name}.json"
    samples.layout.save(layout)
    _write_samples(samples, train, test, path)
    models = tuple(options.models.split(",")) if options.models else None
    settings = ComparisonSettings(models=models, by="given", members=options.members)
    return _accuracies(path, layout, settings, options.out / path.stem)


def _write_samples(samples: Samples, train: np.ndarray, test: np.ndarray, path: Path) -> None:
    """Writes a file of samples with a training and a test part."""
    rows = np.concatenate([train, test])
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        np.savez(
            file,
            x=samples.x[rows].astype(np.float32),
            y=samples.y[rows],
            trial=samples.unit[rows],
            part=np.array(["train"] * len(train) + ["test"] * len(test)),
        )


def _accuracies(
    path: Path, layout: Path, settings: ComparisonSettings, out: Path
) -> dict[str, float]:
    """Compares models on a file of samples and returns the accuracy of each in percent."""
    plan = comparison_plan(data_source(path, layout=str(layout)), settings, name=path.stem)
    finished = run_plan(plan, out)
    for run, reason in finished.failed.items():
        print(f"failed: {run}: {reason}", flush=True)
    comparison = summarize(finished)
    scores = {r.model.name: 100 * r.scores["accuracy"].mean for r in comparison.results}
    chosen = recommended(comparison) or comparison.best
    return scores if chosen is None else {**scores, "chosen": scores[chosen.model.name]}


def main() -> None:
    options = parse(
        __doc__,
        {
            "--data": (Path("shared/data"), "folder of the real data"),
            "--out": (Path("few_labels"), "folder of runs and results"),
            "--sets": (list(SETS), "which data sets"),
            "--labels": (10, "labels a class"),
            "--draws": (5, "draws of labels and test"),
            "--first": (0, "the first draw"),
            "--members": (3, "networks that are averaged"),
            "--models": ("", "names of models, with commas; all if left out"),
        },
    )
    options.out.mkdir(parents=True, exist_ok=True)
    result = options.out / "result.json"
    found = json.loads(result.read_text()) if result.is_file() else {"machine": describe_machine()}
    made = options.out / "made"
    for name in options.sets:
        samples = SETS[name](options.data, made)
        for draw in range(options.first, options.first + options.draws):
            scores = compared(name, samples, draw, options)
            found.setdefault(name, {})[f"{options.labels} labels, draw {draw}"] = scores
            with atomic_path(result) as temporary:
                temporary.write_text(json.dumps(found, indent=1))
            words = ", ".join(f"{model} {score:.1f}" for model, score in scores.items())
            print(f"{name}, draw {draw}: {words}", flush=True)


if __name__ == "__main__":
    main()
