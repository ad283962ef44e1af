r"""The data files that come with the package."""

from importlib.resources import files
from pathlib import Path

from torch_geometric_tactile.sensors.layout import TaxelLayout

_KINDS = ("chains", "layouts")


def stock_path(kind: str, name: str) -> Path:
    r"""Returns the path of a data file of the package, to copy and edit.

    Args:
        kind (str): :obj:`"layouts"` or :obj:`"chains"`.
        name (str): Its name, such as :obj:`"allegro_uskin"`.

    Raises:
        ValueError: If there is no such file; the message lists those that there are.
    """
    if kind not in _KINDS:
        raise ValueError(f"'kind' must be one of {list(_KINDS)} (got '{kind}')")
    folder = Path(str(files(__package__) / kind))
    path = folder / f"{name}.json"
    if not path.is_file():
        known = sorted(file.stem for file in folder.glob("*.json"))
        raise ValueError(f"'name' must be one of {known} (got '{name}')")
    return path


def stock_layout(name: str) -> TaxelLayout:
    r"""Returns a layout that comes with the package.

    Args:
        name (str): Its name, such as :obj:`"biotac"`.
    """
    return TaxelLayout.load(stock_path("layouts", name))
