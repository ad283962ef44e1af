r"""How a predictor's recordings are read: what it keeps of the options of its training data."""

from collections.abc import Mapping
from typing import Any

# Neither labels nor limits: a file to predict has no labels, and may be another's.
_TYPES: dict[str, type | tuple[type, ...]] = {
    "tactile": list,
    "joint": list,
    "num_channels": int,
    "time": str,
    "time_unit": str,
    "rate": (int, float),
    "forces": bool,
    "num_taxels": int,
    "num_joints": int,
    "header": bool,
}


def stored_options(options: Mapping[str, Any]) -> dict[str, Any]:
    r"""Returns what a predictor keeps of options of
    :func:`~torch_geometric_tactile.io.read_recording`: how numbers are read, but neither labels nor
    expressions.

    Examples:
        >>> stored_options({"tactile": ("thumb", "index"), "joint": "q.*", "label": "grasp"})
        {'tactile': ['thumb', 'index']}
    """
    plain = {k: list(v) if isinstance(v, tuple) else v for k, v in options.items()}
    return {key: value for key, value in plain.items() if _is_valid(key, value)}


def checked_options(options: Any) -> dict[str, Any]:
    r"""Returns options that :func:`stored_options` returned, from a file that may be another's."""
    if not isinstance(options, Mapping):
        raise ValueError(f"its 'read_options' must be a mapping (got {str(options)[:80]})")
    for key, value in options.items():
        if not _is_valid(key, value):
            raise ValueError(
                f"its 'read_options' must be some of {[*_TYPES]}, names as lists of texts (got "
                f"{str(key)[:40]!r}: {str(value)[:80]})"
            )
    return dict(options)


def _is_valid(key: str, value: Any) -> bool:
    if not isinstance(value, _TYPES.get(key, ())):
        return False
    if isinstance(value, list):
        return all(isinstance(name, str) for name in value)
    return isinstance(value, bool) == (_TYPES[key] is bool)
