r"""What a recording tells of the classes or numbers that a model predicts."""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.data._annotations import OUTSIDE, annotation_of_frames, without_gaps

ANNOTATED = "annotations"  # the source of what annotations tell


class Truth(NamedTuple):
    r"""What is true in each frame, and where the recording says so.

    Shapes:
        - **value:** of classes their names, an empty text where unknown :math:`(T,)`; of labels 0
          or 1, of a regression numbers, NaN where unknown :math:`(T, C)`.
    """

    value: np.ndarray
    source: str


def find_truth(recording: Recording, names: Sequence[str], task: str) -> Truth | None:
    r"""Returns what a recording tells of outputs by their names, :obj:`None` if nothing."""
    if task == "multiclass":
        return next(_true_classes(recording, names), None)
    value = np.full((recording.num_frames, len(names)), np.nan)
    sources = []
    properties, labels = recording.meta.get("label_names"), recording.meta.get("labels")
    if task == "multilabel" and isinstance(properties, list) and isinstance(labels, list):
        known = dict(zip(map(str, properties), labels, strict=False))
        for i, name in enumerate(names):
            if known.get(name) in (0, 1):
                value[:, i] = known[name]
                sources.append("labels")
    signals = {**recording.extra, **recording.privileged}
    for i, name in enumerate(names):
        found = signals.get(name, recording.meta.get(name))
        if isinstance(found, np.ndarray):
            is_number = found.ndim == 1 and found.dtype.kind in "biuf"
        else:
            is_number = isinstance(found, int | float)
        if is_number:
            value[:, i] = found
            sources.append(name)
    if task == "multilabel":
        value[~np.isin(value, (0, 1))] = np.nan
    return Truth(value, sources[0]) if sources else None


def _true_classes(recording: Recording, names: Sequence[str]) -> Iterator[Truth]:
    num_frames = recording.num_frames
    if recording.label is not None and str(recording.label) in names:
        yield Truth(np.full(num_frames, str(recording.label)), "label")
    if without_gaps(recording.annotations):
        with suppress(ValueError):  # of those that overlap or lie outside nothing is true
            texts = annotation_of_frames(recording.annotations, recording.time)
            outside = (texts == OUTSIDE) & (OUTSIDE not in names)
            if np.isin(texts[~outside], names).all():
                yield Truth(np.where(outside, "", texts), ANNOTATED)
    for key, signal in recording.privileged.items():
        if signal.ndim != 1 or signal.dtype.kind not in "biuU":
            continue
        if signal.dtype.kind == "U":
            texts = signal
        elif list(names[1:]) == [key]:  # such as 'slip', 0 or 1, of 'hold' and 'slip'
            texts = np.array(["", *names])[np.where(np.isin(signal, (0, 1)), signal + 1, 0)]
        else:
            known = recording.meta.get(f"{key}_names")
            known = [str(name) for name in known] if isinstance(known, list) else []
            inside = (signal >= 0) & (signal < len(known))
            texts = np.array(["", *known])[np.where(inside, signal.astype(np.int64) + 1, 0)]
        # Of one that only shares a name with the classes, such as a phase 'hold', nothing is true.
        if np.isin(texts, ["", *names]).all() and (texts != "").any():
            yield Truth(texts, key)
    for key, said in recording.meta.items():
        if isinstance(said, str) and said in names:
            yield Truth(np.full(num_frames, said), key)
    # Integers that are no text's: of a column of labels that are numbers.
    for key, signal in recording.privileged.items():
        if signal.ndim == 1 and signal.dtype.kind in "iu" and key != "phase":
            texts = signal.astype(str)
            if np.isin(texts, names).all():
                yield Truth(texts, key)
