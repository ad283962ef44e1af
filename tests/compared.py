"""A small file of touches to compare models on."""

import numpy as np
import pytest

pytest.importorskip("lightning", reason="needs the extra 'train'")

from torch_geometric_tactile.data import Protocol
from torch_geometric_tactile.datasets import SamplesFile
from torch_geometric_tactile.experiments._experiment import Choice, Experiment
from torch_geometric_tactile.experiments.compared_windows import data_source

SVM = {"class_path": "torch_geometric_tactile.baselines.linear_svm"}
SCALED = {"class_path": "torch_geometric_tactile.transforms.ZScore"}
GIVEN = np.repeat([0, 0, 0, 0, 0, 0, 1, 1, 1, 2, 2, 2], 4)


class SelectedTouches(SamplesFile):
    """Every so many-th sample of a file of touches, which is selected after loading."""

    def __init__(self, path, stride=1):
        super().__init__(path, grid="3x4")
        self._indices = range(0, self.len(), stride)


def touches(path, num_trials=12, frames=4, classes=3, seed=0, **changes):
    """Writes touches on a grid of 3 x 4: class c presses taxel c of a trial that has an offset."""
    draw = np.random.default_rng(seed)
    y = np.arange(num_trials) % classes
    x = draw.normal(size=(num_trials, frames, 12)) + draw.normal(size=(num_trials, 1, 12))
    x[np.arange(num_trials), :, y] += 4.0
    content = {
        "x": x.reshape(-1, 3, 4).astype(np.float32),
        "y": y.repeat(frames),
        "trial": np.arange(num_trials).repeat(frames),
    }
    content |= {key: value for key, value in changes.items() if value is not None}
    for key in [key for key, value in changes.items() if value is None]:
        del content[key]
    np.savez(path, **content)
    return content


def experiment(path, model=SVM, settings=({},), metric="accuracy", **changes):
    """An experiment with a choice, on a file of touches."""
    source, _ = data_source(path, grid="3x4").resolve()
    arguments = {
        "name": "model",
        "data": source,
        "protocol": Protocol("trial", folds=3, stratify=None if metric == "mae" else "y"),
        "protocol_name": "by trial",
        "model": model,
        "transform": SCALED,
        "epochs": 4,
        "batch_size": 8,
        "choice": Choice(settings, metric),
    }
    return Experiment(**{**arguments, **changes})
