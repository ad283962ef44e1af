r"""Construction of sources from URLs."""

import os
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any
from urllib.parse import parse_qsl, unquote

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._texts import printable
from torch_geometric_tactile.live.source import Source

_TRUE_TEXTS = ("1", "true", "yes")
_FALSE_TEXTS = ("0", "false", "no")
_URL_EXAMPLES = (
    '"serial:/dev/ttyACM0?protocol=anyskin", ws://host:5000, "file:grasp.h5?speed=2&loop=1", the '
    'path of a file, or "sim:?object=sponge"'
)


def open_source(url: str, **settings: Any) -> Source:
    r"""Returns the source for a URL, without opening it.

    ============================================ ===================================================
    :obj:`serial:PORT?protocol=NAME`             :class:`SerialSource` with the decoder of
                                                 :func:`~torch_geometric_tactile.io.decoder_of`;
                                                 :obj:`baudrate`, and the settings of the decoder
    :obj:`serial:PORT`                           the same with :obj:`protocol=lines`, if the bytes
                                                 of the first seconds are lines of numbers
    :obj:`ws://HOST:PORT`, :obj:`wss://...`      :class:`XelaSource`; :obj:`forces`
    :obj:`file:PATH`, or the path alone          :class:`ReplaySource`; :obj:`speed`, :obj:`loop`,
                                                 and options of
                                                 :func:`~torch_geometric_tactile.io.read_recording`
    :obj:`sim:`                                  :class:`SimulatedSource`; :obj:`object`,
                                                 :obj:`rate`, :obj:`seed`, :obj:`objects`,
                                                 :obj:`motion`
    ============================================ ===================================================

    Options follow a question mark, as :obj:`name=value` with :obj:`&` between them.

    Args:
        url (str): The URL.
        **settings (optional): Options, which override the options in the URL.

    Raises:
        ImportError: If an extra is missing.
        ValueError: If the scheme, an option or its value is unknown. The message lists the valid
            values.

    Examples:
        >>> open_source("file:grasp.h5?speed=2")
        ReplaySource('file:grasp.h5')
    """
    if not isinstance(url, str | os.PathLike) or not str(url):
        raise ValueError(f"a source must be one of {_URL_EXAMPLES} (got {url!r})")
    url = os.fspath(url)
    # An existing file takes precedence over a scheme, so that names with a colon can be opened.
    scheme, colon, remainder = url.partition(":")
    if (
        not colon or "/" in scheme or len(scheme) < 2 or os.path.exists(url)
    ):  # "C:" is a Windows drive
        return (
            _file_source(url, settings)
            if os.path.exists(url)
            else _file_source(*_split_options(url, settings))
        )
    if scheme in ("ws", "wss"):
        address, options = _split_options(url, settings)
        return _websocket_source(address, options)
    if scheme not in _SOURCES:
        raise ValueError(f"a source must be one of {_URL_EXAMPLES} (got '{printable(url)}')")
    return _SOURCES[scheme](*_split_options(remainder, settings))


def _split_options(text: str, settings: Mapping[str, Any]) -> tuple[str, dict[str, Any]]:
    path, _, query = text.partition("?")
    options: dict[str, Any] = {}
    for name, value in parse_qsl(query, keep_blank_values=True):
        if name in options:
            raise ValueError(f"option '{name}' must be given once (got it twice)")
        options[name] = value
    return unquote(path) if "%" in path else path, {**options, **settings}


def _file_source(path: str, options: Mapping[str, Any]) -> Source:
    from torch_geometric_tactile.live.replay_source import ReplaySource

    need(path, "a file source must name the file, such as file:grasp.h5")
    if re.match(r"/dev/|COM[0-9]+$", path) or Path(path).is_char_device():
        raise ValueError(
            f'a serial port must be given as "serial:{path}?protocol=NAME" '
            f"(got '{printable(path)}')"
        )
    return ReplaySource(path, **_convert_options("file:", options, _FILE_CONVERTERS))


def _websocket_source(url: str, options: Mapping[str, Any]) -> Source:
    from torch_geometric_tactile.live.xela_source import XelaSource

    return XelaSource(url, **_convert_options("ws:", options, {"forces": _to_bool}))


def _serial_source(port: str, options: Mapping[str, Any]) -> Source:
    from torch_geometric_tactile.io import decoder_of
    from torch_geometric_tactile.live.serial_source import SerialSource

    settings = dict(options)
    protocol = settings.pop("protocol", None)
    baudrate = settings.pop("baudrate", None)
    baudrate = None if baudrate is None else _to_int("baudrate", baudrate)
    decoder = decoder_of("lines" if protocol is None else protocol, **settings)
    return SerialSource(port, decoder, baudrate, expects_lines=protocol is None)


def _simulated_source(path: str, options: Mapping[str, Any]) -> Source:
    from torch_geometric_tactile.live.simulated_source import SimulatedSource

    need(not path, "a simulated source must be sim: or 'sim:?object=NAME'", f"'sim:{path}'")
    converters = {
        "object": _to_text,
        "rate": _to_float,
        "seed": _to_int,
        "objects": _to_text,
        "motion": _to_text,
    }
    return SimulatedSource(**_convert_options("sim:", options, converters))


_SOURCES: dict[str, Callable[[str, Mapping[str, Any]], Source]] = {
    "serial": _serial_source,
    "file": _file_source,
    "sim": _simulated_source,
}


def _convert_options(
    scheme: str, options: Mapping[str, Any], converters: Mapping[str, Callable[[str, Any], Any]]
) -> dict[str, Any]:
    for name in options:
        if name not in converters:
            raise ValueError(
                f"an option of {scheme} must be one of {list(converters)} (got '{printable(name)}')"
            )
    return {name: converters[name](name, value) for name, value in options.items()}


def _to_float(name: str, value: Any) -> float:
    try:
        return float(value)
    except (TypeError, ValueError):
        raise ValueError(f"'{name}' must be a number (got {value!r})") from None


def _to_int(name: str, value: Any) -> int:
    try:
        return int(value)
    except (TypeError, ValueError):
        raise ValueError(f"'{name}' must be an integer (got {value!r})") from None


def _to_text(name: str, value: Any) -> str:
    return str(value)


def _to_texts(name: str, value: Any) -> list[str]:
    return value.split(",") if isinstance(value, str) else list(value)


def _to_bool(name: str, value: Any) -> bool:
    if isinstance(value, bool):
        return value
    text = str(value).lower()
    need(text in _TRUE_TEXTS + _FALSE_TEXTS, f"'{name}' must be 1 or 0 (got {value!r})")
    return text in _TRUE_TEXTS


# Options of `ReplaySource` and of the readers of recordings.
_FILE_CONVERTERS: dict[str, Callable[[str, Any], Any]] = {
    **dict.fromkeys(("speed", "rate"), _to_float),
    **dict.fromkeys(("loop", "forces", "header", "unit_row"), _to_bool),
    **dict.fromkeys(("num_taxels", "num_channels", "num_joints", "preamble"), _to_int),
    **dict.fromkeys(("tactile", "joint", "time", "time_unit", "label", "unit"), _to_text),
    **dict.fromkeys(("separator", "decimal", "encoding", "time_format"), _to_text),
    **dict.fromkeys(("extra", "ignore", "missing"), _to_texts),
}
