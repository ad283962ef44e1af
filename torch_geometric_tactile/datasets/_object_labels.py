r"""What recordings tell of their objects, as labels of the frames."""

from collections.abc import Mapping, Sequence

from torch import Tensor

from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.datasets._trial import Trial, checked_labels, checked_names


class ObjectLabels:
    r"""The objects and properties of trials, as their metadata tell them; a data set whose
    recordings tell more has a subclass.
    """

    def object_names(self, trials: Sequence[Trial]) -> list[str]:
        r"""Returns the names of the objects, in the order of their numbers."""
        return sorted({trial.object_name for trial in trials if trial.object_name is not None})

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
