r"""What is held out of a data set to test on and, of the rest, to choose on."""

import warnings
from typing import NamedTuple

import numpy as np
import torch

from torch_geometric_tactile.data import Protocol, StaticDataset
from torch_geometric_tactile.experiments._experiment import Experiment

_FOLDS = 5
_LEAST = 3  # units: to train, to choose and to test on


class Parts(NamedTuple):
    r"""The parts of an experiment with a choice: :obj:`fit` to train and :obj:`val` to choose on,
    both together :obj:`train`, and :obj:`test`.
    """

    fit: StaticDataset
    val: StaticDataset
    train: StaticDataset
    test: StaticDataset


def balanced_protocol(
    dataset: StaticDataset, by: str, folds: int = _FOLDS, *, quiet: bool = False
) -> Protocol:
    r"""Returns folds by frame, trial or group, with every class in every fold where that is
    possible.
    """
    count = num_units(dataset, by)
    if count < 2:
        raise ValueError(f"'dataset' must have at least 2 {by}s to be split by {by} (got {count})")
    plain = Protocol(by, folds=min(folds, count))  # type: ignore[arg-type]
    y = dataset.column("y")
    if y is None or y.dim() != 1 or y.is_floating_point():
        return plain
    for number in range(min(folds, count), 1, -1):
        stratified = Protocol(by, folds=number, stratify="y")  # type: ignore[arg-type]
        with warnings.catch_warnings():
            if quiet:
                warnings.simplefilter("ignore")
            try:
                splits = [stratified.split(dataset, 0, fold) for fold in range(number)]
            except ValueError:  # the most frequent class has fewer units than folds
                continue
        if all(len(split.test) for split in splits):
            return stratified
    return plain


def num_units(dataset: StaticDataset, by: str) -> int:
    r"""Returns how many units there are that a split never tears apart."""
    if by == "frame":
        return len(dataset)
    unit = dataset.column(by)
    if unit is None:
        raise ValueError(
            f"'dataset' must have '{by}', a number or name for each sample, to be split by {by} "
            "(got none)"
        )
    return len(unit.unique())


def check_units(dataset: StaticDataset, by: str) -> None:
    r"""Checks that there is something to train, to choose and to test on."""
    count = num_units(dataset, by)
    if count < _LEAST:
        others = {"group": "trial or by frame", "trial": "frame"}.get(by)
        hint = f"; compare by {others}, which tells less" if others else ""
        raise ValueError(
            f"'dataset' must have at least {_LEAST} {by}s, to train, to choose and to test on "
            f"(got {count}){hint}"
        )


def choice_parts(experiment: Experiment) -> Parts:
    r"""Returns the parts of an experiment. The validation part is a fifth of the training part, cut
    by what the test is held out by; given parts bring their own.
    """
    protocol = experiment.protocol
    if protocol.by == "given":
        dataset = experiment.data.load()
        split = protocol.split(dataset)
        if len(split.val):
            train = torch.cat([split.train, split.val]).sort().values
            return Parts(*(dataset[i] for i in (split.train, split.val, train, split.test)))
    train, test = experiment.data.parts(protocol, experiment.seed, experiment.fold)
    by = protocol.by
    if by == "given":
        by = "frame" if train.column("trial") is None else "trial"
    inner = balanced_protocol(train, by, quiet=True)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of classes with few units, which the test told of
        cut = inner.split(train, experiment.seed, fold=0)
    return Parts(train[cut.train], train[cut.test], train, test)


def column_of(dataset: StaticDataset, key: str) -> np.ndarray | None:
    r"""Returns an attribute of the samples as an array, or :obj:`None` if there is no such."""
    column = dataset.column(key)
    return None if column is None else np.asarray(column.numpy(force=True))
