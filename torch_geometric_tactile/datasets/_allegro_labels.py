r"""Labels of the frames of grasps with the Allegro hand, from the metadata of the recordings."""

from collections.abc import Mapping, Sequence

import numpy as np
import torch
from torch import Tensor

from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.data._paper_objects import PAPER_OBJECTS, PROPERTIES
from torch_geometric_tactile.datasets._frame_labels import ObjectLabels
from torch_geometric_tactile.datasets._trial import Trial, checked_labels, checked_names

#: The targets of simulated grasps, with the names of their columns. A shape is a class.
GRASP_TARGETS = {"shape": (), "width": ("width",), "centre": ("x", "y", "z"), "yaw": ("yaw",)}


class AllegroLabels(ObjectLabels):
    r"""Labels with the six properties of the papers and the targets of simulated grasps.

    Objects with a name in :obj:`PAPER_OBJECTS` need no labels in their metadata.
    """

    def object_names(self, trials: Sequence[Trial]) -> list[str]:
        r"""Returns the names of the objects: the papers' objects in the papers' order, then all
        other objects.
        """
        names = super().object_names(trials)
        paper_names = [name for name in PAPER_OBJECTS if name in names]
        return paper_names + [name for name in names if name not in paper_names]

    def properties(self, trial: Trial) -> tuple[tuple[str, ...], tuple[int, ...]] | None:
        r"""Returns the names and values of the properties of a trial, or :obj:`None` if they are
        unknown.
        """
        names: tuple[str, ...] = PROPERTIES
        if trial.meta.get("label_names") is not None:
            names = checked_names(trial, "label_names")
        if trial.meta.get("labels") is None or sorted(names) != sorted(PROPERTIES):
            present = PAPER_OBJECTS.get(trial.object_name or "")
            return (
                None
                if present is None
                else (PROPERTIES, tuple(int(name in present) for name in PROPERTIES))
            )
        labels = checked_labels(trial, names)
        values = {name: labels[names.index(name)] for name in PROPERTIES}
        # PROPERTIES alternates between a property and its opposite.
        for name, opposite in zip(PROPERTIES[::2], PROPERTIES[1::2], strict=True):
            if values[name] and values[opposite]:
                raise ValueError(
                    f"{trial.where} must not be both '{name}' and '{opposite}' in 'labels' "
                    f"(got {list(labels)})"
                )
        return PROPERTIES, tuple(values.values())

    def extra_attributes(
        self, trials: Sequence[Trial], names: dict[str, list[str]]
    ) -> dict[str, Tensor]:
        r"""Returns the shape, width, centre and yaw of the objects as far as they are known, and
        adds the names of the shapes to :obj:`names`.
        """
        names["shape"], targets = grasp_targets(trials)
        return targets

    def target(
        self, data: StaticData, names: Mapping[str, list[str]], target: str, root: str
    ) -> Tensor:
        r"""Returns the labels :obj:`y` of all frames for a target."""
        if target in GRASP_TARGETS:
            return grasp_target(data, target, root)
        return super().target(data, names, target, root)

    def unknown_properties(self, unknown: Sequence[str]) -> str:
        r"""Returns the error message for objects with unknown properties as the target."""
        return (
            f"the properties of {list(unknown)} are unknown: write 0 or 1 for each of "
            f"{list(PROPERTIES)} as 'labels' into the metadata of their recordings, rename them to "
            f"one of {list(PAPER_OBJECTS)}, or choose task='object'"
        )


def grasp_targets(trials: Sequence[Trial]) -> tuple[list[str], dict[str, Tensor]]:
    r"""Returns the names of the shapes, and the targets that are known for all trials.

    * :obj:`shape`: index into the names.
    * :obj:`width`: width of the object in metres.
    * :obj:`centre`: position of the object in the palm's frame in metres.
    * :obj:`yaw`: rotation of the object's long axis (:math:`y`) about the palm's normal in radians,
      from -pi/2 to pi/2. It is zero across the fingers, pi/2 along them, and NaN for a sphere.

    Shape and width are read from :obj:`"shape"` and :obj:`"width"` in the metadata, or from the
    :obj:`"object_parameters"` of a simulation. Centre and yaw are computed from
    :obj:`privileged["object_pose"]` and :obj:`privileged["palm_pose"]`, positions and quaternions
    :math:`(T, 7)` in the world's frame.

    Shapes:
        - **shape, width, yaw:** :math:`(S,)`
        - **centre:** :math:`(S, 3)`
    """
    num_frames = torch.tensor([trial.num_frames for trial in trials])
    shapes, widths = zip(*map(_shape_and_width, trials), strict=True)
    names = sorted({shape for shape in shapes if shape is not None})
    targets: dict[str, Tensor] = {}
    if None not in shapes:
        codes = torch.tensor([names.index(shape) for shape in shapes])
        targets["shape"] = codes.repeat_interleave(num_frames)
    if None not in widths:
        targets["width"] = torch.tensor(widths).float().repeat_interleave(num_frames)
    if all({"object_pose", "palm_pose"} <= trial.pose.keys() for trial in trials):
        poses = [_centre_and_yaw(trial) for trial in trials]
        targets["centre"] = torch.from_numpy(
            np.concatenate([centre for centre, _ in poses])
        ).float()
        yaws = [
            np.full(len(yaw), np.nan) if shape == "sphere" else yaw
            for (_, yaw), shape in zip(poses, shapes, strict=True)
        ]
        targets["yaw"] = torch.from_numpy(np.concatenate(yaws)).float()
    return names if "shape" in targets else [], targets


def grasp_target(data: StaticData, task: str, root: str) -> Tensor:
    r"""Returns one of the :obj:`GRASP_TARGETS` of all frames.

    Raises:
        ValueError: If the target is unknown or NaN in all frames.
    """
    target: Tensor | None = data[task] if task in data else None  # noqa: SIM401 - Data is no mapping
    if target is not None and target.isfinite().any():
        return target.clone()
    requirement = (
        "privileged 'object_pose' and 'palm_pose' (T, 7) of objects that are not spheres"
        if task in ("centre", "yaw")
        else f"'{task}' in their metadata"
    )
    raise ValueError(
        f"task='{task}' must have a target in all recordings in '{root}': {requirement}, as "
        "tactile simulate writes them; or choose task='object'"
    )


def _shape_and_width(trial: Trial) -> tuple[str | None, float | None]:
    parameters = trial.meta.get("object_parameters")
    parameters = parameters if isinstance(parameters, dict) else {}
    size = parameters.get("size")
    shape = trial.meta.get("shape", parameters.get("shape"))
    width = trial.meta.get("width", size[0] if isinstance(size, list) and size else None)
    is_number = isinstance(width, int | float) and not isinstance(width, bool)
    return shape if isinstance(shape, str) else None, float(width) if is_number else None


def _centre_and_yaw(trial: Trial) -> tuple[np.ndarray, np.ndarray]:
    # Returns the centre (T, 3) and the yaw (T,) of the object in the palm's frame.
    object_pose, palm_pose = trial.pose["object_pose"], trial.pose["palm_pose"]
    R_palm_world = _quaternion_to_matrix(palm_pose[:, 3:]).transpose(0, 2, 1)
    centre = np.einsum("tij,tj->ti", R_palm_world, object_pose[:, :3] - palm_pose[:, :3])
    axis = np.einsum("tij,tj->ti", R_palm_world, _quaternion_to_matrix(object_pose[:, 3:])[:, :, 1])
    # An axis has no direction, so a half turn does not change the yaw.
    sign = np.where(axis[:, 1:2] < 0, -1.0, 1.0)
    return centre, np.arctan2(*(sign * axis[:, [2, 1]]).T)


def _quaternion_to_matrix(quaternion: np.ndarray) -> np.ndarray:
    w, x, y, z = quaternion.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), -1, 0)
