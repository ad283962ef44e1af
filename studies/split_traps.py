r"""What a random forest makes of the traps of real data sets.

::

    PYTHONPATH=benchmarks python studies/split_traps.py icub FOLDER
    PYTHONPATH=benchmarks python studies/split_traps.py eflesh FOLDER
    PYTHONPATH=benchmarks python studies/split_traps.py mat FOLDER

* ``icub``, the first and the last frame of a trial: the object, from the encoders alone, from the
  taxels alone, and from both. Five folds by trial, stratified by object.
* ``eflesh``, the first frame of a sequence, and mean and deviation of each channel less the first
  ten frames: slip or hold. Five folds by trial, stratified, and the given parts.
* ``mat``, every eighth frame of experiment I: posture and side, in five folds by frame, by file
  (the side only, as a posture of a person is one file) and by person (thirteen).

The forests have 300 trees. Accuracy, mean and deviation over three seeds (mat: one seed).
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from shared import parse, print_setting
from sklearn.ensemble import RandomForestClassifier
from torch import Tensor

from torch_geometric_tactile.data import Protocol, StaticDataset, Trials
from torch_geometric_tactile.datasets import EFleshSlip, ICubGrasp, PressureMat

_BY_TRIAL = Protocol("trial", folds=5, stratify="y")


def report(
    what: str,
    dataset: StaticDataset,
    inputs: Tensor,
    protocol: Protocol,
    *,
    kept: Tensor | None = None,
    seeds: int = 3,
) -> None:
    r"""Prints the accuracy of a forest that sees inputs :math:`(S, F)`, on the samples that are
    kept :math:`(S,)`.
    """
    y = dataset.column("y").numpy()
    chosen = np.ones(len(y), bool) if kept is None else kept.numpy()
    scores = []
    for seed in range(seeds):
        right: list[bool] = []
        for fold in range(protocol.num_folds(dataset)):
            split = protocol.split(dataset, seed, fold)
            train, test = (p.numpy()[chosen[p]] for p in (split.train, split.test))
            forest = RandomForestClassifier(300, random_state=seed, n_jobs=-1)
            forest.fit(inputs[train].numpy(), y[train])
            right.extend(forest.predict(inputs[test].numpy()) == y[test])
        scores.append(100 * np.mean(right))
    print(f"{what}, {protocol.describe()}: {np.mean(scores):.1f} +- {np.std(scores):.1f} %")


def icub(folder: Path) -> None:
    dataset = ICubGrasp(folder)
    joint, taxels, trial = (dataset.column(key) for key in ("joint", "x", "trial"))
    inputs = {"encoders": joint, "taxels": taxels.flatten(1)}
    inputs["both"] = torch.cat([inputs["taxels"], joint], dim=1)
    edge, change = torch.ones(1, dtype=torch.bool), trial[1:] != trial[:-1]
    ends = {"first": torch.cat([edge, change]), "last": torch.cat([change, edge])}
    for end, kept in ends.items():
        for name, values in inputs.items():
            report(f"{end} frame, {name}", dataset, values, _BY_TRIAL, kept=kept)


def eflesh(folder: Path) -> None:
    trials = Trials(EFleshSlip(folder))
    x = trials.dataset.column("x").view(len(trials), -1, 30)
    moved = x - x[:, :10].mean(dim=1, keepdim=True)
    inputs = {
        "first frame": x[:, 0],
        "mean and deviation": torch.cat([moved.mean(dim=1), moved.std(dim=1)], dim=1),
    }
    for name, values in inputs.items():
        for protocol in (_BY_TRIAL, Protocol("given")):
            report(name, trials, values, protocol)


def mat(folder: Path) -> None:
    protocols: Sequence[Protocol]
    for target in ("posture", "side"):
        dataset = PressureMat(folder, target=target)[::8]
        protocols = [Protocol("frame", folds=5), Protocol("group", leave_one_out=True)]
        if target == "side":
            protocols.insert(1, Protocol("trial", folds=5))
        for protocol in protocols:
            report(target, dataset, dataset.column("x").flatten(1), protocol, seeds=1)


SETS = {"icub": icub, "eflesh": eflesh, "mat": mat}


def main() -> None:
    r"""Prints the table of a data set."""
    options = parse(
        __doc__,
        {"set": (..., "which data set", list(SETS)), "root": (Path, "its folder")},
    )
    print_setting("sklearn", "torch")
    SETS[options.set](options.root)


if __name__ == "__main__":
    main()
