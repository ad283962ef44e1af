r"""``tactile replay``: replays a recording as a live stream, serves it or repairs it."""

import argparse
import math
from collections.abc import Callable
from contextlib import suppress
from typing import TYPE_CHECKING

from torch_geometric_tactile.commands._paths import input_path, recording_file
from torch_geometric_tactile.commands._reading import add_reading_options, reading_options
from torch_geometric_tactile.commands._runs import option_names_in_errors

if TYPE_CHECKING:
    from torch_geometric_tactile.live import Stream

_UPDATE_SECONDS = 0.1
_PORT = 5000
HELP = "Replay a recording, serve it like XELA's server, or repair it"
DESCRIPTION = """\
Replays a recording at its own speed and shows the state of the stream.

--serve sends the frames over a WebSocket to any number of clients, as messages of XELA's server,
so that you can test a program without a hand. --repair recovers the frames of a truncated or
damaged MCAP file.
"""
EXAMPLES = """\
examples:
  tactile replay grasp.mcap --speed 4
  tactile replay grasp.mcap --serve ws --loop    clients connect to ws://127.0.0.1:5000
  tactile replay grasp.h5 --serve ws:0           at a free port, which is printed
  tactile replay cut.mcap --repair whole.mcap
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    r"""Adds the arguments of the command to a parser."""
    parser.add_argument(
        "file", metavar="FILE", type=input_path, help="the recording, in any format"
    )
    parser.add_argument(
        "--speed",
        metavar="X",
        type=_parse_speed,
        default=1.0,
        help="speed factor (default: 1)",
    )
    parser.add_argument("--loop", action="store_true", help="start again at the end")
    mode = parser.add_mutually_exclusive_group()
    mode.add_argument(
        "--repair",
        metavar="OUT",
        type=recording_file("--repair"),
        help="write a repaired MCAP file; replay nothing",
    )
    mode.add_argument(
        "--serve",
        metavar="ws[:PORT]",
        type=_parse_port,
        help=f"act as XELA's server at this port of 127.0.0.1 (default: {_PORT})",
    )
    add_reading_options(parser)


def _parse_speed(text: str) -> float:
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not 0 < number <= 1000:
        raise argparse.ArgumentTypeError(f"must be above 0 and up to 1000 (got {text[:40]!r})")
    return number


def _parse_port(text: str) -> int:
    kind, colon, port = text.partition(":")
    number = int(port) if port.isascii() and port.isdigit() and len(port) < 6 else -1
    if kind != "ws" or (colon and not 0 <= number < 2**16):
        raise argparse.ArgumentTypeError(f"must be ws or ws:PORT (got {text[:40]!r})")
    return number if colon else _PORT


def run(arguments: argparse.Namespace) -> int:
    r"""Runs the command and returns the exit status."""
    from torch_geometric_tactile._texts import printable

    if arguments.repair is not None:
        from torch_geometric_tactile.io import repair_mcap

        report = repair_mcap(arguments.file, arguments.repair)
        print(f"{printable(arguments.repair)}: {report}")
        return 0
    play = _play if arguments.serve is None else _serve
    with option_names_in_errors(arguments):
        print(f"{printable(arguments.file)}: {play(arguments)}")
    return 0


def _play(arguments: argparse.Namespace) -> str:
    from torch_geometric_tactile.commands._status_line import StatusLine
    from torch_geometric_tactile.live import ReplaySource, Stream

    options = reading_options(arguments)
    stream = Stream(ReplaySource(arguments.file, arguments.speed, arguments.loop, **options))
    with StatusLine() as line:
        try:
            with stream:
                _update_until(
                    lambda: stream.state == "ended", lambda: line.show(_describe_state(stream))
                )
        except KeyboardInterrupt:
            pass  # the usual end of a replay in a loop
    if stream.error is not None:
        raise stream.error
    return f"replayed {stream.health().frames} frames"


def _serve(arguments: argparse.Namespace) -> str:
    from torch_geometric_tactile.commands._status_line import StatusLine
    from torch_geometric_tactile.io import read_recording
    from torch_geometric_tactile.live import ReplayServer

    recording = read_recording(arguments.file, **reading_options(arguments))
    server = ReplayServer(recording, arguments.serve, arguments.speed, arguments.loop)
    with StatusLine() as line, server:
        line.write(f"serving {server.url}, starting with the first client; Ctrl-C quits")
        with suppress(KeyboardInterrupt):  # the usual end of a server
            _update_until(
                lambda: server.wait(0),
                lambda: line.show(f"{server.clients} clients, {server.sent} messages sent"),
            )
    return f"sent {server.sent} messages"


def _update_until(is_ended: Callable[[], bool], show_state: Callable[[], None]) -> None:
    import time

    while not is_ended():
        show_state()
        time.sleep(_UPDATE_SECONDS)


def _describe_state(stream: "Stream") -> str:
    health = stream.health()
    return f"{health.frames} frames, {health.line()}"
