r"""What the models of a comparison said of single samples, and their scores by set and group."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from torch_geometric_tactile.data import StaticDataset
from torch_geometric_tactile.experiments._held_out import column_of
from torch_geometric_tactile.experiments._scores import prediction_scores
from torch_geometric_tactile.experiments.comparison import Comparison
from torch_geometric_tactile.experiments.judgement import Judgement

KINDS = ("set", "session", "group", "trial")
_MOST = 50


class PartScores(NamedTuple):
    r"""The scores of the models on the test samples of each set, session or group."""

    kind: str
    counts: dict[str, int]
    scores: dict[str, list[float]]


def part_scores(comparison: Comparison) -> Iterator[PartScores]:
    r"""Yields the scores of each kind of which the test samples have 2 to 50."""
    dataset = comparison.run.plan.data.load()
    said: dict[str, list[Judgement]] = {result.model.name: [] for result in comparison.results}
    for experiment, result in comparison.run.results:
        if experiment.name in said:
            said[experiment.name].append(Judgement.from_dict(result["predictions"]))
    joined = {name: Judgement.join(judgements) for name, judgements in said.items()}
    for kind in KINDS[:-1]:
        of_model = {name: _names(dataset, kind, j.index) for name, j in joined.items()}
        names, counts = np.unique(next(iter(of_model.values()), []), return_counts=True)
        if not 2 <= len(names) <= _MOST:
            continue
        scores = {
            model: [_score(comparison, joined[model].select(of_sample == name)) for name in names]
            for model, of_sample in of_model.items()
        }
        yield PartScores(kind, dict(zip(names.tolist(), counts.tolist(), strict=True)), scores)


def _score(comparison: Comparison, said: Judgement) -> float:
    numbers = comparison.metric == "mae"
    return prediction_scores(said.y, said.prediction, numbers)[comparison.metric]


def prediction_rows(comparison: Comparison) -> Iterator[list[Any]]:
    r"""Yields the header of a table with a row for each model, split and test sample, and
    its rows.
    """
    dataset = comparison.run.plan.data.load()
    kinds = [kind for kind in KINDS if column_of(dataset, kind) is not None]
    y = column_of(dataset, "y")
    width = [""] if y is None or y.ndim == 1 else [f"_{i}" for i in range(y.shape[1])]
    answers = [f"{name}{end}" for name in ("y", "prediction") for end in width]
    yield ["model", "seed", "fold", "index", *kinds, *answers]
    for experiment, result in comparison.run.results:
        said = Judgement.from_dict(result["predictions"])
        columns = [_names(dataset, kind, said.index).tolist() for kind in kinds]
        for values in (said.y, said.prediction):
            columns += _named(values, dataset.class_names).reshape(len(values), -1).T.tolist()
        head = [experiment.name, experiment.seed, experiment.fold]
        assert said.index is not None
        for row in zip(said.index.tolist(), *columns, strict=True):
            yield [*head, *row]


def _names(dataset: StaticDataset, kind: str, index: np.ndarray | None) -> np.ndarray:
    # Of the samples with these places among all that the data set holds, selected or not.
    column = column_of(dataset, kind)
    if column is None or index is None:
        return np.array([])
    place = np.zeros(dataset.len(), dtype=np.int64)
    place[np.asarray(dataset.indices())] = np.arange(len(dataset))
    return _named(column[place[index]], dataset._names.get(kind, ()))


def _named(values: np.ndarray, names: Any) -> np.ndarray:
    if values.dtype.kind == "f":
        return values
    return np.array([names[v] if v < len(names) else str(v) for v in values.ravel().tolist()])
