r"""How the frames of a data set were made: what those of its trials have in common."""

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

_MIN_FRAMES = 10  # of a trial, whose rate counts where there are longer ones
_MAX_LEFT_OUT = 5  # selected frames in a row, as of a phase, that may be missing
_MIN_SHARE = 0.5  # of the distances of selected frames that must be the same


class StoredTrials(NamedTuple):
    r"""The trials of all frames that a data set stores, also of those that are not selected.

    Shapes:
        - **start:** The first frame of each :math:`(R,)`.
        - **end:** The frame after the last :math:`(R,)`.
        - **time:** Times of all frames in seconds :math:`(S,)`; :obj:`None` if they are not known,
          or do not increase within the trials.
    """

    number: np.ndarray
    start: np.ndarray
    end: np.ndarray
    time: np.ndarray | None

    @classmethod
    def of(cls, data: Any) -> "StoredTrials | None":
        r"""Returns the trials of stored samples; :obj:`None` if they belong to none."""
        trial = data["trial"] if "trial" in data else None  # noqa: SIM401 - Data is no mapping
        if not isinstance(trial, Tensor) or trial.dim() != 1 or not len(trial):
            return None
        number, count = trial.cpu().unique_consecutive(return_counts=True)
        end = count.cumsum(0).numpy()
        start = end - count.numpy()
        return cls(number.numpy(), start, end, _increasing(data, start))

    def of_rows(self, rows: np.ndarray) -> np.ndarray:
        r"""Returns the place of the trial of each frame.

        Shapes:
            - **rows:** Frames :math:`(K,)`.
            - **output:** :math:`(K,)`
        """
        return np.searchsorted(self.start, rows, side="right") - 1


def _increasing(data: Any, start: np.ndarray) -> np.ndarray | None:
    value = data["time"] if "time" in data else None  # noqa: SIM401 - Data is no mapping
    if not isinstance(value, Tensor) or value.dim() != 1 or len(value) != data.num_samples:
        return None
    time = value.detach().cpu().double().numpy()
    rises = np.diff(time) > 0
    rises[start[1:] - 1] = True
    return time if rises.all() else None


class SelectedFrames(NamedTuple):
    r"""How the selected frames of a data set were made.

    Shapes:
        - **is_gap:** Whether time or frames are missing between a selected frame and the next
          :math:`(K - 1,)`.
    """

    info: FrameInfo
    is_gap: np.ndarray


def dataset_info(dataset: "StaticDataset", info: FrameInfo, *, with_rate: bool = True) -> FrameInfo:
    r"""Returns what is known of the frames of a data set, with its rate, largest gap and stride.

    Raises:
        ValueError: If its trials have several rates.
    """
    trials = _trials(dataset)
    if trials is None or not len(dataset):
        return info
    if dataset._indices is None and info.selected_rate is None:
        return _measured(dataset, trials, np.arange(len(trials.start)), info, with_rate)
    rows = _rows(dataset)
    of_row = trials.of_rows(rows)
    info = _measured(dataset, trials, np.unique(of_row), info, with_rate)
    steps = _steps(trials, rows, of_row, info)
    within = np.diff(of_row) == 0
    stride = _most_common(steps[within])
    return info.changed(stride=max(1, stride or 1))


def joined_info(dataset: "StaticDataset") -> FrameInfo:
    r"""Returns what a data set knows of its frames, without a rate if its trials have several: for
    samples of single frames or whole trials, to which it does not matter.
    """
    try:
        return dataset.info
    except ValueError:
        return dataset_info(dataset, dataset._known_info(), with_rate=False)


def selected_frames(
    dataset: "StaticDataset", info: FrameInfo, max_gap: float | None
) -> SelectedFrames:
    r"""Returns how the selected frames were made, and where time or frames are missing between
    them.

    Shapes:
        - **max_gap:** The largest distance of two frames in seconds that is no gap; that of
          :obj:`info` if left out.

    Raises:
        ValueError: If they are at no regular distances, such as drawn ones.
    """
    trials = _trials(dataset)
    info = info if max_gap is None else info.changed(max_gap=max_gap)
    if trials is None or trials.time is None or info.max_gap is None:
        return SelectedFrames(info, np.zeros(max(len(dataset) - 1, 0), bool))
    if dataset._indices is None and info.selected_rate is None:
        is_gap = gaps_in(trials.time, info.max_gap)
        is_gap[trials.start[1:] - 1] = False
        return SelectedFrames(info, is_gap)
    rows = _rows(dataset)
    of_row = trials.of_rows(rows)
    within = np.diff(of_row) == 0
    steps = _steps(trials, rows, of_row, info)
    irregular = within & (steps != info.stride)
    if irregular.sum() > _MIN_SHARE * max(within.sum(), 1):
        at = int(np.flatnonzero(irregular)[0])
        raise ValueError(
            "windows must be cut from frames at regular distances (got frame "
            f"{int(rows[at] - trials.start[of_row[at]])} of a trial and then frame "
            f"{int(rows[at + 1] - trials.start[of_row[at]])}): leave out samples_per_trial, or "
            "select frames with stride or rate"
        )
    part = info.part_numbers(trials.time, len(trials.time))[rows]
    is_left_out = (steps > _MAX_LEFT_OUT * info.stride) & np.isfinite(info.max_gap)
    is_gap = within & ((np.diff(part) != 0) | is_left_out)
    return SelectedFrames(info, is_gap)


def _trials(dataset: "StaticDataset") -> StoredTrials | None:
    data = dataset._data
    key = "_stored_trials"
    cached = dataset.__dict__.get(key)
    if cached is None or cached[0] is not data:
        cached = dataset.__dict__[key] = (data, StoredTrials.of(data), {})
    trials: StoredTrials | None = cached[1]
    return trials


def _rows(dataset: "StaticDataset") -> np.ndarray:
    if dataset._indices is None:
        return np.arange(dataset._data.num_samples)
    rows: np.ndarray = dataset._index().cpu().numpy()
    return rows


def _measured(
    dataset: "StaticDataset",
    trials: StoredTrials,
    chosen: np.ndarray,
    info: FrameInfo,
    with_rate: bool,
) -> FrameInfo:
    if not with_rate or trials.time is None or None not in (info.rate, info.max_gap):
        return info
    measured: dict[int, Rate] = dataset.__dict__["_stored_trials"][2]
    for i in chosen.tolist():
        if i not in measured:
            measured[i] = measure_rate(trials.time[trials.start[i] : trials.end[i]])
    length = (trials.end - trials.start)[chosen]
    min_length = min(_MIN_FRAMES, int(length.max()))
    counted = [i for i in chosen[length >= min_length].tolist() if np.isfinite(measured[i].rate)]
    if not counted:
        return info
    rates = {i: measured[i].rate for i in counted}
    gaps = [measured[i].max_gap for i in counted]
    names = trial_names(dataset, trials.number)
    if info.rate is not None:  # of the recordings, whose frames are not all stored
        return info.changed(max_gap=float(np.median(gaps)))
    if info.selected_rate is None:
        rate, tolerance = joined_rate(rates, names)
        return info.changed(rate=rate, tolerance=tolerance, max_gap=float(np.median(gaps)))
    # Recordings of any rate, from which frames at one rate were selected.
    return info.changed(rate=max(rates.values()), max_gap=max(gaps))


def trial_names(dataset: "StaticDataset", number: np.ndarray) -> list[str]:
    r"""Returns what to call trials in messages.

    Shapes:
        - **number:** Their numbers :math:`(R,)`.
    """
    names: Sequence[str] = dataset._names.get("trial", ())
    return [f"'{names[i]}'" if 0 <= i < len(names) else f"trial {i}" for i in number.tolist()]


def _steps(
    trials: StoredTrials, rows: np.ndarray, of_row: np.ndarray, info: FrameInfo
) -> np.ndarray:
    # From each selected frame to the next, in the frames that `selected_rate` leaves.
    if info.selected_rate is None or trials.time is None:
        return np.diff(rows)
    return np.diff(info.ticks(trials.time[rows] - trials.time[trials.start[of_row]])).astype(int)


def _most_common(steps: np.ndarray) -> int | None:
    if not len(steps):
        return None
    values, counts = np.unique(steps, return_counts=True)
    return int(values[counts.argmax()])


def selected_at_rate(time: Tensor, trial: Tensor, info: FrameInfo) -> Tensor:
    r"""Tells which frames are selected at a rate, see :meth:`FrameInfo.ticks`.

    Shapes:
        - **time:** Time of each frame in seconds, increasing in a trial :math:`(S,)`.
        - **trial:** Trial of each frame, those of one trial in a row :math:`(S,)`.
        - **output:** booleans :math:`(S,)`
    """
    kept = torch.zeros(len(time), dtype=torch.bool)
    _, counts = trial.unique_consecutive(return_counts=True)
    ends = counts.cumsum(0).tolist()
    for count, end in zip(counts.tolist(), ends, strict=True):
        seconds = time[end - count : end].double().numpy()
        index = info.changed(stride=1).selected_frames(seconds, count)
        kept[end - count + torch.from_numpy(index)] = True
    return kept
