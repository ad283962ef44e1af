r"""Check of the argument :obj:`split` of data sets."""

import warnings
from collections.abc import Sequence
from typing import Any

from torch_geometric_tactile._checks import need


def checked_split(split: Any, parts: Sequence[str]) -> str | None:
    r"""Returns the name of a part, or :obj:`None` for all samples.

    Version 0.3 accepts :obj:`"all"` as well, with a :class:`DeprecationWarning`.

    Args:
        split (str, optional): The part.
        parts (sequence of str): The names of the parts.

    Raises:
        ValueError: If :obj:`split` is not the name of a part.
    """
    if split == "all":
        warnings.warn(
            "split='all' is now split=None, as in all data sets; version 0.4.0 no longer accepts "
            "'all'",
            DeprecationWarning,
            stacklevel=3,
        )
        return None
    names = ", ".join(f"'{part}'" for part in parts)
    need(split is None or split in parts, f"'split' must be {names} or None", repr(split))
    return None if split is None else str(split)
