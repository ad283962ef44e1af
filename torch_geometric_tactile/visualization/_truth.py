r"""True classes or numbers of model outputs, from a recording."""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.data._annotations import OUTSIDE, annotation_of_frames, without_gaps

ANNOTATED = "annotations"  # the source if the truth comes from annotations


class Truth(NamedTuple):
    r"""The true classes or numbers of the frames, and their source in the recording.

    Shapes:
        - **value:** names of classes :math:`(T,)`, which are empty where unknown; for labels 0 or 1
          and for a regression numbers :math:`(T, C)`, which are NaN where unknown
    """

    value: np.ndarray
    source: str


def find_truth(recording: Recording, names: Sequence[str], task: str) -> Truth | None:
    r"""Returns the true classes or numbers in a recording, or :obj:`None` if there are none.

    Args:
        recording (Recording): The recording.
        names (sequence of str): Names of the outputs of the model.
        task (str): :obj:`"multiclass"`, :obj:`"multilabel"` or :obj:`"regression"`.
    """
    if task == "multiclass":
        return next(_true_classes(recording, names), None)
    value = np.full((recording.num_frames, len(names)), np.nan)
    sources = []
    properties, labels = recording.meta.get("label_names"), recording.meta.get("labels")
    if task == "multilabel" and isinstance(properties, list) and isinstance(labels, list):
        label_by_name = dict(zip(map(str, properties), labels, strict=False))
        for i, name in enumerate(names):
            if label_by_name.get(name) in (0, 1):
                value[:, i] = label_by_name[name]
                sources.append("labels")
    signals = {**recording.extra, **recording.privileged}
    for i, name in enumerate(names):
        signal = signals.get(name, recording.meta.get(name))
        if isinstance(signal, np.ndarray):
            is_number = signal.ndim == 1 and signal.dtype.kind in "biuf"
        else:
            is_number = isinstance(signal, int | float)
        if is_number:
            value[:, i] = signal
            sources.append(name)
    if task == "multilabel":
        value[~np.isin(value, (0, 1))] = np.nan
    return Truth(value, sources[0]) if sources else None


def _true_classes(recording: Recording, names: Sequence[str]) -> Iterator[Truth]:
    num_frames = recording.num_frames
    if recording.label is not None and str(recording.label) in names:
        yield Truth(np.full(num_frames, str(recording.label)), "label")
    if without_gaps(recording.annotations):
        with suppress(ValueError):  # overlapping annotations and annotations outside have no class
            classes = annotation_of_frames(recording.annotations, recording.time)
            is_unknown = (classes == OUTSIDE) & (OUTSIDE not in names)
            if np.isin(classes[~is_unknown], names).all():
                yield Truth(np.where(is_unknown, "", classes), ANNOTATED)
    for key, signal in recording.privileged.items():
        if signal.ndim != 1 or signal.dtype.kind not in "biuU":
            continue
        if signal.dtype.kind == "U":
            classes = signal
        elif list(names[1:]) == [key]:  # such as a signal 'slip' for the classes 'hold' and 'slip'
            classes = np.array(["", *names])[np.where(np.isin(signal, (0, 1)), signal + 1, 0)]
        else:
            value_names = recording.meta.get(f"{key}_names")
            value_names = (
                [str(name) for name in value_names] if isinstance(value_names, list) else []
            )
            has_name = (signal >= 0) & (signal < len(value_names))
            index = np.where(has_name, signal.astype(np.int64) + 1, 0)
            classes = np.array(["", *value_names])[index]
        # All values must be classes: a phase 'hold' among other phases is not the class 'hold'.
        if np.isin(classes, ["", *names]).all() and (classes != "").any():
            yield Truth(classes, key)
    for key, text in recording.meta.items():
        if isinstance(text, str) and text in names:
            yield Truth(np.full(num_frames, text), key)
    # Integers without names, such as a column with numeric labels.
    for key, signal in recording.privileged.items():
        if signal.ndim == 1 and signal.dtype.kind in "iu" and key != "phase":
            classes = signal.astype(str)
            if np.isin(classes, names).all():
                yield Truth(classes, key)
