r"""One recording as a trial of a data set: its object, labels and phases, checked."""

import re
from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.data import Annotation, Recording
from torch_geometric_tactile.data._annotations import OUTSIDE, annotation_of_frames, without_gaps
from torch_geometric_tactile.sensors import TaxelLayout

ANNOTATION = "annotation"  # the target that is the label of the annotation of a frame


@dataclass(frozen=True, eq=False)
class Trial:
    r"""A recording without its readings, which may not fit into memory.

    Shapes:
        - **time:** Times in seconds :math:`(T,)`.
        - **joint:** Joint angles in radians :math:`(T, J)`.
        - **phase:** Indices into :obj:`phase_names` :math:`(T,)`.
        - **pose:** Positions and quaternions :math:`(T, 7)`.
    """

    where: str
    name: str
    time: np.ndarray
    joint: np.ndarray | None
    label: str | int | None
    meta: Mapping[str, Any]
    privileged: Mapping[str, np.ndarray]
    object_name: str | None = None
    number: int | None = None
    phase: np.ndarray | None = None
    phase_names: tuple[str, ...] = ()
    pose: Mapping[str, np.ndarray] = field(default_factory=dict)
    annotations: Sequence[Annotation] = ()

    @property
    def num_frames(self) -> int:
        r"""The number of frames."""
        return len(self.time)

    @property
    def columns(self) -> dict[str, list[str]]:
        r"""The names of the columns of readings and angles, as far as they are known."""
        return dict(self.meta.get("column_names", {}))

    @property
    def num_joints(self) -> int:
        r"""The number of joints, 0 without joint angles."""
        return 0 if self.joint is None else self.joint.shape[1]

    def numbered_phase(self, names: Sequence[str]) -> Tensor:
        r"""Returns the phase of each frame as an index into names, or -1 if it is unknown.

        Shapes:
            - **output:** :math:`(T,)`
        """
        if self.phase is None:
            return torch.full((self.num_frames,), -1)
        numbers = torch.tensor([names.index(name) for name in self.phase_names])
        return numbers[torch.from_numpy(self.phase).long()]

    def _advice(self, key: str) -> str:
        if key != "label" and self.label is not None:
            return f"; its label is {self.label!r}: choose target='label'"
        named = [name for name, value in self.privileged.items() if value.dtype.kind == "U"]
        if key == "label" and named:
            return f"; '{named[0]}' changes from frame to frame: choose target='{named[0]}'"
        return ""

    def target(self, key: str) -> np.ndarray:
        r"""Returns the label of each frame as text: the recording's own label, a value in its
        metadata, what :obj:`privileged` says frame by frame, or, as :obj:`"annotation"`, the label
        of the annotation that covers it.

        Shapes:
            - **output:** texts or integers :math:`(T,)`
        """
        value = self.privileged.get(key)
        if value is None and key == ANNOTATION and key not in self.meta:
            need(
                without_gaps(self.annotations),
                f"{self.where} must have annotations for target='{ANNOTATION}' (got none): if "
                f"nothing happens in it, annotate it as '{OUTSIDE}' from its start to its end",
            )
            return annotation_of_frames(self.annotations, self.time, self.where)
        if value is None:
            label = self.label if key == "label" else None
            label = self.meta.get(key) if label is None else label
            if isinstance(label, bool) or not isinstance(label, str | int):
                raise ValueError(
                    f"{self.where} must have '{key}', a text or an integer, as its label, in its "
                    f"metadata or in the name of its file (got {label!r}){self._advice(key)}"
                )
            return np.full(self.num_frames, label)
        if value.dtype.kind not in "biuU":
            raise ValueError(
                f"{self.where} must have one text or integer a frame in '{key}' (got {value.dtype})"
            )
        return value.astype(int) if value.dtype.kind == "b" else value


def make_trial(
    recording: Recording,
    layout: TaxelLayout,
    *,
    where: str,
    name: str,
    pattern: str,
    needs: Sequence[str] = (),
) -> Trial:
    r"""Checks a recording on its own, and reads the name of its file."""
    try:
        recording.check(layout)
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from error
    need(recording.num_frames != 0, f"{where} must hold at least one frame (got none)")
    found = re.fullmatch(pattern, name)
    said = {} if found is None else {k: v for k, v in found.groupdict().items() if v is not None}
    if "label" in said and recording.label is not None and str(recording.label) != said["label"]:
        raise ValueError(
            f"{where} must have one label (got {recording.label!r} in the file and "
            f"{said['label']!r} in its name): correct one of them"
        )
    for key, kind in (("synthetic", bool), ("session", str | int)):
        if not isinstance(recording.meta.get(key, kind is bool or ""), kind):
            raise ValueError(
                f"{where} must have in its metadata '{key}' "
                f"{'true or false' if kind is bool else 'a text or an integer'} "
                f"(got {recording.meta[key]!r})"
            )
    object_name, number = _object_and_trial(where, recording.meta, said, needs)
    phase, phase_names = _phase(where, recording)
    return Trial(
        where=where,
        name=name,
        time=recording.time,
        joint=recording.joint,
        label=said.get("label") if recording.label is None else recording.label,
        meta={**said, **recording.meta},
        privileged={key: value for key, value in recording.privileged.items() if value.ndim == 1},
        object_name=object_name,
        number=number,
        phase=phase,
        phase_names=phase_names,
        pose={
            key: value
            for key, value in recording.privileged.items()
            if value.shape[1:] == (7,) and value.dtype.kind == "f"
        },
        annotations=recording.annotations,
    )


def _object_and_trial(
    where: str, meta: Mapping[str, Any], said: Mapping[str, str], needs: Sequence[str]
) -> tuple[str | None, int | None]:
    object_name, number = meta.get("object", said.get("object")), meta.get("trial")
    if number is None and re.fullmatch("[0-9]+", said.get("trial", "")):
        number = int(said["trial"])
    is_object = object_name is None or (isinstance(object_name, str) and object_name != "")
    is_number = number is None or type(number) is int
    lacks = [k for k, v in (("object", object_name), ("trial", number)) if k in needs and v is None]
    if lacks or not is_object or not is_number:
        raise ValueError(
            f"{where} must tell its object and trial: 'object' (a text) and 'trial' (an integer) "
            "in its metadata, or a file name <object>_<number> such as 'sponge_003.h5' "
            f"(got object {object_name!r}, trial {number!r})"
        )
    return object_name, number


def _phase(where: str, recording: Recording) -> tuple[np.ndarray | None, tuple[str, ...]]:
    phase, names = recording.privileged.get("phase"), recording.meta.get("phase_names")
    if phase is None or names is None:
        return None, ()
    names = _checked_names(where, names, "phase_names")
    if (
        phase.shape != (recording.num_frames,)
        or phase.dtype.kind not in "iu"
        or not 0 <= phase.min() <= phase.max() < len(names)
    ):
        raise ValueError(
            f"{where} must hold in 'phase' one index into 'phase_names' a frame, 0 to "
            f"{len(names) - 1} (got {phase.dtype} of shape {phase.shape})"
        )
    return phase, names


def check_together(trials: Sequence[Trial], unit: str | None = None) -> None:
    r"""Checks that recordings go together."""
    check_one_file_each(
        ((t.object_name, t.number), f"trial {t.number} of '{t.object_name}'", t.where)
        for t in trials
        if t.object_name is not None and t.number is not None
    )
    units: dict[str | None, str] = {}
    for trial in trials:
        units.setdefault(trial.meta.get("unit", unit), trial.where)
        if trial.num_joints != trials[0].num_joints:
            raise ValueError(
                f"{trial.where} must have {trials[0].num_joints} joint angles a frame, "
                f"as {trials[0].where} (got {trial.num_joints})"
            )
    if len(units) > 1:
        listed = " and ".join(f"{name or 'none'!r} in {where}" for name, where in units.items())
        raise ValueError(
            f"all recordings must have one unit (got {listed}): convert one of them, or name the "
            "unit as 'unit' in its metadata, or in the data set's argument 'unit' for all that "
            "name none"
        )


def check_one_file_each(trials: Iterable[tuple[Hashable, str, str]]) -> None:
    r"""Checks that no trial is in two files: of each its key, what to call it, and its file."""
    seen: dict[Hashable, str] = {}
    for key, trial, where in trials:
        other = seen.setdefault(key, where)
        if other is not where:
            raise ValueError(f"{trial} must be in one file (got {other} and {where})")


def checked_labels(trial: Trial, names: Sequence[str]) -> tuple[int, ...]:
    r"""Returns the :obj:`"labels"` in the metadata of a trial."""
    labels = trial.meta["labels"]
    is_right = isinstance(labels, list) and len(labels) == len(names)
    if not is_right or not all(type(label) in (bool, int) and label in (0, 1) for label in labels):
        raise ValueError(
            f"{trial.where} must have a 0 or 1 in 'labels' for each of {list(names)} (got {labels})"
        )
    return tuple(map(int, labels))


def checked_names(trial: Trial, key: str) -> tuple[str, ...]:
    r"""Returns names in the metadata of a trial."""
    return _checked_names(trial.where, trial.meta[key], key)


def _checked_names(where: str, names: Any, key: str) -> tuple[str, ...]:
    is_list = isinstance(names, list) and all(isinstance(name, str) for name in names)
    if not is_list or len(set(names)) < len(names):
        raise ValueError(f"{where} must have different texts in '{key}' (got {names!r})")
    return tuple(names)


def checked_pattern(pattern: str) -> str:
    r"""Returns a regular expression for names of files."""
    try:
        re.compile(pattern)
    except (re.error, RecursionError, TypeError) as error:
        raise ValueError(f"'pattern' must be a regular expression ({error})") from error
    return pattern
