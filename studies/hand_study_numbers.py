"""The numbers of the study of the simulated hand, from the files of its runs."""

import json
import statistics
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from torch_geometric_tactile.experiments import Difference, Predictions, paired_difference

METRICS = {"shape": "accuracy", "width": "mae"}
OVERLAP = {"trial": 1 / 4, "placement": 1 / 2, "size": 0.0}  # test samples by training samples
Found = dict[tuple[str, str, int | None], dict[str, list[dict[str, Any]]]]


def load(folder: Path) -> Found:
    """Runs by what is asked and by model, in the order of their folds."""
    found: Found = {}
    files = sorted(folder.glob("*-*.json"))
    for run in (json.loads(file.read_text(encoding="utf-8")) for file in files):
        group = found.setdefault((run["task"], run["by"], run["trials"]), {})
        group.setdefault(run["model"], []).append(run)
    for models in found.values():
        for runs in models.values():
            runs.sort(key=lambda run: run["fold"])
    return found


def score(task: str, y: Any, said: Any) -> float:
    """Percent that is right, or the mean absolute error in millimetres."""
    y, said = np.asarray(y), np.asarray(said)
    return float(100 * (y == said).mean() if task == "shape" else np.abs(y - said).mean())


def mean_and_sd(values: Sequence[float]) -> dict[str, Any]:
    sd = statistics.stdev(values) if len(values) > 1 else None
    folds = [round(value, 3) for value in values]
    return {"mean": statistics.mean(values), "sd": sd, "folds": folds}


def of_answer(runs: list[dict[str, Any]], key: str) -> dict[str, Any]:
    """The score of the runs in one of the tests."""
    return mean_and_sd([score(run["task"], run["y"], run["answers"][key]) for run in runs])


def of_devices(runs: list[dict[str, Any]]) -> dict[str, Any]:
    """The score on other devices, their mean in each fold."""
    values = []
    for run in runs:
        devices = [said for key, said in run["answers"].items() if key.startswith("device")]
        values.append(statistics.mean(score(run["task"], run["y"], said) for said in devices))
    return mean_and_sd(values)


def of_other_hand(runs: list[dict[str, Any]]) -> dict[str, Any]:
    """Scores on the other hand, and on the same trials of the hand that was trained on."""
    out: dict[str, Any] = {}
    for kind in ("own", "moved"):
        if all(kind in run["other_hand"] for run in runs):
            other = [(run["task"], run["other_hand"]["y"], run["other_hand"][kind]) for run in runs]
            out[kind] = mean_and_sd([score(*one) for one in other])
    values = []
    for run in runs:
        kept = np.isin(run["names"], run["other_hand"]["names"])
        said = np.asarray(run["answers"]["test"])[kept]
        values.append(score(run["task"], np.asarray(run["y"])[kept], said))
    return {"trained on": mean_and_sd(values), **out}


def predictions(runs: list[dict[str, Any]], key: str = "test") -> list[Predictions]:
    """What the runs said, as the package compares it."""
    out = []
    for run in runs:
        said, y = np.asarray(run["answers"][key]), np.asarray(run["y"])
        out.append(Predictions(said, said, y, trial=np.asarray(run["names"])))
    return out


def difference(
    a: list[dict[str, Any]], b: list[dict[str, Any]], key: str = "test"
) -> dict[str, Any]:
    """One model less another, on the folds that both have."""
    task, folds = a[0]["task"], {run["fold"] for run in a} & {run["fold"] for run in b}
    parts = [[run for run in runs if run["fold"] in folds] for runs in (a, b)]
    found: Difference = paired_difference(
        predictions(parts[0], key), predictions(parts[1], key), METRICS[task], OVERLAP[a[0]["by"]]
    )
    scale = 100 if task == "shape" else 1
    return {
        "mean": scale * found.mean,
        "over_splits": scale * found.over_splits if found.num_splits > 1 else None,
        "over_trials": scale * found.over_units,
        "splits": found.num_splits,
        "verdict": found.verdict,
        "wins": sum(
            (score(task, x["y"], x["answers"][key]) - score(task, x["y"], z["answers"][key]))
            * (1 if task == "shape" else -1)
            > 0
            for x, z in zip(*parts, strict=True)
        ),
    }
