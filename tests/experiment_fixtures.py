import sys

import pytest


@pytest.fixture
def trained(monkeypatch):
    """Puts made-up results in the place of training; the names of what was trained."""
    from torch_geometric_tactile.experiments import run_plan

    module = sys.modules[run_plan.__module__]

    names = []

    def run(experiment):
        names.append(f"{experiment.name} {experiment.protocol_name} {experiment.seed}")
        if experiment.name == "x_pos":
            return {"error": "ValueError: it must not"}
        metrics = {"accuracy": 0.5, "f1": 0.5, "auroc": None}
        return {"metrics": metrics, "num_train": 1, "machine": "m"}

    monkeypatch.setattr(module, "run_safely", run)
    return names


@pytest.fixture
def of_grasps(grasps):
    """An experiment on the small folder of grasps: ``of_grasps(model="p2_table2/ii_tac")``."""
    from torch_geometric_tactile.data import Protocol
    from torch_geometric_tactile.experiments._experiment import Experiment
    from torch_geometric_tactile.experiments.source import DataSource
    from torch_geometric_tactile.training._config import load_config

    def make(model="p2_table2/ii_tac", task="object", selection=None, **changes):
        config = load_config(model)
        source = DataSource(
            "torch_geometric_tactile.datasets.AllegroUSkin",
            {"root": str(grasps), "task": task, "split": None},
            selection or {},
            fingerprint="f",
        )
        arguments = {
            "name": model.rpartition("/")[2],
            "data": source,
            "protocol": Protocol("trial", val=0.1, test=0.3, stratify="group"),
            "protocol_name": "by trial",
            "model": config["model"],
            "transform": config["data"]["transform"],
            "epochs": 1,
        }
        return Experiment(**{**arguments, **changes})

    return make
