r"""What a model costs a frame, and what it makes of damaged arrays."""

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
    thread: the median of single calls.

    Args:
        num_calls (int): How many calls.
    """

    def __init__(self, num_calls: int = 300) -> None:
        self.num_calls = num_calls

    def measure(self, trained: Trained) -> dict[str, Any]:
        r"""Returns the median :obj:`milliseconds`."""
        count = min(self.num_calls, trained.test.num_samples)
        samples = [trained.test.index_select(torch.tensor([i])) for i in range(count)]
        inputs: list[Any] = samples
        if not trained.is_network:
            inputs = [estimator_input(trained.model, sample) for sample in samples]
        threads = torch.get_num_threads()
        torch.set_num_threads(1)
        seconds = []
        try:
            for given in inputs:
                start = time.perf_counter()
                _classify(trained, given)
                seconds.append(time.perf_counter() - start)
        finally:
            torch.set_num_threads(threads)
        return {"milliseconds": 1000 * statistics.median(seconds), "num_calls": count}


def _classify(trained: Trained, given: Any) -> Any:
    if trained.is_network:
        return trained.logits(given).argmax(dim=1)
    return trained.model.predict(given)


class DeadRows(Study):
    r"""Tests a model on arrays of which some rows, drawn for each sample, read nothing, as it
    happens to a signal line that breaks. The model was not trained on such arrays. Rows are those
    of the image map of the layout, or lines of equal :math:`y` where there is none.

    What a dead taxel reads is the smallest reading of the training part, that of rest.

    Args:
        num_rows (sequence of int): How many rows are dead, one accuracy each.
        seed (int): Which rows.
    """

    def __init__(self, num_rows: Sequence[int] = (0, 1, 2, 4, 8), seed: int = 0) -> None:
        self.num_rows = tuple(num_rows)
        self.seed = seed

    def measure(self, trained: Trained) -> dict[str, Any]:
        r"""Returns :obj:`num_rows` and the :obj:`accuracy` with so many dead ones."""
        layout = trained.layout
        assert layout is not None  # that of the hand
        places = layout.pos[:, 1] if layout.image_map is None else layout.image_map[:, 0]
        _, row = np.unique(np.round(places.numpy(), 6), return_inverse=True)
        rest = trained.train.x.amin(dim=(0, 1))
        rng = np.random.default_rng(self.seed)
        order = np.argsort(rng.random((trained.test.num_samples, int(row.max()) + 1)), axis=1)
        accuracy = []
        for count in self.num_rows:
            is_dead = np.zeros(order.shape, dtype=bool)
            np.put_along_axis(is_dead, order[:, :count], True, axis=1)
            dead = torch.from_numpy(is_dead[:, row])
            samples = _with_x(trained.test, torch.where(dead[..., None], rest, trained.test.x))
            accuracy.append(_accuracy(trained, samples))
        return {"num_rows": list(self.num_rows), "accuracy": accuracy}


def _with_x(samples: StaticData, x: torch.Tensor) -> StaticData:
    out = samples.clone()
    out.x = x
    return out


def _accuracy(trained: Trained, samples: StaticData) -> float:
    if trained.is_network:
        said = trained.logits(samples).argmax(dim=1).numpy()
    else:
        said = np.asarray(trained.model.predict(estimator_input(trained.model, samples)))
    return float((said == samples.y.numpy()).mean())
