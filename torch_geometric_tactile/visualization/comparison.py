r"""Pictures of measured numbers beside published ones."""

from collections.abc import Mapping, Sequence
from math import isfinite
from typing import TYPE_CHECKING, Any, NamedTuple

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.visualization._style import (
    MARKERS,
    MAX_WIDTH,
    current_theme,
    draw_legend,
    new_figure,
    open_plot,
    plain_text,
    series_color,
    title_axes,
    title_figure,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

_Values = Mapping[str, tuple[float, float]]
_ROW_HEIGHT, _SERIES_HEIGHT = 0.14, 0.065  # inches per row, plus inches per series
_MIN_PANEL_WIDTH = 2.2  # inches
_HALF_ROW = 0.32  # points lie within this part of a row on either side of its centre


class ComparisonPanel(NamedTuple):
    r"""The title, axis label and numbers of one panel of :func:`plot_comparison`.

    Args:
        title (str): Title of the panel.
        xlabel (str): Name and unit of the numbers.
        rows (Mapping): Mean and standard deviation of each series, for each row. If a row has no
            result for a series, the series is left out. If the standard deviation is NaN, no bar is
            drawn. A line separates rows whose names differ before the colon.
        from_zero (bool): Whether the axis begins at zero.

    Examples:
        >>> rows = {"GCN": {"published": (86.1, float("nan")), "ours": (84.0, 1.5)}}
        >>> panel = ComparisonPanel("by trial", "accuracy in %", rows)
        >>> panel.rows["GCN"]["ours"]
        (84.0, 1.5)
    """

    title: str
    xlabel: str
    rows: Mapping[str, _Values]
    from_zero: bool = False


def plot_comparison(
    panels: Sequence[ComparisonPanel], series: Sequence[str], title: str
) -> "Figure":
    r"""Draws a table of numbers as points, with one line for each row and one colour for each
    series. Points without a standard deviation, such as published numbers or results of one seed,
    are hollow.

    Two panels are drawn side by side, or one if the row names are too wide for a page. Neighbouring
    panels with the same rows share the row names, and panels with the same label share the range of
    the axis.

    Args:
        panels (sequence of ComparisonPanel): The panels.
        series (sequence of str): Names of the series, in the order of the legend. The first series
            is the reference and is drawn as black diamonds.
        title (str): Title of the picture.

    Raises:
        ImportError: If matplotlib is missing.
        ValueError: If there are no panels or rows, or if :obj:`series` lacks a series of a panel.

    Examples:
        >>> rows = {"GCN": {"published": (86.1, float("nan")), "ours": (84.0, 1.5)}}
        >>> panel = ComparisonPanel("by trial", "accuracy in %", rows)
        >>> figure = plot_comparison([panel], ["published", "ours"], "Published and ours")
        >>> [text.get_text() for text in figure.legends[0].get_texts()]
        ['published', 'ours', 'hollow: no spread known']
    """
    if not panels or not all(panel.rows for panel in panels):
        raise ValueError("'panels' must hold at least one panel with at least one row (got none)")
    unknown = {name for panel in panels for row in panel.rows.values() for name in row} - {*series}
    need(not unknown, f"'series' must hold all names in 'panels' (lacks {sorted(unknown)})")
    columns = _num_columns(panels)
    panel_rows = [panels[i : i + columns] for i in range(0, len(panels), columns)]
    heights = [max(len(panel.rows) for panel in panel_row) for panel_row in panel_rows]
    row_height = _ROW_HEIGHT + _SERIES_HEIGHT * len(series)
    figure = new_figure(
        min(MAX_WIDTH, 3.4 * columns + _names_width(panels) + 0.6),
        row_height * sum(heights) + 0.75 * len(panel_rows) + 0.5 + 0.2 * len(series),
    )
    axes = figure.subplots(len(panel_rows), columns, squeeze=False, height_ratios=heights)
    for panel_row, axes_row in zip(panel_rows, axes, strict=True):
        for i, ax in enumerate(axes_row):
            if i >= len(panel_row):
                ax.set_axis_off()
                continue
            _draw_panel(ax, panel_row[i], series)
            if i and list(panel_row[i].rows) == list(panel_row[0].rows):
                ax.tick_params(labelleft=False)
    panel_axes = list(zip(panels, axes.flat, strict=False))
    for label in {panel.xlabel for panel in panels}:
        same_label = [ax for panel, ax in panel_axes if panel.xlabel == label]
        low, high = zip(*(ax.get_xlim() for ax in same_label), strict=True)
        for ax in same_label:
            ax.set_xlim(min(low), max(high))
    points = [
        (name, isfinite(sd))
        for panel in panels
        for values in panel.rows.values()
        for name, (_, sd) in values.items()
    ]
    with_spread = {name for name, has_spread in points if has_spread}
    handles = [_legend_handle(i, name in with_spread) for i, name in enumerate(series)]
    labels = [plain_text(name) for name in series]
    has_hollow = not all(has_spread for _, has_spread in points)
    columns = 1 if max(map(len, labels)) > 40 else 2
    draw_legend(figure, handles, labels, columns=columns, has_hollow=has_hollow)
    title_figure(figure, title)
    return figure


def _names_width(panels: Sequence[ComparisonPanel]) -> float:
    return 0.075 * max(len(name) for panel in panels for name in panel.rows)


def _num_columns(panels: Sequence[ComparisonPanel]) -> int:
    if len(panels) == 1:
        return 1
    share_names = all(
        list(left.rows) == list(right.rows)
        for left, right in zip(panels[::2], panels[1::2], strict=False)
    )
    names_width = _names_width(panels) if share_names else 2 * _names_width(panels)
    return 2 if names_width + 2 * _MIN_PANEL_WIDTH <= MAX_WIDTH else 1


def _draw_panel(ax: "Axes", panel: ComparisonPanel, series: Sequence[str]) -> None:
    theme = current_theme()
    names = list(panel.rows)
    share_rows = any(len(values) > 1 for values in panel.rows.values())
    for y, values in enumerate(panel.rows.values()):
        if y % 2 == 0:
            ax.axhspan(y - 0.5, y + 0.5, color=theme.band, zorder=0, linewidth=0)
        if y and names[y].split(":")[0] != names[y - 1].split(":")[0]:
            ax.axhline(y - 0.5, color=theme.faint, linewidth=0.8)
        for i, name in enumerate(series):
            if name not in values:
                continue
            mean, sd = values[name]
            offset = _HALF_ROW * (2 * (i + 0.5) / len(series) - 1) if share_rows else 0.0
            ax.errorbar(
                mean,
                y + offset,
                xerr=sd if isfinite(sd) else None,
                elinewidth=1.0,
                capsize=1.6,
                **_marker_style(i, isfinite(sd)),
            )
    ax.set_ylim(len(panel.rows) - 0.5, -0.5)
    ax.set_yticks(range(len(panel.rows)), [plain_text(name) for name in names])
    ax.tick_params(axis="y", labelcolor=theme.ink)
    if panel.from_zero:
        ax.set_xlim(left=0.0)
    ax.tick_params(axis="y", length=0)
    open_plot(ax, "x")
    ax.set_xlabel(plain_text(panel.xlabel))
    title_axes(ax, plain_text(panel.title))


def _marker_style(index: int, has_spread: bool) -> dict[str, Any]:
    theme = current_theme()
    color = theme.ink if index == 0 else series_color(index - 1)
    return {
        "linestyle": "none",
        "marker": "D" if index == 0 else MARKERS[(index - 1) % len(MARKERS)],
        "color": color,
        "markersize": 5.0,
        "markerfacecolor": color if has_spread else theme.ground,
        "markeredgewidth": 0.3 if has_spread else 1.1,
        "markeredgecolor": theme.ground if has_spread else color,
    }


def _legend_handle(index: int, has_spread: bool) -> "Line2D":
    from matplotlib.lines import Line2D

    return Line2D([], [], **_marker_style(index, has_spread))
