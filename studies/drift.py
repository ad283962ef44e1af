r"""What is left of a model where the session, the run, the mattress or the whole mat is another.

::

    PYTHONPATH=benchmarks python studies/drift.py --data DIR --out drift.json

DIR has a folder for each data set: BioTacSP, PressureMat, EFleshSlip.

* **BTS3**: trained on the three training sessions. Known: new objects in the same sessions (five
  folds). Other: the official test, new objects in three other sessions.
* **mattress**: experiment II, supine, left or right, four folds by person. Known: the mattress is
  in the training part. Other: it is not.
* **mat**: trained on experiment I (every 32nd frame), tested on experiment II, which is another mat
  of other cells with other persons. Only descriptors are the same numbers on both.
* **run**: eFlesh, whole sequences. Known: five folds by sequence. Other: the given parts.

A preparation is fitted on the training part. ``session`` scales each session by its own unlabelled
readings, test sessions included. Accuracy in percent: forests mean over three seeds.
"""

import json
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from shared import describe_machine, parse
from sklearn.ensemble import RandomForestClassifier
from sklearn.pipeline import Pipeline
from torch_geometric.transforms import BaseTransform, Compose

from torch_geometric_tactile import transforms as T
from torch_geometric_tactile._files import atomic_path
from torch_geometric_tactile.baselines import (
    DescriptorFeatures,
    descriptor_forest,
    flat_forest,
    rbf_svm,
)
from torch_geometric_tactile.data import Protocol, StaticDataset, Trials
from torch_geometric_tactile.datasets import BioTacSP, EFleshSlip, PressureMat
from torch_geometric_tactile.sensors import TaxelLayout
from torch_geometric_tactile.transforms.fitting import fit_transform

SEEDS = 3
Part = tuple[StaticDataset, StaticDataset]
SCALE = {"scale_per": "channel", "with_mean": False}  # rest stays zero, for descriptors
PREPARATIONS: dict[str, Callable[[], BaseTransform]] = {
    "raw": T.ZScore,
    "common mode": lambda: Compose([T.CommonMode(), T.ZScore()]),
    "session": T.SessionZScore,
    "common mode, session": lambda: Compose([T.CommonMode(), T.SessionZScore()]),
    "square root": lambda: Compose([T.SquareRoot(), T.ZScore(**SCALE)]),
    "own size": lambda: Compose([T.NormalizeRMS(), T.ZScore(**SCALE)]),
    "counts": lambda: T.ZScore(**SCALE),
}


def models(layout: TaxelLayout) -> dict[str, tuple[Pipeline, int]]:
    r"""The models with their numbers of seeds."""
    return {
        "forest": (flat_forest(), SEEDS),
        "svm": (rbf_svm(C=10.0, most_samples=10_000), 1),
        "descriptors_forest": (descriptor_forest(layout), SEEDS),
    }


def accuracy(parts: Iterator[Part], prepare: Callable[[], BaseTransform], name: str) -> float:
    r"""Returns the accuracy over all test samples of some pairs of training and test part."""
    right: list[np.ndarray] = []
    for train, test in parts:
        transform = prepare()
        seen = fit_transform(transform, train)
        other = fit_transform(transform, test, adapt=True)
        model, seeds = models(train.layout)[name]
        for seed in range(seeds):
            if seeds > 1:
                model.steps[-1][1].set_params(random_state=seed)
            model.fit(seen.x.numpy(), seen.y.numpy())
            right.append(model.predict(other.x.numpy()) == other.y.numpy())
    return 100 * float(np.concatenate(right).mean())


def folds(dataset: StaticDataset, protocol: Protocol) -> Iterator[Part]:
    for fold in range(protocol.num_folds(dataset)):
        split = protocol.split(dataset, 0, fold)
        yield dataset[split.train], dataset[split.test]


def compare(
    kinds: dict[str, tuple[StaticDataset, Protocol]], preparations: str, names: str
) -> dict[str, dict[str, float]]:
    found: dict[str, dict[str, float]] = {}
    for prepared in preparations.split("; "):
        for name in names.split(", "):
            row = {
                kind: accuracy(folds(dataset, protocol), PREPARATIONS[prepared], name)
                for kind, (dataset, protocol) in kinds.items()
            }
            found[f"{prepared} | {name}"] = row
            print(f"{prepared:22} {name:20}", {k: f"{v:.1f}" for k, v in row.items()}, flush=True)
    return found


def bts3(data: Path) -> dict[str, dict[str, float]]:
    root = data / "BioTacSP"
    kinds = {
        "known": (BioTacSP(root), Protocol("group", folds=5)),
        "other": (BioTacSP(root, split=None), Protocol("given")),
    }
    preparations = "raw; common mode; session; common mode, session"
    return compare(kinds, preparations, "forest, svm, descriptors_forest")


def mattress(data: Path) -> dict[str, dict[str, float]]:
    dataset = PressureMat(data / "PressureMat", "ii", "side")
    kinds = {
        "known": (dataset, Protocol("group", folds=4)),
        "other": (dataset, Protocol("group", folds=4, unseen="session")),
    }
    preparations = "raw; session; counts; square root; own size"
    return compare(kinds, preparations, "forest, svm, descriptors_forest")


def mat(data: Path) -> dict[str, dict[str, float]]:
    first = PressureMat(data / "PressureMat", target="side")
    first, second = first[::32], PressureMat(data / "PressureMat", "ii", "side")
    found: dict[str, dict[str, float]] = {}
    for prepared in ("counts", "square root", "own size"):
        right: list[np.ndarray] = []
        x = []
        for dataset in (first, second):
            # Each mat is scaled by its own readings, without labels.
            ready = fit_transform(PREPARATIONS[prepared](), dataset)
            if dataset is second:  # whose head is at the other end
                ready.x = ready.x.flip(1)
            x.append((DescriptorFeatures(dataset.layout).fit_transform(ready.x.numpy()), ready.y))
        for seed in range(SEEDS):
            forest = RandomForestClassifier(300, random_state=seed)
            forest.fit(x[0][0], x[0][1].numpy())
            right.append(forest.predict(x[1][0]) == x[1][1].numpy())
        found[f"{prepared} | forest on descriptors"] = {
            "other": 100 * float(np.concatenate(right).mean())
        }
        print(prepared, found[f"{prepared} | forest on descriptors"], flush=True)
    counts = second.column("y").bincount()
    found["the most frequent side"] = {"other": 100 * float(counts.max() / counts.sum())}
    return found


def run(data: Path) -> dict[str, dict[str, float]]:
    found: dict[str, dict[str, float]] = {}
    frames = EFleshSlip(data / "EFleshSlip")
    for prepared in ("raw", "tare"):
        trials = Trials(frames)
        x = trials.dataset.column("x").view(len(trials), -1, 30)
        if prepared == "tare":
            x = x - x[:, :10].mean(dim=1, keepdim=True)
        rows = np.concatenate([x.mean(dim=1).numpy(), x.std(dim=1).numpy()], axis=1)
        y = trials.column("y").numpy()
        row = {}
        for kind, protocol in (
            ("known", Protocol("trial", folds=5, stratify="y")),
            ("other", Protocol("given")),
        ):
            right: list[np.ndarray] = []
            for seed in range(SEEDS):
                for fold in range(protocol.num_folds(trials)):
                    split = protocol.split(trials, seed, fold)
                    forest = RandomForestClassifier(300, random_state=seed)
                    forest.fit(rows[split.train.numpy()], y[split.train.numpy()])
                    test = split.test.numpy()
                    right.append(forest.predict(rows[test]) == y[test])
            row[kind] = 100 * float(np.concatenate(right).mean())
        found[f"{prepared} | forest on mean and deviation"] = row
        print(prepared, row, flush=True)
    return found


STUDIES = {"bts3": bts3, "mattress": mattress, "mat": mat, "run": run}


def main() -> None:
    options = parse(
        __doc__,
        {
            "--data": (Path("data"), "folder with a folder for each data set"),
            "--out": (Path("drift.json"), "file of the numbers"),
            "--only": (",".join(STUDIES), "which studies"),
        },
    )
    print(describe_machine())
    found = json.loads(options.out.read_text()) if options.out.is_file() else {}
    for name in options.only.split(","):
        print(name)
        found[name] = STUDIES[name](options.data)
        with atomic_path(options.out) as temporary:
            temporary.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
