r"""The default folders of data sets."""

import os
from pathlib import Path

import pooch


def default_root(name: str) -> Path:
    r"""Returns the default folder of a data set: :obj:`$TACTILE_DATA/name`, or a folder in the
    user's cache if that variable is not set.

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
