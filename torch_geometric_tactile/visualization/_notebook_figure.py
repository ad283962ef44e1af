r"""A figure that notebooks display, in the style of all pictures. It has a separate module because
the definition of the class needs matplotlib, which is optional.
"""

from io import BytesIO
from typing import Any

from matplotlib.figure import Figure

from torch_geometric_tactile.visualization._style import (
    SMALL,
    TEXT,
    TITLE,
    current_theme,
    style_axes,
)


class NotebookFigure(Figure):
    r"""A figure that notebooks display without pyplot, as the last line of a cell or with
    :obj:`display`. Axes, colour bars, legends and titles have the style of all pictures.
    """

    def _repr_png_(self) -> bytes:
        buffer = BytesIO()
        self.savefig(buffer, format="png", dpi=100)
        return buffer.getvalue()

    def add_subplot(self, *args: Any, **kwargs: Any) -> Any:
        r"""Adds axes in the style of all pictures, with the arguments of matplotlib."""
        ax = super().add_subplot(*args, **kwargs)
        style_axes(ax)
        return ax

    def colorbar(self, *args: Any, **kwargs: Any) -> Any:
        r"""Adds a colour bar in the style of all pictures, with the arguments of matplotlib."""
        bar = super().colorbar(*args, **kwargs)
        style_axes(bar.ax)
        bar.outline.set(edgecolor=current_theme().faint, linewidth=0.8)
        bar.ax.tick_params(labelsize=SMALL)
        return bar

    def legend(self, *args: Any, **kwargs: Any) -> Any:
        r"""Adds a legend without a frame, with the arguments of matplotlib."""
        defaults = {"fontsize": TEXT, "frameon": False, "labelcolor": current_theme().ink}
        return super().legend(*args, **(defaults | kwargs))

    def suptitle(self, *args: Any, **kwargs: Any) -> Any:
        r"""Adds a title in the style of all pictures, with the arguments of matplotlib."""
        defaults: dict[str, Any] = {"fontsize": TITLE, "color": current_theme().ink}
        return super().suptitle(*args, **(defaults | kwargs))
