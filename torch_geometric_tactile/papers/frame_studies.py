r"""Studies of the time per frame and the accuracy on damaged arrays."""

import statistics
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch

from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.experiments._estimators import estimator_input
from torch_geometric_tactile.experiments.studies import Study, Trained


class FrameTime(Study):
    r"""Measures how long a model takes to classify one sample, from readings to a class, on one
    thread. The result is the median over single calls.

    Args:
        num_calls (int): Number of calls.
    """

    def __init__(self, num_calls: int = 300) -> None:
        self.num_calls = num_calls

    def measure(self, trained: Trained) -> dict[str, Any]:
        r"""Returns the median :obj:`milliseconds`."""
        num_calls = min(self.num_calls, trained.test.num_samples)
        samples = [trained.test.index_select(torch.tensor([i])) for i in range(num_calls)]
        inputs: list[Any] = samples
        if not trained.is_network:
            inputs = [estimator_input(trained.model, sample) for sample in samples]
        num_threads = torch.get_num_threads()
        torch.set_num_threads(1)
        seconds = []
        try:
            for sample_input in inputs:
                start = time.perf_counter()
                _classify(trained, sample_input)
                seconds.append(time.perf_counter() - start)
        finally:
            torch.set_num_threads(num_threads)
        return {"milliseconds": 1000 * statistics.median(seconds), "num_calls": num_calls}


def _classify(trained: Trained, sample_input: Any) -> Any:
    if trained.is_network:
        return trained.logits(sample_input).argmax(dim=1)
    return trained.model.predict(sample_input)


class DeadRows(Study):
    r"""Tests a model on samples with dead rows, as caused by a broken signal line. The dead rows
    are drawn at random for each sample. The model was not trained on such samples. Rows are defined
    by the image map of the layout or, without an image map, by taxels with equal :math:`y`.

    A dead taxel has the smallest reading in the training part, which is the reading at rest.

    Args:
        num_rows (sequence of int): Numbers of dead rows. An accuracy is computed for each.
        seed (int): Seed for drawing rows.
    """

    def __init__(self, num_rows: Sequence[int] = (0, 1, 2, 4, 8), seed: int = 0) -> None:
        self.num_rows = tuple(num_rows)
        self.seed = seed

    def measure(self, trained: Trained) -> dict[str, Any]:
        r"""Returns :obj:`num_rows` and the :obj:`accuracy` for each number of dead rows."""
        layout = trained.layout
        assert layout is not None  # tables have data sets with one layout
        coordinates = layout.pos[:, 1] if layout.image_map is None else layout.image_map[:, 0]
        # Coordinates are rounded, since they may differ in their last digits within a row.
        _, row_of_taxel = np.unique(np.round(coordinates.numpy(), 6), return_inverse=True)
        rest = trained.train.x.amin(dim=(0, 1))
        rng = np.random.default_rng(self.seed)
        row_order = np.argsort(
            rng.random((trained.test.num_samples, int(row_of_taxel.max()) + 1)), axis=1
        )
        accuracy = []
        for num_dead in self.num_rows:
            is_dead = np.zeros(row_order.shape, dtype=bool)
            np.put_along_axis(is_dead, row_order[:, :num_dead], True, axis=1)
            dead = torch.from_numpy(is_dead[:, row_of_taxel])
            samples = _replace_readings(
                trained.test, torch.where(dead[..., None], rest, trained.test.x)
            )
            accuracy.append(_accuracy(trained, samples))
        return {"num_rows": list(self.num_rows), "accuracy": accuracy}


def _replace_readings(samples: StaticData, x: torch.Tensor) -> StaticData:
    out = samples.clone()
    out.x = x
    return out


def _accuracy(trained: Trained, samples: StaticData) -> float:
    if trained.is_network:
        predicted = trained.logits(samples).argmax(dim=1).numpy()
    else:
        predicted = np.asarray(trained.model.predict(estimator_input(trained.model, samples)))
    return float((predicted == samples.y.numpy()).mean())
