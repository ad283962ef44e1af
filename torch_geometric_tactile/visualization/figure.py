r"""The theme and the files of all figures. Figures do not use pyplot: they have no global state,
need no display and can be drawn in threads.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._files import atomic_path
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.visualization._style import CURRENT_THEME, DPI, THEMES

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def save_figure(figure: "Figure", path: PathLike) -> None:
    r"""Writes a figure as a PNG file at 150 dots per inch. The file is either complete or absent,
    and equal figures have equal bytes.

    Args:
        figure (matplotlib.figure.Figure): The figure.
        path (str or PathLike): The file, with the suffix :obj:`.png`.

    Raises:
        ValueError: If :obj:`path` does not end in :obj:`.png`.

    Examples:
        >>> import tempfile
        >>> from matplotlib.figure import Figure
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     save_figure(Figure(figsize=(1, 1)), Path(folder) / "empty.png")
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


@contextmanager
def theme(name: Literal["light", "dark"]) -> Iterator[None]:
    r"""Sets the theme of figures that are created within a :obj:`with` block: colours for a light
    page (the default) or for a dark page.

    Args:
        name (str): :obj:`"light"` or :obj:`"dark"`.

    Raises:
        ValueError: If the theme is unknown.

    Examples:
        >>> from torch_geometric_tactile.sensors import grid
        >>> from torch_geometric_tactile.visualization import plot_layout
        >>> with theme("dark"):
        ...     figure = plot_layout(grid(2, 3, pitch=0.002))
        >>> max(figure.get_facecolor()[:3]) < 0.2
        True
    """
    need(name in THEMES, f"'name' must be 'light' or 'dark' (got '{name}')")
    token = CURRENT_THEME.set(THEMES[name])
    try:
        yield
    finally:
        CURRENT_THEME.reset(token)
