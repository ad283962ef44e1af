r"""Annotations of a recording: checked, cut, and frame by frame."""

import math
from collections.abc import Iterable, Mapping, Sequence
from numbers import Real
from typing import Any

import numpy as np

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.data._recording_arrays import check_utf8
from torch_geometric_tactile.data.annotation import Annotation

MOST_ANNOTATIONS = 10_000
OUTSIDE = "none"  # the class of frames outside of all annotations
GAP = "gap"  # the label of outages, which a recorder writes and which labels no frame
_LONGEST_LABEL = 255


def checked_annotations(value: Any) -> tuple[Annotation, ...]:
    r"""Returns annotations in the order of their starts."""
    if isinstance(value, str | Mapping) or not isinstance(value, Iterable):
        raise ValueError(
            f"'annotations' must be a sequence of (start, end, label) (got {type(value).__name__})"
        )
    found = [*value]
    if len(found) > MOST_ANNOTATIONS:
        raise ValueError(
            f"'annotations' must be at most {MOST_ANNOTATIONS} in one recording (got {len(found)})"
        )
    return tuple(sorted(checked_annotation(row) for row in found))


def checked_annotation(row: Any) -> Annotation:
    r"""Returns one annotation, of a start, an end and a label."""
    is_row = isinstance(row, list | tuple) and len(row) == 3
    need(is_row, "'annotations' must be a start, an end and a label each", f"{row!r:.80}")
    start, end, label = row
    try:
        start, end = (float(t) if isinstance(t, Real) else math.nan for t in (start, end))
    except OverflowError:
        start = math.inf
    if not (math.isfinite(start) and math.isfinite(end) and start <= end):
        raise ValueError(
            "'annotations' must have a finite start and an end that is not before it, in seconds "
            f"(got {row!r:.80})"
        )
    if (
        not isinstance(label, str)
        or not 0 < len(label) <= _LONGEST_LABEL
        or not label.isprintable()
        or label != label.strip()
    ):
        raise ValueError(
            f"'annotations' must have labels of 1 to {_LONGEST_LABEL} printable characters, "
            f"without blanks at the ends (got {label!r:.80})"
        )
    check_utf8("labels in 'annotations'", label)
    return Annotation(start, end, label)


def annotations_within(annotations: Sequence[Annotation], time: np.ndarray) -> list[Annotation]:
    r"""Returns those that overlap the time from the first to the last frame, cut to it.

    Shapes:
        - **time:** Time of each frame in seconds :math:`(T,)`.
    """
    if not len(time):
        return []
    first, last = float(time[0]), float(time[-1])
    return [
        Annotation(max(start, first), min(end, last), label)
        for start, end, label in annotations
        if start <= last and end >= first
    ]


def annotation_of_frames(annotations: Sequence[Annotation], time: np.ndarray) -> np.ndarray:
    r"""Returns the label of the annotation that covers each frame, and :obj:`"none"` outside of
    all. An annotation covers its ends; a frame where one ends and the next begins is of the next.
    One with the label :obj:`"gap"` is an outage, and covers none.

    Shapes:
        - **time:** Time of each frame in seconds :math:`(T,)`.
        - **output:** texts :math:`(T,)`
    """
    annotations = [annotation for annotation in annotations if annotation.label != GAP]
    width = max([len(OUTSIDE), *(len(label) for _, _, label in annotations)])
    labels = np.full(len(time), OUTSIDE, dtype=f"U{width}")
    until = np.full(len(time), -np.inf)
    for start, end, label in annotations:
        rows = slice(np.searchsorted(time, start), np.searchsorted(time, end, side="right"))
        twice = np.flatnonzero((labels[rows] != label) & (time[rows] < until[rows]))
        if len(twice):
            frame = int(rows.start + twice[0])
            raise ValueError(
                "annotations must not overlap to label frames, unless their label is the same (got "
                f"{str(labels[frame])!r} and {label!r} in frame {frame}, at {time[frame]:g} s)"
            )
        labels[rows] = label
        until[rows] = np.maximum(until[rows], end)
    return labels
