r"""What recordings of the Allegro hand tell of the grasped objects, as labels of the frames."""

from collections.abc import Mapping, Sequence

import numpy as np
import torch
from torch import Tensor

from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.data._paper_objects import PAPER_OBJECTS, PROPERTIES
from torch_geometric_tactile.datasets._frame_labels import ObjectLabels
from torch_geometric_tactile.datasets._trial import Trial, checked_labels, checked_names

#: The targets, with the names of their numbers; a shape is a class.
GRASP_TARGETS = {"shape": (), "width": ("width",), "centre": ("x", "y", "z"), "yaw": ("yaw",)}


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


def grasp_targets(trials: Sequence[Trial]) -> tuple[list[str], dict[str, Tensor]]:
    r"""Returns the names of the shapes, and those targets that all trials know: :obj:`shape`, an
    index into the names; :obj:`width` in metres; :obj:`centre` of the object in the palm's frame,
    in metres; and :obj:`yaw`, the turn of its long axis (:math:`y`) about the palm's normal in
    radians, from -pi/2 to pi/2: zero across the fingers, pi/2 along them. A sphere's yaw is NaN.

    They are read from the metadata, :obj:`"shape"` and :obj:`"width"` or :obj:`"object_parameters"`
    of a simulation, and from :obj:`privileged["object_pose"]` and :obj:`privileged["palm_pose"]`,
    positions and quaternions :math:`(T, 7)` in the world's frame.

    Shapes:
        - **shape, width, yaw:** :math:`(S,)`
        - **centre:** :math:`(S, 3)`
    """
    num_frames = torch.tensor([trial.num_frames for trial in trials])
    shapes, widths = zip(*map(_shape_and_width, trials), strict=True)
    names = sorted({shape for shape in shapes if shape is not None})
    out: dict[str, Tensor] = {}
    if None not in shapes:
        numbers = torch.tensor([names.index(shape) for shape in shapes])
        out["shape"] = numbers.repeat_interleave(num_frames)
    if None not in widths:
        out["width"] = torch.tensor(widths).float().repeat_interleave(num_frames)
    if all({"object_pose", "palm_pose"} <= trial.pose.keys() for trial in trials):
        found = [_seen_from_the_palm(trial) for trial in trials]
        out["centre"] = torch.from_numpy(np.concatenate([centre for centre, _ in found])).float()
        yaws = [
            np.full(len(yaw), np.nan) if shape == "sphere" else yaw
            for (_, yaw), shape in zip(found, shapes, strict=True)
        ]
        out["yaw"] = torch.from_numpy(np.concatenate(yaws)).float()
    return names if "shape" in out else [], out


def grasp_target(data: StaticData, task: str, root: str) -> Tensor:
    r"""Returns a target of the frames."""
    target: Tensor | None = data[task] if task in data else None  # noqa: SIM401 - Data is no mapping
    if target is not None and target.isfinite().any():
        return target.clone()
    needed = (
        "privileged 'object_pose' and 'palm_pose' (T, 7), of objects that are no spheres"
        if task in ("centre", "yaw")
        else f"'{task}' in their metadata"
    )
    raise ValueError(
        f"task='{task}' must have a target in all recordings in '{root}': {needed}, as tactile "
        "simulate writes them; or choose task='object'"
    )


def _shape_and_width(trial: Trial) -> tuple[str | None, float | None]:
    simulated = trial.meta.get("object_parameters")
    simulated = simulated if isinstance(simulated, dict) else {}
    size = simulated.get("size")
    shape = trial.meta.get("shape", simulated.get("shape"))
    width = trial.meta.get("width", size[0] if isinstance(size, list) and size else None)
    is_number = isinstance(width, int | float) and not isinstance(width, bool)
    return shape if isinstance(shape, str) else None, float(width) if is_number else None


def _seen_from_the_palm(trial: Trial) -> tuple[np.ndarray, np.ndarray]:
    item, palm = trial.pose["object_pose"], trial.pose["palm_pose"]
    to_palm = _rotation(palm[:, 3:]).transpose(0, 2, 1)
    centre = np.einsum("tij,tj->ti", to_palm, item[:, :3] - palm[:, :3])
    axis = np.einsum("tij,tj->ti", to_palm, _rotation(item[:, 3:])[:, :, 1])
    # An axis has no direction: half a turn is none.
    side = np.where(axis[:, 1:2] < 0, -1.0, 1.0)
    return centre, np.arctan2(*(side * axis[:, [2, 1]]).T)


def _rotation(quaternion: np.ndarray) -> np.ndarray:
    w, x, y, z = quaternion.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), -1, 0)
