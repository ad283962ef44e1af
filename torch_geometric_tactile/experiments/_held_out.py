r"""Test parts of a data set, and validation parts of the training samples."""

import logging
import statistics
import warnings
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from torch_geometric_tactile._checks import Argument, ArgumentError, need, need_argument
from torch_geometric_tactile.data import Protocol, Windows
from torch_geometric_tactile.data._frame_view import FrameView, innermost
from torch_geometric_tactile.data._graph_samples import SampleSet
from torch_geometric_tactile.data._sample_units import require_units, unit_column
from torch_geometric_tactile.data._shared_samples import sharing_ignored
from torch_geometric_tactile.experiments._experiment import Experiment
from torch_geometric_tactile.experiments.source import DataSource

_logger = logging.getLogger(__name__)
_NUM_FOLDS = 5
_MIN_UNITS = 3  # one each for training, model selection and test


class Parts(NamedTuple):
    r"""The parts of an experiment with a choice: :obj:`fit` to train the candidate settings,
    :obj:`val` to select one, :obj:`train` (both together), and :obj:`test`.
    """

    fit: SampleSet
    val: SampleSet
    train: SampleSet
    test: SampleSet


def balanced_protocol(
    dataset: SampleSet, by: str, folds: int = _NUM_FOLDS, *, quiet: bool = False
) -> Protocol:
    r"""Returns a protocol with folds by frame or by a unit. The folds are stratified by class if
    possible, and reduced in number if necessary.

    Args:
        dataset (StaticDataset): The samples.
        by (str): The unit that a split keeps together.
        folds (int): The number of folds. There are fewer folds if there are fewer units.
        quiet (bool): If :obj:`True`, suppresses warnings about classes with few units.

    Raises:
        ValueError: If there are fewer than two units.
    """
    num_units = _count_units(dataset, by)
    need(num_units >= 2, f"'dataset' must have at least 2 {by}s to be split by {by}", num_units)
    plain = Protocol(by, folds=min(folds, num_units))
    y = dataset.column("y")
    if y is None or y.dim() != 1 or y.is_floating_point():
        return plain
    for num_folds in range(min(folds, num_units), 1, -1):
        stratified = Protocol(by, folds=num_folds, stratify="y")
        with sharing_ignored():
            if quiet:
                warnings.simplefilter("ignore")
            try:
                splits = [stratified.split(dataset, 0, fold) for fold in range(num_folds)]
            except ValueError:  # the most frequent class has fewer units than folds
                continue
        if all(len(split.test) for split in splits):
            return stratified
    return plain


def _count_units(dataset: SampleSet, by: str) -> int:
    # Returns the number of units that a split keeps together.
    if by == "frame":
        return len(dataset)
    return len(require_units(dataset, by).unique())


def compared_protocol(dataset: SampleSet, by: str | None, folds: int) -> Protocol:
    r"""Returns the protocol of a comparison. If :obj:`by` is left out, samples are split by trial.
    Samples without trials are split by group if there are enough groups, otherwise by frame.

    Args:
        dataset (StaticDataset): The samples.
        by (str, optional): The unit that a split keeps together, or :obj:`"given"`.
        folds (int): The number of folds.

    Raises:
        ValueError: If there are fewer than three units, or windows of several parts overlap.
    """
    if by is None:
        by = _default_unit(dataset)
        _warn_of_seen_units(dataset, by)
    if by == "given":
        with sharing_ignored():
            Protocol("given").split(dataset)  # raises an error if there are no parts
        _check_frames_apart(dataset, by)
        return Protocol("given")
    num_units = _count_units(dataset, by)
    if num_units < _MIN_UNITS:
        smaller_units = {"trial": "frame", "frame": ""}.get(by, "trial or by frame")
        hint = f"; compare by {smaller_units}, which is a weaker test" if smaller_units else ""
        raise ValueError(
            f"'dataset' must have at least {_MIN_UNITS} {by}s, to train, to select and to test on "
            f"(got {num_units}){hint}"
        )
    need_argument(
        num_units > _MIN_UNITS or folds >= _MIN_UNITS,
        "folds",
        f"must be at least 3 for 3 {by}s, so that 2 are left to train and to select on",
        folds,
    )
    _check_frames_apart(dataset, by)
    return balanced_protocol(dataset, by, folds)


def _default_unit(dataset: SampleSet) -> str:
    if dataset.column("trial") is not None:
        return "trial"
    kind = dataset.group_kind
    num_groups, obstacle = _count_groups(dataset), ""
    if num_groups:
        obstacle = _describe_group_obstacle(dataset, num_groups)
        if not obstacle:
            _logger.warning(
                "the samples have no 'trial' and are split by %s (%d of them): the scores hold for "
                "a new %s. If each sample is a separate touch and new %ss do not matter, add "
                "'--by frame' to split single samples",
                *(kind, num_groups, kind, kind),
            )
            return "group"
    units = [by for by in ("group", "session") if dataset.column(by) is not None]
    hints = " or ".join(f"'--by {by}'" for by in units)
    _logger.warning(
        "the samples have no 'trial' and are split one by one%s: if several samples come from one "
        "touch, the scores are too high for a new touch%s",
        f", since {obstacle}" if obstacle else "",
        f" ({hints} holds out whole {'s or '.join(units)}s)" if units else "",
    )
    return "frame"


def _warn_of_seen_units(dataset: SampleSet, by: str) -> None:
    # Warns of units that the user has named, such as persons in the pattern of file names, and that
    # are in both parts of a split by another unit.
    column = column_of(dataset, by)
    num_parted = len(dataset) if column is None else len(np.unique(column))
    for name in getattr(innermost(dataset), "named_units", ()):
        column = column_of(dataset, name)
        num_units = 0 if column is None else len(np.unique(column))
        if name != by and 1 < num_units < num_parted:
            _logger.warning(
                "samples are split by %s: the %d values of '%s' are in both the training and the "
                "test part, so the scores do not hold for a new %s; add '--by %s' for such scores",
                *(by, num_units, name, name, name),
            )


def _count_groups(dataset: SampleSet) -> int:
    group = column_of(dataset, "group")
    return 0 if group is None else len(np.unique(group))


def _describe_group_obstacle(dataset: SampleSet, num_groups: int) -> str:
    # Returns why samples without trials cannot be split by group, or an empty text if they can.
    if num_groups < _MIN_UNITS:
        return f"at least {_MIN_UNITS} groups are needed to split by group (got {num_groups})"
    group, y = column_of(dataset, "group"), column_of(dataset, "y")
    if group is None or y is None or y.ndim != 1 or y.dtype.kind == "f":
        return ""
    classes = np.unique(y)
    num_single = sum(len(np.unique(group[y == label])) == 1 for label in classes)
    if 2 * num_single > len(classes):  # for example, if groups are objects and objects are classes
        counts = f"{num_single} of {len(classes)} classes"
        return f"{counts} are in a single group and cannot be learned"
    return ""


def _check_frames_apart(dataset: SampleSet, by: str) -> None:
    # Checks that no frame of a window or trial can be in two parts of a split.
    if not isinstance(dataset, FrameView):
        return
    if by == "frame" and isinstance(dataset, Windows):
        reach = dataset.length + dataset.horizon
        if dataset.hop < reach:
            parts = "windows" if not dataset.horizon else "windows and the frames of their labels"
            raise ArgumentError(
                Argument("by"),
                f" must be 'trial' or 'group' where {parts} overlap (got 'frame', with windows "
                f"of {dataset.length} frames every {dataset.hop}), so that no frame is in both "
                f"parts of a split; or set 'hop' to at least {reach}",
            )
        _logger.warning(
            "windows are split one by one: windows of one trial are in both parts, and the scores "
            "are too high for a new trial"
        )
    if by not in ("frame", "trial"):
        _check_constant_in_trials(dataset.dataset, "part" if by == "given" else by)


def _check_constant_in_trials(frames: SampleSet, key: str) -> None:
    value, trial = frames.column(key), frames.column("trial")
    if not isinstance(value, Tensor) or trial is None or not len(trial):
        return  # the split raises an error for a missing column
    changed = (value[1:] != value[:-1]) & (trial[1:] == trial[:-1])
    if changed.any():
        number = int(trial[int(changed.nonzero()[0])])
        raise ValueError(
            f"'{key}' must be the same in all frames of a trial if samples have several frames "
            f"(got two values in trial {number})"
        )


def mean_training_size(source: DataSource, protocol: Protocol) -> float:
    r"""Returns the mean number of selected samples in a training part over the folds. Given
    validation parts belong to the training part.

    Args:
        source (DataSource): The samples.
        protocol (Protocol): The splits.
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
    experiment: Experiment, repeats: int, max_samples: int | None = None
) -> tuple[SampleSet, SampleSet, list[tuple[SampleSet, SampleSet]]]:
    r"""Returns the training part, the test part, and cuts of the training part. Each cut has a part
    to train on and a validation part. The validation part is a different fifth of the training part
    in each cut, and is split by the same unit as the test part. A given validation part is used
    unchanged, in a single cut.

    Args:
        experiment (Experiment): The experiment.
        repeats (int): The largest number of cuts.
        max_samples (int, optional): Largest number of samples to train on. If there are more, a
            random subset is used.
    """
    protocol = experiment.protocol
    if protocol.by == "given":
        dataset, split = experiment.data.load(), experiment.data.split(protocol)
        if len(split.val):
            train = torch.cat([split.train, split.val]).sort().values
            part = _draw_samples(dataset[split.train], max_samples, experiment.seed)
            return dataset[train], dataset[split.test], [(part, dataset[split.val])]
    train_part, test = experiment.data.parts(protocol, experiment.seed, experiment.fold)
    by = _new_unit(train_part, test) if protocol.by == "given" else protocol.by
    inner = balanced_protocol(train_part, by, quiet=True)
    with warnings.catch_warnings():
        # Splitting off the test part already warned of classes with few units.
        warnings.simplefilter("ignore")
        folds = range(min(repeats, inner.folds or 1))
        cuts = [inner.split(train_part, experiment.seed, fold=fold) for fold in folds]
    parts = [(train_part[cut.train], train_part[cut.test]) for cut in cuts]
    return (
        train_part,
        test,
        [(_draw_samples(part, max_samples, experiment.seed), val) for part, val in parts],
    )


def _new_unit(train: SampleSet, test: SampleSet) -> str:
    # Returns the largest unit that is new in the test part. Groups count if more than half of them
    # are new (see ScoreUnits).
    for by in ("group", "trial"):
        train_units, test_units = (column_of(part, by) for part in (train, test))
        if train_units is None or test_units is None or len(np.unique(train_units)) < 2:
            continue
        units = np.unique(test_units)
        num_leaked = int(np.isin(units, train_units).sum())
        if num_leaked == 0 or (by == "group" and 2 * num_leaked < len(units)):
            return by
    return "frame"


def _draw_samples(part: SampleSet, max_samples: int | None, seed: int) -> SampleSet:
    if max_samples is None or len(part) <= max_samples:
        return part
    rng = np.random.default_rng(seed)
    return part[torch.from_numpy(np.sort(rng.permutation(len(part))[:max_samples]))]


def column_of(dataset: SampleSet, key: str) -> np.ndarray | None:
    r"""Returns an attribute or unit of the samples as an array, or :obj:`None` if it is missing."""
    column = unit_column(dataset, key)
    return None if column is None else np.asarray(column.numpy(force=True))
