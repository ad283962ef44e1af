r"""The text of a single message of XELA's server, as fast as a live hand sends them."""

import json
from typing import Any

from torch_geometric_tactile._texts import short_repr
from torch_geometric_tactile.io.xela_message import XelaFrame, parse_xela_message, sensor_keys

_orjson: Any
try:
    import orjson as _orjson
except ImportError:  # the extra `live` has it; without it messages take twice as long
    _orjson = None

# Some servers send line breaks inside of texts, which strict JSON forbids.
_JSON = json.JSONDecoder(strict=False)


def parse_xela_text(text: str | bytes, forces: bool = False) -> XelaFrame | None:
    r"""Parses the JSON text of one message of XELA's server.

    Args:
        text (str or bytes): The text, as it comes from the WebSocket.
        forces (bool): Whether to read the forces in newtons instead of the counts.

    Returns:
        XelaFrame: What :meth:`parse_xela_message` returns, or :obj:`None` if the message is a
        greeting (:obj:`{"message": "Welcome"}`), which has no sensors.

    Raises:
        ValueError: If the text is no JSON, or :meth:`parse_xela_message` refuses it.

    Examples:
        >>> parse_xela_text('{"message": "Welcome"}') is None
        True
        >>> text = '{"message": 7, "time": 0.5, "1": {"data": "0001,0002,00FF", "temp": [25.5]}}'
        >>> frame = parse_xela_text(text)
        >>> frame.reading.tolist(), frame.temp.tolist()
        ([[1.0, 2.0, 255.0]], [25.5])
    """
    if _orjson is not None:
        given = text.encode("utf-8", "replace") if isinstance(text, str) else text
        for content in (given, given.replace(b",\n", b",")):
            try:
                return _read(_orjson.loads(content), forces)
            except ValueError:  # also what only Python's reader takes, who tells what is wrong
                continue
    try:
        message = _JSON.decode(text if isinstance(text, str) else text.decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:  # also of a number with thousands of digits
        raise ValueError(
            f"a XELA message must be JSON (got {short_repr(text)}: {error})"
        ) from error
    return _read(message, forces)


def _read(message: Any, forces: bool) -> XelaFrame | None:
    if (
        isinstance(message, dict)
        and isinstance(message.get("message"), str)
        and not sensor_keys(message)
    ):
        return None
    return parse_xela_message(message, forces)
