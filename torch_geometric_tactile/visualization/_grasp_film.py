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
from torch_geometric_tactile.sim import stock_bodies
from torch_geometric_tactile.sim.hand_model import STAND
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

_Color = tuple[float, float, float, float]  # with opacity: taxels are seen through bones and object
_BONE: _Color = (0.66, 0.69, 0.74, 0.40)
_OBJECT: _Color = (0.95, 0.74, 0.45, 0.30)
_STAND: _Color = (0.80, 0.80, 0.78, 1.0)
_SKIN: _Color = (0.45, 0.48, 0.53, 0.55)
_LIGHT = np.array([0.35, -0.55, 0.76])
_FULL_FORCE = 1.0  # newtons at the end of the colours of the film
_TOUCH = 0.02  # newtons from which a taxel is drawn as touched
_TAXEL, _TOUCHED = 0.0018, 0.0036  # radius of a drawn taxel, m
_MARGIN = 0.012  # m around the hand and the object
_QUANTILE = 0.95  # of the forces at touched taxels, at the end of the colours of the phases


class _Faces(NamedTuple):
    corners: np.ndarray  # (F, K, 3)
    color: np.ndarray  # (F, 4)
    is_followed: bool = True  # by the view
    ahead: np.ndarray | float = 0.0  # m by which they are drawn before what is nearer


def plot_grasp_film(
    recording: Recording,
    layout: TaxelLayout,
    kinematics: HandKinematics,
    frames: int = 8,
    azimuth: float = -62.0,
    elevation: float = 6.0,
) -> "Figure":
    r"""Draws a simulated trial as a strip of pictures, each as near as hand and object allow.
    Touched taxels are drawn large, before all else and in the colour of their normal force. Each
    phase has about as many pictures, however long it lasts.
    """
    _check(recording)
    need(frames >= 1, "'frames' must be at least 1", frames)
    columns = min(frames, 4)
    rows = -(-frames // columns)
    shown = [int(i) for i in _spread_over_phases(recording.privileged["phase"], frames)]
    scale = value_scale(None, (0.0, _FULL_FORCE), "sequential")
    scenes = [list(_scene(recording, frame, layout, kinematics, scale)) for frame in shown]
    view = view_axes(azimuth, elevation)
    plane, towards = view[:2].T, view[2]
    sizes = [np.ptp(_corners(scene, plane), axis=0) + 2 * _MARGIN for scene in scenes]
    ratio = float(np.mean([size[1] / size[0] for size in sizes]))
    tall = 1.9 * ratio
    figure = new_figure(max(2.0 * columns, 4.0), (tall + 0.3) * rows + 1.0)
    axes = []
    for i, (frame, scene) in enumerate(zip(shown, scenes, strict=True)):
        wide = max(sizes[i][0], sizes[i][1] / ratio)
        ax = figure.add_subplot(rows, columns, i + 1)
        _draw(ax, scene, plane, towards, np.array([wide, ratio * wide]))
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
    bar.set_label("normal force on a taxel (N); taxels without touch are grey")
    title_figure(figure, f"Simulated grasp of {recording.label}")
    return figure


def plot_grasp_forces(
    recording: Recording, layout: TaxelLayout, kinematics: HandKinematics
) -> "Figure":
    r"""Draws the normal force on every taxel of a simulated trial, a hand for each phase: the mean
    over the last half of the phase. Few taxels carry most of it, so that the colours end at the
    95th percentile of the taxels that are touched.
    """
    _check(recording)
    force = {}
    for phase in np.unique(recording.privileged["phase"]):
        frames = np.flatnonzero(recording.privileged["phase"] == phase)
        late = frames[len(frames) // 2 :]
        force[int(phase)] = recording.privileged["force"][late, :, 2].mean(axis=0)
    every = np.concatenate(list(force.values()))
    touched = every[every > _TOUCH]
    top = float(np.quantile(touched, _QUANTILE)) if touched.size else 1.0
    columns = min(len(force), 3)
    rows = -(-len(force) // columns)
    figure = new_figure(2.4 * columns + 0.8, 2.6 * rows + 0.4)
    axes = []
    for i, (phase, values) in enumerate(force.items()):
        axes.append(figure.add_subplot(rows, columns, i + 1))
        plot_hand(
            layout,
            kinematics,
            value=torch.from_numpy(values.astype(np.float32)),
            ax=axes[-1],
            limits=(0.0, top),
            label=None,
            title=f"{_phase_name(recording, phase)}: {values.clip(0).sum():.1f} N",
        )
        axes[-1].set_axis_off()
    bar = figure.colorbar(
        value_scale(None, (0.0, top), "sequential"),
        ax=axes,
        shrink=0.7,
        aspect=30,
        extend="max" if touched.size and float(touched.max()) > top else "neither",
    )
    bar.set_label("normal force on a taxel (N)")
    title_figure(figure, f"Simulated grasp of {recording.label}: normal force on the skin by phase")
    return figure


def _check(recording: Recording) -> None:
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


def _spread_over_phases(phase: np.ndarray, frames: int) -> np.ndarray:
    weight = 1.0 / np.bincount(phase)[phase]
    passed = np.cumsum(weight) / weight.sum()
    return np.searchsorted(passed, (np.arange(frames) + 0.5) / frames).clip(max=len(phase) - 1)


def _corners(scene: list[_Faces], plane: np.ndarray) -> np.ndarray:
    points = np.concatenate(
        [(faces.corners @ plane).reshape(-1, 2) for faces in scene if faces.is_followed]
    )
    return np.stack([points.min(axis=0), points.max(axis=0)])


def _draw(
    ax: Any, scene: list[_Faces], plane: np.ndarray, towards: np.ndarray, size: np.ndarray
) -> None:
    from matplotlib.collections import PolyCollection

    polygons = [polygon for faces in scene for polygon in faces.corners @ plane]
    depth = np.concatenate(
        [(faces.corners @ towards).mean(axis=1) + faces.ahead for faces in scene]
    )
    # The painter's algorithm: far faces are drawn first.
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
        faces = _shaded(corners + np.array([0.0, 0.0, height / 2]), _STAND)
        yield faces._replace(is_followed=False)
    item = recording.meta["object_parameters"]
    pose = recording.privileged["object_pose"][frame]
    for corners in _primitive(item["shape"], np.array(item["size"]) / 2):
        yield _shaded(corners @ _rotation(pose[3:]).T + pose[:3], _OBJECT)

    palm = recording.privileged["palm_pose"][frame]
    turn, origin = _rotation(palm[3:]), palm[:3]
    joint = torch.from_numpy(recording.joint[frame]).double()
    links = kinematics.link_pose(joint)
    for body in stock_bodies():
        number = kinematics.link_names.index(body["link"])
        link_turn = turn @ links.rotation[number].numpy()
        place = turn @ links.translation[number].numpy() + origin
        box = "box" in body
        half = np.array(body["box"]) / 2 if box else [body["sphere"]] * 3
        for corners in _primitive("box" if box else "ellipsoid", half):
            yield _shaded((corners + np.array(body["center"])) @ link_turn.T + place, _BONE)

    taxels = kinematics.taxel_pose(layout, joint)
    assert taxels.normal is not None
    force = recording.privileged["force"][frame, :, 2]
    touched = force > _TOUCH
    yield _Faces(
        _discs(
            taxels.pos.numpy() @ turn.T + origin,
            taxels.normal.numpy() @ turn.T,
            np.where(touched, _TOUCHED, _TAXEL),
        ),
        np.where(touched[:, None], scale.to_rgba(force), np.array(_SKIN)),
        ahead=touched.astype(np.float64),
    )


def _rotation(quaternion: np.ndarray) -> np.ndarray:
    return np.asarray(Rotation.from_quat(np.roll(quaternion, -1)).as_matrix())  # of w, x, y, z


def _shaded(corners: np.ndarray, color: _Color) -> _Faces:
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, -1] - corners[:, 0])
    length = np.linalg.norm(normal, axis=1)
    light = np.abs(normal @ _LIGHT) / np.where(length > 0, length, 1.0)
    light[length == 0] = 1.0
    shade = (0.55 + 0.45 * light)[:, None] * np.array(color[:3])
    return _Faces(corners, np.column_stack([shade, np.full(len(shade), color[3])]))


def _discs(pos: np.ndarray, normal: np.ndarray, radius: np.ndarray) -> np.ndarray:
    across = np.cross(normal, [0.3, 0.5, 0.8])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    angle = np.linspace(0, 2 * np.pi, 9)[:-1, None]
    ring = np.cos(angle) * across[:, None] + np.sin(angle) * np.cross(normal, across)[:, None]
    return np.asarray(pos[:, None] + radius[:, None, None] * ring)


def _primitive(shape: str, half: ArrayLike) -> list[np.ndarray]:
    return [corners * np.asarray(half) for corners in _unit_primitive(shape)]


@lru_cache
def _unit_primitive(shape: str) -> list[np.ndarray]:
    # In many small faces: the painter's order of large ones can be wrong.
    if shape == "box":
        steps = np.linspace(-1, 1, 4)
        face = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1)
        sides = [(axis, side) for axis in range(3) for side in (-1.0, 1.0)]
        return [np.concatenate([_quads(np.insert(face, *side, axis=-1)) for side in sides])]
    around = np.linspace(0, 2 * np.pi, 25)
    if shape == "cylinder":
        ring = np.stack([np.cos(around), np.zeros(25), np.sin(around)], axis=1)
        heights = np.linspace(-1, 1, 9)[:, None] * [0.0, 1.0, 0.0]
        middle = np.broadcast_to(heights[[0, -1]], (24, 2, 3))
        ends = np.stack([ring[:-1, None] + middle, ring[1:, None] + middle, middle], axis=2)
        return [_quads(ring[:, None] + heights), ends.reshape(-1, 3, 3)]
    a, e = np.meshgrid(around, np.linspace(-np.pi / 2, np.pi / 2, 13), indexing="ij")
    return [_quads(np.stack([np.cos(e) * np.cos(a), np.sin(e), np.cos(e) * np.sin(a)], axis=-1))]


def _quads(points: np.ndarray) -> np.ndarray:
    # The cells of a surface (U, V, 3), as (F, 4, 3).
    corners = points[:-1, :-1], points[1:, :-1], points[1:, 1:], points[:-1, 1:]
    return np.stack(corners, axis=2).reshape(-1, 4, 3)
