r"""Trials of a data set: the checked object, labels and phases of a recording."""

import re
from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torch_geometric_tactile._checks import Argument, ArgumentError, need
from torch_geometric_tactile.data import Annotation, Recording
from torch_geometric_tactile.data._annotations import OUTSIDE, annotation_of_frames, without_gaps
from torch_geometric_tactile.sensors import TaxelLayout

#: The default pattern of file names without suffix: ``mug_003`` is trial 3 of the object ``mug``.
DEFAULT_PATTERN = r"(?P<object>.+)_(?P<trial>\d+)"
_NAME_IN_BRACES = re.compile(r"\{([A-Za-z_]\w*)\}")
ANNOTATION = "annotation"  # target: the label of the annotation that covers a frame


@dataclass(frozen=True, eq=False)
class Trial:
    r"""A recording without its readings, which may not fit into memory. :obj:`where` names the file
    in error messages, and :obj:`file_names` are the names in the name of the file, such as the name
    of a person.

    Shapes:
        - **time:** Times in seconds :math:`(T,)`.
        - **joint:** Joint angles in radians :math:`(T, J)`.
        - **action:** Commands :math:`(T, A)`.
        - **phase:** Indices into :obj:`phase_names` :math:`(T,)`.
        - **pose:** Positions and quaternions :math:`(T, 7)`.
    """

    where: str
    name: str
    time: np.ndarray
    joint: np.ndarray | None
    label: str | int | None
    meta: Mapping[str, Any]  # including the names in the name of the file
    privileged: Mapping[str, np.ndarray]
    object_name: str | None = None
    number: int | None = None
    phase: np.ndarray | None = None
    phase_names: tuple[str, ...] = ()
    pose: Mapping[str, np.ndarray] = field(default_factory=dict)
    annotations: Sequence[Annotation] = ()
    action: np.ndarray | None = None
    file_names: Mapping[str, str] = field(default_factory=dict)

    @property
    def num_frames(self) -> int:
        r"""The number of frames."""
        return len(self.time)

    @property
    def columns(self) -> dict[str, list[str]]:
        r"""The names of the columns of readings and joint angles, as far as they are known."""
        return dict(self.meta.get("column_names", {}))

    @property
    def num_joints(self) -> int:
        r"""The number of joints. It is 0 without joint angles."""
        return 0 if self.joint is None else self.joint.shape[1]

    def numbered_phase(self, names: Sequence[str]) -> Tensor:
        r"""Returns the phase of each frame as an index into :obj:`names`, -1 where it is unknown.

        Shapes:
            - **output:** :math:`(T,)`
        """
        if self.phase is None:
            return torch.full((self.num_frames,), -1)
        indices = torch.tensor([names.index(name) for name in self.phase_names])
        return indices[torch.from_numpy(self.phase).long()]

    def _target_advice(self, key: str) -> str:
        # Returns the end of the error message for a missing target, which suggests another target.
        if key != "label" and self.label is not None:
            return f"; its label is {self.label!r}: choose target='label'"
        texts = [name for name, value in self.privileged.items() if value.dtype.kind == "U"]
        if key == "label" and texts:
            return f"; '{texts[0]}' changes from frame to frame: choose target='{texts[0]}'"
        return ""

    def target(self, key: str) -> np.ndarray:
        r"""Returns the target of each frame.

        The key :obj:`"label"` is the label of the recording, and :obj:`"annotation"` the label of
        the annotation that covers a frame. Other keys are looked up in :obj:`privileged`, frame by
        frame, and in the metadata.

        Shapes:
            - **output:** texts or integers :math:`(T,)`

        Raises:
            ValueError: If the recording has no such target.
        """
        column = self.privileged.get(key)
        if column is None and key == ANNOTATION and key not in self.meta:
            need(
                without_gaps(self.annotations),
                f"{self.where} must have annotations for target='{ANNOTATION}' (got none): if no "
                f"label applies, annotate it as '{OUTSIDE}' from its start to its end",
            )
            return annotation_of_frames(self.annotations, self.time, self.where)
        if column is None:
            label = self.label if key == "label" else None
            label = self.meta.get(key) if label is None else label
            if isinstance(label, bool) or not isinstance(label, str | int):
                raise ValueError(
                    f"{self.where} must have '{key}', a text or an integer, as its label, in its "
                    f"metadata or in the name of its file (got {label!r}){self._target_advice(key)}"
                )
            return np.full(self.num_frames, label)
        if column.dtype.kind not in "biuU":
            raise ValueError(
                f"{self.where} must have one text or integer per frame in '{key}' "
                f"(got {column.dtype})"
            )
        return column.astype(int) if column.dtype.kind == "b" else column


def make_trial(
    recording: Recording,
    layout: TaxelLayout,
    *,
    where: str,
    name: str,
    pattern: str,
    needs: Sequence[str] = (),
) -> Trial:
    r"""Checks a recording and returns its trial, with metadata from the name of its file.

    Args:
        recording (Recording): The recording.
        layout (TaxelLayout): The taxels.
        where (str): Name of the recording in error messages.
        name (str): Name of the file without suffix.
        pattern (str): Regular expression whose named groups are metadata in the file name.
        needs (sequence of str): Which of :obj:`"object"` and :obj:`"trial"` must be known.
    """
    try:
        recording.check(layout)
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from error
    need(recording.num_frames != 0, f"{where} must hold at least one frame (got none)")
    match = re.fullmatch(pattern, name)
    groups = {} if match is None else {k: v for k, v in match.groupdict().items() if v is not None}
    if (
        "label" in groups
        and recording.label is not None
        and str(recording.label) != groups["label"]
    ):
        raise ValueError(
            f"{where} must have one label (got {recording.label!r} in the file and "
            f"{groups['label']!r} in its name): correct one of them"
        )
    for key, kind in (("synthetic", bool), ("session", str | int)):
        if not isinstance(recording.meta.get(key, kind is bool or ""), kind):
            raise ValueError(
                f"{where} must have {'true or false' if kind is bool else 'a text or an integer'} "
                f"as '{key}' in its metadata (got {recording.meta[key]!r})"
            )
    object_name, number = _object_and_trial(where, recording.meta, groups, needs)
    phase, phase_names = _phase(where, recording)
    return Trial(
        where=where,
        name=name,
        time=recording.time,
        joint=recording.joint,
        label=groups.get("label") if recording.label is None else recording.label,
        meta={**groups, **recording.meta},
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
        action=recording.action,
        file_names=groups,
    )


def _object_and_trial(
    where: str, meta: Mapping[str, Any], groups: Mapping[str, str], needs: Sequence[str]
) -> tuple[str | None, int | None]:
    # Returns the name of the object and the trial number from the metadata, or else from the file
    # name.
    object_name, number = meta.get("object", groups.get("object")), meta.get("trial")
    if number is None and re.fullmatch("[0-9]+", groups.get("trial", "")):
        number = int(groups["trial"])
    is_object = object_name is None or (isinstance(object_name, str) and object_name != "")
    is_number = number is None or type(number) is int
    missing = [
        key
        for key, value in (("object", object_name), ("trial", number))
        if key in needs and value is None
    ]
    if missing or not is_object or not is_number:
        raise ValueError(
            f"{where} must name its object and trial: 'object' (a text) and 'trial' (an integer) "
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
            f"{where} must hold one index into 'phase_names' per frame in 'phase', 0 to "
            f"{len(names) - 1} (got {phase.dtype} of shape {phase.shape})"
        )
    return phase, names


def check_compatible(trials: Sequence[Trial], unit: str | None = None) -> None:
    r"""Checks that trials are unique and have the same unit and the same numbers of joints and
    actions.

    Args:
        trials (sequence of Trial): The trials.
        unit (str, optional): Unit of trials whose metadata name none.
    """
    check_unique_trials(
        (_trial_key(t), f"trial {t.number} of '{t.object_name}'", t.where)
        for t in trials
        if t.object_name is not None and t.number is not None
    )
    units: dict[str | None, str] = {}
    for trial in trials:
        units.setdefault(trial.meta.get("unit", unit), trial.where)
        if trial.num_joints != trials[0].num_joints:
            raise ValueError(
                f"{trial.where} must have {trials[0].num_joints} joint angles per frame, "
                f"like {trials[0].where} (got {trial.num_joints})"
            )
    sizes = {t.where: t.action.shape[1] for t in trials if t.action is not None}
    for where, size in sizes.items():
        first, first_size = next(iter(sizes.items()))
        if size != first_size:
            raise ValueError(
                f"{where} must have {first_size} actions per frame, like {first} (got {size})"
            )
    if len(units) > 1:
        unit_texts = " and ".join(f"{name or 'none'!r} in {where}" for name, where in units.items())
        raise ValueError(
            f"all recordings must have the same unit (got {unit_texts}): convert one of them, add "
            "'unit' to its metadata, or pass the unit of all recordings without one as argument "
            "'unit' of the data set"
        )


def _trial_key(trial: Trial) -> Hashable:
    # Trials of different people or sessions may have the same object and number.
    names = {k: v for k, v in trial.file_names.items() if k not in ("object", "trial", "label")}
    session = trial.meta.get("session")
    return trial.object_name, trial.number, session, tuple(sorted(names.items()))


def check_unique_trials(trials: Iterable[tuple[Hashable, str, str]]) -> None:
    r"""Checks that no trial is in two files.

    Args:
        trials (iterable of tuple): The key of each trial, its name in error messages, and its file.
    """
    files: dict[Hashable, str] = {}
    for key, trial, where in trials:
        first_file = files.setdefault(key, where)
        if first_file is not where:
            raise ValueError(f"{trial} must be in only one file (got {first_file} and {where})")


def checked_labels(trial: Trial, names: Sequence[str]) -> tuple[int, ...]:
    r"""Returns the :obj:`"labels"` in the metadata of a trial: 0 or 1 for each name."""
    labels = trial.meta["labels"]
    has_all = isinstance(labels, list) and len(labels) == len(names)
    if not has_all or not all(type(label) in (bool, int) and label in (0, 1) for label in labels):
        raise ValueError(
            f"{trial.where} must have a 0 or 1 in 'labels' for each of {list(names)} (got {labels})"
        )
    return tuple(map(int, labels))


def checked_names(trial: Trial, key: str) -> tuple[str, ...]:
    r"""Returns a list of different names in the metadata of a trial."""
    return _checked_names(trial.where, trial.meta[key], key)


def _checked_names(where: str, names: Any, key: str) -> tuple[str, ...]:
    is_list = isinstance(names, list) and all(isinstance(name, str) for name in names)
    if not is_list or len(set(names)) < len(names):
        raise ValueError(f"{where} must have different texts in '{key}' (got {names!r})")
    return tuple(names)


def checked_pattern(pattern: str) -> str:
    r"""Returns the argument :obj:`pattern` as a regular expression. A name in braces becomes a
    group.

    Examples:
        >>> checked_pattern("{object}_{trial}")
        '(?P<object>[^/]+?)_(?P<trial>[0-9]+)'
    """
    try:
        pattern = _NAME_IN_BRACES.sub(_name_to_group, pattern)
        groups = re.compile(pattern).groupindex
    except (re.error, RecursionError, TypeError) as error:
        raise ArgumentError(
            Argument("pattern"),
            f" must be a regular expression, or names in braces such as '{{object}}_{{trial}}' "
            f"({error})",
        ) from error
    if {"object", "group"} <= {*groups}:
        raise ArgumentError(
            Argument("pattern"),
            " must name an object or a group, since the group of a sample is its object (got "
            "both): use another name for the group, such as 'person'",
        )
    return pattern


def _name_to_group(match: re.Match[str]) -> str:
    return f"(?P<{match[1]}>{'[0-9]+' if match[1] == 'trial' else '[^/]+?'})"
