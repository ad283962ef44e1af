"""How the settings of GCN-DF were chosen: inside the training set, the test set is never opened.

Every candidate differs from the shipped configuration `grasp_gcn_df` in what its name says. It is
judged twice on the training part of the BioTac SP stability set:

* objects: folds by object. The objects left out were recorded in the sessions of the others.
* objects and session: the same folds, but trained without one of the three recording sessions and
  judged on the objects left out in that session, as the official test asks for objects that are
  unseen and a session that is new.

In both, the readings held out count as new sessions, scaled by their own mean and deviation.
"""

import copy
import platform

import numpy as np
import torch
import torch_geometric
from joblib import Parallel, delayed
from shared import parse
from tabulate import tabulate
from torch_geometric.transforms import BaseTransform, Compose
from tqdm import tqdm

from torch_geometric_tactile.baselines import GraspSVM
from torch_geometric_tactile.data import splits
from torch_geometric_tactile.datasets import BioTacSP
from torch_geometric_tactile.experiments._networks import fit_classifier
from torch_geometric_tactile.training import TactileDataModule, classification_metrics
from torch_geometric_tactile.training._predictions import collect_predictions
from torch_geometric_tactile.training._config import load_config
from torch_geometric_tactile.transforms import KNNGraph, SessionZScore

MODEL = ("model", "model", "init_args")
OPTIMIZER = ("model", "optimizer", "init_args")
CANDIDATES = {
    "shipped": {},
    "no edges": {"k": 0},
    "k = 1": {"k": 1},
    "k = 3": {"k": 3},
    "k = 4": {"k": 4},
    "k = 8": {"k": 8},
    "hidden 16": {(*MODEL, "hidden_channels"): 16},
    "hidden 32": {(*MODEL, "hidden_channels"): 32},
    "hidden 128": {(*MODEL, "hidden_channels"): 128},
    "2 layers": {(*MODEL, "num_layers"): 2},
    "no dropout": {(*MODEL, "dropout"): 0.0},
    "dropout 0.3": {(*MODEL, "dropout"): 0.3},
    "dropout 0.5": {(*MODEL, "dropout"): 0.5},
    "dropout 0.2": {(*MODEL, "dropout"): 0.2},
    "weight decay 0": {(*OPTIMIZER, "weight_decay"): 0.0},
    "weight decay 0.01": {(*OPTIMIZER, "weight_decay"): 0.01},
    "weight decay 0.03": {(*OPTIMIZER, "weight_decay"): 0.03},
    "rate 0.005": {(*OPTIMIZER, "lr"): 0.005},
    "rate 0.02": {(*OPTIMIZER, "lr"): 0.02},
    "batch 64": {("data", "batch_size"): 64},
    "15 epochs": {"epochs": 15},
    "15 epochs, rate 0.005": {"epochs": 15, (*OPTIMIZER, "lr"): 0.005},
    "30 epochs": {"epochs": 30},
    "60 epochs": {"epochs": 60},
    "paper: Adam 0.001, batch 32, 100 epochs, constant rate": {
        "epochs": 100,
        (*OPTIMIZER, "lr"): 0.001,
        (*OPTIMIZER, "weight_decay"): 0.0,
        (*MODEL, "dropout"): 0.0,
        ("data", "batch_size"): 32,
        ("model", "lr_scheduler"): None,
    },
    "GCN-FF": {(*MODEL, "fusion"): "feature"},
    "SVM": None,
}


class NoEdges(BaseTransform):
    supports_static = True

    def forward(self, data):
        data.edge_index = torch.empty(2, 0, dtype=torch.long)
        return data


class NewSessions(BaseTransform):
    supports_static = True

    def forward(self, data):
        data.session = data.session + 1000
        return data


def accuracy(name, seed, fold, session, folds, root):
    torch.set_num_threads(1)
    changes = dict(CANDIDATES[name] or {})
    dataset = BioTacSP(root, "train")
    k = changes.pop("k", 2)
    dataset.transform = KNNGraph(k) if k else NoEdges()
    part = splits.k_fold(dataset, folds, "group", seed)[fold]
    train, test = dataset[part.train], dataset[part.test]
    if session is not None:
        train = train[train.column("session") != session]
        test = test[test.column("session") == session]
    test.transform = Compose([dataset.transform, NewSessions()])
    if CANDIDATES[name] is None:
        held_out = NewSessions()(test.data)
        transform = SessionZScore().fit(train).adapt(held_out)
        seen, held_out = transform(train.data), transform(held_out)
        return GraspSVM().fit(seen.x, seen.y).score(held_out.x, held_out.y)
    config = copy.deepcopy(load_config("grasp_gcn_df"))
    epochs = changes.pop("epochs", config["trainer"]["max_epochs"])
    for path, value in changes.items():
        section = config
        for key in path[:-1]:
            section = section[key]
        section[path[-1]] = value
    data = TactileDataModule(
        train,
        test,
        split="frame",
        val=0.0,
        transform=SessionZScore(),
        batch_size=config["data"]["batch_size"],
    )
    classifier = fit_classifier(config["model"], data, seed, {"accelerator": "cpu"}, epochs)
    said = collect_predictions(classifier, data.test_dataloader())
    return classification_metrics(said.probability, said.y)["accuracy"]


def main():
    arguments = parse(
        __doc__,
        {
            "--root": (None, "root of BioTacSP; its default if left out"),
            "--seeds": (3, "random partitions into folds"),
            "--folds": (5, "of each partition"),
            "--jobs": (2, "processes"),
            "--only": (list(CANDIDATES), "candidates", list(CANDIDATES)),
        },
    )
    BioTacSP(arguments.root)  # download and process before the processes start

    jobs = [
        (name, seed, fold, session)
        for name in arguments.only
        for seed in range(arguments.seeds)
        for fold in range(arguments.folds)
        for session in (None, 0, 1, 2)
    ]
    results = Parallel(arguments.jobs, return_as="generator")(
        delayed(accuracy)(*job, arguments.folds, arguments.root) for job in jobs
    )
    values = dict(zip(jobs, tqdm(results, total=len(jobs)), strict=True))
    rows = []
    for name in arguments.only:
        row = [name]
        for new_session in (False, True):
            own = [
                value
                for job, value in values.items()
                if job[0] == name and (job[3] is not None) == new_session
            ]
            row.append(f"{np.mean(own):.4f} ± {np.std(own, ddof=1) / len(own) ** 0.5:.4f}")
        rows.append(row)
    print(tabulate(rows, ["candidate", "objects", "objects and session"], tablefmt="github"))
    print(
        f"\nAccuracy ± standard error. BTS3 training set, {arguments.folds} folds by object, "
        f"seeds 0 to {arguments.seeds - 1}; {platform.machine()}, torch {torch.__version__}, "
        f"torch-geometric {torch_geometric.__version__}"
    )


if __name__ == "__main__":
    main()
