r"""The decoders by the names of their protocols."""

import inspect
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

from torch_geometric_tactile.io.decoders.anyskin import AnySkinDecoder
from torch_geometric_tactile.io.decoders.decoder import Decoder
from torch_geometric_tactile.io.decoders.flexitac import FlexiTacDecoder
from torch_geometric_tactile.io.decoders.letter_array_packets import LetterArrayDecoder
from torch_geometric_tactile.io.decoders.lines import LinesDecoder
from torch_geometric_tactile.io.decoders.m1616 import M1616Decoder
from torch_geometric_tactile.io.decoders.packets import CobsDecoder
from torch_geometric_tactile.io.decoders.paxini import PaXiniDecoder
from torch_geometric_tactile.io.decoders.robotiq import RobotiqDecoder
from torch_geometric_tactile.io.decoders.text_rows import TextRowsDecoder

#: Decoders of serial sensors, by the name of the protocol.
PROTOCOLS: Mapping[str, type[Decoder]] = MappingProxyType(
    {
        "cobs": CobsDecoder,
        "anyskin": AnySkinDecoder,
        "flexitac": FlexiTacDecoder,
        "m1616": M1616Decoder,
        "paxini": PaXiniDecoder,
        "text": TextRowsDecoder,
        "lines": LinesDecoder,
        "robotiq": RobotiqDecoder,
        "letter_array": LetterArrayDecoder,
    }
)


def decoder_of(protocol: str, **settings: Any) -> Decoder:
    r"""Returns the decoder of a serial protocol by its name.

    Args:
        protocol (str): A name of :obj:`PROTOCOLS`.
        **settings (optional): Arguments of the decoder. Strings are parsed as in a URL, such as
            :obj:`"12x32"` for a shape.

    Raises:
        ValueError: If the protocol or a setting is unknown, or a value is invalid.

    Examples:
        >>> decoder_of("text", shape="12x32").shape
        (12, 32)
    """
    if protocol not in PROTOCOLS:
        raise ValueError(f"'protocol' must be one of {', '.join(PROTOCOLS)} (got '{protocol}')")
    decoder_class = PROTOCOLS[protocol]
    parameters = inspect.signature(decoder_class).parameters
    for name in settings:
        if name not in parameters:
            raise ValueError(
                f"a setting of protocol '{protocol}' must be one of "
                f"{', '.join(parameters) or 'none'}, or 'baudrate' of the port (got '{name}')"
            )
    return decoder_class(
        **{name: _parse_setting(name, value, parameters[name]) for name, value in settings.items()}
    )


def _parse_setting(name: str, value: Any, parameter: inspect.Parameter) -> Any:
    if not isinstance(value, str):
        return value
    parse = _PARSERS[type(parameter.default)]
    try:
        return parse(value)
    except ValueError as error:
        example = (
            "x".join(map(str, parameter.default)) if parse is _parse_shape else parameter.default
        )
        raise ValueError(f"'{name}' must have a value like {example} (got '{value}')") from error


def _parse_shape(text: str) -> tuple[int, ...]:
    return tuple(int(size) for size in text.split("x"))


_PARSERS: dict[type, Callable[[str], Any]] = {
    int: int,
    float: float,
    str: str,
    tuple: _parse_shape,
}
