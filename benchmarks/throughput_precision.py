r"""What a fused optimizer and bfloat16 are worth in training, in speed and in accuracy."""

import copy
import logging
import os
import statistics
import time
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import torch
from hand_frames import LAYOUT, Frames
from rounded_products import has_bfloat16, rounded_products
from shared import spread
from torch import nn

from torch_geometric_tactile.data import Protocol
from torch_geometric_tactile.datasets import AllegroUSkin
from torch_geometric_tactile.experiments._networks import fit_classifier
from torch_geometric_tactile.loader import StaticLoader
from torch_geometric_tactile.nn.models import TactileGCN
from torch_geometric_tactile.training import TactileDataModule, classification_metrics
from torch_geometric_tactile.training._config_files import expand_template
from torch_geometric_tactile.training._predictions import collect_predictions
from torch_geometric_tactile.transforms import ZScore

WAYS = {
    "loop, float32": (False, False),
    "fused, float32": (True, False),
    "fused, bfloat16": (True, True),
}
SEEDS = 5
_PHASES = ("squeeze", "lift", "hold")


def measure_precision(
    batch_size: int, rounds: int, threads: int, root: Path | None, stride: int, epochs: int
) -> dict[str, Any]:
    """Frames per second of X and II in each way and, with recordings, their accuracy by trial."""
    torch.set_num_threads(threads)
    found: dict[str, Any] = {
        "batch_size": batch_size,
        "threads": threads,
        "load": os.getloadavg()[0],
        "has_bfloat16": has_bfloat16(),
        "frames_per_second": {},
        "ratios": {},
    }
    for name, segments in (("X", None), ("II", "patch")):
        speed = _speed(segments, batch_size, rounds)
        found["frames_per_second"][name] = {way: spread(values) for way, values in speed.items()}
        for way in list(speed)[1:]:
            pairs = zip(speed[way], speed["loop, float32"], strict=True)
            found["ratios"][f"{name}: {way} against loop, float32"] = statistics.median(
                a / b for a, b in pairs
            )
    if root is not None:
        found["accuracy"] = _accuracies(root, batch_size, stride, epochs)
    return found


def _speed(segments: str | None, batch_size: int, rounds: int) -> dict[str, list[float]]:
    torch.manual_seed(0)
    dataset = Frames(6 * batch_size)
    dataset.data.x.sub_(30_000).div_(100)
    loader = StaticLoader(dataset, batch_size, shuffle=True)
    first = TactileGCN(LAYOUT, 8, segments=segments)
    sides = {}
    for way, (fused, bf16) in WAYS.items():
        if bf16 and not has_bfloat16():
            continue
        model = copy.deepcopy(first)
        optimizer = torch.optim.Adam(model.parameters(), **_options(fused))
        sides[way] = (model, optimizer, bf16)
    speed: dict[str, list[float]] = {way: [] for way in sides}
    for round_ in range(rounds + 1):
        for way, (model, optimizer, bf16) in sides.items():
            start = time.perf_counter()
            for _ in range(2):
                for batch in loader:
                    optimizer.zero_grad()
                    with torch.autocast("cpu", torch.bfloat16, enabled=bf16):
                        loss = nn.functional.cross_entropy(
                            model(batch.x, batch.edge_index), batch.y
                        )
                    loss.backward()
                    optimizer.step()
            if round_ > 0:  # the first warms up
                speed[way].append(2 * len(dataset) / (time.perf_counter() - start))
    return speed


def _accuracies(root: Path, batch_size: int, stride: int, epochs: int) -> dict[str, Any]:
    # Of the same splits, weights at the start and batches in each way.
    dataset = AllegroUSkin(
        root, task="object", split=None, phases=_PHASES, stride=stride, tare="hover"
    )
    protocol = Protocol("trial", test=0.3, stratify="group")
    accuracy: dict[str, dict[str, list[float]]] = {}
    num_train = 0
    for name, experiment in (("X", "x_tac"), ("II", "ii_tac")):
        model = expand_template("p2_table2")[experiment]["model"]
        accuracy[name] = {way: [] for way in WAYS}
        for seed in range(SEEDS):
            train, _, test = protocol.split(dataset, seed)
            num_train = len(train)
            for way, (fused, bf16) in WAYS.items():
                data = TactileDataModule(
                    dataset[train],
                    dataset[test],
                    split="frame",
                    val=0.0,
                    transform=ZScore(per="channel"),
                    batch_size=batch_size,
                )
                mixed, rounded = bf16 and has_bfloat16(), bf16 and not has_bfloat16()
                settings = {"accelerator": "cpu", "precision": "bf16-mixed" if mixed else "32-true"}
                section = {
                    **model,
                    "num_classes": dataset.num_classes,
                    "optimizer": {
                        "class_path": "torch.optim.Adam",
                        "init_args": {"lr": 0.001, **_options(fused)},
                    },
                }
                with rounded_products() if rounded else nullcontext():
                    classifier = fit_classifier(section, data, seed, settings, epochs)
                    said = collect_predictions(classifier, data.test_dataloader())
                found = classification_metrics(said.probability, said.y)["accuracy"]
                accuracy[name][way].append(found)
                logging.info("%s, seed %d, %s: %.3f", name, seed, way, found)
    return {
        "num_trials": len(dataset.column("trial").unique()),
        "num_train": num_train,
        "num_test": len(dataset) - num_train,
        "stride": stride,
        "epochs": epochs,
        "bfloat16": "autocast" if has_bfloat16() else "rounded",
        "models": accuracy,
    }


def _options(fused: bool) -> dict[str, bool]:
    return {"fused": True} if fused else {"foreach": False}
