r"""Text and JSON of others: shown as it is without harm, read without surprises."""

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

_LONGEST_QUOTE = 60  # characters of a text or value in a message
_MARKDOWN = str.maketrans({char: f"\\{char}" for char in "\\|<>`[]"})


def printable(text: object) -> str:
    r"""Returns text on one line, with everything escaped that a terminal would obey: control
    characters, line breaks, marks that turn the direction of writing, and what is no character.

    Examples:
        >>> print(printable("a cup\n\x1b[2J\u202e"))
        a cup\n\x1b[2J\u202e
    """
    text = str(text)
    if text.isprintable():
        return text
    return "".join(char if _is_harmless(char) else _escaped(char) for char in text)


def _is_harmless(char: str) -> bool:
    return char.isprintable() or unicodedata.category(char) == "Zs"  # any kind of space


def _escaped(char: str) -> str:
    return char.encode("unicode_escape").decode("ascii")


def quoted(text: str) -> str:
    r"""Returns a text of a file for a message: in quotes, not too long, and without characters that
    a terminal would obey.
    """
    short = text if len(text) <= _LONGEST_QUOTE else f"{text[:_LONGEST_QUOTE]}..."
    return f"'{short}'" if short.isprintable() else ascii(short)


def short_repr(value: object) -> str:
    r"""Returns any value of a file for a message, cut where it is long."""
    try:
        text = repr(value)
    except (RecursionError, ValueError):  # nested deeply, or a number that Python does not print
        return f"a {type(value).__name__}"
    return text if len(text) <= _LONGEST_QUOTE else f"{text[: _LONGEST_QUOTE - 3]}..."


def short_list(
    items: Sequence[Any],
    most: int,
    show: Callable[[Any], str] = str,
    rest: str = " and {} more",
    joint: str = ", ",
) -> str:
    r"""Returns the first of some names or numbers for a message, and how many others there are.

    Examples:
        >>> short_list(["thumb", "index", "middle", "ring"], most=2)
        'thumb, index and 2 more'
        >>> short_list([], most=2)
        'none'
    """
    text = joint.join(map(show, items[:most])) if len(items) else "none"
    return text + (rest.format(len(items) - most) if len(items) > most else "")


def markdown_text(text: object) -> str:
    r"""Returns text as Markdown that shows it and is nothing else: no markup, link or new cell.

    Examples:
        >>> print(markdown_text("<b>|[a]|"))
        \<b\>\|\[a\]\|
    """
    return printable(text).translate(_MARKDOWN)


def markdown_table(header: Sequence[object], rows: Iterable[Sequence[str]]) -> list[str]:
    r"""Returns the lines of a table, whose cells are Markdown already, and whose header is text.

    Examples:
        >>> markdown_table(["a", "b"], [["1", "2"]])
        ['| a | b |', '| --- | --- |', '| 1 | 2 |']
    """
    cells = [[markdown_text(name) for name in header], ["---"] * len(header), *rows]
    return ["| " + " | ".join(row) + " |" for row in cells]


def read_json(path: PathLike) -> Any:
    r"""Reads a JSON file that somebody else may have written. Everything in it counts once: a key
    that an object has twice, and numbers that are none (:obj:`NaN`) or too large, are refused.
    """
    path = Path(path)
    found = path.stat()
    need(stat.S_ISREG(found.st_mode), "it must be a regular file (got a folder, pipe or device)")
    need(found.st_size <= JSON_BYTES, f"it must not exceed {JSON_BYTES} bytes", found.st_size)
    return parse_json(path.read_text(encoding="utf-8"))


def parse_json(text: str) -> Any:
    r"""Returns the value of a JSON text, as :func:`read_json` reads it.

    Examples:
        >>> parse_json('{"rate": 100}')
        {'rate': 100}
    """
    try:
        return json.loads(
            text, object_pairs_hook=each_key_once, parse_constant=_constant, parse_float=_float
        )
    except RecursionError:
        raise ValueError("it must not be nested this deeply") from None


def each_key_once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    r"""Returns a JSON object, and refuses a key that it has twice."""
    out = dict(pairs)
    if len(out) < len(pairs):
        seen: set[str] = set()
        for key, _ in pairs:
            if key in seen:
                raise ValueError(f"an object must have each key once (got {key!r} twice)")
            seen.add(key)
    return out


def _constant(name: str) -> float:
    raise ValueError(f"numbers must be finite (got {name})")


def _float(text: str) -> float:
    number = float(text)
    if math.isinf(number):
        raise ValueError(f"numbers must be finite (got {text[:40]})")
    return number
