r"""What is drawn of the predictions for a recording, in arrays that are small."""

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
    MOST_COLUMNS,
    Lane,
    Phase,
    annotation_lanes,
    phases_of,
    reading_at_rest,
    title_parts,
)
from torch_geometric_tactile.visualization._truth import ANNOTATED, Truth, find_truth

_REST = 0.5  # seconds, as in `plot_recording`
_AT_REST, _SUSTAIN = 10, 3  # frames, as of `ContactCrop`
_FLOOR = 5.0  # counts


class PredictedTrial(NamedTuple):
    r"""The answers of a predictor over the time of a recording, and what was touched.

    Shapes:
        - **edges:** ends of the frames in seconds :math:`(T + 1,)`.
        - **answer_edges:** ends of the answers in seconds :math:`(R + 1,)`.
        - **last:** the last frame of each answer :math:`(R,)`.
        - **value:** probabilities or numbers :math:`(R, C)`.
        - **total:** sum of the lengths of all readings relative to rest :math:`(T,)`.
        - **contact:** number of taxels in contact :math:`(T,)`.
        - **gaps:** start and end in seconds of each time without frames :math:`(G, 2)`.
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
    def of(
        cls,
        predictor: Predictor,
        recording: Recording,
        probability: Tensor,
        frames: Sequence[int],
        truth: Truth | None = None,
    ) -> Self:
        r"""Returns what is drawn.

        Shapes:
            - **probability:** What :meth:`Predictor.recording` returned :math:`(R, C)`.
            - **frames:** The last frame of each row :math:`(R,)`.
        """
        names = predictor.names(probability.size(1))
        time = recording.time - recording.time[0]
        last = np.asarray(frames, dtype=np.int64)
        edges = _frame_edges(time)
        every_frame = np.array_equal(last, np.arange(len(time)))
        is_class = predictor.task != "regression"
        total = _total(recording, time)
        found = find_truth(recording, names, predictor.task) if truth is None else truth
        return cls(
            names,
            predictor.task,
            edges,
            edges if every_frame else _answer_edges(time[last], edges),
            last,
            probability.cpu().double().numpy(),
            predictor.labels(probability) if is_class and len(last) else [],
            found,
            total,
            _contact(recording, time),
            phases_of(recording, time),
            recording.gaps - recording.time[0],
            [] if found is not None and found.source == ANNOTATED else annotation_lanes(recording),
            UNITS.get(recording.meta.get("unit", ""), "unit unknown"),
            title_parts(recording),
        )

    @property
    def share_right(self) -> float | None:
        r"""The part of the answers that are true, of those frames whose class is known."""
        if self.truth is None or self.task != "multiclass":
            return None
        true = self.truth.value[self.last]
        pairs = [(t, p) for t, p in zip(true, self.predicted, strict=True) if t != "" and p]
        return sum(p[0] == t for t, p in pairs) / len(pairs) if pairs else None


def _frame_edges(time: np.ndarray) -> np.ndarray:
    step = float(np.median(np.diff(time))) if len(time) > 1 else 1.0
    middles = (time[1:] + time[:-1]) / 2
    return np.array([time[0] - step / 2, *middles, time[-1] + step / 2])


def _answer_edges(time: np.ndarray, edges: np.ndarray) -> np.ndarray:
    # An answer stands from the last frame of its window to that of the next.
    if len(time) == 0:
        return edges[:1]
    width = 0.03 * (edges[-1] - edges[0])
    step = float(np.median(np.diff(time))) if len(time) > 1 else np.inf
    return np.append(time, min(time[-1] + step, max(edges[-1], time[-1] + width)))


def _change(recording: Recording, time: np.ndarray) -> np.ndarray:
    if len(time) == 1:  # which has no rest: the taxels are compared with each other
        first = recording.tactile[0]
        seen = ~np.isnan(first).all(axis=0)
        center = np.zeros(first.shape[1], dtype=np.float32)
        center[seen] = np.nanmedian(first[:, seen], axis=0)
        return recording.tactile - center
    window = min(_REST, recording.duration / 10)
    change: np.ndarray = recording.tactile - reading_at_rest(recording.tactile, time, window)
    return change


def _total(recording: Recording, time: np.ndarray) -> np.ndarray:
    change = np.nan_to_num(_change(recording, time))
    total: np.ndarray = np.linalg.norm(change, axis=2).sum(axis=1, dtype=np.float64)
    return total


def _contact(recording: Recording, time: np.ndarray) -> np.ndarray | None:
    window = min(_REST, recording.duration / 10)
    rest = max(int((time <= window).sum()), _AT_REST)
    if recording.num_frames < rest + _SUSTAIN:
        return None
    tactile = recording.tactile
    whole = np.isnan(tactile) | (tactile == np.round(tactile))
    unit = recording.meta.get("unit")
    floor = _FLOOR if unit == "count" or (unit is None and whole.all()) else 0.0
    crop = ContactCrop(rest, floor=floor, sustain=_SUSTAIN)
    signals = torch.from_numpy(tactile.transpose(1, 2, 0).copy())
    stays = crop.stays_beyond(signals.unsqueeze(0))[0].any(dim=1)  # (N, T)
    contact = stays.clone()
    for i in range(1, _SUSTAIN):
        contact[:, i:] |= stays[:, : stays.size(1) - i]
    out: np.ndarray = contact.sum(dim=0).numpy()
    return out


def thinned_steps(edges: np.ndarray, value: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    r"""Returns steps of which no more are left than pixels can show: of each few the least and the
    greatest value, in their order.

    Shapes:
        - **edges:** :math:`(R + 1,)`
        - **value:** :math:`(R, K)`
    """
    if len(value) <= 2 * MOST_COLUMNS:
        return edges, value
    size = -(-len(value) // MOST_COLUMNS)
    starts = np.arange(0, len(value), size)
    low = np.where(np.isnan(value), np.inf, value)
    high = np.where(np.isnan(value), -np.inf, value)
    steps = []
    for part, least, most in zip(
        *(np.split(values, starts[1:]) for values in (value, low, high)), strict=True
    ):
        ends = np.sort([least.argmin(axis=0), most.argmax(axis=0)], axis=0)
        steps.append(np.take_along_axis(part, ends, axis=0))
    stops = np.append(starts[1:], len(value))
    middles = (edges[starts] + edges[stops]) / 2
    thin = np.append(np.stack([edges[starts], middles], axis=1).reshape(-1), edges[-1])
    return thin, np.concatenate(steps)


def thinned_codes(edges: np.ndarray, code: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    r"""Returns numbers of classes of which no more are left than pixels can show: of each few the
    most frequent.

    Shapes:
        - **edges:** :math:`(R + 1,)`
        - **code:** from -1 on :math:`(R,)`
    """
    if len(code) <= MOST_COLUMNS:
        return edges, code
    starts = np.arange(0, len(code), -(-len(code) // MOST_COLUMNS))
    parts = np.split(code + 1, starts[1:])
    most = np.array([np.bincount(part).argmax() for part in parts]) - 1
    return np.append(edges[starts], edges[-1]), most
