r"""Detection of trials, groups, sessions and copies of recordings that parts of a split share."""

import hashlib
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple
from weakref import ref

import numpy as np
import torch
from torch import Tensor

from torch_geometric_tactile._texts import short_list
from torch_geometric_tactile.data._graph_samples import AnySamples as Samples
from torch_geometric_tactile.data._graph_samples import GraphSamples, as_samples, sample_column
from torch_geometric_tactile.data._sample_units import unit_column
from torch_geometric_tactile.data.static_data import StaticData

_UNITS = ("trial", "group", "session")
# Trials are first compared by a few readings. Trials that agree are compared completely.
_NUM_PROBE_FRAMES = 8  # per trial
_NUM_PROBE_READINGS = 64  # per frame
# Equal readings with fewer different values than this, such as all zeros, do not prove a copy.
_MIN_VALUES = 8
_MAX_LISTED_UNITS = 3  # in a message


class SharedDataWarning(UserWarning):
    r"""The warning that parts of a split share a trial, or have copies of a recording under
    different trial numbers.
    """


class Copy(NamedTuple):
    r"""Two trials with the same readings. Without trials, they are samples.

    Args:
        held_out (int): Number of the trial that is held out.
        original (int): Number of the trial in an earlier part of the split.
    """

    held_out: int
    original: int


_Groups = list[tuple[int, ...]]
_cache: dict[int, tuple["ref[StaticData]", _Groups]] = {}
_MAX_CACHED = 8


def num_shared(values: Tensor, first: Tensor, second: Tensor) -> int:
    r"""Returns how many different values two sets of samples have in common.

    Args:
        values (torch.Tensor): An attribute of the samples :math:`(S,)`, such as :obj:`trial`.
        first (torch.Tensor): Indices of the samples in the first set.
        second (torch.Tensor): Indices of the samples in the second set.

    Examples:
        >>> trial = torch.tensor([0, 0, 1, 1, 2])
        >>> num_shared(trial, torch.tensor([0, 2]), torch.tensor([1, 3, 4]))
        2
    """
    return len(_shared_values(values, first, second))


def shared_units(
    dataset: Samples, split: Sequence[Tensor], units: Sequence[str] = _UNITS
) -> dict[str, list[int]]:
    r"""Returns the trials, groups and sessions that are in more than one part of a split.

    Args:
        dataset (StaticDataset or StaticData): The samples.
        split (Split): The indices of the samples of each part.
        units (sequence of str): Names of the units. They may be names in the metadata of trials,
            such as :obj:`"person"`.

    Returns:
        dict: For each unit that the samples have, the numbers that are in more than one part.

    Examples:
        >>> data = StaticData(x=torch.zeros(4, 1, 1), trial=torch.tensor([0, 0, 1, 1]))
        >>> parts = (torch.tensor([0, 2]), torch.tensor([], dtype=torch.long), torch.tensor([1, 3]))
        >>> shared_units(data, parts)
        {'trial': [0, 1]}
    """
    unit_numbers = {}
    dataset = as_samples(dataset)
    for unit in units:
        values = unit_column(dataset, unit)
        if values is not None and values.dim() == 1:
            shared = {
                number
                for i, second in enumerate(split)
                for first in split[:i]
                for number in _shared_values(values, first, second)
            }
            unit_numbers[unit] = sorted(shared)
    return unit_numbers


def shared_recordings(dataset: Samples, split: Sequence[Tensor]) -> list[Copy]:
    r"""Returns the trials that have the same readings, frame by frame, as a trial with another
    number in an earlier part of a split. Without trials, samples are compared.

    Trials with fewer than eight different readings, for example of a sensor at rest, are ignored,
    since equal readings do not prove a copy there.

    Args:
        dataset (StaticDataset or StaticData): The samples. For windows and complete trials, the
            frames from which they are cut are compared.
        split (Split): The indices of the samples of each part.
    """
    dataset = as_samples(dataset)
    groups = _equal_recordings(dataset)
    if not groups:
        return []
    numbers = sample_column(dataset, "trial")
    if numbers is None:
        indices = None if isinstance(dataset, StaticData) else dataset._indices
        size = dataset.num_samples if isinstance(dataset, StaticData) else len(dataset)
        numbers = torch.arange(size) if indices is None else torch.as_tensor(list(indices))
    parts = [set(numbers[part].unique().tolist()) for part in split]
    return [
        Copy(held_out, original)
        for group in groups
        for held_out in group
        if (original := _find_original(held_out, group, parts)) is not None
    ]


def describe_shared(
    dataset: Samples, splits: Sequence[Sequence[Tensor]], *, with_units: bool
) -> list[str]:
    r"""Returns the reasons why scores are too high, one sentence each: units, and copies of
    recordings, that are in several parts of a split.

    Args:
        dataset (StaticDataset or StaticData): The samples.
        splits (sequence of Split): The indices of the samples of each part, for each split.
        with_units (bool): Whether to report trials that are in several parts, which happens if a
            data set defines its parts. Without trials, groups or else sessions are reported.
    """
    sentences = []
    units = [shared_units(dataset, split) for split in splits] if with_units else []
    for unit in [unit for unit in _UNITS if units and unit in units[0]][:1]:
        numbers = sorted({number for shared in units for number in shared[unit]})
        if numbers:
            name_list = short_list(
                [_unit_name(dataset, number, unit) for number in numbers], _MAX_LISTED_UNITS
            )
            sentences.append(
                f"{len(numbers)} {unit}s are in more than one part ({name_list}): the scores "
                f"measure how well models recognise these {unit}s and are too high for new ones; "
                f"give all samples of a {unit} the same 'part', or split by {unit}"
            )
    copies = sorted({copy for split in splits for copy in shared_recordings(dataset, split)})
    if copies:
        unit = "sample" if sample_column(dataset, "trial") is None else "trial"
        pairs = [
            f"{_unit_name(dataset, copy.held_out, unit)} is "
            f"{_unit_name(dataset, copy.original, unit)}"
            for copy in copies
        ]
        sentences.append(
            f"{len({copy.held_out for copy in copies})} {unit}s have the same readings as a {unit} "
            f"in another part ({short_list(pairs, _MAX_LISTED_UNITS)}), so the scores are too "
            "high: remove the copies"
        )
    return sentences


def warn_of_shared(dataset: Samples, split: Sequence[Tensor], *, with_units: bool) -> None:
    r"""Issues a :class:`SharedDataWarning` for each sentence of :func:`describe_shared`."""
    for sentence in describe_shared(dataset, [split], with_units=with_units):
        warnings.warn(sentence, SharedDataWarning, stacklevel=4)


@contextmanager
def sharing_ignored() -> Iterator[None]:
    r"""Suppresses each :class:`SharedDataWarning` within the context, for callers that report
    shared data once for all splits.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SharedDataWarning)
        yield


def _find_original(number: int, group: tuple[int, ...], parts: Sequence[set[int]]) -> int | None:
    # Returns a trial of the group in an earlier part of the split than `number`.
    is_member = [number in part for part in parts]
    if not any(is_member):
        return None
    earlier = set().union(*parts[: is_member.index(True)]) - {number}
    return next((candidate for candidate in group if candidate in earlier), None)


def _shared_values(values: Tensor, first: Tensor, second: Tensor) -> list[int]:
    values = values.cpu()
    first_values, second_values = (
        np.unique(values[part.cpu()].numpy()) for part in (first, second)
    )
    return [int(value) for value in np.intersect1d(first_values, second_values, assume_unique=True)]


def _unit_name(dataset: Samples, number: int, unit: str) -> str:
    names = getattr(dataset, f"{unit}_names", None) or ()
    name = names[number] if 0 <= number < len(names) else str(number)
    return f"{unit} {number}" if name == str(number) else f"{unit} '{name}'"


def _equal_recordings(dataset: Any) -> _Groups:
    # Returns groups of stored trials with the same readings. Without trials, groups of samples.
    if isinstance(dataset, GraphSamples):
        return _equal_graph_recordings(dataset)
    while not isinstance(dataset, StaticData) and hasattr(dataset, "dataset"):
        dataset = dataset.dataset  # the frames of a view
    data = dataset if isinstance(dataset, StaticData) else dataset._data
    if not isinstance(data, StaticData):
        return []
    # The comparison reads all readings, so it is cached for each data set. The reference ensures
    # that the identity has not been reused by another object.
    reference, groups = _cache.get(id(data), (None, []))
    if reference is None or reference() is not data:
        x, trial = sample_column(data, "x"), sample_column(data, "trial")
        is_usable = x is not None and not data.is_shared("x") and len(x) == data.num_samples
        groups = _group_equal_trials(x, trial) if is_usable and x is not None else []
        _cache[id(data)] = (ref(data), groups)
        for key in list(_cache)[:-_MAX_CACHED]:
            _cache.pop(key, None)
    return groups


def _equal_graph_recordings(dataset: GraphSamples) -> _Groups:
    # Like `_equal_recordings`, for samples with different numbers of taxels.
    samples = dataset.stored()
    trial = sample_column(samples, "trial")
    numbers = range(len(samples)) if trial is None else trial.tolist()
    codes: dict[int, Any] = {}
    values: dict[int, set[float]] = {}
    for i, number in enumerate(numbers):
        x = samples[i].x
        if not isinstance(x, Tensor):
            return []
        code = codes.setdefault(number, hashlib.blake2b())
        code.update(f"{x.dtype} {tuple(x.shape)}".encode())
        code.update(_bytes(x.reshape(1, -1)).tobytes())
        distinct = values.setdefault(number, set())
        if len(distinct) < _MIN_VALUES:
            distinct.update(x.unique()[:_MIN_VALUES].tolist())
    groups: dict[bytes, list[int]] = {}
    for number in sorted(codes):
        if len(values[number]) >= _MIN_VALUES:
            groups.setdefault(codes[number].digest(), []).append(number)
    return [tuple(group) for group in groups.values() if len(group) > 1]


def _group_equal_trials(x: Tensor, trial: Tensor | None) -> _Groups:
    # Compares a few readings of each trial first, and only hashes complete trials if these agree.
    if len(x) < 2 or not x[0].numel():
        return []
    number, order, start, count = _unit_runs(len(x), trial)
    step = torch.linspace(0, 1, _NUM_PROBE_FRAMES if trial is not None else 1)
    place = start[:, None] + (step * (count[:, None] - 1)).long()
    columns = torch.linspace(0, x[0].numel() - 1, min(_NUM_PROBE_READINGS, x[0].numel())).long()
    probe = x.reshape(len(x), -1)[order[place.view(-1)]][:, columns].reshape(len(number), -1)
    _, code_index, num_units = np.unique(
        _row_codes(_bytes(probe), count.numpy()), return_inverse=True, return_counts=True
    )
    groups: dict[bytes, list[int]] = {}
    for i in np.flatnonzero(num_units[code_index] > 1).tolist():
        readings = x[order[int(start[i]) : int(start[i] + count[i])]]
        if len(readings.unique()) >= _MIN_VALUES:
            code = hashlib.blake2b(_bytes(readings.reshape(1, -1)).tobytes()).digest()
            groups.setdefault(code, []).append(int(number[i]))
    return [tuple(group) for group in groups.values() if len(group) > 1]


def _unit_runs(num_samples: int, trial: Tensor | None) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    # Returns the numbers of the trials, the order that sorts the samples by trial, and the start
    # and length of each trial in this order. Without trials, each sample is one trial.
    samples = torch.arange(num_samples)
    if trial is None:
        return samples, samples, samples, torch.ones_like(samples)
    order = trial.cpu().argsort(stable=True)
    number, count = trial.cpu()[order].unique_consecutive(return_counts=True)
    return number, order, count.cumsum(0) - count, count


def _row_codes(rows: np.ndarray, count: np.ndarray) -> np.ndarray:
    # Returns a hash of each row of bytes, which is equal for equal rows and rarely for others.
    words = np.pad(rows, ((0, 0), (0, -rows.shape[1] % 8))).view(np.uint64)
    words = np.concatenate([words, count[:, None].astype(np.uint64)], axis=1)
    factors = np.random.default_rng(0).integers(1, 2**63, words.shape[1], dtype=np.uint64) | 1
    codes: np.ndarray = (words * factors).sum(axis=1)  # modulo 2 ** 64
    return codes


def _bytes(rows: Tensor) -> np.ndarray:
    # All NaNs become the same NaN and both zeros the same zero, so that equal readings have equal
    # bytes.
    rows = rows.detach().cpu()
    if rows.is_floating_point():
        rows = torch.where(rows.isnan(), torch.nan, rows) + 0.0
    return rows.contiguous().view(torch.uint8).numpy()
