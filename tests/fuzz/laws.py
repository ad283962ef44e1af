"""What may come of a mutated file.

A case reads the file before and after one mutation. Allowed are

``same``
    It reads equal to the file before.
``cell``
    Text formats only, which have no checksum: it reads as the reference reader of ``oracles.py``
    reads it, which takes a number for what its cell says, a column for what its name says, and
    refuses whatever is not whole and unambiguous. So only what was mutated is other. A line that
    was removed with its line break, and a column that was removed with its name, are gone without
    a trace, and the reading must be equal but for these.
``rewritten``
    Binary formats only, where the mutation wrote the file anew with a tool that computes its
    checksums anew as well: such a file is whole, and says something else. It must be read or
    refused without harm. Mutations of this kind that nobody can mean (a number that became a list,
    a data set that became a link) must be refused all the same, and are judged strictly.
``error``
    ValueError or OSError, and the message names the file.

Everything else is a failure:

``silent``
    Another reading, and no word; or a file that must be refused (a link to another file) is read.
``wrong error``
    Another exception, or a message that does not name the file.
``crash``, ``hang``
    The process died, or did not answer within five seconds of its own time.
``memory``
    Memory for more than half a gigabyte was taken, or asked for and not explained.
``ran code``
    A file was made, removed or renamed, or a process was started, by reading.
"""

from typing import Any

import numpy as np

ALLOWED = ("same", "cell", "rewritten", "error")
FAILURES = ("silent", "wrong error", "crash", "hang", "memory", "ran code")
OUTCOMES = ALLOWED + FAILURES

# What a mutation allows.
JUDGED = "judged"  # same, cell or error
REFUSED = "refused"  # error
REWRITTEN = "rewritten"  # same, rewritten or error


class Refused(Exception):  # noqa: N818
    """The reference reader says that a file cannot be read without guessing."""


def equal(a: Any, b: Any) -> bool:
    """Whether two readings are equal, NaN with NaN; 1, 1.0 and True are not."""
    if isinstance(a, np.ndarray) or isinstance(b, np.ndarray):
        if type(a) is not type(b) or a.dtype != b.dtype or a.shape != b.shape:
            return False
        return bool(np.array_equal(a, b, equal_nan=a.dtype.kind in "fc"))
    if isinstance(a, float) and isinstance(b, float):
        return a == b or (a != a and b != b)
    if type(a) is not type(b):
        return False
    if isinstance(a, dict):
        return list(a) == list(b) and all(equal(a[key], b[key]) for key in a)
    if isinstance(a, list | tuple):
        return len(a) == len(b) and all(map(equal, a, b))
    return bool(a == b)


def difference(a: Any, b: Any, place: str = "") -> str:
    """The first place where two readings differ, and how."""
    if isinstance(a, dict) and isinstance(b, dict) and list(a) == list(b):
        parts = ((f"{place}.{key}", a[key], b[key]) for key in a)
    elif isinstance(a, list) and isinstance(b, list) and len(a) == len(b):
        parts = ((f"{place}[{i}]", x, y) for i, (x, y) in enumerate(zip(a, b, strict=True)))
    elif isinstance(a, np.ndarray) and isinstance(b, np.ndarray) and a.shape == b.shape:
        where = np.argwhere(~((a == b) | ((a != a) & (b != b))))[:1].tolist()
        spot = tuple(where[0]) if where else ...
        return (
            f"{place}{list(spot) if where else ''}: {a.dtype} {a[spot]} became {b.dtype} {b[spot]}"
        )
    else:
        sizes = [getattr(value, "shape", repr(value)[:80]) for value in (a, b)]
        return f"{place}: {sizes[0]} became {sizes[1]}"
    return next((difference(x, y, name) for name, x, y in parts if not equal(x, y)), "nothing")
