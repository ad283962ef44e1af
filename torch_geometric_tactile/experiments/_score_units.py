r"""The units of a comparison: the trials, persons or objects that are new in the test parts."""

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
_KEYS_OVER_TRIALS = ("group", "session")  # a group or session has several trials


class TrainTestIndices(NamedTuple):
    r"""Indices of the samples of a split: :obj:`train`, for training and model selection, and
    :obj:`test`.
    """

    train: np.ndarray
    test: np.ndarray


def comparison_splits(plan: Plan) -> list[TrainTestIndices]:
    r"""Returns the splits of a comparison as indices of samples.

    Args:
        plan (Plan): The comparison.
    """
    splits = {(e.seed, e.fold): e for e in plan.experiments}.values()
    indices = []
    for experiment in splits:
        train, val, test = plan.data.split(experiment.protocol, experiment.seed, experiment.fold)
        indices.append(TrainTestIndices(torch.cat([train, val]).numpy(), test.numpy()))
    return indices


@dataclass(frozen=True, eq=False)
class ScoreUnits:
    r"""The units of which each counts as one observation: groups, sessions or trials, whichever are
    fewest, that are never in both parts of a split.

    If all splits have the same test part, as with given parts, groups or sessions are units if most
    groups or sessions in the test part are new. Samples from one person are not independent
    observations, even if other persons are in both parts.

    Args:
        name (str): Name of a unit, such as :obj:`"trial"` or :obj:`"person"`; :obj:`"sample"` if
            each sample is a unit.
        numbers (ndarray, optional): Unit of each stored sample :math:`(S,)`; :obj:`None` if each
            sample is a unit.
        num_leaked (int): Number of trials that are in both parts of a split. If there are any, the
            scores say nothing about new trials.
        num_seen (int): Number of units of the test part that are also in the training part.
    """

    name: str
    numbers: np.ndarray | None = None
    num_leaked: int = 0
    num_seen: int = 0

    @classmethod
    def from_splits(
        cls, dataset: SampleSet, splits: Sequence[TrainTestIndices], by: str = "trial"
    ) -> Self:
        r"""Finds the units of the splits of a data set.

        Args:
            dataset (StaticDataset): The data set.
            splits (sequence of TrainTestIndices): Its splits.
            by (str): The unit that the splits keep together. It is preferred over other units of
                the same number.
        """
        keys = tuple(dict.fromkeys((*([by] if by not in ("frame", "given") else []), *_KEYS)))
        columns = {key: column_of(dataset, key) for key in keys}
        numbers = {key: column for key, column in columns.items() if column is not None}
        shared = [
            shared_units(dataset, [torch.from_numpy(part) for part in s], keys) for s in splits
        ]
        leaked_units = {key: {n for units in shared for n in units[key]} for key in numbers}
        test = np.concatenate([split.test for split in splits])
        num_test_units = {key: len(np.unique(column[test])) for key, column in numbers.items()}
        new_keys = [key for key in numbers if not leaked_units[key]]
        if len({split.test.tobytes() for split in splits}) == 1:
            new_keys += [
                key
                for key in _KEYS_OVER_TRIALS
                if 0 < 2 * len(leaked_units.get(key, ())) < num_test_units.get(key, 0)
            ]
        if new_keys:
            key = min(new_keys, key=lambda key: num_test_units[key])
            name = innermost(dataset).group_kind if key == "group" else key
            num_seen = len(leaked_units[key])
            num_leaked = len(leaked_units.get("trial", ())) if num_seen else 0
            return cls(name, _by_stored_index(dataset, numbers[key]), num_leaked, num_seen)
        if "trial" not in numbers:
            return cls("sample")
        trials = _by_stored_index(dataset, numbers["trial"])
        return cls("trial", trials, num_leaked=len(leaked_units["trial"]))

    def count_units(self, predictions: Sequence[Predictions]) -> int:
        r"""Returns the number of different units in predictions returned by
        :meth:`replace_trials`.

        Args:
            predictions (sequence of Predictions): Predictions for several splits.
        """
        units = [p.index if p.trial is None else p.trial for p in predictions]
        return len(np.unique(np.concatenate([numbers for numbers in units if numbers is not None])))

    def replace_trials(self, predictions: Predictions) -> Predictions:
        r"""Returns predictions whose :obj:`trial` is the unit of each sample.

        Args:
            predictions (Predictions): Predictions for one split.
        """
        if self.numbers is None or predictions.index is None:
            return replace(predictions, trial=None)
        return replace(predictions, trial=self.numbers[predictions.index])


class ConstantAnswer(NamedTuple):
    r"""The constant answer and its mean score over the splits. The constant answer is the most
    frequent class of the training part, or the mean of its numbers.
    """

    name: str
    score: float

    @classmethod
    def from_splits(
        cls, dataset: SampleSet, splits: Sequence[TrainTestIndices], metric: str
    ) -> Self:
        r"""Computes the answer and its score.

        Args:
            dataset (StaticDataset): The data set.
            splits (sequence of TrainTestIndices): Its splits.
            metric (str): As in :class:`ComparisonSettings`.
        """
        y = column_of(dataset, "y")
        assert y is not None
        scores, answers = [], []
        for train, test in splits:
            if metric == "mae":
                constant = np.broadcast_to(y[train].mean(axis=0), y[test].shape)
            else:
                answers.append(int(np.bincount(y[train]).argmax()))
                constant = np.full(len(test), answers[-1])
            scores.append(prediction_scores(y[test], constant, metric == "mae")[metric])
        if metric == "mae":
            return cls("the mean", float(np.mean(scores)))
        answer = int(np.bincount(answers).argmax())
        names = dataset.class_names
        name = names[answer] if answer < len(names) else str(answer)
        return cls(f"'{name}'", float(np.mean(scores)))


def _by_stored_index(dataset: SampleSet, column: np.ndarray) -> np.ndarray:
    # The index in predictions counts all stored samples, including samples that are not selected.
    stored = np.zeros(dataset.len(), dtype=np.int64)
    stored[np.asarray(dataset.indices())] = column
    return stored
