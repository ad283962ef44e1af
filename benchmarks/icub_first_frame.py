r"""What a random forest makes of the first frame of each trial of iCub Grasp.

::

    python benchmarks/icub_first_frame.py FOLDER

Five folds by trial, stratified by object, three seeds; one sample a trial. The accuracy is that of
a random forest of 300 trees on the encoders alone, on the taxels alone, and on both.
"""

import numpy as np
import torch
from shared import parse
from sklearn.ensemble import RandomForestClassifier

from torch_geometric_tactile.data import Protocol
from torch_geometric_tactile.datasets import ICubGrasp

FOLDS, SEEDS = 5, 3


def accuracy(dataset: ICubGrasp, inputs: torch.Tensor, frame: str) -> tuple[float, float]:
    r"""Returns mean and standard deviation over the seeds, of what the forest sees of each frame
    :math:`(S, F)`, for the :obj:`"first"` or the :obj:`"last"` of each trial.
    """
    trial = dataset.column("trial")
    edge = torch.ones(1, dtype=torch.bool)
    change = trial[1:] != trial[:-1]
    kept = torch.cat([edge, change] if frame == "first" else [change, edge])
    y = dataset.column("y").numpy()
    scores = []
    for seed in range(SEEDS):
        right = []
        for fold in range(FOLDS):
            parts = Protocol("trial", folds=FOLDS, stratify="y").split(dataset, seed, fold)
            train, test = (part[kept[part]].numpy() for part in (parts.train, parts.test))
            forest = RandomForestClassifier(300, random_state=seed)
            forest.fit(inputs[train].numpy(), y[train])
            right.extend(forest.predict(inputs[test].numpy()) == y[test])
        scores.append(np.mean(right))
    return float(np.mean(scores)), float(np.std(scores))


def main() -> None:
    r"""Prints the table."""
    dataset = ICubGrasp(parse(__doc__, {"root": (..., "folder of the data set")}).root)
    joint, taxels = dataset.column("joint"), dataset.column("x").flatten(1)
    inputs = {"encoders": joint, "taxels": taxels, "both": torch.cat([taxels, joint], dim=1)}
    print(f"{len(dataset.column('trial').unique())} trials, {dataset.num_classes} classes")
    for frame in ("first", "last"):
        for name, values in inputs.items():
            mean, sd = accuracy(dataset, values, frame)
            print(f"{frame} frame, {name:8s}  {100 * mean:.1f} +- {100 * sd:.1f} %")


if __name__ == "__main__":
    main()
