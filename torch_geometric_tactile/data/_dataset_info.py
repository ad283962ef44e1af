r"""Properties of the frames of a data set: the rate, largest gap and stride of its trials."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from torch_geometric_tactile.data._gaps import gaps_in, joined_rate
from torch_geometric_tactile.data.frame_info import FrameInfo
from torch_geometric_tactile.data.frame_rate import Rate, measure_rate

if TYPE_CHECKING:
    from torch_geometric_tactile.data.static_dataset import StaticDataset

_MIN_FRAMES = 10  # shorter trials are ignored in the rate, unless all trials are shorter
_MAX_SKIPPED = 5  # frames in a row that a selection, such as one phase, may leave out of a window
_MIN_REGULAR_SHARE = 0.5  # share of the steps between selected frames that must be equal


class StoredTrials(NamedTuple):
    r"""The trials of all frames that a data set stores, including frames that are not selected.

    Shapes:
        - **number:** The number of each trial :math:`(R,)`.
        - **start:** The first frame of each trial :math:`(R,)`.
        - **end:** The first frame after each trial :math:`(R,)`.
        - **time:** Times of all frames in seconds :math:`(S,)`; :obj:`None` if the times are
          unknown or do not increase within the trials.
    """

    number: np.ndarray
    start: np.ndarray
    end: np.ndarray
    time: np.ndarray | None

    @classmethod
    def from_data(cls, data: Any) -> "StoredTrials | None":
        r"""Returns the trials of stored samples; :obj:`None` if the samples have no trials."""
        trial = data["trial"] if "trial" in data else None  # noqa: SIM401 - Data is no mapping
        if not isinstance(trial, Tensor) or trial.dim() != 1 or not len(trial):
            return None
        number, count = trial.cpu().unique_consecutive(return_counts=True)
        end = count.cumsum(0).numpy()
        start = end - count.numpy()
        return cls(number.numpy(), start, end, _increasing_time(data, start))

    def trial_indices(self, rows: np.ndarray) -> np.ndarray:
        r"""Returns the index of the trial of each frame.

        Shapes:
            - **rows:** Frames :math:`(K,)`.
            - **output:** :math:`(K,)`
        """
        return np.searchsorted(self.start, rows, side="right") - 1


def _increasing_time(data: Any, start: np.ndarray) -> np.ndarray | None:
    value = data["time"] if "time" in data else None  # noqa: SIM401 - Data is no mapping
    if not isinstance(value, Tensor) or value.dim() != 1 or len(value) != data.num_samples:
        return None
    time = value.detach().cpu().double().numpy()
    increases = np.diff(time) > 0
    increases[start[1:] - 1] = True  # a new trial may begin at any time
    return time if increases.all() else None


class SelectedFrames(NamedTuple):
    r"""The properties of the selected frames of a data set, and the gaps between these frames.

    Shapes:
        - **is_gap:** Whether time or frames are missing between a selected frame and the next one
          :math:`(K - 1,)`.
    """

    info: FrameInfo
    is_gap: np.ndarray


def dataset_info(dataset: "StaticDataset", info: FrameInfo, *, with_rate: bool = True) -> FrameInfo:
    r"""Adds the measured rate, largest gap and stride of a data set to the known properties of its
    frames.

    Args:
        dataset (StaticDataset): The frames, or a selection of them.
        info (FrameInfo): The properties that are known without measuring.
        with_rate (bool): Whether to measure the rate and the largest gap.

    Raises:
        ValueError: If the trials have several rates.
    """
    trials = _cached_trials(dataset)
    if trials is None or not len(dataset):
        return info
    if dataset._indices is None and info.selected_rate is None:
        return _with_measured_rate(dataset, trials, np.arange(len(trials.start)), info, with_rate)
    rows = _selected_rows(dataset)
    trial_index = trials.trial_indices(rows)
    info = _with_measured_rate(dataset, trials, np.unique(trial_index), info, with_rate)
    steps = _frame_steps(trials, rows, trial_index, info)
    is_within = np.diff(trial_index) == 0
    stride = _most_common(steps[is_within])
    return info.changed(stride=max(1, stride or 1))


def joined_info(dataset: "StaticDataset") -> FrameInfo:
    r"""Returns the properties of the frames of a data set, without a rate if its trials have
    several rates. Used for samples that are single frames or whole trials, for which the rate does
    not matter.
    """
    try:
        return dataset.info
    except ValueError:
        return dataset_info(dataset, dataset._known_info(), with_rate=False)


def selected_frames(
    dataset: "StaticDataset", info: FrameInfo, max_gap: float | None
) -> SelectedFrames:
    r"""Returns the properties of the selected frames, and where time or frames are missing between
    them.

    Args:
        dataset (StaticDataset): The frames, or a selection of them.
        info (FrameInfo): The properties of the frames.
        max_gap (float, optional): The largest time in seconds between two frames that is not a gap.
            If left out, :obj:`max_gap` of :obj:`info` is used.

    Raises:
        ValueError: If the selected frames are irregular, such as randomly drawn frames.
    """
    trials = _cached_trials(dataset)
    info = info if max_gap is None else info.changed(max_gap=max_gap)
    if trials is None or trials.time is None or info.max_gap is None:
        return SelectedFrames(info, np.zeros(max(len(dataset) - 1, 0), bool))
    if dataset._indices is None and info.selected_rate is None:
        is_gap = gaps_in(trials.time, info.max_gap)
        is_gap[trials.start[1:] - 1] = False
        return SelectedFrames(info, is_gap)
    rows = _selected_rows(dataset)
    trial_index = trials.trial_indices(rows)
    is_within = np.diff(trial_index) == 0
    steps = _frame_steps(trials, rows, trial_index, info)
    is_irregular = is_within & (steps != info.stride)
    if is_irregular.sum() > _MIN_REGULAR_SHARE * max(is_within.sum(), 1):
        i = int(np.flatnonzero(is_irregular)[0])
        raise ValueError(
            "windows must be cut from frames at regular intervals (got frame "
            f"{int(rows[i] - trials.start[trial_index[i]])} of a trial and then frame "
            f"{int(rows[i + 1] - trials.start[trial_index[i]])}): leave out samples_per_trial, or "
            "select frames with stride or rate"
        )
    part = info.part_numbers(trials.time, len(trials.time))[rows]
    is_skip = (steps > _MAX_SKIPPED * info.stride) & np.isfinite(info.max_gap)
    is_gap = is_within & ((np.diff(part) != 0) | is_skip)
    return SelectedFrames(info, is_gap)


def _cached_trials(dataset: "StaticDataset") -> StoredTrials | None:
    # Cached on the data set, together with the measured rates, until its samples are replaced:
    # otherwise, each access to `info` would compute them again.
    data = dataset._data
    key = "_stored_trials"
    cached = dataset.__dict__.get(key)
    if cached is None or cached[0] is not data:
        cached = dataset.__dict__[key] = (data, StoredTrials.from_data(data), {})
    trials: StoredTrials | None = cached[1]
    return trials


def _selected_rows(dataset: "StaticDataset") -> np.ndarray:
    if dataset._indices is None:
        return np.arange(dataset._data.num_samples)
    rows: np.ndarray = dataset._index().cpu().numpy()
    return rows


def _with_measured_rate(
    dataset: "StaticDataset",
    trials: StoredTrials,
    trial_index: np.ndarray,
    info: FrameInfo,
    with_rate: bool,
) -> FrameInfo:
    # Adds the rate and the largest gap over the trials in `trial_index`.
    if not with_rate or trials.time is None or None not in (info.rate, info.max_gap):
        return info
    trial_rates: dict[int, Rate] = dataset.__dict__["_stored_trials"][2]
    for i in trial_index.tolist():
        if i not in trial_rates:
            trial_rates[i] = measure_rate(trials.time[trials.start[i] : trials.end[i]])
    length = (trials.end - trials.start)[trial_index]
    min_length = min(_MIN_FRAMES, int(length.max()))
    rated_trials = [
        i for i in trial_index[length >= min_length].tolist() if np.isfinite(trial_rates[i].rate)
    ]
    if not rated_trials:
        return info
    rates = {i: trial_rates[i].rate for i in rated_trials}
    gaps = [trial_rates[i].max_gap for i in rated_trials]
    names = trial_names(dataset, trials.number)
    if info.rate is not None:  # the rate of the recordings, of which only some frames are stored
        return info.changed(max_gap=float(np.median(gaps)))
    if info.selected_rate is None:
        rate, tolerance = joined_rate(rates, names)
        return info.changed(rate=rate, tolerance=tolerance, max_gap=float(np.median(gaps)))
    # Frames were selected at one rate from recordings, which may have any rate.
    return info.changed(rate=max(rates.values()), max_gap=max(gaps))


def trial_names(dataset: "StaticDataset", number: np.ndarray) -> list[str]:
    r"""Returns the names of trials for messages; :obj:`"trial 3"` for a trial without a name.

    Shapes:
        - **number:** The numbers of the trials :math:`(R,)`.
    """
    names: Sequence[str] = dataset._names.get("trial", ())
    return [f"'{names[i]}'" if 0 <= i < len(names) else f"trial {i}" for i in number.tolist()]


def _frame_steps(
    trials: StoredTrials, rows: np.ndarray, trial_index: np.ndarray, info: FrameInfo
) -> np.ndarray:
    # Returns the step from each selected frame to the next, in frames after `selected_rate`.
    if info.selected_rate is None or trials.time is None:
        return np.diff(rows)
    return np.diff(info.ticks(trials.time[rows] - trials.time[trials.start[trial_index]])).astype(
        int
    )


def _most_common(steps: np.ndarray) -> int | None:
    if not len(steps):
        return None
    values, counts = np.unique(steps, return_counts=True)
    return int(values[counts.argmax()])


def selected_at_rate(time: Tensor, trial: Tensor, info: FrameInfo) -> Tensor:
    r"""Returns which frames are selected at a rate, see :meth:`FrameInfo.ticks`.

    Shapes:
        - **time:** Time of each frame in seconds, increasing in a trial :math:`(S,)`.
        - **trial:** Trial of each frame :math:`(S,)`. The frames of a trial must be consecutive.
        - **output:** booleans :math:`(S,)`
    """
    is_selected = torch.zeros(len(time), dtype=torch.bool)
    _, counts = trial.unique_consecutive(return_counts=True)
    ends = counts.cumsum(0).tolist()
    for count, end in zip(counts.tolist(), ends, strict=True):
        seconds = time[end - count : end].double().numpy()
        index = info.changed(stride=1).selected_frames(seconds, count)
        is_selected[end - count + torch.from_numpy(index)] = True
    return is_selected
