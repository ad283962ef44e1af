r"""Numbers of a line of text."""

import re

_LABEL = re.compile(rb"(?<![\w.+-])[A-Za-z_]\w*:[ \t]*")
_VALID_BYTES = b"0123456789+-.eE \t,;nafiNAFI"


def parse_line(line: bytes) -> list[float] | None:
    r"""Returns the numbers in a line of text, or :obj:`None` if the line contains anything except
    numbers, their labels and one kind of separator.

    Examples:
        >>> parse_line(b"a:12, b:1.5e3,\r"), parse_line(b"1\t2"), parse_line(b"1,2 3")
        ([12.0, 1500.0], [1.0, 2.0], None)
    """
    # Arduino prints "ovf" for floats beyond 32 bits.
    text = _LABEL.sub(b"", line.rstrip(b"\r")).replace(b"ovf", b"inf").strip(b" \t")
    if not text or text.translate(None, _VALID_BYTES):
        return None
    separator = next((mark for mark in (b",", b";") if mark in text), None)
    cells = text.split(separator)
    if separator is not None and not cells[-1]:  # a separator at the end
        cells.pop()
    try:
        values = [float(cell) for cell in cells]
    except ValueError:
        return None
    return values or None
