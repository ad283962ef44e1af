r"""``tactile record``: what a source sends, into a file."""

import argparse
import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from torch_geometric_tactile.live import Recorder

_SHOWN_EVERY = 0.1
HELP = "record what a sensor sends"
DESCRIPTION = """\
Opens a source and writes every frame that it sends into FILE, until Ctrl-C, or for a number
of seconds. .mcap is handed to the disk every quarter of a second: whatever ends the
recording, that much is lost at most, and 'tactile replay FILE --repair OUT' makes a whole
file of what is left. .h5 and .hdf5 keep frames only, each second.

SOURCE is serial:/dev/ttyACM0?protocol=anyskin ('tactile ports' lists them), the address of
XELA's server (ws://host:5000), a recording (grasp.h5, replayed at its own speed) or sim: (the
simulated hand).
"""
EXAMPLES = """\
examples:
  tactile record serial:/dev/ttyACM0?protocol=anyskin mug.mcap --label mug
  tactile record ws://127.0.0.1:5000 grasp.mcap --layout allegro_uskin_368 --seconds 30
                                                 with the taxels in space, for Foxglove
  tactile record sim: grasp.h5
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    r"""Adds the arguments of the verb.

    Args:
        parser (argparse.ArgumentParser): The parser of the verb.
    """
    parser.add_argument("source", metavar="SOURCE", help="where the frames come from")
    parser.add_argument("file", metavar="FILE", help="the file to write (.mcap, .h5 or .hdf5)")
    parser.add_argument("--label", metavar="LABEL", help="what the recording is an example of")
    parser.add_argument(
        "--seconds", metavar="S", type=_seconds, help="end so long after the first frame"
    )
    parser.add_argument(
        "--layout",
        metavar="NAME",
        help="taxels of the source, for viewers that show them in space: a stock layout or its "
        "file",
    )
    parser.add_argument(
        "--map",
        metavar="NAME",
        help="from the order of the source to that of the layout: a stock map or a JSON file",
    )
    parser.add_argument("--overwrite", action="store_true", help="replace FILE, if there is one")


def _seconds(text: str) -> float:
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not 0 < number < math.inf:
        raise argparse.ArgumentTypeError(
            f"must be a positive number of seconds (got {text[:40]!r})"
        )
    return number


def run(arguments: argparse.Namespace) -> int:
    r"""Runs the verb and returns the exit status.

    Args:
        arguments (argparse.Namespace): The arguments.
    """
    from torch_geometric_tactile.live import Recorder, Stream, TaxelMap, open_source
    from torch_geometric_tactile.texts import printable

    taxel_map = None if arguments.map is None else TaxelMap.load(arguments.map)
    stream = Stream(open_source(arguments.source), taxel_map=taxel_map)
    recorder = Recorder(
        arguments.file,
        stream,
        layout=arguments.layout,
        label=arguments.label,
        overwrite=arguments.overwrite,
    )
    recorder.start()
    try:
        with stream:
            _wait(recorder, arguments.seconds)
    except KeyboardInterrupt:
        pass  # how a recording is ended
    finally:
        stream.close()
        recorder.close()
    if not recorder.frames:
        raise OSError(f"'{arguments.source}' sent no frame, and '{arguments.file}' was not made")
    counts = stream.source.counts
    print(
        f"{printable(arguments.file)}: {recorder.frames} frames in {recorder.seconds:.2f} s, "
        f"{counts.lost} lost and {counts.corrupt} corrupt on their way"
    )
    return 0


def _wait(recorder: "Recorder", seconds: float | None) -> None:
    import time

    from torch_geometric_tactile.commands.status_line import StatusLine

    stream = recorder.stream
    with StatusLine() as line:
        while recorder.error is None and stream.state not in ("ended", "closed"):
            if seconds is not None and recorder.seconds >= seconds:
                return
            line.show(f"{recorder.frames} frames, {stream.health().line()}")
            time.sleep(_SHOWN_EVERY)
