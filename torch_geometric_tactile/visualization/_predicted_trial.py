r"""The predictions for a recording, reduced to small arrays for drawing."""

from collections.abc import Sequence
from typing import NamedTuple, Self

import numpy as np
import torch
from torch import Tensor

from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.data.recording import UNITS
from torch_geometric_tactile.predictor import Predictor
from torch_geometric_tactile.transforms import ContactCrop
from torch_geometric_tactile.visualization._time_panels import (
    MAX_COLUMNS,
    Lane,
    Phase,
    annotation_lanes,
    reading_at_rest,
    recording_phases,
    title_parts,
)
from torch_geometric_tactile.visualization._truth import ANNOTATED, Truth, find_truth

_REST_SECONDS = 0.5  # as in `plot_recording`
_MIN_REST_FRAMES, _SUSTAIN_FRAMES = 10, 3  # as in `ContactCrop`
_CONTACT_FLOOR = 5.0  # counts


class PredictedTrial(NamedTuple):
    r"""The predictions for a recording over time, with the truth, contact and total pressure.

    Shapes:
        - **edges:** boundaries of the frames in seconds :math:`(T + 1,)`
        - **answer_edges:** boundaries of the predictions in seconds :math:`(R + 1,)`
        - **last:** index of the last frame of each prediction :math:`(R,)`
        - **value:** probabilities or predicted numbers :math:`(R, C)`
        - **total:** sum over the taxels of the norms of readings relative to rest :math:`(T,)`
        - **contact:** number of taxels in contact :math:`(T,)`
        - **gaps:** start and end in seconds of each time without frames :math:`(G, 2)`
    """

    names: list[str]
    task: str
    edges: np.ndarray
    answer_edges: np.ndarray
    last: np.ndarray
    value: np.ndarray
    predicted: list[list[str]]
    truth: Truth | None
    total: np.ndarray
    contact: np.ndarray | None
    phases: list[Phase]
    gaps: np.ndarray
    lanes: list[Lane]
    unit: str
    title: list[str]

    @classmethod
    def from_predictions(
        cls,
        predictor: Predictor,
        recording: Recording,
        probability: Tensor,
        frames: Sequence[int],
        truth: Truth | None = None,
    ) -> Self:
        r"""Returns the trial of a recording and its predictions.

        Args:
            predictor (Predictor): The predictor.
            recording (Recording): The recording.
            probability (torch.Tensor): Output of :meth:`Predictor.recording`.
            frames (sequence of int): Index of the last frame of each row.
            truth (Truth, optional): True classes or numbers (default: from the recording).

        Shapes:
            - **probability:** :math:`(R, C)`
            - **frames:** :math:`(R,)`
        """
        names = predictor.names(probability.size(1))
        time = recording.time - recording.time[0]
        last = np.asarray(frames, dtype=np.int64)
        edges = _frame_edges(time)
        has_all_frames = np.array_equal(last, np.arange(len(time)))
        has_labels = predictor.task != "regression"
        total = _total_pressure(recording, time)
        if truth is None:
            truth = find_truth(recording, names, predictor.task)
        is_annotated = truth is not None and truth.source == ANNOTATED
        return cls(
            names,
            predictor.task,
            edges,
            edges if has_all_frames else _answer_edges(time[last], edges),
            last,
            probability.cpu().double().numpy(),
            predictor.labels(probability) if has_labels and len(last) else [],
            truth,
            total,
            _num_contacts(recording, time),
            recording_phases(recording, time),
            recording.gaps - recording.time[0],
            [] if is_annotated else annotation_lanes(recording),
            UNITS.get(recording.meta.get("unit", ""), "unit unknown"),
            title_parts(recording),
        )

    @property
    def accuracy(self) -> float | None:
        r"""The share of correctly predicted classes among frames with a known class. :obj:`None` if
        there are no such frames.
        """
        if self.truth is None or self.task != "multiclass":
            return None
        true = self.truth.value[self.last]
        pairs = [(t, p) for t, p in zip(true, self.predicted, strict=True) if t != "" and p]
        return sum(p[0] == t for t, p in pairs) / len(pairs) if pairs else None


def _frame_edges(time: np.ndarray) -> np.ndarray:
    step = float(np.median(np.diff(time))) if len(time) > 1 else 1.0
    centres = (time[1:] + time[:-1]) / 2
    return np.array([time[0] - step / 2, *centres, time[-1] + step / 2])


def _answer_edges(time: np.ndarray, edges: np.ndarray) -> np.ndarray:
    # A prediction is drawn from the last frame of its window to the last frame of the next window.
    if len(time) == 0:
        return edges[:1]
    width = 0.03 * (edges[-1] - edges[0])
    step = float(np.median(np.diff(time))) if len(time) > 1 else np.inf
    return np.append(time, min(time[-1] + step, max(edges[-1], time[-1] + width)))


def _change_from_rest(recording: Recording, time: np.ndarray) -> np.ndarray:
    if len(time) == 1:  # a single frame has no rest, so taxels are compared with their median
        first = recording.tactile[0]
        has_readings = ~np.isnan(first).all(axis=0)
        median = np.zeros(first.shape[1], dtype=np.float32)
        median[has_readings] = np.nanmedian(first[:, has_readings], axis=0)
        return recording.tactile - median
    window = min(_REST_SECONDS, recording.duration / 10)
    change: np.ndarray = recording.tactile - reading_at_rest(recording.tactile, time, window)
    return change


def _total_pressure(recording: Recording, time: np.ndarray) -> np.ndarray:
    change = np.nan_to_num(_change_from_rest(recording, time))
    total: np.ndarray = np.linalg.norm(change, axis=2).sum(axis=1, dtype=np.float64)
    return total


def _num_contacts(recording: Recording, time: np.ndarray) -> np.ndarray | None:
    window = min(_REST_SECONDS, recording.duration / 10)
    num_rest_frames = max(int((time <= window).sum()), _MIN_REST_FRAMES)
    if recording.num_frames < num_rest_frames + _SUSTAIN_FRAMES:
        return None
    tactile = recording.tactile
    is_integer = np.isnan(tactile) | (tactile == np.round(tactile))
    unit = recording.meta.get("unit")
    # Only counts need a floor; in other units its value would be arbitrary.
    has_counts = unit == "count" or (unit is None and is_integer.all())
    floor = _CONTACT_FLOOR if has_counts else 0.0
    crop = ContactCrop(num_rest_frames, floor=floor, sustain=_SUSTAIN_FRAMES)
    signals = torch.from_numpy(tactile.transpose(1, 2, 0).copy())
    # True where a taxel is beyond its threshold in this frame and the next ones, (N, T).
    starts_contact = crop.stays_beyond(signals.unsqueeze(0))[0].any(dim=1)
    contact = starts_contact.clone()
    for i in range(1, _SUSTAIN_FRAMES):
        contact[:, i:] |= starts_contact[:, : starts_contact.size(1) - i]
    num_contacts: np.ndarray = contact.sum(dim=0).numpy()
    return num_contacts


def thin_steps(edges: np.ndarray, value: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    r"""Returns a step function reduced to the resolution of a panel: the smallest and the largest
    value of each block of steps, in order.

    Shapes:
        - **edges:** boundaries of the steps :math:`(R + 1,)`
        - **value:** values of :math:`K` series :math:`(R, K)`
    """
    if len(value) <= 2 * MAX_COLUMNS:
        return edges, value
    size = -(-len(value) // MAX_COLUMNS)
    starts = np.arange(0, len(value), size)
    low = np.where(np.isnan(value), np.inf, value)
    high = np.where(np.isnan(value), -np.inf, value)
    steps = []
    for block, low_block, high_block in zip(
        *(np.split(values, starts[1:]) for values in (value, low, high)), strict=True
    ):
        extremes = np.sort([low_block.argmin(axis=0), high_block.argmax(axis=0)], axis=0)
        steps.append(np.take_along_axis(block, extremes, axis=0))
    stops = np.append(starts[1:], len(value))
    centres = (edges[starts] + edges[stops]) / 2
    thin_edges = np.append(np.stack([edges[starts], centres], axis=1).reshape(-1), edges[-1])
    return thin_edges, np.concatenate(steps)


def thin_codes(edges: np.ndarray, code: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    r"""Returns class indices over time reduced to the resolution of a panel: the most frequent
    index of each block of steps.

    Shapes:
        - **edges:** boundaries of the steps :math:`(R + 1,)`
        - **code:** class indices, at least -1 :math:`(R,)`
    """
    if len(code) <= MAX_COLUMNS:
        return edges, code
    starts = np.arange(0, len(code), -(-len(code) // MAX_COLUMNS))
    blocks = np.split(code + 1, starts[1:])
    most_frequent = np.array([np.bincount(block).argmax() for block in blocks]) - 1
    return np.append(edges[starts], edges[-1]), most_frequent
