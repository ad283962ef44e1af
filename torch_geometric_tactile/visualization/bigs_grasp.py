r"""Pictures of simulated grasps with three fingertips over time."""

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

_INPUT_SECONDS = 2.0  # seconds from pick-up to the end of the paper's input
_PHASE_OPACITY = 0.10


def plot_bigs_grasps(recordings: Sequence[Recording]) -> "Figure":
    r"""Draws simulated grasps side by side over time: the change of all electrode readings, and the
    normal force, shear and standard deviation of the vibration of each fingertip. Phases are
    shaded. A dashed line marks the end of the paper's input, a red line the onset of slip, and a
    dotted red line the loss of the object. One or two grasps fit on a page.

    Args:
        recordings (sequence of Recording): Grasps written by :func:`simulate_bigs`.

    Raises:
        ValueError: If there are no grasps, or if a recording lacks frames, signals or metadata of a
            simulated grasp.

    Examples:
        >>> try:
        ...     plot_bigs_grasps([])
        ... except ValueError as error:
        ...     print(error)
        'recordings' must hold at least one grasp (got none)
    """
    need(len(recordings) != 0, "'recordings' must hold at least one grasp (got none)")
    for recording in recordings:
        _check_grasp(recording)
    changes = [_change_from_rest(recording) for recording in recordings]
    limit = max(1.0, *(float(np.percentile(np.abs(change), 99.5)) for change in changes))
    figure = new_figure(max(8.0, 3.6 * len(recordings) + 0.8), 8.4)
    axes = figure.subplots(
        6, len(recordings), sharex="col", squeeze=False, height_ratios=(1.2, 1.2, 1.2, 1, 1, 1)
    )
    max_force = max(float(r.privileged["normal_force"].max()) for r in recordings)
    image: Any = None
    for column, (recording, change) in enumerate(zip(recordings, changes, strict=True)):
        names = recording.meta["finger_names"]
        for finger in range(3):
            image = _draw_electrodes(axes[finger, column], recording, change[..., finger], limit)
            if column == 0:
                axes[finger, column].set_ylabel(f"{names[finger]}\nelectrode")
        _draw_lines(axes[3, column], recording, recording.privileged["normal_force"], names)
        _draw_lines(axes[4, column], recording, recording.privileged["shear_force"], names)
        vibration = recording.extra["pac"].astype(np.float64).std(axis=2)
        _draw_lines(axes[5, column], recording, vibration, names)
        axes[5, column].set_yscale("log")
        axes[3, column].set_ylim(0, 1.35 * max_force)
        axes[4, column].set_ylim(0, 0.6 * max_force)
        axes[5, column].set_xlabel("time (s)")
        _draw_title(axes[0, column], recording)
        for row in range(3, 6):
            _mark_times(axes[row, column], recording, shade=True)
        for row in range(3):
            _mark_times(axes[row, column], recording, shade=False)
    for row, label in ((3, "normal force (N)"), (4, "shear (N)"), (5, "vibration\n(sd, counts)")):
        axes[row, 0].set_ylabel(label)
    ink = current_theme().ink
    axes[3, 0].legend(loc="upper left", ncols=3, fontsize=SMALL, frameon=False, labelcolor=ink)
    figure.colorbar(image, ax=axes[:3, :], label="change (counts)", aspect=40, pad=0.01)
    title_figure(
        figure,
        "Simulated grasps. Dashed: end of the input; red: onset of slip; red, dotted: loss of the "
        "object",
    )
    return figure


def _check_grasp(recording: Recording) -> None:
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


def _change_from_rest(recording: Recording) -> np.ndarray:
    is_closing = recording.privileged["phase"] == 0  # before contact
    rest = recording.tactile[is_closing if is_closing.any() else slice(1)].mean(axis=0)
    change: np.ndarray = recording.tactile - rest
    return change


def _draw_electrodes(ax: Any, recording: Recording, change: np.ndarray, limit: float) -> Any:
    extent = (0.0, float(recording.time[-1]), change.shape[1] + 0.5, 0.5)
    image = ax.imshow(
        change.T,
        aspect="auto",
        extent=extent,
        cmap=colormap("diverging"),
        vmin=-limit,
        vmax=limit,
        interpolation="nearest",
    )
    ax.set_yticks([1, 10, 19])
    return image


def _draw_lines(ax: Any, recording: Recording, values: np.ndarray, names: Sequence[str]) -> None:
    for finger in range(3):
        color = series_color(finger)
        ax.plot(recording.time, values[:, finger], color=color, linewidth=0.9, label=names[finger])
    ax.margins(x=0)


def _draw_title(ax: Any, recording: Recording) -> None:
    grasp = recording.meta.get("grasp", {})
    parts = [str(recording.meta.get("object", "grasp")), str(recording.label)]
    if "mass" in grasp:
        parts.append(f"{1000 * grasp['mass']:.0f} g, friction {grasp['friction']:.2f}")
    title_axes(ax, plain_text(": ".join([", ".join(parts[:2]), *parts[2:]])), size=TEXT, pad=16)
    phase, names = recording.privileged["phase"], recording.meta["phase_names"]
    for number in np.unique(phase):
        centre = float(recording.time[phase == number].mean())
        ax.annotate(
            names[number],
            (centre, 1.02),
            xycoords=("data", "axes fraction"),
            ha="center",
            va="bottom",
            fontsize=SMALL,
            color=current_theme().soft,
        )


def _mark_times(ax: Any, recording: Recording, shade: bool) -> None:
    phase, time, theme = recording.privileged["phase"], recording.time, current_theme()
    for number in np.unique(phase):
        start = float(time[phase == number][0])
        if shade:
            end = float(time[phase == number][-1])
            color = theme.palette[(4, 5, 1)[(number - 1) % 3]] if number else theme.ground
            ax.axvspan(start, end, color=color, alpha=_PHASE_OPACITY, zorder=0, linewidth=0)
        if number:
            ax.axvline(start, color=theme.faint, linewidth=0.7)
    input_end = recording.meta["pickup_time"] + _INPUT_SECONDS
    ax.axvline(input_end, color=theme.ink, linestyle="--", linewidth=1)
    if recording.meta.get("slip_time") is not None:
        ax.axvline(recording.meta["slip_time"], color=theme.alarm, linewidth=1.4)
    if recording.meta.get("lost") is not None:
        loss_time = recording.meta["pickup_time"] + recording.meta["lost"]
        ax.axvline(loss_time, color=theme.alarm, linewidth=1.4, linestyle=":")
