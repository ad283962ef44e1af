r"""Measures how well plain models recognise objects and properties on the simulated Allegro hand,
with whole trials or random frames held out.

No result is from a real hand. Models and training are fixed in advance and not tuned.

Examples:
    tactile simulate --out data/paper8 --objects paper8 --seed 1 --jobs 2
    tactile simulate --out data/control8 --objects control8 --seed 1 --jobs 2
    PYTHONPATH=benchmarks python studies/simulated_hand.py --paper8 data/paper8 --control8 data/control8
"""

import argparse
import json
import platform
import statistics
import sys
import time
from collections.abc import Iterator
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import torch
from shared import parse, table, write, write_json
from sklearn.ensemble import RandomForestClassifier
from torch import Tensor, nn
from tqdm import tqdm

import torch_geometric_tactile
from torch_geometric_tactile.datasets import AllegroUSkin
from torch_geometric_tactile.transforms import ZScore

_TOUCH = ("squeeze", "lift", "hold")
_INPUTS = ("joints", "tactile", "both")
_MODELS = ("FNN", "random forest")
_FRACTIONS = (0.7, 0.0, 0.3)
_EPOCHS = 30
_BY_HAND = "<!-- below: written by hand, kept by studies/simulated_hand.py -->"


OPTIONS = {
    "--paper8": (..., "folder of simulated trials, 8 objects"),
    "--control8": (..., "folder of simulated trials, one shape"),
    "--out": ("docs/results", "where the table is written"),
    "--seeds": (3, "splits and trainings of each model"),
    "--stride": (20, "use every n-th frame"),
}


def features(dataset: AllegroUSkin, scale: ZScore, inputs: str) -> Tensor:
    data = scale(dataset.data)
    parts = []
    if inputs != "joints":
        parts.append(data.x.flatten(1))
    if inputs != "tactile":
        parts.append(data.joint)
    return torch.cat(parts, dim=1)


def train_fnn(x: Tensor, y: Tensor, seed: int) -> nn.Module:
    torch.manual_seed(seed)
    multi_label = y.dim() == 2
    num_outputs = y.size(1) if multi_label else int(y.max()) + 1
    model = nn.Sequential(
        nn.Linear(x.size(1), 256),
        nn.ReLU(),
        nn.Dropout(0.3),
        nn.Linear(256, 64),
        nn.ReLU(),
        nn.Linear(64, num_outputs),
    )
    loss = nn.BCEWithLogitsLoss() if multi_label else nn.CrossEntropyLoss()
    optimizer = torch.optim.Adam(model.parameters(), lr=1e-3, weight_decay=1e-4)
    for _ in range(_EPOCHS):
        for index in torch.randperm(len(x)).split(128):
            optimizer.zero_grad()
            loss(model(x[index]), y[index]).backward()
            optimizer.step()
    return model.eval()


def predict(model: str, x: Tensor, y: Tensor, x_test: Tensor, seed: int) -> Tensor:
    if model == "FNN":
        network = train_fnn(x, y, seed)
        with torch.no_grad():
            logits = network(x_test)
        return (logits > 0).to(y) if y.dim() == 2 else logits.argmax(dim=1)
    forest = RandomForestClassifier(100, random_state=seed, n_jobs=-1)
    forest.fit(x.numpy(), y.long().numpy())
    return torch.from_numpy(np.asarray(forest.predict(x_test.numpy()))).to(y)


def runs(arguments: argparse.Namespace) -> Iterator[dict[str, Any]]:
    cases = [
        ("object", arguments.paper8, _TOUCH),
        ("property", arguments.control8, _TOUCH),
        ("object, before contact", arguments.paper8, ("hover",)),
    ]
    for task, root, phases in cases:
        for split_by in ("trial", "frame"):
            for seed in range(arguments.seeds):
                common = {
                    "task": "property" if task == "property" else "object",
                    "phases": phases,
                    "stride": arguments.stride,
                    "split_by": split_by,
                    "split_seed": seed,
                    "fractions": _FRACTIONS,
                }
                train = AllegroUSkin(root, split="train", **common)
                test = AllegroUSkin(root, split="test", **common)
                scale = ZScore().fit(train)
                y, y_test = train.data.y, test.data.y
                for inputs in _INPUTS:
                    x, x_test = (features(part, scale, inputs) for part in (train, test))
                    for model in _MODELS:
                        right = predict(model, x, y, x_test, seed) == y_test
                        yield {
                            "task": task,
                            "split_by": split_by,
                            "seed": seed,
                            "input": inputs,
                            "model": model,
                            "train": len(train),
                            "test": len(test),
                            "accuracy": float(right.float().mean()),
                            "per_label": right.float().mean(dim=0).tolist()
                            if y.dim() == 2
                            else None,
                            "labels": train.property_names if y.dim() == 2 else None,
                        }


def accuracy_table(results: list[dict[str, Any]], task: str) -> list[str]:
    rows = []
    for inputs, model in product(_INPUTS, _MODELS):
        cells = []
        for split_by in ("trial", "frame"):
            values = [
                100 * result["accuracy"]
                for result in results
                if (result["task"], result["input"], result["model"], result["split_by"])
                == (task, inputs, model, split_by)
            ]
            spread = statistics.stdev(values) if len(values) > 1 else 0.0
            cells.append(f"{statistics.mean(values):.1f} ± {spread:.1f}")
        rows.append([inputs, model, *cells])
    return table(["input", "model", "by trial", "by frame"], rows)


def label_table(results: list[dict[str, Any]]) -> list[str]:
    by_trial = [r for r in results if r["task"] == "property" and r["split_by"] == "trial"]
    rows = []
    for inputs, model in product(_INPUTS, _MODELS):
        runs = [r["per_label"] for r in by_trial if (r["input"], r["model"]) == (inputs, model)]
        means = [f"{100 * statistics.mean(column):.0f}" for column in zip(*runs, strict=True)]
        rows.append([inputs, model, *pairs(means)])
    return table(["input", "model", *pairs(by_trial[0]["labels"])], rows)


def pairs(texts: list[str]) -> list[str]:
    # Labels come in pairs of opposites, such as light and heavy.
    return [" / ".join(pair) for pair in zip(texts[::2], texts[1::2], strict=True)]


def main(argv: list[str] | None = None) -> int:
    arguments = parse(__doc__, OPTIONS, argv)
    start = time.perf_counter()
    total = 3 * 2 * arguments.seeds * len(_INPUTS) * len(_MODELS)
    results = list(tqdm(runs(arguments), total=total, unit="model"))
    simulations = {
        name: json.loads((Path(folder) / "simulation.json").read_text(encoding="utf-8"))
        for name, folder in (("paper8", arguments.paper8), ("control8", arguments.control8))
    }
    seeds = ", ".join(map(str, range(arguments.seeds)))
    counts = {(r["task"], r["split_by"]): (r["train"], r["test"]) for r in results}
    machine = (
        f"{platform.machine()}, threads: {torch.get_num_threads()}, torch {torch.__version__}, "
        f"torch_geometric_tactile {torch_geometric_tactile.__version__}, MuJoCo "
        f"{simulations['paper8']['mujoco']}"
    )
    lines = [
        "# Plain models on the simulated hand",
        "",
        "This page shows how well plain models recognise objects and their properties on the "
        "simulated hand, and how much a split by random frames leaks.",
        "",
        "**All results are simulated**; none is from a real hand. Data: `tactile simulate`, preset "
        f"`full`, seed {simulations['paper8']['seed']}; "
        + "; ".join(
            f"{name}: {s['successes']} trials in {s['attempts']} attempts"
            for name, s in simulations.items()
        )
        + ". Accuracy in % on held-out frames, mean ± standard deviation over the seeds "
        f"{seeds} (of split and training). *By trial* holds out whole trials (3 of 10 of each "
        "object), *by frame* random frames of the same trials. Every "
        f"{arguments.stride}th frame is a sample, scaled by the training set. The FNN has two "
        f"hidden layers (256, 64) and {_EPOCHS} epochs, the forest 100 trees; neither was tuned. "
        f"Written by `studies/simulated_hand.py` ({machine}).",
        "",
        "## Eight objects (chance 12.5)",
        "",
        "Frames of squeeze, lift and hold; by trial, "
        f"{counts['object', 'trial'][0]} frames for training and "
        f"{counts['object', 'trial'][1]} for the test.",
        "",
        *accuracy_table(results, "object"),
        "",
        "## Six properties of eight objects of one shape (chance 50)",
        "",
        "Mean over the six labels, on frames of the same phases.",
        "",
        *accuracy_table(results, "property"),
        "",
        "Each label, by trial:",
        "",
        *label_table(results),
        "",
        "## Leakage: eight objects before contact (chance 12.5)",
        "",
        "Frames of the phase hover only, in which the hand has not touched the object. A model "
        "that is tested on random frames recognises the trial from its joint angles and sensor "
        "offsets, not the object.",
        "",
        *accuracy_table(results, "object, before contact"),
        "",
    ]
    out = Path(arguments.out)
    content = {"machine": machine, "simulations": simulations, "results": results}
    write_json(out / "simulated_hand.json", content)
    page = out / "simulated_hand.md"
    old = page.read_text(encoding="utf-8") if page.is_file() else ""
    by_hand = old.partition(_BY_HAND)[2] or "\n"
    write(page, "\n".join([*lines, _BY_HAND]) + by_hand)
    print("\n".join(lines))
    print(f"{time.perf_counter() - start:.0f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main())
