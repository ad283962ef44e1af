r"""Checks of annotations, cuts to a span of time, and labels of frames from annotations."""

import logging
import math
from collections.abc import Iterable, Mapping, Sequence
from numbers import Real
from typing import Any

import numpy as np

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.data._recording_arrays import check_utf8
from torch_geometric_tactile.data.annotation import Annotation

MAX_ANNOTATIONS = 10_000
OUTSIDE = "none"  # the class of frames outside all annotations
#: The label of a span without frames. Live recordings use it from the last frame before an outage
#: to the first frame after it. It is reserved and never the label of a frame.
GAP = "gap"
_MAX_LABEL_LENGTH = 255
# An annotation starts or ends at a frame if the difference in time is less than this part of the
# time to the next frame. This allows times rounded to milliseconds at up to 100 frames per second.
_TOLERANCE = 0.05
_logger = logging.getLogger(__name__)


def checked_annotations(value: Any) -> tuple[Annotation, ...]:
    r"""Checks annotations and returns them in the order of their starts.

    Raises:
        ValueError: If the annotations are not a sequence, an annotation is invalid, or there are
            too many.
    """
    if isinstance(value, str | Mapping) or not isinstance(value, Iterable):
        raise ValueError(
            f"'annotations' must be a sequence of (start, end, label) (got {type(value).__name__})"
        )
    rows = [*value]
    if len(rows) > MAX_ANNOTATIONS:
        raise ValueError(
            f"'annotations' must be at most {MAX_ANNOTATIONS} in one recording (got {len(rows)})"
        )
    return tuple(sorted(checked_annotation(row) for row in rows))


def checked_annotation(row: Any) -> Annotation:
    r"""Checks a start, an end and a label, and returns them as an annotation.

    Raises:
        ValueError: If a time is not finite, the end is before the start, or the label is not a
            short text.
    """
    is_row = isinstance(row, list | tuple) and len(row) == 3
    need(is_row, "'annotations' must each have a start, an end and a label", f"{row!r:.80}")
    start, end, label = row
    try:
        start, end = (float(t) if isinstance(t, Real) else math.nan for t in (start, end))
    except OverflowError:
        start = math.inf
    if not (math.isfinite(start) and math.isfinite(end) and start <= end):
        raise ValueError(
            "'annotations' must have a finite start, and an end not before the start, in seconds "
            f"(got {row!r:.80})"
        )
    if (
        not isinstance(label, str)
        or not 0 < len(label) <= _MAX_LABEL_LENGTH
        or not label.isprintable()
        or label != label.strip()
    ):
        raise ValueError(
            f"'annotations' must have labels of 1 to {_MAX_LABEL_LENGTH} printable characters, "
            f"without blanks at the ends (got {label!r:.80})"
        )
    check_utf8("labels in 'annotations'", label)
    return Annotation(start, end, label)


def without_gaps(annotations: Iterable[Annotation]) -> list[Annotation]:
    r"""Returns the annotations except those that mark spans without frames (:obj:`"gap"`)."""
    return [annotation for annotation in annotations if annotation.label != GAP]


def annotations_within(annotations: Sequence[Annotation], time: np.ndarray) -> list[Annotation]:
    r"""Returns the annotations that overlap the span from the first to the last frame, cut to this
    span. Annotations that end at the first frame or begin at the last frame are included, within
    rounding.

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
    r"""Returns the label of the annotation that covers each frame, and :obj:`"none"` for frames
    outside all annotations.

    An annotation covers the frames at its start and at its end. A frame at which one annotation
    ends and the next begins has the label of the next. Annotations with the label :obj:`"gap"`
    label no frame. A warning is logged for each annotation that covers no frame.

    Args:
        annotations (sequence of Annotation): The annotations, in the order of their starts.
        time (numpy.ndarray): Time of each frame in seconds :math:`(T,)`.
        where (str): Name of the recording in messages.

    Shapes:
        - **output:** labels :math:`(T,)`

    Raises:
        ValueError: If an annotation lies before the first or after the last frame, or two
            annotations with different labels overlap on a frame.
    """
    annotations = without_gaps(annotations)
    width = max([len(OUTSIDE), *(len(label) for _, _, label in annotations)])
    labels = np.full(len(time), OUTSIDE, dtype=f"U{width}")
    if not len(time):
        return labels
    tolerance = _tolerance(time)
    earliest, latest = time - tolerance, time + tolerance
    label_end = np.full(len(time), -np.inf)
    covered_rows = []
    for annotation in annotations:
        start, end, label = annotation
        if start > latest[-1] or end < earliest[0]:
            raise ValueError(
                f"{where}: the annotation {label!r} must be within the recording, from "
                f"{float(time[0])!r} to {float(time[-1])!r} s (got {start!r} to {end!r} s): use "
                "seconds on the clock of the recording for its start and end"
            )
        rows = slice(np.searchsorted(latest, start), np.searchsorted(earliest, end, side="right"))
        conflicts = np.flatnonzero((labels[rows] != label) & (latest[rows] < label_end[rows]))
        if len(conflicts):
            frame = int(rows.start + conflicts[0])
            raise ValueError(
                f"{where}: overlapping annotations must have the same label to label frames "
                f"(got {str(labels[frame])!r} and {label!r} in frame {frame}, at "
                f"{time[frame]:g} s)"
            )
        labels[rows] = label
        label_end[rows] = np.maximum(label_end[rows], end)
        covered_rows.append((annotation, rows))
    for (start, end, label), rows in covered_rows:
        if not (labels[rows] == label).any():
            _logger.warning(
                "%s: the annotation %r from %r to %r s labels no frame: it is shorter than the "
                "time between two frames, or no frame was recorded in it",
                where,
                label,
                start,
                end,
            )
    return labels


def _tolerance(time: np.ndarray) -> np.ndarray:
    # Returns the time around each frame within which a start or end counts as being at the frame:
    # a part of the time to its nearest neighbour, and at least the rounding error of float64, which
    # matters for seconds since 1970. It stays below half of the time to the neighbour, so that
    # frames cannot be confused.
    step = np.concatenate([[np.inf], np.diff(time), [np.inf]])
    distance = np.minimum(step[:-1], step[1:])
    rounding = 2 * np.spacing(np.abs(time))
    distance = np.where(np.isfinite(distance), distance, 4 * rounding)  # a single frame
    tolerance: np.ndarray = np.minimum(np.maximum(_TOLERANCE * distance, rounding), 0.49 * distance)
    return tolerance
