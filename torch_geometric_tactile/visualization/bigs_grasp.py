r"""Pictures of simulated grasps of three fingertips over time."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.visualization._style import (
    SMALL,
    TEXT,
    colormap,
    current_theme,
    new_figure,
    plain_text,
    series_color,
    title_axes,
    title_figure,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_INPUT = 2.0  # s after pick-up, where the input of the paper ends
_SHADE = 0.10  # opacity of the colour of a phase


def plot_bigs_grasps(recordings: Sequence[Recording]) -> "Figure":
    r"""Draws simulated grasps side by side over time: the change of every electrode of each
    fingertip, the normal force and the shear of each, and how loud the vibration is. Phases are
    shaded; a dashed line is where the input of the paper ends, a red one the onset of slip, a
    dotted red one the loss of the object. One or two grasps fit a page.

    Args:
        recordings (sequence of Recording): Grasps as :func:`simulate_bigs` writes them.

    Raises:
        ValueError: If there are none, or one lacks something.

    Examples:
        >>> try:
        ...     plot_bigs_grasps([])
        ... except ValueError as error:
        ...     print(error)
        'recordings' must hold at least one grasp (got none)
    """
    need(len(recordings) != 0, "'recordings' must hold at least one grasp (got none)")
    for recording in recordings:
        _check(recording)
    changes = [_change(recording) for recording in recordings]
    most = max(1.0, *(float(np.percentile(np.abs(change), 99.5)) for change in changes))
    figure = new_figure(max(8.0, 3.6 * len(recordings) + 0.8), 8.4)
    axes = figure.subplots(
        6, len(recordings), sharex="col", squeeze=False, height_ratios=(1.2, 1.2, 1.2, 1, 1, 1)
    )
    force = max(float(r.privileged["normal_force"].max()) for r in recordings)
    image: Any = None
    for column, (recording, change) in enumerate(zip(recordings, changes, strict=True)):
        names = recording.meta["finger_names"]
        for finger in range(3):
            image = _electrodes(axes[finger, column], recording, change[..., finger], most)
            if column == 0:
                axes[finger, column].set_ylabel(f"{names[finger]}\nelectrode")
        _lines(axes[3, column], recording, recording.privileged["normal_force"], names)
        _lines(axes[4, column], recording, recording.privileged["shear_force"], names)
        loud = recording.extra["pac"].astype(np.float64).std(axis=2)
        _lines(axes[5, column], recording, loud, names)
        axes[5, column].set_yscale("log")
        axes[3, column].set_ylim(0, 1.35 * force)
        axes[4, column].set_ylim(0, 0.6 * force)
        axes[5, column].set_xlabel("time (s)")
        _title(axes[0, column], recording)
        for row in range(3, 6):
            _mark(axes[row, column], recording, shade=True)
        for row in range(3):
            _mark(axes[row, column], recording, shade=False)
    for row, label in ((3, "normal force (N)"), (4, "shear (N)"), (5, "vibration\n(sd, counts)")):
        axes[row, 0].set_ylabel(label)
    look = current_theme()
    axes[3, 0].legend(loc="upper left", ncols=3, fontsize=SMALL, frameon=False, labelcolor=look.ink)
    figure.colorbar(image, ax=axes[:3, :], label="change (counts)", aspect=40, pad=0.01)
    title_figure(
        figure,
        "Simulated grasps. Dashed: the end of the input; red: the onset of slip; red, dotted: the "
        "loss of the object",
    )
    return figure


def _check(recording: Recording) -> None:
    missing = [
        name
        for name in ("normal_force", "shear_force", "phase")
        if name not in recording.privileged
    ]
    missing += [name for name in ("pac",) if name not in recording.extra]
    missing += [
        name
        for name in ("pickup_time", "phase_names", "finger_names")
        if name not in recording.meta
    ]
    if missing or recording.num_frames == 0:
        raise ValueError(
            f"'recordings' must be simulated grasps with frames and '{(missing or ['time'])[0]}' "
            f"(got {recording!r})"
        )


def _change(recording: Recording) -> np.ndarray:
    before = recording.privileged["phase"] == 0
    rest = recording.tactile[before if before.any() else slice(1)].mean(axis=0)
    change: np.ndarray = recording.tactile - rest
    return change


def _electrodes(ax: Any, recording: Recording, change: np.ndarray, most: float) -> Any:
    extent = (0.0, float(recording.time[-1]), change.shape[1] + 0.5, 0.5)
    image = ax.imshow(
        change.T,
        aspect="auto",
        extent=extent,
        cmap=colormap("diverging"),
        vmin=-most,
        vmax=most,
        interpolation="nearest",
    )
    ax.set_yticks([1, 10, 19])
    return image


def _lines(ax: Any, recording: Recording, values: np.ndarray, names: Sequence[str]) -> None:
    for finger in range(3):
        color = series_color(finger)
        ax.plot(recording.time, values[:, finger], color=color, linewidth=0.9, label=names[finger])
    ax.margins(x=0)


def _title(ax: Any, recording: Recording) -> None:
    grasp = recording.meta.get("grasp", {})
    parts = [str(recording.meta.get("object", "grasp")), str(recording.label)]
    if "mass" in grasp:
        parts.append(f"{1000 * grasp['mass']:.0f} g, friction {grasp['friction']:.2f}")
    title_axes(ax, plain_text(": ".join([", ".join(parts[:2]), *parts[2:]])), size=TEXT, pad=16)
    phase, names = recording.privileged["phase"], recording.meta["phase_names"]
    for number in np.unique(phase):
        middle = float(recording.time[phase == number].mean())
        ax.annotate(
            names[number],
            (middle, 1.02),
            xycoords=("data", "axes fraction"),
            ha="center",
            va="bottom",
            fontsize=SMALL,
            color=current_theme().soft,
        )


def _mark(ax: Any, recording: Recording, shade: bool) -> None:
    phase, time, look = recording.privileged["phase"], recording.time, current_theme()
    for number in np.unique(phase):
        start = float(time[phase == number][0])
        if shade:
            end = float(time[phase == number][-1])
            color = look.palette[(4, 5, 1)[(number - 1) % 3]] if number else look.ground
            ax.axvspan(start, end, color=color, alpha=_SHADE, zorder=0, linewidth=0)
        if number:
            ax.axvline(start, color=look.faint, linewidth=0.7)
    ax.axvline(recording.meta["pickup_time"] + _INPUT, color=look.ink, linestyle="--", linewidth=1)
    if recording.meta.get("slip_time") is not None:
        ax.axvline(recording.meta["slip_time"], color=look.alarm, linewidth=1.4)
    if recording.meta.get("lost") is not None:
        lost = recording.meta["pickup_time"] + recording.meta["lost"]
        ax.axvline(lost, color=look.alarm, linewidth=1.4, linestyle=":")
