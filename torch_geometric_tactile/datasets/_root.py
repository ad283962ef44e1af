r"""The default folders of data sets."""

import os
from pathlib import Path

import pooch


def default_root(name: str) -> Path:
    r"""Returns the default folder of a data set: :obj:`$TACTILE_DATA/name`, or a folder in the
    user's cache if that variable is not set.

    If :obj:`$TACTILE_DATA/name` does not exist, a folder whose name differs only in case,
    underscores or hyphens is used, such as :obj:`pressure_mat` for :obj:`PressureMat`.

    Args:
        name (str): Name of the data set.

    Raises:
        ValueError: If several folders differ from the name in this way.

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
    return _existing_folder(base, name) if parent else base / name


def _existing_folder(base: Path, name: str) -> Path:
    if (base / name).exists() or not base.is_dir():
        return base / name
    folders = sorted(path for path in base.iterdir() if path.is_dir())
    matches = [path for path in folders if _normalized(path.name) == _normalized(name)]
    if len(matches) > 1:
        raise ValueError(
            f"'{base}' must have only one folder of the data set '{name}' (got "
            f"{', '.join(path.name for path in matches)}): rename or remove the others"
        )
    return matches[0] if matches else base / name


def _normalized(name: str) -> str:
    return name.replace("_", "").replace("-", "").lower()
