"""How the settings of GCN-DF were chosen: by left-out objects inside the training set.

Every candidate differs from the shipped configuration `grasp_gcn_df` in what its name says. It is
trained and judged on folds of the training objects of the BioTac SP stability set; the test set is
never opened. As in the official test, the readings of the objects left out count as new sessions,
which are scaled by their own mean and deviation.
"""

import argparse
import copy
import platform

import numpy as np
import torch
import torch_geometric
from joblib import Parallel, delayed
from tabulate import tabulate
from torch_geometric.transforms import BaseTransform, Compose
from tqdm import tqdm

from torch_geometric_tactile.baselines import GraspSVM
from torch_geometric_tactile.data import splits
from torch_geometric_tactile.datasets import BioTacSP
from torch_geometric_tactile.training.config import load_config
from torch_geometric_tactile.training.evaluation import data_module, judge, train_classifier
from torch_geometric_tactile.transforms import KNNGraph, SessionZScore

MODEL = ("model", "model", "init_args")
OPTIMIZER = ("model", "optimizer", "init_args")
CANDIDATES = {
    "shipped": {},
    "k = 1": {"k": 1},
    "k = 3": {"k": 3},
    "k = 4": {"k": 4},
    "k = 8": {"k": 8},
    "hidden 32": {(*MODEL, "hidden_channels"): 32},
    "hidden 128": {(*MODEL, "hidden_channels"): 128},
    "hidden 256": {(*MODEL, "hidden_channels"): 256},
    "2 layers": {(*MODEL, "num_layers"): 2},
    "dropout 0.3": {(*MODEL, "dropout"): 0.3},
    "dropout 0.5": {(*MODEL, "dropout"): 0.5},
    "weight decay 0": {(*OPTIMIZER, "weight_decay"): 0.0},
    "weight decay 0.003": {(*OPTIMIZER, "weight_decay"): 0.003},
    "weight decay 0.01": {(*OPTIMIZER, "weight_decay"): 0.01},
    "rate 0.002": {(*OPTIMIZER, "lr"): 0.002},
    "rate 0.01": {(*OPTIMIZER, "lr"): 0.01},
    "batch 128": {("data", "batch_size"): 128},
    "batch 64": {("data", "batch_size"): 64},
    "30 epochs": {"epochs": 30},
    "60 epochs": {"epochs": 60},
    "paper: Adam 0.001, batch 32, 100 epochs, constant rate": {
        "epochs": 100,
        (*OPTIMIZER, "lr"): 0.001,
        (*OPTIMIZER, "weight_decay"): 0.0,
        ("data", "batch_size"): 32,
        ("model", "lr_scheduler"): None,
    },
    "GCN-FF": {(*MODEL, "fusion"): "feature"},
    "SVM": None,
}


class NewSessions(BaseTransform):
    supports_static = True

    def forward(self, data):
        data.session = data.session + 1000
        return data


def accuracy(name, seed, fold, folds, root):
    torch.set_num_threads(1)
    changes = dict(CANDIDATES[name] or {})
    dataset = BioTacSP(root, "train")
    dataset.transform = KNNGraph(changes.pop("k", 2))
    part = splits.k_fold(dataset, folds, "group", seed)[fold]
    train, test = dataset[part.train], dataset[part.test]
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
    scheduler = config["model"]["lr_scheduler"]
    if scheduler is not None:
        scheduler["init_args"]["T_max"] = epochs
    data = data_module(config, train, test, "session")
    return judge(train_classifier(config, data, seed, epochs), data).metrics()["accuracy"]


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    parser.add_argument("--root", default=None, help="root of BioTacSP; its default if left out")
    parser.add_argument("--seeds", type=int, default=3, help="random partitions into folds")
    parser.add_argument("--folds", type=int, default=5)
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    parser.add_argument("--only", nargs="*", choices=list(CANDIDATES), default=list(CANDIDATES))
    arguments = parser.parse_args()
    BioTacSP(arguments.root)  # download and process before the processes start

    jobs = [
        (name, seed, fold)
        for name in arguments.only
        for seed in range(arguments.seeds)
        for fold in range(arguments.folds)
    ]
    results = Parallel(arguments.jobs, return_as="generator")(
        delayed(accuracy)(*job, arguments.folds, arguments.root) for job in jobs
    )
    values = list(tqdm(results, total=len(jobs)))
    rows = []
    for name in arguments.only:
        own = np.array([v for job, v in zip(jobs, values, strict=True) if job[0] == name])
        rows.append([name, f"{own.mean():.4f}", f"{own.std(ddof=1) / len(own) ** 0.5:.4f}"])
    print(tabulate(rows, ["candidate", "accuracy", "standard error"], tablefmt="github"))
    print(
        f"\nBTS3 training set, {arguments.folds} folds by object x seeds 0 to "
        f"{arguments.seeds - 1}, scaled by session; {platform.machine()}, torch "
        f"{torch.__version__}, torch-geometric {torch_geometric.__version__}"
    )


if __name__ == "__main__":
    main()
