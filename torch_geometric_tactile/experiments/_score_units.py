r"""The units of a comparison: what a test part has that no model has seen in training."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, Self

import numpy as np
import torch

from torch_geometric_tactile.data._frame_view import innermost
from torch_geometric_tactile.data._graph_samples import SampleSet
from torch_geometric_tactile.data._shared_samples import shared_units
from torch_geometric_tactile.experiments._held_out import column_of
from torch_geometric_tactile.experiments._scores import prediction_scores
from torch_geometric_tactile.experiments.plan import Plan
from torch_geometric_tactile.experiments.predictions import Predictions

_KEYS = ("trial", "group", "session")
_LARGE = ("group", "session")  # that have several trials


class SeenAndTest(NamedTuple):
    r"""The samples of a split, by their places in the data set: :obj:`seen` to train and choose on,
    and those to :obj:`test` on.
    """

    seen: np.ndarray
    test: np.ndarray


def comparison_splits(plan: Plan) -> list[SeenAndTest]:
    r"""Returns the splits of a comparison.

    Args:
        plan (Plan): The comparison.
    """
    splits = {(e.seed, e.fold): e for e in plan.experiments}.values()
    parts = []
    for experiment in splits:
        train, val, test = plan.data.split(experiment.protocol, experiment.seed, experiment.fold)
        parts.append(SeenAndTest(torch.cat([train, val]).numpy(), test.numpy()))
    return parts


@dataclass(frozen=True, eq=False)
class ScoreUnits:
    r"""The largest of group, session and trial of which no member is in both parts of a split. Of a
    single split, as of given parts, a group or session is a unit if most of those that are tested
    are new: samples of one person are no independent observations, whoever else was seen.

    Args:
        name (str): What one is called, such as :obj:`"trial"` or :obj:`"person"`; :obj:`"sample"`
            where each sample is one.
        numbers (ndarray, optional): The number of the unit of each stored sample; :obj:`None`
            where each sample is one.
        num_leaked (int): How many trials are in both parts of some split: no score then says
            anything about a new trial.
        num_seen (int): How many of the units that are tested are in the training part too, where
            the others are new.
    """

    name: str
    numbers: np.ndarray | None = None
    num_leaked: int = 0
    num_seen: int = 0

    @classmethod
    def of(cls, dataset: SampleSet, splits: Sequence[SeenAndTest]) -> Self:
        r"""Finds the units of the splits of a data set.

        Args:
            dataset (StaticDataset): The data set.
            splits (sequence of SeenAndTest): Its splits.
        """
        columns = {key: column_of(dataset, key) for key in _KEYS}
        numbers = {key: column for key, column in columns.items() if column is not None}
        shared = [shared_units(dataset, [torch.from_numpy(part) for part in s]) for s in splits]
        leaked = {key: {n for units in shared for n in units[key]} for key in numbers}
        tested = np.concatenate([split.test for split in splits])
        num_tested = {key: len(np.unique(column[tested])) for key, column in numbers.items()}
        new_keys = [key for key in numbers if not leaked[key]]
        if len({split.test.tobytes() for split in splits}) == 1:
            new_keys += [k for k in _LARGE if 0 < 2 * len(leaked.get(k, ())) < num_tested.get(k, 0)]
        if new_keys:
            key = min(new_keys, key=lambda key: num_tested[key])
            name = innermost(dataset).group_kind if key == "group" else key
            num_seen = len(leaked[key])
            num_leaked = len(leaked.get("trial", ())) if num_seen else 0
            return cls(name, _by_stored_place(dataset, numbers[key]), num_leaked, num_seen)
        if "trial" not in numbers:
            return cls("sample")
        trials = _by_stored_place(dataset, numbers["trial"])
        return cls("trial", trials, num_leaked=len(leaked["trial"]))

    def num_of(self, predictions: Sequence[Predictions]) -> int:
        r"""Returns the number of units of predictions that :meth:`of_predictions` returned.

        Args:
            predictions (sequence of Predictions): Those of several splits.
        """
        places = [p.index if p.trial is None else p.trial for p in predictions]
        return len(np.unique(np.concatenate([p for p in places if p is not None])))

    def of_predictions(self, predictions: Predictions) -> Predictions:
        r"""Returns predictions with the units in place of the trials.

        Args:
            predictions (Predictions): Those of one split.
        """
        if self.numbers is None or predictions.index is None:
            return replace(predictions, trial=None)
        return replace(predictions, trial=self.numbers[predictions.index])


class ConstantAnswer(NamedTuple):
    r"""The answer that is most frequent in training, or the mean, and its mean score."""

    name: str
    score: float

    @classmethod
    def of(cls, dataset: SampleSet, splits: Sequence[SeenAndTest], metric: str) -> Self:
        r"""Computes the answer and its score.

        Args:
            dataset (StaticDataset): The data set.
            splits (sequence of SeenAndTest): Its splits.
            metric (str): As of a comparison.
        """
        y = column_of(dataset, "y")
        assert y is not None
        scores, answers = [], []
        for seen, test in splits:
            if metric == "mae":
                constant = np.broadcast_to(y[seen].mean(axis=0), y[test].shape)
            else:
                answers.append(int(np.bincount(y[seen]).argmax()))
                constant = np.full(len(test), answers[-1])
            scores.append(prediction_scores(y[test], constant, metric == "mae")[metric])
        if metric == "mae":
            return cls("the mean", float(np.mean(scores)))
        answer = int(np.bincount(answers).argmax())
        names = dataset.class_names
        name = names[answer] if answer < len(names) else str(answer)
        return cls(f"'{name}'", float(np.mean(scores)))


def _by_stored_place(dataset: SampleSet, column: np.ndarray) -> np.ndarray:
    # Predictions know the place of a sample among all that are stored, selected or not.
    stored = np.zeros(dataset.len(), dtype=np.int64)
    stored[np.asarray(dataset.indices())] = column
    return stored
