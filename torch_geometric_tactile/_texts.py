r"""Formats untrusted text for messages and Markdown, and reads JSON strictly."""

import json
import math
import stat
import unicodedata
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._limits import JSON_BYTES
from torch_geometric_tactile._typing import PathLike

_MAX_QUOTE_LENGTH = 60  # largest number of characters of a text or value in a message
_MARKDOWN = str.maketrans({char: f"\\{char}" for char in "\\|<>`[]"})


def printable(text: object) -> str:
    r"""Returns text on one line, with escapes for everything that a terminal would interpret:
    control characters, line breaks, writing direction marks and invalid characters.

    Examples:
        >>> print(printable("a cup\n\x1b[2J\u202e"))
        a cup\n\x1b[2J\u202e
    """
    text = str(text)
    if text.isprintable():
        return text
    return "".join(char if _is_printable(char) else _escape(char) for char in text)


def _is_printable(char: str) -> bool:
    return char.isprintable() or unicodedata.category(char) == "Zs"  # any kind of space


def _escape(char: str) -> str:
    return char.encode("unicode_escape").decode("ascii")


def quoted(text: str) -> str:
    r"""Returns untrusted text for a message. The text is quoted and shortened to 60 characters.
    Everything that a terminal would interpret is escaped.
    """
    short = text if len(text) <= _MAX_QUOTE_LENGTH else f"{text[:_MAX_QUOTE_LENGTH]}..."
    return f"'{short}'" if short.isprintable() else ascii(short)


def short_repr(value: object) -> str:
    r"""Returns the :func:`repr` of an untrusted value for a message, shortened to 60 characters."""
    try:
        text = repr(value)
    except (RecursionError, ValueError):  # deep nesting, or a number too long for Python to print
        return f"a {type(value).__name__}"
    return text if len(text) <= _MAX_QUOTE_LENGTH else f"{text[: _MAX_QUOTE_LENGTH - 3]}..."


def short_list(
    items: Sequence[Any],
    max_items: int,
    show: Callable[[Any], str] = str,
    ending: str = " and {} more",
    separator: str = ", ",
) -> str:
    r"""Returns the first names or numbers of a list for a message, and how many more there are.

    Examples:
        >>> short_list(["thumb", "index", "middle", "ring"], max_items=2)
        'thumb, index and 2 more'
        >>> short_list([], max_items=2)
        'none'
    """
    text = separator.join(map(show, items[:max_items])) if len(items) else "none"
    return text + (ending.format(len(items) - max_items) if len(items) > max_items else "")


def markdown_text(text: object) -> str:
    r"""Returns text with the special characters of Markdown escaped, so that it is shown literally.

    Examples:
        >>> print(markdown_text("<b>|[a]|"))
        \<b\>\|\[a\]\|
    """
    return printable(text).translate(_MARKDOWN)


def markdown_table(header: Sequence[object], rows: Iterable[Sequence[str]]) -> list[str]:
    r"""Returns the lines of a Markdown table. The header is plain text; the cells are Markdown.

    Examples:
        >>> markdown_table(["a", "b"], [["1", "2"]])
        ['| a | b |', '| --- | --- |', '| 1 | 2 |']
    """
    cells = [[markdown_text(name) for name in header], ["---"] * len(header), *rows]
    return ["| " + " | ".join(row) + " |" for row in cells]


def read_json(path: PathLike) -> Any:
    r"""Reads an untrusted JSON file. Duplicate keys, :obj:`NaN` and numbers that overflow are
    errors.

    Raises:
        ValueError: If the file is not a regular file, is too large, or is not strict JSON.
    """
    path = Path(path)
    status = path.stat()
    need(stat.S_ISREG(status.st_mode), "it must be a regular file (got a folder, pipe or device)")
    need(status.st_size <= JSON_BYTES, f"it must not exceed {JSON_BYTES} bytes", status.st_size)
    return parse_json(path.read_text(encoding="utf-8"))


def parse_json(text: str) -> Any:
    r"""Parses a JSON text with the rules of :func:`read_json`.

    Examples:
        >>> parse_json('{"rate": 100}')
        {'rate': 100}
    """
    try:
        return json.loads(
            text,
            object_pairs_hook=each_key_once,
            parse_constant=_reject_constant,
            parse_float=_finite_float,
        )
    except RecursionError:
        raise ValueError("it must not be nested this deeply") from None


def each_key_once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    r"""Returns a JSON object from its pairs, and raises an error for a duplicate key."""
    content = dict(pairs)
    if len(content) < len(pairs):
        keys: set[str] = set()
        for key, _ in pairs:
            if key in keys:
                raise ValueError(f"an object must have each key once (got {key!r} twice)")
            keys.add(key)
    return content


def _reject_constant(name: str) -> float:
    raise ValueError(f"numbers must be finite (got {name})")


def _finite_float(text: str) -> float:
    number = float(text)
    if math.isinf(number):
        raise ValueError(f"numbers must be finite (got {text[:40]})")
    return number
