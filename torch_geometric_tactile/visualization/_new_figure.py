r"""An empty figure: drawn in memory, and shown by notebooks."""

from typing import TYPE_CHECKING

from torch_geometric_tactile.visualization._style import current_theme

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DPI = 150
INSTALL = 'pip install "torch-geometric-tactile[viz]"'


def new_figure(width: float, height: float) -> "Figure":
    r"""Returns an empty figure in the colours of :func:`theme` that is drawn in memory and shown by
    notebooks.

    Examples:
        >>> figure = new_figure(4.0, 3.0)
        >>> figure.get_size_inches().tolist()
        [4.0, 3.0]
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg

        from torch_geometric_tactile.visualization._shown_figure import ShownFigure
    except ImportError as error:
        raise ImportError(f"pictures need matplotlib: {INSTALL}") from error
    ground = current_theme().ground
    figure = ShownFigure(figsize=(width, height), layout="constrained", facecolor=ground)
    FigureCanvasAgg(figure)
    return figure
