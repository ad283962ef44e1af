r"""Figures without pyplot: no global state, no display, safe in threads."""

from pathlib import Path
from typing import TYPE_CHECKING

from torch_geometric_tactile.files import atomic_path
from torch_geometric_tactile.texts import printable
from torch_geometric_tactile.typing import PathLike

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DPI = 150
INSTALL = 'pip install "torch-geometric-tactile[viz]"'


def new_figure(width: float, height: float) -> "Figure":
    r"""Returns an empty white figure that is drawn in memory and shown by notebooks.

    Args:
        width (float): Width in inches.
        height (float): Height in inches.

    Raises:
        ImportError: If matplotlib is missing.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg

        from torch_geometric_tactile.visualization.shown_figure import ShownFigure
    except ImportError as error:
        raise ImportError(f"pictures need matplotlib: {INSTALL}") from error
    figure = ShownFigure(figsize=(width, height), layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def plain_text(text: str) -> str:
    r"""Returns a text in which matplotlib finds no formula and no control characters, but lines.

    Args:
        text (str): The text, such as the name of an object.

    Examples:
        >>> print(plain_text("$5 mug"))
        \$5 mug
    """
    return "\n".join(map(printable, text.split("\n"))).replace("$", r"\$")


def save_figure(figure: "Figure", path: PathLike) -> None:
    r"""Writes a figure as a PNG file that is either whole or absent, at 150 dots per inch. The same
    figure gives the same bytes.

    Args:
        figure (matplotlib.figure.Figure): The figure.
        path (str or PathLike): The file, with the suffix :obj:`.png`.

    Raises:
        ValueError: If :obj:`path` has another suffix.
    """
    if Path(path).suffix.lower() != ".png":
        raise ValueError(f"'path' must end in '.png' (got '{path}')")
    with atomic_path(path) as temporary:
        figure.savefig(temporary, format="png", dpi=DPI, metadata={"Software": None})
