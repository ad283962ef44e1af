r"""Annotations of a recording: checked, cut, and frame by frame."""

import logging
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
#: The label of time without frames, which live recordings have from the last frame before an
#: outage to the first one after it. It is reserved, and never the label of a frame.
GAP = "gap"
_LONGEST_LABEL = 255
# An end is at a frame if it is closer to it than this part of the distance to the next frame: times
# that were rounded to milliseconds, at up to 100 frames a second.
_TOLERANCE = 0.05
_logger = logging.getLogger(__name__)


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


def without_gaps(annotations: Iterable[Annotation]) -> list[Annotation]:
    r"""Returns the annotations that label frames: all but those of time without frames."""
    return [annotation for annotation in annotations if annotation.label != GAP]


def annotations_within(annotations: Sequence[Annotation], time: np.ndarray) -> list[Annotation]:
    r"""Returns those that overlap the time from the first to the last frame, cut to it. One that
    ends at the first frame or begins at the last, but for rounding, is kept.

    Shapes:
        - **time:** Time of each frame in seconds :math:`(T,)`.
    """
    if not len(time):
        return []
    first, last = float(time[0]), float(time[-1])
    tolerance = _tolerance(time)
    earliest, latest = first - tolerance[0], last + tolerance[-1]
    return [
        Annotation(min(max(start, first), last), min(max(end, first), last), label)
        for start, end, label in annotations
        if start <= latest and end >= earliest
    ]


def annotation_of_frames(
    annotations: Sequence[Annotation], time: np.ndarray, where: str = "the recording"
) -> np.ndarray:
    r"""Returns the label of the annotation that covers each frame, and :obj:`"none"` outside of
    all. An annotation covers its ends; a frame where one ends and the next begins is of the next.
    Time without frames, labelled :obj:`"gap"`, labels none. A warning is logged of an annotation
    that meets no frame.

    Args:
        annotations (sequence of Annotation): The annotations, in the order of their starts.
        time (numpy.ndarray): Time of each frame in seconds :math:`(T,)`.
        where (str): How messages call the recording.

    Shapes:
        - **output:** texts :math:`(T,)`

    Raises:
        ValueError: If an annotation lies before the first frame or after the last one, or two with
            different labels overlap on a frame.
    """
    annotations = without_gaps(annotations)
    width = max([len(OUTSIDE), *(len(label) for _, _, label in annotations)])
    labels = np.full(len(time), OUTSIDE, dtype=f"U{width}")
    if not len(time):
        return labels
    tolerance = _tolerance(time)
    earliest, latest = time - tolerance, time + tolerance
    until = np.full(len(time), -np.inf)
    covered = []
    for annotation in annotations:
        start, end, label = annotation
        if start > latest[-1] or end < earliest[0]:
            raise ValueError(
                f"{where}: the annotation {label!r} must be within the recording, from "
                f"{float(time[0])!r} to {float(time[-1])!r} s (got {start!r} to {end!r} s): give "
                "its start and end in seconds on the clock of the recording"
            )
        rows = slice(np.searchsorted(latest, start), np.searchsorted(earliest, end, side="right"))
        twice = np.flatnonzero((labels[rows] != label) & (latest[rows] < until[rows]))
        if len(twice):
            frame = int(rows.start + twice[0])
            raise ValueError(
                f"{where}: annotations must not overlap to label frames, unless their label is the "
                f"same (got {str(labels[frame])!r} and {label!r} in frame {frame}, at "
                f"{time[frame]:g} s)"
            )
        labels[rows] = label
        until[rows] = np.maximum(until[rows], end)
        covered.append((annotation, rows))
    for (start, end, label), rows in covered:
        if not (labels[rows] == label).any():
            _logger.warning(
                "%s: the annotation %r from %r to %r s labels no frame: it is shorter than a "
                "frame, or no frame was recorded in its time",
                where,
                label,
                start,
                end,
            )
    return labels


def _tolerance(time: np.ndarray) -> np.ndarray:
    # How far an end may be from each frame to be at it: a part of the distance to the closer of its
    # neighbours, and what float64 rounds of times since 1970, but less than half of the distance.
    distance = np.concatenate([[np.inf], np.diff(time), [np.inf]])
    nearest = np.minimum(distance[:-1], distance[1:])
    rounding = 2 * np.spacing(np.abs(time))
    nearest = np.where(np.isfinite(nearest), nearest, 4 * rounding)  # of a single frame
    tolerance: np.ndarray = np.minimum(np.maximum(_TOLERANCE * nearest, rounding), 0.49 * nearest)
    return tolerance
