r"""Trials, groups, sessions and copies of recordings that are in several parts of a split."""

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
from torch_geometric_tactile.data.static_data import StaticData

_UNITS = ("trial", "group", "session")
_NUM_PROBED_FRAMES = 8  # of a trial, and
_NUM_PROBED_READINGS = 64  # of a frame, by which trials are compared first
_MIN_VALUES = 8  # different readings, without which equal ones are no evidence
_NUM_NAMED = 3  # trials in a message


class SharedDataWarning(UserWarning):
    r"""The parts of a split share a trial, or the same recording under two numbers."""


class Copy(NamedTuple):
    r"""Two trials (or samples, without trials) with the same readings: the number of the one that
    is held out, and that of the one in an earlier part.
    """

    held_out: int
    known: int


_Groups = list[tuple[int, ...]]
_cache: dict[int, tuple["ref[StaticData]", _Groups]] = {}
_MAX_CACHED = 8


def num_shared(values: Tensor, first: Tensor, second: Tensor) -> int:
    r"""Returns how many different values two sets of samples have in common.

    Args:
        values (torch.Tensor): An attribute of the samples :math:`(S,)`, such as :obj:`trial`.
        first (torch.Tensor): Indices of samples.
        second (torch.Tensor): Indices of others.

    Examples:
        >>> trial = torch.tensor([0, 0, 1, 1, 2])
        >>> num_shared(trial, torch.tensor([0, 2]), torch.tensor([1, 3, 4]))
        2
    """
    return len(_shared(values, first, second))


def shared_units(dataset: Samples, split: Sequence[Tensor]) -> dict[str, list[int]]:
    r"""Returns which trials, groups and sessions are in more than one part of a split.

    Args:
        dataset (StaticDataset or StaticData): The samples.
        split (Split): The indices of its parts.

    Returns:
        dict: The numbers of the members that are shared, for each of :obj:`"trial"`,
        :obj:`"group"` and :obj:`"session"` that the samples have.

    Examples:
        >>> data = StaticData(x=torch.zeros(4, 1, 1), trial=torch.tensor([0, 0, 1, 1]))
        >>> parts = (torch.tensor([0, 2]), torch.tensor([], dtype=torch.long), torch.tensor([1, 3]))
        >>> shared_units(data, parts)
        {'trial': [0, 1]}
    """
    found = {}
    dataset = as_samples(dataset)
    for unit in _UNITS:
        values = sample_column(dataset, unit)
        if values is not None and values.dim() == 1:
            shared = {
                number
                for i, second in enumerate(split)
                for first in split[:i]
                for number in _shared(values, first, second)
            }
            found[unit] = sorted(shared)
    return found


def shared_recordings(dataset: Samples, split: Sequence[Tensor]) -> list[Copy]:
    r"""Returns which trials of a part have the same readings, frame by frame, as a trial of another
    number in an earlier part; without trials, which samples.

    Readings with fewer than eight different values, such as those of a sensor at rest, are no
    evidence, and left out.

    Args:
        dataset (StaticDataset or StaticData): The samples. Of windows and whole trials, the frames
            that they are cut from are compared.
        split (Split): The indices of the parts.
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
        Copy(held_out, known)
        for group in groups
        for held_out in group
        if (known := _known_copy(held_out, group, parts)) is not None
    ]


def describe_shared(
    dataset: Samples, splits: Sequence[Sequence[Tensor]], *, given: bool
) -> list[str]:
    r"""Returns what makes the scores of some splits too high, a sentence each.

    Args:
        dataset (StaticDataset or StaticData): The samples.
        splits (sequence of Split): The indices of the parts of each split.
        given (bool): Whether the parts were given, not drawn: then trials in several parts are
            told too; without trials groups, and without these sessions.
    """
    sentences = []
    units = [shared_units(dataset, split) for split in splits] if given else []
    for unit in [unit for unit in _UNITS if units and unit in units[0]][:1]:
        numbers = sorted({number for shared in units for number in shared[unit]})
        if numbers:
            listed = short_list([_name(dataset, number, unit) for number in numbers], _NUM_NAMED)
            sentences.append(
                f"{len(numbers)} {unit}s are in more than one part ({listed}): the scores tell how "
                f"well models recognise these {unit}s, and are too high for new ones; give all "
                f"samples of a {unit} the same 'part', or split by {unit}"
            )
    copies = sorted({copy for split in splits for copy in shared_recordings(dataset, split)})
    if copies:
        unit = "sample" if sample_column(dataset, "trial") is None else "trial"
        pairs = [
            f"{_name(dataset, copy.held_out, unit)} is {_name(dataset, copy.known, unit)}"
            for copy in copies
        ]
        sentences.append(
            f"{len({copy.held_out for copy in copies})} {unit}s have the same readings as a {unit} "
            f"in another part ({short_list(pairs, _NUM_NAMED)}), so that the scores are too high: "
            "remove the copies"
        )
    return sentences


def warn_of_shared(dataset: Samples, split: Sequence[Tensor], *, given: bool) -> None:
    r"""Warns of what :func:`describe_shared` returns."""
    for sentence in describe_shared(dataset, [split], given=given):
        warnings.warn(sentence, SharedDataWarning, stacklevel=4)


@contextmanager
def sharing_ignored() -> Iterator[None]:
    r"""Splits without warnings of what the parts share: a plan tells it once."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SharedDataWarning)
        yield


def _known_copy(number: int, group: tuple[int, ...], parts: Sequence[set[int]]) -> int | None:
    # A copy that is in an earlier part, and not in that of the number.
    own = [number in part for part in parts]
    if not any(own):
        return None
    earlier = set().union(*parts[: own.index(True)]) - {number}
    return next((other for other in group if other in earlier), None)


def _shared(values: Tensor, first: Tensor, second: Tensor) -> list[int]:
    values = values.cpu()
    one, other = (np.unique(values[part.cpu()].numpy()) for part in (first, second))
    return [int(value) for value in np.intersect1d(one, other, assume_unique=True)]


def _name(dataset: Samples, number: int, unit: str) -> str:
    names = getattr(dataset, f"{unit}_names", None) or ()
    name = names[number] if 0 <= number < len(names) else str(number)
    return f"{unit} {number}" if name == str(number) else f"{unit} '{name}'"


def _equal_recordings(dataset: Any) -> _Groups:
    # Trials, or samples without trials, of all stored samples that have the same readings.
    if isinstance(dataset, GraphSamples):
        return _equal_graphs(dataset)
    while not isinstance(dataset, StaticData) and hasattr(dataset, "dataset"):
        dataset = dataset.dataset  # the frames that a view cuts
    data = dataset if isinstance(dataset, StaticData) else dataset._data
    if not isinstance(data, StaticData):
        return []
    known, groups = _cache.get(id(data), (None, []))
    if known is None or known() is not data:  # it is compared once
        x, trial = sample_column(data, "x"), sample_column(data, "trial")
        is_usable = x is not None and not data.is_shared("x") and len(x) == data.num_samples
        groups = _find_equal(x, trial) if is_usable and x is not None else []
        _cache[id(data)] = (ref(data), groups)
        for key in list(_cache)[:-_MAX_CACHED]:
            _cache.pop(key, None)
    return groups


def _equal_graphs(dataset: GraphSamples) -> _Groups:
    # Of samples that may have any number of taxels each.
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


def _find_equal(x: Tensor, trial: Tensor | None) -> _Groups:
    if len(x) < 2 or not x[0].numel():
        return []
    number, order, start, count = _units(len(x), trial)
    step = torch.linspace(0, 1, _NUM_PROBED_FRAMES if trial is not None else 1)
    place = start[:, None] + (step * (count[:, None] - 1)).long()
    columns = torch.linspace(0, x[0].numel() - 1, min(_NUM_PROBED_READINGS, x[0].numel())).long()
    probe = x.reshape(len(x), -1)[order[place.view(-1)]][:, columns].reshape(len(number), -1)
    _, of_unit, size = np.unique(
        _row_codes(_bytes(probe), count.numpy()), return_inverse=True, return_counts=True
    )
    groups: dict[bytes, list[int]] = {}
    for i in np.flatnonzero(size[of_unit] > 1).tolist():  # the others differ already
        readings = x[order[int(start[i]) : int(start[i] + count[i])]]
        if len(readings.unique()) >= _MIN_VALUES:
            code = hashlib.blake2b(_bytes(readings.reshape(1, -1)).tobytes()).digest()
            groups.setdefault(code, []).append(int(number[i]))
    return [tuple(group) for group in groups.values() if len(group) > 1]


def _units(num_samples: int, trial: Tensor | None) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    # Number, order of the samples, first place in this order and length of each unit.
    samples = torch.arange(num_samples)
    if trial is None:
        return samples, samples, samples, torch.ones_like(samples)
    order = trial.cpu().argsort(stable=True)
    number, count = trial.cpu()[order].unique_consecutive(return_counts=True)
    return number, order, count.cumsum(0) - count, count


def _row_codes(rows: np.ndarray, count: np.ndarray) -> np.ndarray:
    # A number for each row of bytes: equal for equal rows, and rarely for others.
    words = np.pad(rows, ((0, 0), (0, -rows.shape[1] % 8))).view(np.uint64)
    words = np.concatenate([words, count[:, None].astype(np.uint64)], axis=1)
    factors = np.random.default_rng(0).integers(1, 2**63, words.shape[1], dtype=np.uint64) | 1
    codes: np.ndarray = (words * factors).sum(axis=1)  # modulo 2 ** 64
    return codes


def _bytes(rows: Tensor) -> np.ndarray:
    # Equal numbers have equal bytes: there are several kinds of NaN and zero.
    rows = rows.detach().cpu()
    if rows.is_floating_point():
        rows = torch.where(rows.isnan(), torch.nan, rows) + 0.0
    return rows.contiguous().view(torch.uint8).numpy()
