r"""Trains the predictors that the package ships, and scores each on objects or persons that its
training part does not have. Settings are chosen on validation parts of the training part only.

The same machine and versions give the same files, with one thread and the seed 0.

Examples:
    tactile simulate --out hand --objects shapes --num-objects 80 --trials 4 --spread wide --seconds 5 --preset ci --seed 0
    OMP_NUM_THREADS=1 PYTHONPATH=benchmarks python studies/pretrained.py --data shared/data --hand hand
"""

import json
import statistics
import sys
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from shared import describe_machine, parse, write_json
from sklearn.ensemble import RandomForestClassifier
from torch import Tensor
from torch.nn import Module
from torch.nn.functional import cross_entropy
from torch.optim import AdamW
from torch.optim.lr_scheduler import CosineAnnealingLR, OneCycleLR
from torch_geometric.transforms import Compose

from torch_geometric_tactile import Predictor
from torch_geometric_tactile.data import (
    ContactRule,
    FrameInfo,
    Protocol,
    Split,
    StaticData,
    StaticDataset,
    apply_transform,
)
from torch_geometric_tactile.datasets import AllegroUSkin, BioTacSP, PressureMat
from torch_geometric_tactile.nn import PosedTaxelNet, SmallCNN, TaxelNet
from torch_geometric_tactile.predictor import MeasuredScore
from torch_geometric_tactile.transforms import (
    CommonMode,
    NormalizeRMS,
    SelectChannels,
    SquareRoot,
    ZScore,
    fit_transform,
)

_SEED = 0
_INNER = Protocol("group", folds=4)  # of the training part, to choose a setting
_MAT_STRIDE = 16  # frames of one file are nearly equal
_HAND_STRIDE = 25  # half a second
_TOUCH = ("squeeze", "lift", "hold")


class Setting(NamedTuple):
    """A model, its transforms and its training."""

    model: Callable[[StaticDataset], Module]
    transforms: Callable[[], list[Any]]
    lr: float = 0.004
    weight_decay: float = 0.03
    batch_size: int = 64
    epochs: int = 15
    label_smoothing: float = 0.1
    is_one_cycle: bool = True


class Task(NamedTuple):
    """A predictor to train: its samples, its candidate settings and what is held out."""

    samples: StaticDataset
    settings: dict[str, Setting]
    splits: list[Split]
    protocol: str
    trained_on: str
    is_final_on_all: bool = True  # otherwise the model in the file is that of the only split
    contact: ContactRule | None = None
    is_tared: bool = False


def biotac_sp_slip(options: Any) -> Task:
    """Slip or stable, from one reading of three fingertips: the settings of grasp_common_mode."""
    BioTacSP.import_raw(options.data, options.work / "bts3")
    samples = BioTacSP(options.work / "bts3", split=None)
    setting = Setting(
        lambda part: TaxelNet(part.layout, 2, in_channels=2, depth=1, taxel_dropout=0.0),
        lambda: [CommonMode(), SelectChannels([1, 2]), ZScore(per="channel")],
        lr=0.003, weight_decay=0.01, batch_size=256, epochs=10, label_smoothing=0.0,
        is_one_cycle=False,
    )  # fmt: skip
    train, _, test = Protocol("given").split(samples)
    return Task(
        samples,
        {"grasp_common_mode": setting},
        [Split(train, test[:0], test)],
        f"the published test part: {len(test):,} grasps of 10 other objects in other sessions",
        f"the published training part: {len(train):,} grasps of 41 objects",
        is_final_on_all=False,
    )


def pressure_mat_side(options: Any) -> Task:
    """The side on which a person lies, from one frame of a mat of 64 x 32 cells."""
    root = options.work / "mat"
    (root / "raw").mkdir(parents=True, exist_ok=True)
    link = root / "raw" / "pmd-1.0.0.zip"
    if not link.exists():
        link.symlink_to((options.data / "pressure_mat" / link.name).resolve())
    frames = PressureMat(root, target="side")
    samples = frames[(frames.column("step") % _MAT_STRIDE == 0).nonzero().view(-1)]
    settings = {
        "square roots": Setting(_small_cnn, lambda: [SquareRoot(), ZScore(per="channel")]),
        "square roots, shape": Setting(_small_cnn, lambda: [SquareRoot(), NormalizeRMS()]),
    }
    return Task(
        samples,
        settings,
        _five_folds(samples, Protocol("group", folds=5)),
        "5 folds by person",
        f"all {len(samples):,} frames of 13 persons",
    )


def _five_folds(samples: StaticDataset, protocol: Protocol) -> list[Split]:
    return [protocol.split(samples, fold=i, seed=_SEED) for i in range(5)]


def _small_cnn(part: StaticDataset) -> Module:
    return SmallCNN(part.layout, 3, in_channels=1, widths=(8, 16, 16), hidden_channels=32)


def simulated_hand_shape(options: Any) -> Task:
    """Box, cylinder, ellipsoid or sphere in a simulated hand, from one frame of 384 taxels."""
    samples = AllegroUSkin(
        options.hand, "shape", None, phases=_TOUCH, stride=_HAND_STRIDE, tare="hover"
    )
    settings = {
        f"{strongest} taxels": Setting(
            _posed(strongest, samples.num_classes), list, batch_size=32, epochs=60
        )
        for strongest in (24, 48)
    }
    return Task(
        samples,
        settings,
        _five_folds(samples, Protocol("group", folds=5, stratify="y")),
        "5 folds by object, simulated",
        f"all {len(samples):,} frames of 320 simulated trials with 80 objects",
        contact=ContactRule(),
        is_tared=True,
    )


def _posed(strongest: int, num_classes: int) -> Callable[[StaticDataset], Module]:
    return lambda part: PosedTaxelNet(
        part.layout, num_classes, posed=False, num_strongest=strongest
    )


def stored(samples: StaticDataset) -> StaticData:
    """The samples after the transforms of their data set."""
    return samples.batch(range(len(samples)))


def train(setting: Setting, samples: StaticDataset, seed: int) -> tuple[Module, Compose]:
    """The trained model and the fitted transform."""
    transform = Compose(setting.transforms())
    data = fit_transform(transform, stored(samples)) if transform.transforms else stored(samples)
    torch.manual_seed(seed)
    model = setting.model(samples).train()
    optimizer = AdamW(model.parameters(), setting.lr, weight_decay=setting.weight_decay)
    steps = -(-len(data.y) // setting.batch_size)
    schedule: Any = CosineAnnealingLR(optimizer, setting.epochs * steps)
    if setting.is_one_cycle:
        schedule = OneCycleLR(optimizer, setting.lr, setting.epochs * steps, cycle_momentum=False)
    for _ in range(setting.epochs):
        for batch in torch.randperm(len(data.y)).split(setting.batch_size):
            if len(batch) > 1:  # batch normalisation
                optimizer.zero_grad()
                logits = model(data.x[batch])
                loss = cross_entropy(
                    logits, data.y[batch], label_smoothing=setting.label_smoothing
                )
                loss.backward()
                optimizer.step()
            schedule.step()
    return model.eval(), transform


def accuracy(model: Module, transform: Compose, samples: StaticDataset) -> float:
    data = stored(samples)
    if transform.transforms:
        data = apply_transform(transform, data)
    with torch.inference_mode():
        answer = torch.cat([model(x).argmax(dim=1) for x in data.x.split(256)])
    return float((answer == data.y).double().mean())


def choose(settings: dict[str, Setting], samples: StaticDataset) -> str:
    """The name of the setting with the best accuracy on a validation part of other groups."""
    if len(settings) == 1:
        return next(iter(settings))
    fit, _, val = _INNER.split(samples, fold=0, seed=_SEED)
    scores = {
        name: accuracy(*train(setting, samples[fit], _SEED), samples[val])
        for name, setting in settings.items()
    }
    return max(scores, key=scores.__getitem__)  # the first of equal ones


def baselines(samples: StaticDataset, fit: Tensor, test: Tensor) -> dict[str, float]:
    """Accuracies of the most frequent class, and of a forest on the readings as they are."""
    data = stored(samples)
    x, y = data.x.flatten(1).numpy(), data.y.numpy()
    forest = RandomForestClassifier(100, random_state=_SEED).fit(x[fit], y[fit])
    frequent = np.bincount(y[fit]).argmax()
    return {
        "most frequent class": float(np.mean(y[test] == frequent)),
        "forest": float(forest.score(x[test], y[test])),
    }


def summary(values: Sequence[float]) -> dict[str, Any]:
    sd = statistics.stdev(values) if len(values) > 1 else None
    return {"mean": statistics.mean(values), "sd": sd, "each": list(values)}


def make(name: str, task: Task, seeds: Sequence[int], folder: Path) -> dict[str, Any]:
    """Scores the task, writes the predictor, and returns the numbers of its card."""
    samples = task.samples
    # No model here reads edges, which would be half of the file of a large layout.
    samples.layout = replace(samples.layout, adjacency={})
    if len(task.splits) > 1:
        seeds = [_SEED]  # the folds show the spread
    scores: dict[int, list[float]] = {seed: [] for seed in seeds}
    plain: dict[str, list[float]] = {}
    chosen = []
    for split in task.splits:
        fit, test = samples[split.train], samples[split.test]
        chosen.append(choose(task.settings, fit))
        for seed in seeds:
            trained = train(task.settings[chosen[-1]], fit, seed)
            scores[seed].append(accuracy(*trained, test))
            if seed == _SEED:
                first = trained
        for key, value in baselines(samples, split.train, split.test).items():
            plain.setdefault(key, []).append(value)
    final = choose(task.settings, samples) if task.is_final_on_all else chosen[-1]
    if task.is_final_on_all:
        first = train(task.settings[final], samples, _SEED)
    model, transform = first
    predictor = Predictor(
        model,
        samples.layout,
        transform if transform.transforms else None,
        samples.class_names,
        num_channels=samples.num_features,
        info=FrameInfo(unit="count"),
        contact=task.contact,
    )
    if task.is_tared:  # without the rests of the trials that it was trained on
        predictor = predictor.with_tare()
    measured = summary(scores[_SEED])
    predictor.score = MeasuredScore(
        type(model).__name__, "accuracy", measured["mean"], measured["sd"], len(task.splits),
        task.protocol, task.trained_on,
    )  # fmt: skip
    path = folder / f"{name}.predictor"
    predictor.save(path)
    return {
        "score": str(predictor.score),
        "bytes": path.stat().st_size,
        "weights": sum(weight.numel() for weight in model.parameters()),
        "setting": final,
        "chosen": dict(Counter(chosen)),
        "accuracy": measured,
        "over_seeds": summary([statistics.mean(scores[seed]) for seed in seeds]),
        "training_samples": len(samples if task.is_final_on_all else fit),
        "baselines": {key: summary(values) for key, values in plain.items()},
        "test_samples": [len(split.test) for split in task.splits],
    }


TASKS = {
    "biotac_sp_slip": biotac_sp_slip,
    "pressure_mat_side": pressure_mat_side,
    "simulated_hand_shape": simulated_hand_shape,
}


def main() -> None:
    options = parse(
        __doc__,
        {
            "--data": (Path("shared/data"), "folder with biotacsp and pressure_mat"),
            "--hand": (Path("hand"), "folder of the simulated trials"),
            "--work": (Path("pretrained"), "folder of processed files"),
            "--out": (Path("torch_geometric_tactile/predictor/pretrained"), "of the predictors"),
            "--numbers": (Path("docs/results/pretrained.json"), "file of the numbers"),
            "--seeds": (3, "trainings on a single split; the file has that of seed 0"),
            "--only": (list(TASKS), "names"),
        },
    )
    torch.set_num_threads(1)
    numbers = options.numbers
    cards = json.loads(numbers.read_text(encoding="utf-8")) if numbers.is_file() else {}
    cards["machine"] = describe_machine()
    for name in options.only:
        start = time.perf_counter()
        card = make(name, TASKS[name](options), range(options.seeds), options.out)
        cards[name] = card
        sys.stdout.write(f"{name}: {card} in {time.perf_counter() - start:.0f} s\n")
    write_json(numbers, cards)


if __name__ == "__main__":
    main()
