r"""The default folders of data sets."""

import os
from pathlib import Path

import pooch


def default_root(name: str) -> Path:
    r"""Returns the folder of a data set that was given no root: :obj:`$TACTILE_DATA/name`, or one
    in the user's cache folder if that variable is not set.

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
    return base / name
