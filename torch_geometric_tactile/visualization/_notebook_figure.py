r"""A figure in the style of all pictures that notebooks show. Imports matplotlib."""

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


class ShownFigure(Figure):
    r"""A figure that is shown as a picture where it is the last line of a notebook's cell or is
    given to :obj:`display`, without pyplot. What is added to it has the colours and sizes of
    all pictures.
    """

    def _repr_png_(self) -> bytes:
        buffer = BytesIO()
        self.savefig(buffer, format="png", dpi=100)
        return buffer.getvalue()

    def add_subplot(self, *args: Any, **kwargs: Any) -> Any:
        r"""Adds axes, as matplotlib does."""
        ax = super().add_subplot(*args, **kwargs)
        style_axes(ax)
        return ax

    def colorbar(self, *args: Any, **kwargs: Any) -> Any:
        r"""Adds a colour bar, as matplotlib does."""
        bar = super().colorbar(*args, **kwargs)
        style_axes(bar.ax)
        bar.outline.set(edgecolor=current_theme().faint, linewidth=0.8)
        bar.ax.tick_params(labelsize=SMALL)
        return bar

    def legend(self, *args: Any, **kwargs: Any) -> Any:
        r"""Adds a legend without a frame, as matplotlib does."""
        look = {"fontsize": TEXT, "frameon": False, "labelcolor": current_theme().ink}
        return super().legend(*args, **(look | kwargs))

    def suptitle(self, *args: Any, **kwargs: Any) -> Any:
        r"""Adds a title, as matplotlib does."""
        look: dict[str, Any] = {"fontsize": TITLE, "color": current_theme().ink}
        return super().suptitle(*args, **(look | kwargs))
