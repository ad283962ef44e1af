r"""Figures without pyplot: no global state, no display, safe in threads."""

from pathlib import Path
from typing import TYPE_CHECKING

from torch_geometric_tactile._files import atomic_path
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.visualization._new_figure import DPI

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
