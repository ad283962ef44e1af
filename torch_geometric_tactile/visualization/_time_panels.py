r"""What pictures over the time of a recording share: its rest, its phases, its annotations and its
title.
"""

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

MOST_COLUMNS = 1500  # about the pixels of a panel; more would drop frames unseen
LANE_HEIGHT = 0.24  # inches
_MOST_LANES = 8
_LETTERS = 20  # of the name of a lane


class Phase(NamedTuple):
    r"""A phase of a trial, in seconds."""

    name: str
    start: float
    end: float


def reading_at_rest(tactile: np.ndarray, time: np.ndarray, rest: float) -> np.ndarray:
    r"""Returns the median reading of each taxel and channel in the first seconds :math:`(N, C)`."""
    first = nan_median(tactile[time <= rest])
    # A taxel that is missing at first takes its first reading.
    late = np.isnan(first)
    if late.any():
        first = np.where(late, nan_median(tactile), first)
    return first


def nan_median(values: np.ndarray) -> np.ndarray:
    r"""Returns the median over the frames of readings :math:`(T, ...)`, NaN without any."""
    out = np.full(values.shape[1:], np.nan, dtype=np.float32)
    present = ~np.isnan(values).all(axis=0)
    out[present] = np.nanmedian(values[:, present], axis=0)
    return out


def phases_of(recording: Recording, time: np.ndarray) -> list[Phase]:
    r"""Returns the phases of a recording, if it knows them, at times :math:`(T,)` in seconds."""
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
    r"""Writes the names of phases above axes, where there is room."""
    for phase in phases:
        # About 95 letters of this size fit above the panel; a longer name would run into the next.
        letters = int(95 * (phase.end - phase.start) / duration)
        name = phase.name
        if len(name) > letters:
            name = name[: max(letters - 3, 0)].rstrip() + "..."
        if len(name) <= letters:
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


def blank_gaps(ax: "Axes", gaps: np.ndarray) -> None:
    r"""Covers the time without frames, over which lines and steps would go on.

    Shapes:
        - **gaps:** start and end of each in seconds :math:`(G, 2)`
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
    r"""The annotations of one label: their starts and lengths in seconds."""

    name: str
    bars: list[tuple[float, float]]


def annotation_lanes(recording: Recording) -> list[Lane]:
    r"""Returns a lane for each label of the annotations, since the first frame; labels beyond the
    first few share the last lane.
    """
    start = float(recording.time[0])
    bars: dict[str, list[tuple[float, float]]] = {}
    for begin, end, label in recording.annotations:
        bars.setdefault(label, []).append((begin - start, end - begin))
    lanes = [Lane(label, found) for label, found in bars.items()]
    if len(lanes) <= _MOST_LANES:
        return lanes
    head, rest = lanes[: _MOST_LANES - 1], lanes[_MOST_LANES - 1 :]
    return [*head, Lane(f"{len(rest)} others", [bar for lane in rest for bar in lane.bars])]


def draw_annotations(
    ax: "Axes", lanes: list[Lane], colors: Mapping[str, str] | None = None
) -> None:
    r"""Draws the annotations of a recording in lanes by their labels, if their colours are given in
    these and others in grey.
    """
    for i, lane in enumerate(lanes):
        color = series_color(i) if colors is None else colors.get(lane.name, current_theme().faint)
        # With an outline, by which one of no length is seen.
        ax.broken_barh(lane.bars, (i - 0.3, 0.6), color=color, linewidth=1.0)
    names = [lane.name for lane in lanes]
    short = [name if len(name) <= _LETTERS else f"{name[: _LETTERS - 3]}..." for name in names]
    style_lanes(ax, [plain_text(name) for name in short])


def style_lanes(ax: "Axes", names: list[str]) -> None:
    r"""Names the lanes of a panel, the first one on top."""
    ax.set_ylim(len(names) - 0.5, -0.5)
    ax.set_yticks(range(len(names)), names, fontsize=SMALL)
    ax.tick_params(axis="y", length=0)
    ax.spines[["top", "right", "left"]].set_visible(False)


def title_parts(recording: Recording) -> list[str]:
    r"""Returns what the title of a recording says: what it is of, and how long."""
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
    r"""Draws every other phase in another ground."""
    look = current_theme()
    for i, phase in enumerate(phases):
        color = look.ground if i % 2 else look.band
        ax.axvspan(phase.start, phase.end, color=color, zorder=0, linewidth=0)
