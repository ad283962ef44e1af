r"""What recordings tell of their objects, labels and phases, as attributes of the frames."""

import logging
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.data._label_names import label_numbers, number_labels
from torch_geometric_tactile.datasets._trial import ANNOTATION, Trial, checked_labels, checked_names

_logger = logging.getLogger(__name__)
# What else trials may be split by, if all of them name it in their metadata.
GROUPINGS = ("session", "placement", "size")


class ObjectLabels:
    r"""The objects and properties of trials, as their metadata tell them; a data set whose
    recordings tell more has a subclass.
    """

    def object_names(self, trials: Sequence[Trial]) -> list[str]:
        r"""Returns the names of the objects, in the order of their numbers."""
        return number_labels([t.object_name for t in trials if t.object_name is not None])[0]

    def properties(self, trial: Trial) -> tuple[tuple[str, ...], tuple[int, ...]] | None:
        r"""Returns names and values of the properties of a trial, if they are known."""
        if trial.meta.get("labels") is None or trial.meta.get("label_names") is None:
            return None
        names = checked_names(trial, "label_names")
        return names, checked_labels(trial, names)

    def more(self, trials: Sequence[Trial], names: dict[str, list[str]]) -> dict[str, Tensor]:
        r"""Returns further attributes of the frames, and adds their names to those there are."""
        return {}

    def target(
        self, data: StaticData, names: Mapping[str, list[str]], target: str, root: str
    ) -> Tensor:
        r"""Returns what :obj:`y` is."""
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
        r"""Returns the message of an error about properties that are asked for, but unknown."""
        return (
            f"the properties of {list(unknown)} are unknown: give 0 or 1 for each as 'labels', and "
            "the same names as 'label_names', in the metadata of all recordings"
        )


def frame_labels(
    trials: Sequence[Trial], known: ObjectLabels, target: str | None
) -> tuple[dict[str, list[str]], dict[str, Tensor]]:
    r"""Returns the names behind numbers, and the attributes of all frames."""
    num_frames = torch.tensor([trial.num_frames for trial in trials])
    objects = known.object_names(trials)
    names: dict[str, list[str]] = {
        "group": objects,
        "trial": [trial.name for trial in trials],
        "phase": [*dict.fromkeys(name for trial in trials for name in trial.phase_names)],
        "property": [],
        "synthetic": [trial.name for trial in trials if trial.meta.get("synthetic", False)],
    }
    out = {
        "time": torch.from_numpy(np.concatenate([trial.time for trial in trials])),
        "trial": torch.arange(len(trials)).repeat_interleave(num_frames),
    }
    if trials[0].joint is not None:
        out["joint"] = torch.from_numpy(np.concatenate([trial.joint for trial in trials]))
    if all(trial.object_name is not None for trial in trials):
        group = label_numbers(objects, [trial.object_name for trial in trials])
        out["group"] = torch.tensor(group).repeat_interleave(num_frames)
    for key in GROUPINGS:
        values = [trial.meta.get(key) for trial in trials]
        if all(isinstance(value, str | int) and not isinstance(value, bool) for value in values):
            names[key], numbers = _numbered(values)
            out[key] = numbers.repeat_interleave(num_frames)
    names["property"], rows, names["unknown"] = _property_rows(trials, known)
    if not names["unknown"]:
        out["property"] = torch.tensor(rows).repeat_interleave(num_frames, dim=0)
    if names["phase"]:
        out["phase"] = torch.cat([trial.numbered_phase(names["phase"]) for trial in trials])
    if target is not None:
        labels = [label for trial in trials for label in trial.target(target).tolist()]
        names["class"], out["y"] = _without_unlabelled(*_numbered(labels))
        if target == ANNOTATION:  # by its own name as well, for windows
            names[target], out[target] = names["class"], out["y"]
    return names, out


def _without_unlabelled(names: list[str], y: Tensor) -> tuple[list[str], Tensor]:
    # -1 beside 0 is no class, but -1, as in scikit-learn, where nobody labelled a frame.
    if names[:2] != ["-1", "0"]:
        return names, y
    _logger.warning(
        "%d of %d frames have the label -1 beside 0, which stands for no label: leave them out "
        "with dataset[dataset.y >= 0] (or give them another label if it is a class)",
        int((y == 0).sum()),
        len(y),
    )
    return names[1:], y - 1


def _numbered(values: list[Any]) -> tuple[list[str], Tensor]:
    names, codes = number_labels(values)
    return names, torch.from_numpy(codes)


def _property_rows(
    trials: Sequence[Trial], known: ObjectLabels
) -> tuple[list[str], list[list[int]], list[str]]:
    # The names of the properties, their values for each trial, and whose properties are unknown
    # or differ from those of the first trial.
    properties = [known.properties(trial) for trial in trials]
    first = next((found[0] for found in properties if found is not None), ())
    rows, unknown = [], set()
    of_object: dict[str, tuple[list[int], str]] = {}
    for trial, found in zip(trials, properties, strict=True):
        if found is None or sorted(found[0]) != sorted(first):
            unknown.add(trial.object_name or trial.name)
            continue
        row = [found[1][found[0].index(name)] for name in first]
        rows.append(row)
        if trial.object_name is not None:
            other, where = of_object.setdefault(trial.object_name, (row, trial.where))
            if other != row:
                raise ValueError(
                    f"'{trial.object_name}' must have the same labels in all recordings (got "
                    f"{other} in {where} and {row} in {trial.where}, for {', '.join(first)}): "
                    "correct them, or give another name to what is another object"
                )
    return list(first) if not unknown else [], rows, sorted(unknown)
