r"""Figures without pyplot: no global state, no display, safe in threads."""

from pathlib import Path
from typing import TYPE_CHECKING

from torch_geometric_tactile._files import atomic_path
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.visualization.style import current_theme

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


def save_figure(figure: "Figure", path: PathLike) -> None:
    r"""Writes a figure as a PNG file that is either complete or absent, at 150 dots per inch. The
    same figure gives the same bytes.

    Args:
        figure (matplotlib.figure.Figure): The figure.
        path (str or PathLike): The file, with the suffix :obj:`.png`.

    Raises:
        ValueError: If :obj:`path` has another suffix.

    Examples:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     save_figure(new_figure(1.0, 1.0), Path(folder) / "empty.png")
        ...     [path.name for path in Path(folder).iterdir()]
        ['empty.png']
    """
    if Path(path).suffix.lower() != ".png":
        raise ValueError(f"'path' must end in '.png' (got '{path}')")
    with atomic_path(path) as temporary:
        figure.savefig(
            temporary,
            format="png",
            dpi=DPI,
            metadata={"Software": None},
            pil_kwargs={"optimize": True},
        )
