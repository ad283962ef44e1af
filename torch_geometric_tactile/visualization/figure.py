r"""What all figures share: their colours and their files. They are made without pyplot: no global
state, no display, safe in threads."""

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
    r"""Writes a figure as a PNG file that is either complete or absent, at 150 dots per inch. The
    same figure gives the same bytes.

    Args:
        figure (matplotlib.figure.Figure): The figure.
        path (str or PathLike): The file, with the suffix :obj:`.png`.

    Raises:
        ValueError: If :obj:`path` has another suffix.

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
    r"""Draws the figures made within a :obj:`with` block in the colours of a light or a dark page.
    Without it they are light.

    Args:
        name (str): :obj:`"light"` or :obj:`"dark"`.

    Raises:
        ValueError: If there is no such theme.

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
