"""Small whole files of models, trainings and tables, as ``bases.py``."""

import math
from pathlib import Path

import torch
import yaml
from fuzz import readers

from torch_geometric_tactile.data import ContactRule, StaticData, StaticDataset
from torch_geometric_tactile.sensors import grid


class SmallDataset(StaticDataset):
    """Sixteen samples in eight trials on four taxels."""

    def __init__(self) -> None:
        self.layout = grid(2, 2, pitch=0.01)
        super().__init__(None)

    def read(self) -> tuple[StaticData, dict[str, list[str]]]:
        draw = torch.Generator().manual_seed(0)
        joint = torch.randn(16, 3, generator=draw)
        data = StaticData(
            x=torch.randn(16, 4, 2, generator=draw),
            edge_index=self.layout.edge_index("original"),
            y=torch.arange(16) % 2,
            joint=joint,
            pos=self.layout.pos,
            trial=torch.arange(16) // 2,
        )
        return data, {"class": ["soft", "hard"]}


MODEL = {
    "model": {
        "class_path": "torch_geometric_tactile.nn.models.TactileFNN",
        "init_args": {
            "layout": 4,
            "out_channels": 2,
            "inputs": ["tactile"],
            "channels": {"tactile": 2},
            "num_joints": 3,
            "widths": [3],
            "pools": [1],
        },
    },
    "optimizer": {"class_path": "torch.optim.Adam", "init_args": {"lr": 0.01}},
    "lr_scheduler": {
        "class_path": "torch.optim.lr_scheduler.StepLR",
        "init_args": {"step_size": 1},
    },
    "num_classes": 2,
}


def checkpoint(folder: Path) -> None:
    import logging

    import lightning as L
    from torch_geometric.transforms import Compose

    from torch_geometric_tactile.training import TactileDataModule, classifier_from_config
    from torch_geometric_tactile.transforms import ZScore

    logging.getLogger("lightning.pytorch").setLevel(logging.ERROR)
    L.seed_everything(0, verbose=False)
    data = TactileDataModule(
        SmallDataset(), transform=Compose([ZScore(), ZScore(attr="joint")]), batch_size=4
    )
    module = classifier_from_config(MODEL, data)
    trainer = L.Trainer(
        max_epochs=1,
        accelerator="cpu",
        logger=False,
        enable_checkpointing=False,
        enable_progress_bar=False,
        enable_model_summary=False,
        default_root_dir=folder,
    )
    trainer.fit(module, data)
    trainer.save_checkpoint(folder / "a.ckpt")


def predictor(folder: Path) -> None:
    from torch_geometric_tactile.predictor import Predictor

    checkpoint(folder)
    made = Predictor.from_checkpoint(folder / "a.ckpt")
    draw = torch.Generator().manual_seed(0)
    made.contact = ContactRule(min_taxels=1).measured(torch.randn(20, 4, 2, generator=draw) - 50)
    made.save(folder / "a.predictor")
    (folder / "a.ckpt").unlink()


def estimator(folder: Path) -> None:
    from torch_geometric_tactile.baselines import TemperatureScaling, descriptor_svm, flat_forest
    from torch_geometric_tactile.predictor import estimator_predictor

    samples = SmallDataset()
    machine = descriptor_svm(samples.layout)
    machine.steps[-1] = ("machine", TemperatureScaling(machine[-1]))
    forest = flat_forest(num_trees=2).set_params(randomforestclassifier__random_state=0)
    for name, pipeline in (("forest", forest), ("machine", machine)):
        pipeline.fit(samples.data, samples.data.y.numpy())
        estimator_predictor(pipeline, samples).save(folder / f"{name}.predictor")


def processed(folder: Path) -> None:
    from torch_geometric_tactile.data._processed_file import save_static

    data, names = SmallDataset().read()
    save_static(data, names, folder / "a.pt", {"class": "Small"}, ["a.txt=1"])


def config(folder: Path) -> None:
    content = {
        "seed_everything": 0,
        "model": MODEL,
        "data": {
            "dataset": {
                "class_path": "torch_geometric_tactile.datasets.FakeTactileDataset",
                "init_args": {"num_samples": 40},
            },
            "split": "trial",
            "val": 0.1,
            "transform": {"class_path": "torch_geometric_tactile.transforms.ZScore"},
        },
        "trainer": {"max_epochs": 1},
    }
    (folder / "a.yaml").write_text(yaml.safe_dump(content, sort_keys=False))


def run_folder(folder: Path) -> None:
    config(folder)
    (folder / "a.yaml").rename(folder / "config.yaml")


def table(folder: Path) -> None:
    content = {
        "title": "Small",
        "data": {
            "class_path": "torch_geometric_tactile.datasets.FakeTactileDataset",
            "init_args": {"num_samples": 100},
        },
        "protocols": {
            "by trial": {"by": "trial", "val": 0.1, "test": 0.2},
            "by frame": {"by": "frame"},
        },
        "cells": [
            {"row": "GCN", "config": "grasp_gcn_df", "accuracy": 92.0},
            {"row": "SVM", "estimator": {"class_path": "sklearn.svm.SVC", "init_args": {"C": 1.0}}},
        ],
        "seeds": 2,
    }
    (folder / "a.yaml").write_text(yaml.safe_dump(content, sort_keys=False))


def run_store(folder: Path) -> None:
    from torch_geometric_tactile.experiments._run_store import RunStore

    experiment = readers.experiment()
    RunStore(folder).write(
        experiment, {"accuracy": 0.5, "confusion": [[1, 2], [3, 4]], "auc": math.pi}
    )
