r"""Objects, labels and phases of recordings as attributes of the frames."""

import logging
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.data._label_names import label_numbers, number_labels
from torch_geometric_tactile.data._sample_units import trial_units
from torch_geometric_tactile.datasets._trial import ANNOTATION, Trial, checked_labels, checked_names

_logger = logging.getLogger(__name__)
# Keys of the metadata that become attributes of the frames if all trials have them.
GROUPINGS = ("session", "placement", "size")


class ObjectLabels:
    r"""Reads objects and properties from the metadata of trials. Data sets with further labels in
    their metadata use a subclass.
    """

    def object_names(self, trials: Sequence[Trial]) -> list[str]:
        r"""Returns the names of the objects, in the order of their class indices."""
        return number_labels([t.object_name for t in trials if t.object_name is not None])[0]

    def properties(self, trial: Trial) -> tuple[tuple[str, ...], tuple[int, ...]] | None:
        r"""Returns the names and values of the properties of a trial, or :obj:`None` if they are
        unknown.
        """
        if trial.meta.get("labels") is None or trial.meta.get("label_names") is None:
            return None
        names = checked_names(trial, "label_names")
        return names, checked_labels(trial, names)

    def extra_attributes(
        self, trials: Sequence[Trial], names: dict[str, list[str]]
    ) -> dict[str, Tensor]:
        r"""Returns further attributes of the frames, and adds the names of their classes to
        :obj:`names`.
        """
        return {}

    def target(
        self, data: StaticData, names: Mapping[str, list[str]], target: str, root: str
    ) -> Tensor:
        r"""Returns the labels :obj:`y` of all frames for a target."""
        if target == "object":
            return data.group.clone()
        if target != "property":
            y: Tensor = data.y
            return y
        if names["unknown"]:
            raise ValueError(self.unknown_properties(names["unknown"]))
        properties: Tensor = data.property.float()
        return properties

    def unknown_properties(self, unknown: Sequence[str]) -> str:
        r"""Returns the error message for objects with unknown properties as the target."""
        return (
            f"the properties of {list(unknown)} are unknown: write 0 or 1 for each as 'labels', "
            "and the same names as 'label_names', into the metadata of all recordings"
        )


def frame_labels(
    trials: Sequence[Trial], object_labels: ObjectLabels, target: str | None
) -> tuple[dict[str, list[str]], dict[str, Tensor]]:
    r"""Returns the names of the classes of each attribute, and the attributes of all frames.

    Without a :obj:`target` there is no attribute :obj:`y`.
    """
    num_frames = torch.tensor([trial.num_frames for trial in trials])
    objects = object_labels.object_names(trials)
    names: dict[str, list[str]] = {
        "group": objects,
        "trial": [trial.name for trial in trials],
        "phase": [*dict.fromkeys(name for trial in trials for name in trial.phase_names)],
        "property": [],
        "synthetic": [trial.name for trial in trials if trial.meta.get("synthetic", False)],
    }
    attributes = {
        "time": torch.from_numpy(np.concatenate([trial.time for trial in trials])),
        "trial": torch.arange(len(trials)).repeat_interleave(num_frames),
    }
    if trials[0].joint is not None:
        attributes["joint"] = torch.from_numpy(np.concatenate([trial.joint for trial in trials]))
    actions = [trial.action for trial in trials if trial.action is not None]
    if len(actions) == len(trials):
        attributes["action"] = torch.from_numpy(np.concatenate(actions))
    if all(trial.object_name is not None for trial in trials):
        group = label_numbers(objects, [trial.object_name for trial in trials])
        attributes["group"] = torch.tensor(group).repeat_interleave(num_frames)
    # Without objects, a 'group' in the metadata is the group of a split.
    for key in GROUPINGS if "group" in attributes else ("group", *GROUPINGS):
        values = [trial.meta.get(key) for trial in trials]
        if all(isinstance(value, str | int) and not isinstance(value, bool) for value in values):
            names[key], codes = _names_and_codes(values)
            attributes[key] = codes.repeat_interleave(num_frames)
    names |= trial_units([trial.meta for trial in trials], attributes)
    names["property"], rows, names["unknown"] = _property_rows(trials, object_labels)
    if not names["unknown"]:
        attributes["property"] = torch.tensor(rows).repeat_interleave(num_frames, dim=0)
    if names["phase"]:
        attributes["phase"] = torch.cat([trial.numbered_phase(names["phase"]) for trial in trials])
    if target is not None:
        labels = [label for trial in trials for label in trial.target(target).tolist()]
        names["class"], attributes["y"] = _mark_unlabelled(*_names_and_codes(labels))
        if target == ANNOTATION:  # Windows look the attribute up by this name.
            names[target], attributes[target] = names["class"], attributes["y"]
    return names, attributes


def _mark_unlabelled(names: list[str], y: Tensor) -> tuple[list[str], Tensor]:
    # If there is a class 0, the label -1 means unlabelled, as in scikit-learn. Unlabelled frames
    # get the code -1, and the codes of the classes begin with 0.
    if names[:2] != ["-1", "0"]:
        return names, y
    _logger.warning(
        "%d of %d frames have the label -1, which means unlabelled if there is a class 0: leave "
        "them out with dataset[dataset.y >= 0] (or use another label if -1 is a class)",
        int((y == 0).sum()),
        len(y),
    )
    return names[1:], y - 1


def _names_and_codes(values: list[Any]) -> tuple[list[str], Tensor]:
    names, codes = number_labels(values)
    return names, torch.from_numpy(codes)


def _property_rows(
    trials: Sequence[Trial], object_labels: ObjectLabels
) -> tuple[list[str], list[list[int]], list[str]]:
    # Returns the names of the properties, their values for each trial, and the names of the objects
    # whose properties are unknown or differ from those of the first trial.
    properties = [object_labels.properties(trial) for trial in trials]
    names = next((pair[0] for pair in properties if pair is not None), ())
    rows, unknown = [], set()
    row_of_object: dict[str, tuple[list[int], str]] = {}
    for trial, pair in zip(trials, properties, strict=True):
        if pair is None or sorted(pair[0]) != sorted(names):
            unknown.add(trial.object_name or trial.name)
            continue
        row = [pair[1][pair[0].index(name)] for name in names]
        rows.append(row)
        if trial.object_name is not None:
            first_row, where = row_of_object.setdefault(trial.object_name, (row, trial.where))
            if first_row != row:
                raise ValueError(
                    f"'{trial.object_name}' must have the same labels in all recordings (got "
                    f"{first_row} in {where} and {row} in {trial.where}, for {', '.join(names)}): "
                    "correct them, or use another name if it is a different object"
                )
    return list(names) if not unknown else [], rows, sorted(unknown)
