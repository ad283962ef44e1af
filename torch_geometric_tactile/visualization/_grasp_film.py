r"""Pictures of simulated grasps."""

from collections.abc import Iterator
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import torch
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.sensors import HandKinematics, TaxelLayout
from torch_geometric_tactile.sim.hand_model import STAND, stock_bodies
from torch_geometric_tactile.visualization._style import (
    SMALL,
    current_theme,
    new_figure,
    plain_text,
    title_axes,
    title_figure,
)
from torch_geometric_tactile.visualization._taxel_map import value_scale, view_axes
from torch_geometric_tactile.visualization.hand import plot_hand

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_Color = tuple[float, float, float, float]  # with opacity: bones and object must not hide taxels
_BONE: _Color = (0.66, 0.69, 0.74, 0.40)
_OBJECT: _Color = (0.95, 0.74, 0.45, 0.30)
_STAND: _Color = (0.80, 0.80, 0.78, 1.0)
_SKIN: _Color = (0.45, 0.48, 0.53, 0.55)
_LIGHT = np.array([0.35, -0.55, 0.76])
_FULL_FORCE = 1.0  # N, end of the colour scale of the film
_MIN_FORCE = 0.02  # N, from which a taxel is drawn as touched
_TAXEL_RADIUS, _TOUCHED_RADIUS = 0.0018, 0.0036  # m, as drawn
_MARGIN = 0.012  # m around the hand and the object
_QUANTILE = 0.95  # of the forces on touched taxels, end of the colour scale of the phases


class _Faces(NamedTuple):
    corners: np.ndarray  # (F, K, 3)
    color: np.ndarray  # (F, 4)
    is_in_view: bool = True  # whether the limits of the view include the faces
    depth_offset: np.ndarray | float = 0.0  # metres towards the viewer, for the drawing order


def plot_grasp_film(
    recording: Recording,
    layout: TaxelLayout,
    kinematics: HandKinematics,
    frames: int = 8,
    azimuth: float = -62.0,
    elevation: float = 6.0,
) -> "Figure":
    r"""Draws a simulated trial as a series of pictures that are zoomed to the hand and the object.
    Touched taxels are large, in front of all other parts, and coloured by their normal force. All
    phases have about the same number of pictures, regardless of their duration.

    Args:
        recording (Recording): The trial.
        layout (TaxelLayout): The taxels.
        kinematics (HandKinematics): The hand.
        frames (int): Number of pictures.
        azimuth (float): Azimuth of the viewer in degrees.
        elevation (float): Elevation of the viewer in degrees.

    Raises:
        ValueError: If the recording is not a simulated trial, or :obj:`frames` is below one.
    """
    _check_simulated(recording)
    need(frames >= 1, "'frames' must be at least 1", frames)
    columns = min(frames, 4)
    rows = -(-frames // columns)
    indices = [int(i) for i in _evenly_over_phases(recording.privileged["phase"], frames)]
    scale = value_scale(None, (0.0, _FULL_FORCE), "sequential")
    scenes = [list(_scene(recording, frame, layout, kinematics, scale)) for frame in indices]
    view = view_axes(azimuth, elevation)
    plane, towards_viewer = view[:2].T, view[2]
    sizes = [np.ptp(_corners(scene, plane), axis=0) + 2 * _MARGIN for scene in scenes]
    ratio = float(np.mean([size[1] / size[0] for size in sizes]))
    panel_height = 1.9 * ratio
    figure = new_figure(max(2.0 * columns, 4.0), (panel_height + 0.3) * rows + 1.0)
    axes = []
    for i, (frame, scene) in enumerate(zip(indices, scenes, strict=True)):
        width = max(sizes[i][0], sizes[i][1] / ratio)
        ax = figure.add_subplot(rows, columns, i + 1)
        _draw_scene(ax, scene, plane, towards_viewer, np.array([width, ratio * width]))
        force = float(recording.privileged["force"][frame, :, 2].clip(0).sum())
        phase = _phase_name(recording, int(recording.privileged["phase"][frame]))
        title_axes(
            ax,
            plain_text(f"{recording.time[frame]:.1f} s, {phase}: {force:.0f} N on the skin"),
            size=SMALL,
        )
        axes.append(ax)
    bar = figure.colorbar(
        scale, ax=axes, location="bottom", shrink=0.5, aspect=40, pad=0.02, extend="max"
    )
    bar.set_label("normal force on a taxel (N); untouched taxels are grey")
    title_figure(figure, f"Simulated grasp of {recording.label}")
    return figure


def plot_grasp_forces(
    recording: Recording, layout: TaxelLayout, kinematics: HandKinematics
) -> "Figure":
    r"""Draws the normal force on every taxel in a simulated trial, with one hand per phase. The
    force is the mean over the second half of the phase. Because few taxels carry most of the force,
    the colour scale ends at the 95th percentile of the touched taxels.

    Args:
        recording (Recording): The trial.
        layout (TaxelLayout): The taxels.
        kinematics (HandKinematics): The hand.

    Raises:
        ValueError: If the recording is not a simulated trial.
    """
    _check_simulated(recording)
    phase_force = {}
    for phase in np.unique(recording.privileged["phase"]):
        frames = np.flatnonzero(recording.privileged["phase"] == phase)
        second_half = frames[len(frames) // 2 :]
        phase_force[int(phase)] = recording.privileged["force"][second_half, :, 2].mean(axis=0)
    force = np.concatenate(list(phase_force.values()))
    touched = force[force > _MIN_FORCE]
    limit = float(np.quantile(touched, _QUANTILE)) if touched.size else 1.0
    columns = min(len(phase_force), 3)
    rows = -(-len(phase_force) // columns)
    figure = new_figure(2.4 * columns + 0.8, 2.6 * rows + 0.4)
    axes = []
    for i, (phase, values) in enumerate(phase_force.items()):
        axes.append(figure.add_subplot(rows, columns, i + 1))
        plot_hand(
            layout,
            kinematics,
            value=torch.from_numpy(values.astype(np.float32)),
            ax=axes[-1],
            limits=(0.0, limit),
            label=None,
            title=f"{_phase_name(recording, phase)}: {values.clip(0).sum():.1f} N",
        )
        axes[-1].set_axis_off()
    bar = figure.colorbar(
        value_scale(None, (0.0, limit), "sequential"),
        ax=axes,
        shrink=0.7,
        aspect=30,
        extend="max" if touched.size and float(touched.max()) > limit else "neither",
    )
    bar.set_label("normal force on a taxel (N)")
    title_figure(figure, f"Simulated grasp of {recording.label}: normal force on the skin by phase")
    return figure


def _check_simulated(recording: Recording) -> None:
    for name in ("palm_pose", "object_pose", "force", "phase"):
        if name not in recording.privileged:
            raise ValueError(
                f"'recording' must be a simulated trial with the privileged '{name}' (got "
                f"{sorted(recording.privileged)})"
            )
    if recording.joint is None or recording.num_frames == 0:
        raise ValueError("'recording' must have frames and joint angles (got none)")


def _phase_name(recording: Recording, phase: int) -> str:
    names = recording.meta.get("phase_names", [])
    return names[phase] if phase < len(names) else f"phase {phase}"


def _evenly_over_phases(phase: np.ndarray, num_frames: int) -> np.ndarray:
    # Indices of frames; each phase has about the same number of them.
    weight = 1.0 / np.bincount(phase)[phase]
    progress = np.cumsum(weight) / weight.sum()
    targets = (np.arange(num_frames) + 0.5) / num_frames
    return np.searchsorted(progress, targets).clip(max=len(phase) - 1)


def _corners(scene: list[_Faces], plane: np.ndarray) -> np.ndarray:
    points = np.concatenate(
        [(faces.corners @ plane).reshape(-1, 2) for faces in scene if faces.is_in_view]
    )
    return np.stack([points.min(axis=0), points.max(axis=0)])


def _draw_scene(
    ax: Any, scene: list[_Faces], plane: np.ndarray, towards_viewer: np.ndarray, size: np.ndarray
) -> None:
    from matplotlib.collections import PolyCollection

    polygons = [polygon for faces in scene for polygon in faces.corners @ plane]
    depth = np.concatenate(
        [(faces.corners @ towards_viewer).mean(axis=1) + faces.depth_offset for faces in scene]
    )
    # This is the painter's algorithm: distant faces are drawn first.
    order = depth.argsort(kind="stable")
    collection = PolyCollection(
        [polygons[i] for i in order],
        facecolors=np.concatenate([faces.color for faces in scene])[order],
        edgecolors="none",
    )
    ax.add_collection(collection)
    ax.axhline(0.0, color=current_theme().faint, linewidth=1.0, zorder=0)
    low, high = (_corners(scene, plane).mean(axis=0) + side * size / 2 for side in (-1, 1))
    ax.set_xlim(low[0], high[0])
    ax.set_ylim(low[1], high[1])
    ax.set_aspect("equal")
    ax.set_axis_off()


def _scene(
    recording: Recording,
    frame: int,
    layout: TaxelLayout,
    kinematics: HandKinematics,
    scale: Any,
) -> Iterator[_Faces]:
    assert recording.joint is not None
    half_x, half_y, height = STAND
    for corners in _primitive("box", [half_x, half_y, height / 2]):
        faces = _shade(corners + np.array([0.0, 0.0, height / 2]), _STAND)
        yield faces._replace(is_in_view=False)
    item = recording.meta["object_parameters"]
    pose = recording.privileged["object_pose"][frame]
    for corners in _primitive(item["shape"], np.array(item["size"]) / 2):
        yield _shade(corners @ _rotation_matrix(pose[3:]).T + pose[:3], _OBJECT)

    palm = recording.privileged["palm_pose"][frame]
    rotation, origin = _rotation_matrix(palm[3:]), palm[:3]
    joint = torch.from_numpy(recording.joint[frame]).double()
    links = kinematics.link_pose(joint)
    for body in stock_bodies():
        link = kinematics.link_names.index(body["link"])
        link_rotation = rotation @ links.rotation[link].numpy()
        link_origin = rotation @ links.translation[link].numpy() + origin
        is_box = "box" in body
        half_size = np.array(body["box"]) / 2 if is_box else [body["sphere"]] * 3
        for corners in _primitive("box" if is_box else "ellipsoid", half_size):
            link_corners = corners + np.array(body["center"])
            yield _shade(link_corners @ link_rotation.T + link_origin, _BONE)

    taxels = kinematics.taxel_pose(layout, joint)
    assert taxels.normal is not None
    force = recording.privileged["force"][frame, :, 2]
    is_touched = force > _MIN_FORCE
    yield _Faces(
        _discs(
            taxels.pos.numpy() @ rotation.T + origin,
            taxels.normal.numpy() @ rotation.T,
            np.where(is_touched, _TOUCHED_RADIUS, _TAXEL_RADIUS),
        ),
        np.where(is_touched[:, None], scale.to_rgba(force), np.array(_SKIN)),
        depth_offset=is_touched.astype(np.float64),
    )


def _rotation_matrix(quaternion: np.ndarray) -> np.ndarray:
    # Quaternions in recordings are w, x, y, z; quaternions in SciPy are x, y, z, w.
    return np.asarray(Rotation.from_quat(np.roll(quaternion, -1)).as_matrix())


def _shade(corners: np.ndarray, color: _Color) -> _Faces:
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, -1] - corners[:, 0])
    length = np.linalg.norm(normal, axis=1)
    brightness = np.abs(normal @ _LIGHT) / np.where(length > 0, length, 1.0)
    brightness[length == 0] = 1.0
    shade = (0.55 + 0.45 * brightness)[:, None] * np.array(color[:3])
    return _Faces(corners, np.column_stack([shade, np.full(len(shade), color[3])]))


def _discs(pos: np.ndarray, normal: np.ndarray, radius: np.ndarray) -> np.ndarray:
    tangent = np.cross(normal, [0.3, 0.5, 0.8])
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    angle = np.linspace(0, 2 * np.pi, 9)[:-1, None]
    ring = np.cos(angle) * tangent[:, None] + np.sin(angle) * np.cross(normal, tangent)[:, None]
    return np.asarray(pos[:, None] + radius[:, None, None] * ring)


def _primitive(shape: str, half_size: ArrayLike) -> list[np.ndarray]:
    return [corners * np.asarray(half_size) for corners in _unit_primitive(shape)]


@lru_cache
def _unit_primitive(shape: str) -> list[np.ndarray]:
    # Shapes are divided into small faces, because the painter's algorithm may draw large faces in
    # the wrong order.
    if shape == "box":
        steps = np.linspace(-1, 1, 4)
        face = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1)
        sides = [(axis, side) for axis in range(3) for side in (-1.0, 1.0)]
        return [np.concatenate([_quads(np.insert(face, *side, axis=-1)) for side in sides])]
    azimuth = np.linspace(0, 2 * np.pi, 25)
    if shape == "cylinder":
        ring = np.stack([np.cos(azimuth), np.zeros(25), np.sin(azimuth)], axis=1)
        heights = np.linspace(-1, 1, 9)[:, None] * [0.0, 1.0, 0.0]
        centres = np.broadcast_to(heights[[0, -1]], (24, 2, 3))
        ends = np.stack([ring[:-1, None] + centres, ring[1:, None] + centres, centres], axis=2)
        return [_quads(ring[:, None] + heights), ends.reshape(-1, 3, 3)]
    a, e = np.meshgrid(azimuth, np.linspace(-np.pi / 2, np.pi / 2, 13), indexing="ij")
    return [_quads(np.stack([np.cos(e) * np.cos(a), np.sin(e), np.cos(e) * np.sin(a)], axis=-1))]


def _quads(points: np.ndarray) -> np.ndarray:
    # The cells of a surface (U, V, 3) as quadrilaterals (F, 4, 3).
    corners = points[:-1, :-1], points[1:, :-1], points[1:, 1:], points[:-1, 1:]
    return np.stack(corners, axis=2).reshape(-1, 4, 3)
