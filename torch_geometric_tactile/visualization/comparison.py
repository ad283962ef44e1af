r"""Pictures of measured numbers beside published ones."""

from collections.abc import Mapping, Sequence
from math import isfinite
from typing import TYPE_CHECKING, Any, NamedTuple

from torch_geometric_tactile.visualization.figure import new_figure, plain_text
from torch_geometric_tactile.visualization.metrics import _COLORS, _MARKERS, _wrapped

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

Values = Mapping[str, tuple[float, float]]
_ROW_HEIGHT = 0.34  # inches
_HALF_ROW = 0.32  # of a row, to either side, in which points are drawn


class ComparisonPanel(NamedTuple):
    r"""One panel of :func:`plot_comparison`.

    Args:
        title (str): Its title.
        xlabel (str): What is drawn, with its unit.
        rows (Mapping): Mean and standard deviation of each series, for each row. A series that has
            nothing to show in a row is left out; a standard deviation that is NaN has no bar. A
            line parts rows with different names before a colon.
        from_zero (bool): Whether the axis begins at zero.
    """

    title: str
    xlabel: str
    rows: Mapping[str, Values]
    from_zero: bool = False


def plot_comparison(
    panels: Sequence[ComparisonPanel], series: Sequence[str], title: str
) -> "Figure":
    r"""Draws a table of numbers as points, with one line for each row and one colour for each
    series. Panels are drawn two side by side: two with the same rows share the names of the rows,
    and two with the same label share the axis.

    Args:
        panels (sequence of ComparisonPanel): The panels.
        series (sequence of str): Names of the series, in the order of the legend; the first, drawn
            hollow, is what the others are compared with.
        title (str): Title of the picture.

    Raises:
        ImportError: If matplotlib is missing.
        ValueError: If there is no panel or row, or a series has no place in :obj:`series`.
    """
    if not panels or not all(panel.rows for panel in panels):
        raise ValueError("'panels' must hold at least one panel with at least one row (got none)")
    unknown = {name for panel in panels for row in panel.rows.values() for name in row} - {*series}
    if unknown:
        raise ValueError(f"'series' must hold all names of 'panels' (lacks {sorted(unknown)})")
    columns = min(2, len(panels))
    lines = [panels[i : i + columns] for i in range(0, len(panels), columns)]
    heights = [max(len(panel.rows) for panel in line) for line in lines]
    names = max(len(name) for panel in panels for name in panel.rows)
    figure = new_figure(
        3.4 * columns + 0.085 * names + 0.6,
        _ROW_HEIGHT * sum(heights) + 0.75 * len(lines) + 0.5 + 0.2 * len(series),
    )
    axes = figure.subplots(len(lines), columns, squeeze=False, height_ratios=heights)
    for line, row in zip(lines, axes, strict=True):
        for i, ax in enumerate(row):
            if i >= len(line):
                ax.set_axis_off()
                continue
            _draw(ax, line[i], series)
            if i and list(line[i].rows) == list(line[0].rows):
                ax.tick_params(labelleft=False)
        if len({panel.xlabel for panel in line}) == 1:
            limits = [ax.get_xlim() for ax in row[: len(line)]]
            for ax in row[: len(line)]:
                ax.set_xlim(min(low for low, _ in limits), max(high for _, high in limits))
    handles = [_handle(i) for i in range(len(series))]
    figure.legend(
        handles,
        [plain_text(name) for name in series],
        loc="outside lower center",
        ncols=1 if max(map(len, series)) > 40 else 2,
        fontsize=9,
        frameon=False,
    )
    figure.suptitle(_wrapped(title, int(figure.get_figwidth() * 11)), fontsize=11)
    return figure


def _draw(ax: "Axes", panel: ComparisonPanel, series: Sequence[str]) -> None:
    names = list(panel.rows)
    share_rows = any(len(values) > 1 for values in panel.rows.values())
    for y, values in enumerate(panel.rows.values()):
        if y % 2 == 0:
            ax.axhspan(y - 0.5, y + 0.5, color="#f3f3f3", zorder=0, linewidth=0)
        if y and names[y].split(":")[0] != names[y - 1].split(":")[0]:
            ax.axhline(y - 0.5, color="#a0a0a0", linewidth=0.8)
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
                **_style(i),
            )
    ax.set_ylim(len(panel.rows) - 0.5, -0.5)
    ax.set_yticks(range(len(panel.rows)), [plain_text(name) for name in names], fontsize=9)
    if panel.from_zero:
        ax.set_xlim(left=0.0)
    ax.tick_params(axis="y", length=0)
    ax.tick_params(axis="x", labelsize=9)
    ax.grid(axis="x", color="#dcdcdc", linewidth=0.6)
    ax.set_axisbelow(True)
    ax.set_xlabel(plain_text(panel.xlabel), fontsize=9)
    ax.set_title(plain_text(panel.title), fontsize=10)


def _style(index: int) -> dict[str, Any]:
    color = "#000000" if index == 0 else _COLORS[(index - 1) % len(_COLORS)]
    return {
        "linestyle": "none",
        "marker": "D" if index == 0 else _MARKERS[(index - 1) % len(_MARKERS)],
        "color": color,
        "markersize": 5.0,
        "markerfacecolor": "white" if index == 0 else color,
        "markeredgewidth": 1.0 if index == 0 else 0.3,
        "markeredgecolor": color if index == 0 else "white",
    }


def _handle(index: int) -> "Line2D":
    from matplotlib.lines import Line2D

    return Line2D([], [], **_style(index))
