r"""Checks of plain data, such as JSON, that somebody else may have written."""

from collections.abc import Collection, Mapping, Sequence
from typing import Any

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._texts import short_repr

MOST_TAXELS = 1_000_000
LARGEST = 1e18  # of a number: far beyond any length or angle, and within float32


def need_mapping(value: Any, what: str) -> None:
    r"""Checks that a value is an object of names and values."""
    if not isinstance(value, Mapping) or not all(isinstance(key, str) for key in value):
        raise ValueError(f"{what} must be a JSON object (got {short_repr(value)})")


def need_key(item: Any, key: str, what: str) -> Any:
    r"""Returns a value of an object."""
    need_mapping(item, what)
    need(key in item, f"{what} must have the key '{key}'", sorted(item))
    return item[key]


def need_list(value: Any, what: str) -> list[Any] | tuple[Any, ...]:
    r"""Returns a value that is a list."""
    if not isinstance(value, list | tuple):
        raise ValueError(f"{what} must be a list (got {short_repr(value)})")
    return value


def is_named(value: Any, known: Collection[str]) -> bool:
    r"""Tells whether a value is one of some names."""
    return isinstance(value, str) and value in known


def only_keys(item: Mapping[str, Any], known: Collection[str], what: str) -> None:
    r"""Checks that an object has no key with a name that means nothing, such as a misspelt one."""
    unknown = next((key for key in item if key not in known), None)
    if unknown is not None:
        raise ValueError(
            f"{what} must have no other keys than {', '.join(known)} (got {short_repr(unknown)})"
        )


def need_text(value: Any, what: str) -> None:
    r"""Checks that a value is a text that can be written to a file."""
    if not isinstance(value, str):
        raise ValueError(f"{what} must be a text (got {short_repr(value)})")
    try:
        value.encode("utf-8")
    except UnicodeEncodeError:
        raise ValueError(f"{what} must be a text of whole characters (got {value!r})") from None


def need_texts(values: Any, what: str, may_repeat: bool = False) -> None:
    r"""Checks that a value is a list of texts."""
    if not isinstance(values, list | tuple):
        raise ValueError(f"{what} must be a list of texts (got {short_repr(values)})")
    for value in values:
        need_text(value, f"each of {what}")
    if not may_repeat and len(set(values)) < len(values):
        raise ValueError(f"{what} must differ from one another (got {short_repr(values)})")


def is_number(value: Any) -> bool:
    r"""Tells whether a value is a finite number, and no truth value."""
    is_kind = isinstance(value, int | float) and not isinstance(value, bool)
    return is_kind and abs(value) <= LARGEST


def is_whole(value: Any) -> bool:
    r"""Tells whether a value is a whole number of a size that tensors hold, and no truth value."""
    is_kind = isinstance(value, int) and not isinstance(value, bool)
    return is_kind and abs(value) < 1 << 62


def are_numbers(value: Any, *counts: int) -> bool:
    r"""Tells whether a value is a list of finite numbers."""
    return _is_list(value, counts) and all(map(is_number, value))


def are_whole(value: Any, *counts: int) -> bool:
    r"""Tells whether a value is a list of whole numbers."""
    return _is_list(value, counts) and all(map(is_whole, value))


def _is_list(value: Any, counts: Sequence[int]) -> bool:
    return isinstance(value, list | tuple) and len(value) in counts
