r"""The look of all pictures: colours, maps and sizes. Matplotlib's defaults stay as they are."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Literal

from torch_geometric_tactile.visualization._style import CURRENT_THEME, THEMES


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
    if name not in THEMES:
        raise ValueError(f"'name' must be 'light' or 'dark' (got '{name}')")
    token = CURRENT_THEME.set(THEMES[name])
    try:
        yield
    finally:
        CURRENT_THEME.reset(token)
