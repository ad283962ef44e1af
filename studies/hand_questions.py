r"""Small experiments beside the tables of the two papers: what becomes of a configuration with
other scaling, another encoder of edge features, weight decay, fewer trials, or shapes as classes.

Nothing here is a result on a real hand. Choices (scaling, batches) are made on validation trials;
the other questions look at the test trials, once each.

Examples:
    tactile simulate --out paper8 --trials 50 --spread wide --seconds 5 --preset ci --seed 1
    tactile simulate --out shapes --objects shapes --num-objects 40 --trials 15 --spread wide \\
      --seconds 5 --preset ci
    PYTHONPATH=benchmarks python studies/hand_questions.py --paper8 paper8 --shapes shapes --out answers.jsonl
"""

import copy
import json
import statistics
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import torch
from shared import parse
from torch import Tensor

from torch_geometric_tactile.data import Protocol, StaticDataset
from torch_geometric_tactile.datasets import AllegroUSkin
from torch_geometric_tactile.experiments._building import build_object
from torch_geometric_tactile.experiments._networks import Clock, fit_classifier, warm_up
from torch_geometric_tactile.sensors import allegro_uskin
from torch_geometric_tactile.training._predictions import collect_predictions
from torch_geometric_tactile.training._config import load_config
from torch_geometric_tactile.training.data_module import TactileDataModule
from torch_geometric_tactile.training.metrics import classification_metrics

_TOUCH = ("squeeze", "lift", "hold")
_P1, _P2 = (Protocol("trial", val=0.1, test=part, stratify="group") for part in (0.2, 0.3))
_CHOICE = Protocol("trial", val=0.3, test=0.2, stratify="group")
_SHAPES = Protocol("trial", val=0.1, test=0.2, stratify="y")
_NN = "torch_geometric_tactile.nn"
_SCALER = "torch_geometric_tactile.transforms.ZScore"

Change = Callable[[dict[str, Any]], None]


@dataclass(frozen=True)
class Question:
    r"""One training, whatever its seed."""

    key: str
    config: str
    protocol: Protocol = _P1  # what is held out
    changes: tuple[Change, ...] = ()  # of the configuration
    task: str = "property"
    part: str = "test"  # that is looked at
    tare: str | None = "hover"  # the frames at rest
    trials: int | None = None  # that are trained on; all if left out
    epochs: int = 10


def scale(**per: str) -> Change:
    r"""Sets the groups of numbers with one scale; what is in metres gets a scaler."""

    def change(config: dict[str, Any]) -> None:
        transforms = config["data"]["transform"]["init_args"]["transforms"]
        scalers = [part for part in transforms if part["class_path"] == _SCALER]
        of_attr = {part.get("init_args", {}).get("attr", "x"): part for part in scalers}
        for attr, value in per.items():
            if attr not in of_attr:
                of_attr[attr] = {"class_path": _SCALER, "init_args": {"attr": attr}}
                transforms.append(of_attr[attr])
            of_attr[attr].setdefault("init_args", {})["per"] = value

    return change


def model(**arguments: Any) -> Change:
    r"""Changes arguments of the model."""
    return lambda config: config["model"]["model"]["init_args"].update(arguments)


def optimizer(**arguments: Any) -> Change:
    r"""Changes arguments of the optimizer."""
    return lambda config: config["model"]["optimizer"]["init_args"].update(arguments)


def small_fnn(config: dict[str, Any]) -> None:
    r"""Puts two small fully connected layers in the place of the model."""
    arguments = {"inputs": ["tactile"], "widths": [512, 128], "pools": [2, 2]}
    config["model"]["model"] = {"class_path": f"{_NN}.TactileFNN", "init_args": arguments}
    config["data"]["batch_size"] = 32


def multiclass(config: dict[str, Any]) -> None:
    r"""Tells classes apart in place of labels."""
    config["model"]["task"] = "multiclass"


def questions() -> Iterator[Question]:
    r"""Yields all of them."""
    for config, task, attr in (
        ("p1_table2/mt_gcn_te", "property", "edge_attr"),
        ("p2_table2/ii_tac_pos", "object", "pos"),
        ("p1_table2/mt_gcn_ta", "property", "absolute"),
    ):
        for per in ("channel", "taxel"):
            yield Question(
                f"scale/{config}/{attr}/{per}",
                config,
                _CHOICE,
                (scale(**{attr: per}),),
                task,
                "val",
                epochs=8,
            )
    for name, config, change in (
        ("ii", "p2_table2/ii_tac", ()),
        ("x", "p2_table2/x_tac", ()),
        ("fnn_small", "p2_table2/x_tac", (small_fnn,)),
    ):
        for per in ("taxel", "channel"):
            for tare in (None, "hover"):
                key = f"old/{name}/{per}, {'no tare' if tare is None else 'tare'}"
                yield Question(key, config, _P2, (scale(x=per), *change), "object", tare=tare)
    patches = {"segment": allegro_uskin().segments("patch").tolist()}
    encoders: dict[str, Any] = {
        "message": "message",
        "attention": "attention",
        "patch": {"class_path": f"{_NN}.EdgePatchEncoder", "init_args": patches},
    }
    for config in ("p1_table2/gcn_te", "p1_table2/mt_gcn_te"):
        for name, encoder in encoders.items():
            changes = (model(encoder=encoder), scale(edge_attr="channel"))
            yield Question(f"encoder/{config}/{name}", config, changes=changes)
        for decay in (0.001, 0.01):
            key = f"encoder/{config}/wd{decay}"
            yield Question(key, config, changes=(optimizer(weight_decay=decay),))
    for trials, epochs in ((56, 50), (140, 20), (280, 10)):  # the same number of frames in all
        for name in ("gcn_t", "gcn_te", "mt_gcn_te"):
            config = f"p1_table2/{name}"
            key = f"trials/{config}/{trials}"
            yield Question(key, config, trials=trials, epochs=epochs)
    for name in ("gcn_t", "mt_gcn_te", "mt_gcn_ta", "gcn_te"):
        config = f"p1_table2/{name}"
        yield Question(f"shape/{config}", config, _SHAPES, (multiclass,), "shape")
    changes = (multiclass, small_fnn)
    yield Question("shape/fnn_small", "p1_table2/gcn_t", _SHAPES, changes, "shape")


@lru_cache(maxsize=1)
def read(root: str, task: Any, tare: str | None) -> StaticDataset:
    r"""Returns all frames."""
    return AllegroUSkin(root, task=task, split=None, tare=tare)


@dataclass
class Frames:
    r"""The frames of a question: those of the phases with touch, at a stride, after the split."""

    root: str
    stride: int
    parts: dict[str, StaticDataset] = field(default_factory=dict)

    def split(self, question: Question, seed: int) -> None:
        r"""Draws the parts."""
        task: Any = question.task
        dataset = read(self.root, task, question.tare)
        some = AllegroUSkin(
            self.root, task=task, split=None, phases=_TOUCH, stride=self.stride
        ).indices()
        kept = torch.zeros(len(dataset), dtype=torch.bool)
        kept[torch.as_tensor(list(some))] = True
        split = question.protocol.split(dataset, seed)._asdict()
        if question.trials is not None:
            split["train"] = some_trials(dataset, split["train"], question.trials, seed)
        self.parts = {name: dataset[index[kept[index]]] for name, index in split.items()}


def some_trials(dataset: StaticDataset, index: Tensor, trials: int, seed: int) -> Tensor:
    r"""Returns the frames of as many trials of each object."""
    trial, group = dataset.column("trial"), dataset.column("group")
    assert trial is not None
    assert group is not None
    generator, kept = torch.Generator().manual_seed(seed), []
    groups = group[index].unique().tolist()
    for number in groups:
        mine = trial[index[group[index] == number]].unique()
        kept.append(mine[torch.randperm(len(mine), generator=generator)[: trials // len(groups)]])
    return index[torch.isin(trial[index], torch.cat(kept))]


def answer(question: Question, root: str, seed: int, stride: int) -> dict[str, Any]:
    r"""Trains once and looks at the part."""
    config = copy.deepcopy(load_config(question.config))
    for change in question.changes:
        change(config)
    frames = Frames(root, stride)
    frames.split(question, seed)
    data = TactileDataModule(
        frames.parts["train"],
        frames.parts[question.part],
        split="frame",
        val=0.0,
        transform=build_object(config["data"]["transform"]),
        batch_size=config["data"]["batch_size"],
    )
    data.setup()
    warm_up("cpu")
    clock = Clock()
    settings = {"accelerator": "cpu"}
    classifier = fit_classifier(config["model"], data, seed, settings, question.epochs, clock)
    said = collect_predictions(classifier, data.test_dataloader(), torch.device("cpu"))
    return {
        "key": f"{question.key}/{seed}",
        "metrics": classification_metrics(said.probability, said.y, classifier.task),
        "train": len(frames.parts["train"]),
        "looked_at": len(frames.parts[question.part]),
        "seconds": clock.seconds,
    }


OPTIONS = {
    "--paper8": (..., "folder of simulated trials, 8 objects"),
    "--shapes": (None, "folder of simulated trials of drawn shapes"),
    "--out": (..., "a line of JSON for each training; goes on"),
    "--only": ("", "beginning of the names of questions"),
    "--seeds": (3, "splits and trainings of each"),
    "--stride": (50, "use every n-th frame"),
}


def main(argv: list[str] | None = None) -> int:
    arguments = parse(__doc__, OPTIONS, argv)
    torch.set_num_threads(1)
    out = Path(arguments.out)
    lines = out.read_text("utf-8").splitlines() if out.is_file() else []
    known = {item["key"]: item for item in map(json.loads, lines)}
    for question in questions():
        root = arguments.shapes if question.task == "shape" else arguments.paper8
        if root is None or not question.key.startswith(arguments.only):
            continue
        for seed in range(arguments.seeds):
            key = f"{question.key}/{seed}"
            if key not in known:
                known[key] = answer(question, root, seed, arguments.stride)
                with out.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(known[key]) + "\n")
        mine = [known[f"{question.key}/{s}"]["metrics"] for s in range(arguments.seeds)]
        right = [100 * metrics["accuracy"] for metrics in mine]
        spread = statistics.stdev(right) if len(right) > 1 else 0.0
        print(f"{question.key}: {statistics.mean(right):.1f} ± {spread:.1f}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
