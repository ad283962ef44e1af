r"""Checks of untrusted plain data, such as the content of JSON files.

The argument :obj:`subject` names the data in error messages, such as ``"a layout"``.
"""

from collections.abc import Collection, Mapping, Sequence
from typing import Any

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._texts import short_repr

MAX_TAXELS = 1_000_000
MAX_NUMBER = 1e18  # far above any length or angle, and within the range of float32


def need_mapping(value: Any, subject: str) -> None:
    r"""Checks that a value is a mapping with strings as keys."""
    if not isinstance(value, Mapping) or not all(isinstance(key, str) for key in value):
        raise ValueError(f"{subject} must be a JSON object (got {short_repr(value)})")


def need_key(item: Any, key: str, subject: str) -> Any:
    r"""Returns the value of a required key of a mapping."""
    need_mapping(item, subject)
    need(key in item, f"{subject} must have the key '{key}'", sorted(item))
    return item[key]


def need_list(value: Any, subject: str) -> list[Any] | tuple[Any, ...]:
    r"""Returns a value that must be a list or tuple."""
    if not isinstance(value, list | tuple):
        raise ValueError(f"{subject} must be a list (got {short_repr(value)})")
    return value


def is_one_of(value: Any, names: Collection[str]) -> bool:
    r"""Returns whether a value is a string and one of the names. The value may be unhashable."""
    return isinstance(value, str) and value in names


def need_only_keys(item: Mapping[str, Any], keys: Collection[str], subject: str) -> None:
    r"""Checks that a mapping has no unknown keys, such as misspelt ones."""
    unknown = next((key for key in item if key not in keys), None)
    if unknown is not None:
        raise ValueError(
            f"{subject} must have only the keys {', '.join(keys)} (got {short_repr(unknown)})"
        )


def need_text(value: Any, subject: str) -> None:
    r"""Checks that a value is a string that can be written to a file."""
    if not isinstance(value, str):
        raise ValueError(f"{subject} must be a string (got {short_repr(value)})")
    try:
        value.encode("utf-8")
    except UnicodeEncodeError:
        raise ValueError(f"{subject} must be a string without surrogates (got {value!r})") from None


def need_texts(values: Any, subject: str, may_repeat: bool = False) -> None:
    r"""Checks that a value is a list of strings, which must be unique unless :obj:`may_repeat`."""
    if not isinstance(values, list | tuple):
        raise ValueError(f"{subject} must be a list of strings (got {short_repr(values)})")
    for value in values:
        need_text(value, f"each of {subject}")
    if not may_repeat and len(set(values)) < len(values):
        raise ValueError(f"{subject} must differ from one another (got {short_repr(values)})")


def is_number(value: Any) -> bool:
    r"""Returns whether a value is a finite number and not a boolean."""
    is_real = isinstance(value, int | float) and not isinstance(value, bool)
    return is_real and abs(value) <= MAX_NUMBER


def is_integer(value: Any) -> bool:
    r"""Returns whether a value is an integer that fits into 62 bits and not a boolean."""
    is_int = isinstance(value, int) and not isinstance(value, bool)
    return is_int and abs(value) < 1 << 62


def are_numbers(value: Any, *lengths: int) -> bool:
    r"""Returns whether a value is a list of finite numbers with one of the lengths."""
    return _is_list(value, lengths) and all(map(is_number, value))


def are_integers(value: Any, *lengths: int) -> bool:
    r"""Returns whether a value is a list of integers with one of the lengths."""
    return _is_list(value, lengths) and all(map(is_integer, value))


def _is_list(value: Any, lengths: Sequence[int]) -> bool:
    return isinstance(value, list | tuple) and len(value) in lengths
