r"""What is held out of a data set to test on and, of the rest, to choose on."""

import logging
import statistics
import warnings
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from torch_geometric_tactile._checks import Argument, ArgumentError, need, need_argument
from torch_geometric_tactile.data import Protocol, Windows
from torch_geometric_tactile.data._frame_view import FrameView
from torch_geometric_tactile.data._graph_samples import SampleSet
from torch_geometric_tactile.data._shared_samples import sharing_ignored
from torch_geometric_tactile.experiments._experiment import Experiment
from torch_geometric_tactile.experiments.source import DataSource

_logger = logging.getLogger(__name__)
_FOLDS = 5
_LEAST = 3  # units: to train, to choose and to test on


class Parts(NamedTuple):
    r"""The parts of an experiment with a choice: :obj:`fit` to train and :obj:`val` to choose on,
    both together :obj:`train`, and :obj:`test`.
    """

    fit: SampleSet
    val: SampleSet
    train: SampleSet
    test: SampleSet


def balanced_protocol(
    dataset: SampleSet, by: str, folds: int = _FOLDS, *, quiet: bool = False
) -> Protocol:
    r"""Returns folds by frame, trial, group or session, with every class in every fold where that
    is possible.
    """
    count = _num_units(dataset, by)
    need(count >= 2, f"'dataset' must have at least 2 {by}s to be split by {by}", count)
    plain = Protocol(by, folds=min(folds, count))  # type: ignore[arg-type]
    y = dataset.column("y")
    if y is None or y.dim() != 1 or y.is_floating_point():
        return plain
    for number in range(min(folds, count), 1, -1):
        stratified = Protocol(by, folds=number, stratify="y")  # type: ignore[arg-type]
        with sharing_ignored():
            if quiet:
                warnings.simplefilter("ignore")
            try:
                splits = [stratified.split(dataset, 0, fold) for fold in range(number)]
            except ValueError:  # the most frequent class has fewer units than folds
                continue
        if all(len(split.test) for split in splits):
            return stratified
    return plain


def _num_units(dataset: SampleSet, by: str) -> int:
    # What a split never tears apart.
    if by == "frame":
        return len(dataset)
    unit = dataset.column(by)
    if unit is None:
        raise ValueError(
            f"'dataset' must have '{by}', a number or name for each sample, to be split by {by} "
            "(got none)"
        )
    return len(unit.unique())


def compared_protocol(dataset: SampleSet, by: str | None, folds: int) -> Protocol:
    r"""Returns how a comparison holds out samples. If :obj:`by` is left out, that is by trial; of
    samples without trials by group, where there are enough groups, and otherwise by frame.
    """
    by = by or _default_unit(dataset)
    if by == "given":
        with sharing_ignored():
            Protocol("given").split(dataset)  # tells that there are no parts
        _check_cut(dataset, by)
        return Protocol("given")
    count = _num_units(dataset, by)
    if count < _LEAST:
        others = {"group": "trial or by frame", "trial": "frame"}.get(by)
        hint = f"; compare by {others}, which tells less" if others else ""
        raise ValueError(
            f"'dataset' must have at least {_LEAST} {by}s, to train, to choose and to test on "
            f"(got {count}){hint}"
        )
    need_argument(
        count > _LEAST or folds >= _LEAST,
        "folds",
        f"must be at least 3 for 3 {by}s, so that 2 are left to train and to choose on",
        folds,
    )
    _check_cut(dataset, by)
    return balanced_protocol(dataset, by, folds)


def _default_unit(dataset: SampleSet) -> str:
    if dataset.column("trial") is not None:
        return "trial"
    kind = dataset.group_kind  # of frames: windows and whole trials have trials
    count, obstacle = _num_groups(dataset), ""
    if count:
        obstacle = _obstacle_to_groups(dataset, count)
        if not obstacle:
            _logger.warning(
                "the samples have no 'trial', and are split by %s (%d of them): the scores are for "
                "a new %s; '--by frame' splits them one by one, if no two are of one touch and new "
                "%ss do not matter",
                *(kind, count, kind, kind),
            )
            return "group"
    units = [by for by in ("group", "session") if dataset.column(by) is not None]
    hints = " or ".join(f"'--by {by}'" for by in units)
    _logger.warning(
        "the samples have no 'trial', and are split one by one%s: if several are of one touch, the "
        "scores tell how well models recognise that touch again, and are too high for a new one%s",
        f", since {obstacle}" if obstacle else "",
        f" ({hints} holds out whole {'s or '.join(units)}s)" if units else "",
    )
    return "frame"


def _num_groups(dataset: SampleSet) -> int:
    group = column_of(dataset, "group")
    return 0 if group is None else len(np.unique(group))


def _obstacle_to_groups(dataset: SampleSet, count: int) -> str:
    # Why samples without trials are not split by group, in words.
    if count < _LEAST:
        return f"{_LEAST} groups or more are needed to split by group (got {count})"
    group, y = column_of(dataset, "group"), column_of(dataset, "y")
    if group is None or y is None or y.ndim != 1 or y.dtype.kind == "f":
        return ""
    classes = np.unique(y)
    in_one = sum(len(np.unique(group[y == label])) == 1 for label in classes)
    if 2 * in_one > len(classes):  # as of objects that are the classes
        return f"{in_one} of {len(classes)} classes are in one group only, and could not be learned"
    return ""


def _check_cut(dataset: SampleSet, by: str) -> None:
    # A split must put no frame into two parts.
    if not isinstance(dataset, FrameView):
        return
    if by == "frame" and isinstance(dataset, Windows):
        reach = dataset.length + dataset.horizon
        if dataset.hop < reach:
            what = "windows" if not dataset.horizon else "windows and the frames of their labels"
            raise ArgumentError(
                Argument("by"),
                f" must be 'trial' or 'group' where {what} overlap (got 'frame', with windows "
                f"of {dataset.length} frames every {dataset.hop}): their frames would be on both "
                f"sides of a split; or let 'hop' be at least {reach}",
            )
        _logger.warning(
            "windows are split one by one: those of one trial are on both sides, and the scores "
            "are too high for a new trial"
        )
    if by in ("group", "session", "given"):
        _check_one_part(dataset.dataset, "part" if by == "given" else by)


def _check_one_part(frames: SampleSet, key: str) -> None:
    value, trial = frames.column(key), frames.column("trial")
    if not isinstance(value, Tensor) or trial is None or not len(trial):
        return  # the split tells what is missing
    changed = (value[1:] != value[:-1]) & (trial[1:] == trial[:-1])
    if changed.any():
        number = int(trial[int(changed.nonzero()[0])])
        raise ValueError(
            f"'{key}' must be the same in all frames of a trial where samples have several frames "
            f"(got two in trial {number})"
        )


def mean_training_size(source: DataSource, protocol: Protocol) -> float:
    r"""Returns the number of samples that a model is trained on, to be tested: the mean over the
    folds, of given parts that of both to train and to validate on. Only samples that are selected
    count.

    Args:
        source (DataSource): The samples.
        protocol (Protocol): Its folds, or :obj:`"given"`.
    """
    splits = [source.split(protocol, fold=fold) for fold in range(protocol.folds or 1)]
    return statistics.fmean(len(split.train) + len(split.val) for split in splits)


def choice_parts(experiment: Experiment) -> Parts:
    r"""Returns the parts of an experiment. The validation part is the first of
    :func:`choice_cuts`.
    """
    train, test, cuts = choice_cuts(experiment, 1)
    return Parts(*cuts[0], train, test)


def choice_cuts(
    experiment: Experiment, repeats: int, most: int | None = None
) -> tuple[SampleSet, SampleSet, list[tuple[SampleSet, SampleSet]]]:
    r"""Returns the training part, the test part, and several cuts of the training part in two, to
    train on (:obj:`most` samples, if there are more) and to choose on. The second is a fifth, by
    what the test is held out by, and differs from cut to cut; given parts bring their own, and
    there is one cut.
    """
    protocol = experiment.protocol
    if protocol.by == "given":
        dataset, split = experiment.data.load(), experiment.data.split(protocol)
        if len(split.val):
            train = torch.cat([split.train, split.val]).sort().values
            part = _some(dataset[split.train], most, experiment.seed)
            return dataset[train], dataset[split.test], [(part, dataset[split.val])]
    train_part, test = experiment.data.parts(protocol, experiment.seed, experiment.fold)
    by = _held_out_by(train_part, test) if protocol.by == "given" else protocol.by
    inner = balanced_protocol(train_part, by, quiet=True)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of classes with few units, which the test told of
        folds = range(min(repeats, inner.folds or 1))
        cuts = [inner.split(train_part, experiment.seed, fold=fold) for fold in folds]
    parts = [(train_part[cut.train], train_part[cut.test]) for cut in cuts]
    return train_part, test, [(_some(part, most, experiment.seed), val) for part, val in parts]


def _held_out_by(train: SampleSet, test: SampleSet) -> str:
    # The largest unit that is new in the test part; of groups most have to be (see ScoreUnits).
    for by in ("group", "trial"):
        known, tested = (column_of(part, by) for part in (train, test))
        if known is None or tested is None or len(np.unique(known)) < 2:
            continue
        units = np.unique(tested)
        num_seen = int(np.isin(units, known).sum())
        if num_seen == 0 or (by == "group" and 2 * num_seen < len(units)):
            return by
    return "frame"


def _some(part: SampleSet, most: int | None, seed: int) -> SampleSet:
    if most is None or len(part) <= most:
        return part
    draw = np.random.default_rng(seed)
    return part[torch.from_numpy(np.sort(draw.permutation(len(part))[:most]))]


def column_of(dataset: SampleSet, key: str) -> np.ndarray | None:
    r"""Returns an attribute of the samples as an array, or :obj:`None` if there is no such."""
    column = dataset.column(key)
    return None if column is None else np.asarray(column.numpy(force=True))
