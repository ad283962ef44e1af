r"""The default folders of data sets."""

import os
from pathlib import Path

import pooch


def default_root(name: str) -> Path:
    r"""Returns the default folder of a data set: :obj:`$TACTILE_DATA/name`, or a folder in the
    user's cache if that variable is not set.

    A folder in :obj:`$TACTILE_DATA` whose name differs in case, underscores or hyphens only, such
    as :obj:`pressure_mat` for :obj:`PressureMat`, is taken if there is none of the name itself.

    Args:
        name (str): Name of the data set.

    Examples:
        >>> default_root("bts3").name
        'bts3'
    """
    parent = os.environ.get("TACTILE_DATA")
    base = (
        Path(os.path.expanduser(parent))
        if parent
        else Path(pooch.os_cache("torch_geometric_tactile"))
    )
    return _spelled(base, name) if parent else base / name


def _spelled(base: Path, name: str) -> Path:
    if (base / name).exists() or not base.is_dir():
        return base / name
    folders = sorted(path for path in base.iterdir() if path.is_dir())
    found = [path for path in folders if _letters(path.name) == _letters(name)]
    if len(found) > 1:
        raise ValueError(
            f"'{base}' must have one folder of the data set '{name}' (got "
            f"{', '.join(path.name for path in found)}): rename or remove the others"
        )
    return found[0] if found else base / name


def _letters(name: str) -> str:
    return name.replace("_", "").replace("-", "").lower()
