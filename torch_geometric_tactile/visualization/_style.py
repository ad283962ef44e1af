r"""Colours, sizes and texts of all pictures."""

import textwrap
from collections.abc import Sequence
from contextvars import ContextVar
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from torch_geometric_tactile._texts import printable

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from matplotlib.text import Text

DPI = 150
INSTALL = 'pip install "torch-geometric-tactile[viz]"'
# Font sizes in points. In a figure that is 8 inches wide, in a column of 720 pixels, 8 points are
# 10 pixels.
TITLE, TEXT, SMALL, TINY = 10.5, 9.0, 8.0, 7.0


MAX_WIDTH = 8.0  # inches
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")
DASHES = ("-", "--", "-.", ":")
HOLLOW = "hollow: no spread known"  # for results of one run, or published without a spread
_MARGIN = 0.25  # inches on either side of a title
_LETTER_WIDTH = 0.52  # mean width in units of the font size


_Hues = tuple[str, ...]


class Theme(NamedTuple):
    r"""The colours of a picture. The defaults are for a light page."""

    ground: str = "#ffffff"
    ink: str = "#1b1f24"
    soft: str = "#57606a"
    faint: str = "#9aa3ad"
    grid: str = "#e3e7eb"
    band: str = "#f3f5f7"
    palette: _Hues = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#1b1f24")
    plain: str = "#ffffff"
    outline: str = "#3a4149"
    join: str = "#e69f00"
    one_way: str = "#c4006a"
    alarm: str = "#b00020"
    skin: str = "#40454d"
    share: str = "Blues"
    sequential: str = "viridis"
    diverging: _Hues = ("#053061", "#2f79b5", "#a7cfe4", "#f7f7f7", "#f8bfa4", "#ca4741", "#67001f")


THEMES = {
    "light": Theme(),
    "dark": Theme(
        ground="#14181d",
        ink="#e6e9ee",
        soft="#a6b0bb",
        faint="#6b7580",
        grid="#2a3038",
        band="#1c2127",
        palette=("#3f9fdc", "#f0803c", "#1fbf8f", "#dc92b9", "#8fcdf2", "#f0b73c", "#e6e9ee"),
        plain="#20262d",
        outline="#8b95a0",
        join="#f0b73c",
        one_way="#ff6fb1",
        alarm="#ff6b7d",
        share="Blues_r",
        diverging=("#b9e2ff", "#56aee6", "#275878", "#232a31", "#7d3b2e", "#e8744f", "#ffd3bf"),
    ),
}


CURRENT_THEME: ContextVar[Theme] = ContextVar("theme", default=THEMES["light"])


def current_theme() -> Theme:
    r"""Returns the colours of new figures."""
    return CURRENT_THEME.get()


def new_figure(width: float, height: float) -> "Figure":
    r"""Returns an empty figure in the colours of :func:`theme`. The figure is drawn in memory and
    displayed by notebooks.

    Args:
        width (float): Width in inches.
        height (float): Height in inches.

    Raises:
        ImportError: If matplotlib is missing.

    Examples:
        >>> figure = new_figure(4.0, 3.0)
        >>> figure.get_size_inches().tolist()
        [4.0, 3.0]
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg

        from torch_geometric_tactile.visualization._notebook_figure import NotebookFigure
    except ImportError as error:
        raise ImportError(f"pictures need matplotlib: {INSTALL}") from error
    ground = current_theme().ground
    figure = NotebookFigure(figsize=(width, height), layout="constrained", facecolor=ground)
    FigureCanvasAgg(figure)
    return figure


def series_color(index: int) -> str:
    r"""Returns the colour of a series. Colours repeat after the end of the palette."""
    palette = current_theme().palette
    return palette[index % len(palette)]


def series_marker(index: int) -> str:
    r"""Returns the marker of a series. Markers repeat after the last marker."""
    return MARKERS[index % len(MARKERS)]


def colormap(name: str) -> Any:
    r"""Returns a colour map by its name: :obj:`"sequential"`, :obj:`"diverging"` or :obj:`"share"`
    of the theme, or a colour map of matplotlib.
    """
    from matplotlib import colormaps
    from matplotlib.colors import LinearSegmentedColormap

    theme = current_theme()
    if name == "diverging":
        return LinearSegmentedColormap.from_list("diverging", theme.diverging)
    return colormaps[{"sequential": theme.sequential, "share": theme.share}.get(name, name)]


def ink_on(color: Sequence[float]) -> str:
    r"""Returns black or white, whichever is easier to read on a colour.

    Examples:
        >>> ink_on((0.9, 0.9, 0.2)), ink_on((0.0, 0.1, 0.4))
        ('#000000', '#ffffff')
    """
    luma = 0.299 * color[0] + 0.587 * color[1] + 0.114 * color[2]
    return "#000000" if luma > 0.5 else "#ffffff"


def plain_text(text: str) -> str:
    r"""Returns a text that matplotlib draws literally. Dollar signs do not start formulas, and
    control characters except line breaks are escaped.

    Examples:
        >>> print(plain_text("$5 mug"))
        \$5 mug
    """
    return "\n".join(map(printable, text.split("\n"))).replace("$", r"\$")


def wrap_text(text: str, width: int) -> str:
    r"""Returns a text in lines of at most :obj:`width` letters.

    Examples:
        >>> wrap_text("leave objects out", 14)
        'leave objects\nout'
    """
    return plain_text("\n".join(textwrap.wrap(text, max(width, 1))))


def fit_text(text: str, inches: float, size: float = TITLE) -> str:
    r"""Returns a text in lines of at most :obj:`inches`, in a font of :obj:`size` points."""
    return wrap_text(text, int(inches * 72 / (_LETTER_WIDTH * size)))


def hollow_handle() -> "Line2D":
    r"""Returns the legend handle for hollow marks, which :obj:`HOLLOW` explains."""
    from matplotlib.lines import Line2D

    theme = current_theme()
    return Line2D(
        [], [], linestyle="none", marker="o", color=theme.soft, markerfacecolor=theme.ground
    )


def draw_legend(
    figure: "Figure", handles: list[Any], labels: list[str], *, columns: int, has_hollow: bool
) -> None:
    r"""Draws a legend below the plots. It explains hollow marks if there are any."""
    if has_hollow:
        handles, labels = [*handles, hollow_handle()], [*labels, HOLLOW]
    figure.legend(handles, labels, loc="outside lower center", ncols=columns)


def draw_series(
    ax: "Axes",
    index: int,
    x: Any,
    mean: Any,
    band: tuple[Any, ...] | None,
    *,
    label: str,
    markersize: float,
    alpha: float,
) -> None:
    r"""Draws a series as a line with a band (positions, lower limits, upper limits). Without a
    band, the marks are hollow.
    """
    color = series_color(index)
    ax.plot(
        x,
        mean,
        color=color,
        marker=series_marker(index),
        markersize=markersize,
        markerfacecolor=current_theme().ground if band is None else color,
        linewidth=1.6,
        label=label,
    )
    if band is not None:
        ax.fill_between(*band, color=color, alpha=alpha, linewidth=0)


def symmetric_limit(values: np.ndarray, quantile: float) -> tuple[float, bool]:
    r"""Returns the end of a scale that is symmetric about zero, and whether values lie beyond it.

    The end is a quantile of the absolute values. Infinite and missing values do not count.
    """
    absolute = np.abs(values[np.isfinite(values)])
    if absolute.size == 0 or absolute.max() == 0:
        return 1.0, False
    # The quantile is zero if almost all values are zero.
    limit = float(np.quantile(absolute, quantile)) or float(absolute.max())
    return limit, float(absolute.max()) > limit


def title_figure(figure: "Figure", title: str | None) -> None:
    r"""Writes the title of a figure, wrapped to its width. Does nothing if it is :obj:`None`."""
    if title is not None:
        figure.suptitle(fit_text(title, figure.get_figwidth() - 2 * _MARGIN))


def title_axes(ax: "Axes", title: str, size: float = TEXT, **kwargs: Any) -> "Text":
    r"""Writes the title of axes, and returns its text object."""
    return ax.set_title(title, fontsize=size, color=current_theme().ink, **kwargs)


def style_axes(ax: "Axes") -> None:
    r"""Applies the colours and sizes of all pictures to empty axes."""
    theme = current_theme()
    ax.set_facecolor(theme.ground)
    ax.set_axisbelow(True)
    for spine in ax.spines.values():
        spine.set(color=theme.faint, linewidth=0.8)
    ax.tick_params(
        which="both", color=theme.faint, labelcolor=theme.soft, labelsize=SMALL, width=0.8, length=3
    )
    for axis in (ax.xaxis, ax.yaxis):
        axis.label.set(color=theme.soft, fontsize=TEXT)
        axis.get_offset_text().set(color=theme.soft, fontsize=SMALL)


def open_plot(ax: "Axes", axis: Literal["both", "x", "y"] = "both") -> None:
    r"""Draws the grid of a plot and removes the frame at the top and on the right."""
    ax.grid(axis=axis, color=current_theme().grid, linewidth=0.7)
    ax.set_axisbelow(True)
    ax.spines[["top", "right"]].set_visible(False)
