r"""Pictures of the readings and joint angles of a recording over time."""

import math
from typing import TYPE_CHECKING

import numpy as np

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.data.recording import UNITS
from torch_geometric_tactile.visualization._style import (
    DASHES,
    SMALL,
    TINY,
    colormap,
    current_theme,
    new_figure,
    open_plot,
    plain_text,
    series_color,
    symmetric_limit,
    title_figure,
)
from torch_geometric_tactile.visualization._time_panels import (
    LANE_HEIGHT,
    MAX_COLUMNS,
    annotation_lanes,
    cover_gaps,
    draw_annotations,
    name_phases,
    nan_median,
    reading_at_rest,
    recording_phases,
    shade_phases,
    title_parts,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colorbar import Colorbar
    from matplotlib.figure import Figure

_QUANTILE = 0.995  # quantile of the absolute readings at the end of the colour scale
_MAX_LEGEND_ENTRIES = 24


def plot_recording(recording: Recording, rest: float = 0.5) -> "Figure":
    r"""Draws a recording over time: an image of the readings of all taxels for each channel, the
    sum of the absolute readings, the joint angles, the actions, and the annotations with a lane for
    each label.

    Readings are drawn relative to the rest of the taxel, which is the median of its first readings.
    A single frame is drawn relative to the median of all taxels. The colour scale of a channel is
    symmetric about zero and ends at the 99.5th percentile of the absolute readings. Missing
    readings are grey, and count as rest in the sum. If there are more frames than pixels, each
    pixel shows the reading farthest from rest. A privileged signal :obj:`"phase"` (integers or
    texts :math:`(T,)`, with optional names in :obj:`"phase_names"` of the metadata) is marked.

    Args:
        recording (Recording): The recording.
        rest (float): Time at the start that counts as rest, in seconds. At most a tenth of the
            recording is used.

    Raises:
        ImportError: If matplotlib is missing.
        ValueError: If the recording has no frames, or :obj:`rest` is negative.

    Examples:
        >>> recording = Recording(np.arange(40) / 10, np.zeros((40, 24, 1)), label="mug")
        >>> figure = plot_recording(recording)
        >>> figure.get_suptitle()
        'label mug  |  40 frames, 3.9 s'
    """
    if recording.num_frames == 0:
        raise ValueError("'recording' must hold at least one frame to be drawn (got none)")
    need(rest >= 0, "'rest' must be at least 0 seconds", rest)
    time = recording.time - recording.time[0]
    is_single_frame = recording.num_frames == 1
    if is_single_frame:
        change = recording.tactile - nan_median(recording.tactile[0])
    else:
        # A longer rest could include most of the contacts of a short recording.
        window = min(rest, recording.duration / 10)
        change = recording.tactile - reading_at_rest(recording.tactile, time, window)
    reference = "median" if is_single_frame else "rest"
    unit = UNITS.get(recording.meta.get("unit", ""), "unit unknown")
    channels = _channel_names(recording.num_channels)
    phases = recording_phases(recording, time)

    image_height = min(max(recording.num_taxels / 90, 1.3), 2.2)
    heights = [image_height] * recording.num_channels + [1.6]
    heights += [2.0 for values in (recording.joint, recording.action) if values is not None]
    lanes = annotation_lanes(recording)
    heights += [LANE_HEIGHT * len(lanes)] if lanes else []
    theme = current_theme()
    figure = new_figure(8.0, sum(heights) * 1.0 + 1.3)
    title_figure(figure, _title(recording))

    axes = figure.subplots(
        len(heights), 1, sharex=True, squeeze=False, gridspec_kw={"height_ratios": heights}
    )[:, 0]
    edges, image = _to_columns(time, change)
    for i, name in enumerate(channels):
        limit, is_clipped = symmetric_limit(change[:, :, i], _QUANTILE)
        bar = _draw_image(axes[i], edges, image[:, :, i], limit, is_clipped)
        bar.set_label(f"reading - {reference}\n({unit})", fontsize=SMALL)
        axes[i].set_ylabel(f"{name}\ntaxel")
        for phase in phases[1:]:
            axes[i].axvline(phase.start, color=theme.ink, linewidth=0.7, linestyle=":")

    total = np.nansum(np.abs(change), axis=1)
    ax = axes[recording.num_channels]
    for i, name in enumerate(channels):
        style = _line_style(i, len(channels), is_single_frame)
        ax.plot(time, total[:, i], label=name, linewidth=1.1, **style)
    ax.set_ylim(0, 1.08 * float(total.max()) or 1.0)
    ax.set_ylabel(f"sum of\n|reading - {reference}|\n({unit})")
    _finish_lines(ax, len(channels))
    panels = iter(axes[recording.num_channels + 1 :])
    for kind, values, label, step in (
        ("joint", recording.joint, "joint angle\n(rad)", "default"),
        # A command is in force until the next command.
        ("action", recording.action, "action", "steps-post"),
    ):
        if values is None:
            continue
        ax = next(panels)
        for i, name in enumerate(_column_names(recording, kind, values.shape[1])):
            ax.plot(
                time,
                values[:, i],
                label=plain_text(name),
                linewidth=1.0,
                drawstyle=step,
                **_line_style(i, values.shape[1], is_single_frame),
            )
        ax.set_ylabel(label)
        _finish_lines(ax, values.shape[1])
    if lanes:
        draw_annotations(axes[-1], lanes)
    for ax in axes[recording.num_channels :]:
        shade_phases(ax, phases)
    for ax in axes[:-1] if lanes else axes:
        cover_gaps(ax, recording.gaps - recording.time[0])
    name_phases(axes[0], phases, float(edges[-1] - edges[0]))
    axes[-1].set_xlim(edges[0], edges[-1])
    axes[-1].set_xlabel("time since the first frame (s)")
    figure.align_ylabels(list(axes))
    return figure


def _draw_image(
    ax: "Axes", edges: np.ndarray, image: np.ndarray, limit: float, is_clipped: bool
) -> "Colorbar":
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.ticker import MaxNLocator

    num_taxels = image.shape[1]
    cmap = colormap("diverging").with_extremes(bad=current_theme().faint)
    scale = Normalize(-limit, limit)
    ax.pcolorfast(
        edges,
        np.arange(num_taxels + 1) - 0.5,
        np.ma.masked_invalid(image.T),
        cmap=cmap,
        norm=scale,
    )
    ax.yaxis.set_major_locator(MaxNLocator(5, integer=True, steps=[1, 2, 5, 10]))
    ax.set_ylim(num_taxels - 0.5, -0.5)
    return ax.figure.colorbar(
        ScalarMappable(scale, cmap),
        cax=ax.inset_axes((1.012, 0, 0.016, 1)),
        extend="both" if is_clipped else "neither",
    )


def _channel_names(num_channels: int) -> list[str]:
    return list("xyz") if num_channels == 3 else [f"channel {i}" for i in range(num_channels)]


def _column_names(recording: Recording, kind: str, size: int) -> list[str]:
    names = recording.meta.get(f"{kind}_names")
    if isinstance(names, list) and len(names) == size:
        return [str(name) for name in names]
    return [f"{kind} {i}" for i in range(size)]


def _to_columns(time: np.ndarray, change: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    r"""Returns the edges of the columns of an image in seconds, and the reading farthest from rest
    in each column, at least one column per pixel.
    """
    num_frames = len(time)
    starts = np.arange(0, num_frames, math.ceil(num_frames / MAX_COLUMNS))
    if len(starts) < num_frames:
        distance = np.nan_to_num(np.abs(change), nan=-1.0)
        columns = [
            np.take_along_axis(block, block_distance.argmax(axis=0)[None], axis=0)[0]
            for block, block_distance in zip(
                np.split(change, starts[1:]), np.split(distance, starts[1:]), strict=True
            )
        ]
        change = np.stack(columns)
    step = float(np.median(np.diff(time))) if num_frames > 1 else 1.0
    inner_edges = (time[starts[1:] - 1] + time[starts[1:]]) / 2
    return np.array([time[0] - step / 2, *inner_edges, time[-1] + step / 2]), change


def _line_style(i: int, num_lines: int, is_single_frame: bool) -> dict[str, str]:
    marker = "o" if is_single_frame else ""  # a line with one point would be invisible
    num_colors = len(current_theme().palette)
    if num_lines > num_colors * len(DASHES):
        return {"color": series_color(0), "marker": marker}
    return {
        "color": series_color(i),
        "linestyle": DASHES[i // num_colors],
        "marker": marker,
    }


def _finish_lines(ax: "Axes", num_lines: int) -> None:
    open_plot(ax)
    if num_lines <= _MAX_LEGEND_ENTRIES:
        ax.legend(
            loc="upper left",
            bbox_to_anchor=(1.005, 1.03),
            borderaxespad=0,
            ncols=math.ceil(num_lines / 8),
            fontsize=TINY,
            frameon=False,
            labelcolor=current_theme().ink,
            labelspacing=0.3,
            columnspacing=0.9,
            handlelength=1.8,
        )


def _title(recording: Recording) -> str:
    parts = title_parts(recording)
    num_dead = len(recording.dead_taxels)
    if num_dead:
        parts.append(f"{num_dead} dead taxel{'s' if num_dead > 1 else ''} (grey)")
    elif recording.missing.any():
        parts.append("grey: missing")
    return "  |  ".join(parts)
