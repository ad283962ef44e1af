r"""Shared parts of the pictures of a recording over time: rest, phases, annotations and title."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.visualization._style import (
    SMALL,
    current_theme,
    plain_text,
    series_color,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MAX_COLUMNS = 1500  # about the pixels of a panel; of more columns, matplotlib would drop some
LANE_HEIGHT = 0.24  # inches
_MAX_LANES = 8
_MAX_NAME_LENGTH = 20  # letters in the name of a lane


class Phase(NamedTuple):
    r"""A phase of a trial, with its start and end in seconds."""

    name: str
    start: float
    end: float


def reading_at_rest(tactile: np.ndarray, time: np.ndarray, rest: float) -> np.ndarray:
    r"""Returns the median reading of each taxel and channel in the first :obj:`rest` seconds
    :math:`(N, C)`. If there are no readings, the median over the entire recording is returned.
    """
    median = nan_median(tactile[time <= rest])
    is_missing = np.isnan(median)
    if is_missing.any():
        median = np.where(is_missing, nan_median(tactile), median)
    return median


def nan_median(values: np.ndarray) -> np.ndarray:
    r"""Returns the median of readings :math:`(T, ...)` over the frames. NaN if all are missing."""
    median = np.full(values.shape[1:], np.nan, dtype=np.float32)
    has_readings = ~np.isnan(values).all(axis=0)
    median[has_readings] = np.nanmedian(values[:, has_readings], axis=0)
    return median


def recording_phases(recording: Recording, time: np.ndarray) -> list[Phase]:
    r"""Returns the phases of a recording, or an empty list if it has no signal :obj:`"phase"`.

    Shapes:
        - **time:** times of the frames in seconds :math:`(T,)`
    """
    phase = recording.privileged.get("phase")
    if phase is None or phase.ndim != 1:
        return []
    names = recording.meta.get("phase_names")

    def name(value: object) -> str:
        if isinstance(value, int) and isinstance(names, list) and 0 <= value < len(names):
            return str(names[value])
        return value if isinstance(value, str) else f"phase {value}"

    starts = [0, *(np.flatnonzero(phase[1:] != phase[:-1]) + 1).tolist()]
    ends = [*(float(time[i]) for i in starts[1:]), float(time[-1])]
    return [
        Phase(name(phase[i].item()), float(time[i]), end)
        for i, end in zip(starts, ends, strict=True)
    ]


def name_phases(ax: "Axes", phases: list[Phase], duration: float) -> None:
    r"""Writes the names of phases above axes, shortened to the widths of the phases."""
    for phase in phases:
        # About 95 letters of this size fit above a panel.
        max_length = int(95 * (phase.end - phase.start) / duration)
        name = phase.name
        if len(name) > max_length:
            name = name[: max(max_length - 3, 0)].rstrip() + "..."
        if len(name) <= max_length:
            ax.text(
                (phase.start + phase.end) / 2,
                1.03,
                plain_text(name),
                transform=ax.get_xaxis_transform(),
                ha="center",
                va="bottom",
                fontsize=SMALL,
                color=current_theme().soft,
            )


def cover_gaps(ax: "Axes", gaps: np.ndarray) -> None:
    r"""Hides lines and steps during times without frames.

    Shapes:
        - **gaps:** start and end of each time without frames in seconds :math:`(G, 2)`
    """
    if not len(gaps):
        return
    limits = ax.get_ylim()
    ax.broken_barh(
        np.stack([gaps[:, 0], gaps[:, 1] - gaps[:, 0]], axis=1).tolist(),
        (0, 1),
        transform=ax.get_xaxis_transform(),
        color=current_theme().ground,
        linewidth=0,
        zorder=2.4,  # above lines, below the axes
    )
    ax.set_ylim(limits)


class Lane(NamedTuple):
    r"""The annotations with one label as bars: starts and lengths in seconds."""

    name: str
    bars: list[tuple[float, float]]


def annotation_lanes(recording: Recording) -> list[Lane]:
    r"""Returns a lane for each annotation label, with times since the first frame. If there are
    more than eight labels, all labels after the seventh share the last lane.
    """
    first_time = float(recording.time[0])
    bars: dict[str, list[tuple[float, float]]] = {}
    for start, end, label in recording.annotations:
        bars.setdefault(label, []).append((start - first_time, end - start))
    lanes = [Lane(label, label_bars) for label, label_bars in bars.items()]
    if len(lanes) <= _MAX_LANES:
        return lanes
    separate, joined = lanes[: _MAX_LANES - 1], lanes[_MAX_LANES - 1 :]
    name = f"{len(joined)} others"
    return [*separate, Lane(name, [bar for lane in joined for bar in lane.bars])]


def draw_annotations(
    ax: "Axes", lanes: list[Lane], colors: Mapping[str, str] | None = None
) -> None:
    r"""Draws the annotations of a recording in lanes by label.

    Args:
        ax (matplotlib.axes.Axes): The panel.
        lanes (list of Lane): The lanes.
        colors (Mapping, optional): Colours by label; other labels are grey (default: the colours of
            the palette).
    """
    for i, lane in enumerate(lanes):
        color = series_color(i) if colors is None else colors.get(lane.name, current_theme().faint)
        # The outline keeps annotations of zero duration visible.
        ax.broken_barh(lane.bars, (i - 0.3, 0.6), color=color, linewidth=1.0)
    limit = _MAX_NAME_LENGTH
    names = [
        lane.name if len(lane.name) <= limit else f"{lane.name[: limit - 3]}..." for lane in lanes
    ]
    style_lanes(ax, [plain_text(name) for name in names])


def style_lanes(ax: "Axes", names: list[str]) -> None:
    r"""Names the lanes of a panel, with the first lane at the top."""
    ax.set_ylim(len(names) - 0.5, -0.5)
    ax.set_yticks(range(len(names)), names, fontsize=SMALL)
    ax.tick_params(axis="y", length=0)
    ax.spines[["top", "right", "left"]].set_visible(False)


def title_parts(recording: Recording) -> list[str]:
    r"""Returns the parts of the title of a recording: sensor, object, trial, label and length."""
    parts = []
    for key in ("sensor", "object", "trial"):
        if recording.meta.get(key) not in (None, ""):
            value = str(recording.meta[key])
            parts.append(value if key == "sensor" else f"{key} {value}")
    if recording.label is not None:
        parts.append(f"label {recording.label}")
    if recording.meta.get("synthetic"):
        parts.append("SIMULATED")
    frames = "1 frame" if recording.num_frames == 1 else f"{recording.num_frames:,} frames"
    return [*parts, f"{frames}, {recording.duration:.4g} s"]


def shade_phases(ax: "Axes", phases: list[Phase]) -> None:
    r"""Shades every second phase."""
    theme = current_theme()
    for i, phase in enumerate(phases):
        color = theme.ground if i % 2 else theme.band
        ax.axvspan(phase.start, phase.end, color=color, zorder=0, linewidth=0)
