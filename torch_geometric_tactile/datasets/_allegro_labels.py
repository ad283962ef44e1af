r"""What recordings of the Allegro hand tell of their objects, as labels of the frames."""

from collections.abc import Mapping, Sequence

from torch import Tensor

from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.datasets._allegro_objects import PAPER_OBJECTS, PROPERTIES
from torch_geometric_tactile.datasets._grasp_targets import (
    GRASP_TARGETS,
    grasp_target,
    grasp_targets,
)
from torch_geometric_tactile.datasets._object_labels import ObjectLabels
from torch_geometric_tactile.datasets._trial import Trial, checked_labels, checked_names


class AllegroLabels(ObjectLabels):
    r"""The six properties of the papers, also of their eight objects by name, and what a simulated
    grasp tells of the object beside them.
    """

    def object_names(self, trials: Sequence[Trial]) -> list[str]:
        r"""Returns the names of the objects: those of the papers in their order, then others."""
        found = super().object_names(trials)
        known = [name for name in PAPER_OBJECTS if name in found]
        return known + [name for name in found if name not in known]

    def properties(self, trial: Trial) -> tuple[tuple[str, ...], tuple[int, ...]] | None:
        r"""Returns names and values of the properties of a trial, if they are known."""
        names: tuple[str, ...] = PROPERTIES
        if trial.meta.get("label_names") is not None:
            names = checked_names(trial, "label_names")
        if trial.meta.get("labels") is None or sorted(names) != sorted(PROPERTIES):
            has = PAPER_OBJECTS.get(trial.object_name or "")
            return None if has is None else (PROPERTIES, tuple(int(p in has) for p in PROPERTIES))
        labels = checked_labels(trial, names)
        values = {name: labels[names.index(name)] for name in PROPERTIES}
        for first, other in zip(PROPERTIES[::2], PROPERTIES[1::2], strict=True):
            if values[first] and values[other]:
                raise ValueError(
                    f"{trial.where} must not be both '{first}' and '{other}' in 'labels' "
                    f"(got {list(labels)})"
                )
        return PROPERTIES, tuple(values.values())

    def more(self, trials: Sequence[Trial], names: dict[str, list[str]]) -> dict[str, Tensor]:
        r"""Returns shape, width, centre and yaw of the objects, where they are known."""
        names["shape"], targets = grasp_targets(trials)
        return targets

    def target(
        self, data: StaticData, names: Mapping[str, list[str]], target: str, root: str
    ) -> Tensor:
        r"""Returns what :obj:`y` is."""
        if target in GRASP_TARGETS:
            return grasp_target(data, target, root)
        return super().target(data, names, target, root)

    def unknown_properties(self, unknown: Sequence[str]) -> str:
        r"""Returns the message of an error about properties that are asked for, but unknown."""
        return (
            f"the properties of {list(unknown)} are unknown: give 0 or 1 for each of "
            f"{list(PROPERTIES)} as 'labels' in the metadata of their recordings, name them as "
            f"one of {list(PAPER_OBJECTS)}, or choose task='object'"
        )
