from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("lightning", reason="needs the extra 'train'")

from torch_geometric_tactile.data import Protocol
from torch_geometric_tactile.experiments.predictions import Predictions
from torch_geometric_tactile.experiments.run_plan import PlanRun
from torch_geometric_tactile.papers._grasp_numbers import grasp_differences

PROTOCOLS = (("test", Protocol("given")), ("folds", Protocol("trial", folds=2)))
CELLS = (("net", "raw"), ("twin", "raw"), ("net", "session"))
Y = np.array([0, 1, 0, 1])


def result(right, index):
    prediction = np.where(right, Y, 1 - Y)
    said = Predictions(score=prediction.astype(float), prediction=prediction, y=Y, index=index)
    return {"predictions": said.to_dict(), "num_train": 8, "num_test": 4}


def run():
    """The net is right on three of four samples and its twin on one, on each of four splits."""
    results = []
    for name, protocol in PROTOCOLS:
        for seed, fold in [(0, 0), (1, 0)] if name == "test" else [(0, 0), (0, 1), (1, 0), (1, 1)]:
            folds = [[0, 1, 2, 3], [4, 5, 6, 7]] if seed == 0 else [[0, 1, 4, 5], [2, 3, 6, 7]]
            index = np.arange(4) if name == "test" else np.array(folds[fold])
            for model, readings in CELLS:
                right = {"net": [1, 1, 1, 0], "twin": [1, 0, 0, 0]}[model]
                right = [0] * 4 if readings == "session" else np.roll(right, seed)
                keys = {"name": f"{model}_{readings}", "protocol_name": name}
                e = SimpleNamespace(**keys, protocol=protocol, seed=seed, fold=fold)
                results.append((e, result(right, index)))
    cells = [SimpleNamespace(row=m, column=r, experiment=f"{m}_{r}") for m, r in CELLS]
    protocols = [SimpleNamespace(name=name, protocol=protocol) for name, protocol in PROTOCOLS]
    plan = SimpleNamespace(table=SimpleNamespace(cells=cells), protocols=protocols)
    return PlanRun(plan, results, 0, {}, 0)


def test_differences_are_those_of_one_kind_of_readings_split_by_split():
    found = grasp_differences(run(), "raw", "net", "twin")
    assert list(found) == ["test", "folds"]
    assert [d.mean for d in found.values()] == pytest.approx([0.5, 0.5])
    assert [d.num_splits for d in found.values()] == [2, 4]
    assert found["folds"].over_trials == pytest.approx((8 / 7 * 4 / 256) ** 0.5)
    assert [d.num_trials for d in found.values()] == [4, 8]  # a sample is one observation
    assert [d.verdict for d in found.values()] == ["too few splits", "beyond the noise"]
