r"""``tactile record``: what a source sends, into a file."""

import argparse
from typing import TYPE_CHECKING

from torch_geometric_tactile.commands.arguments import SOURCE, seconds

if TYPE_CHECKING:
    from torch_geometric_tactile.live import Recorder

_SHOWN_EVERY = 0.1
HELP = "Record a sensor to a file"
DESCRIPTION = """\
Writes every frame of a sensor to FILE until Ctrl-C, or for --seconds. An .mcap file is saved
every quarter of a second, so a crash or a power cut loses at most that much; repair such a
file with 'tactile replay FILE --repair OUT'. An .h5 file is saved every second and holds
frames only.
"""
EXAMPLES = f"""\
{SOURCE}
examples:
  tactile record serial:/dev/ttyACM0?protocol=anyskin mug.mcap --label mug
  tactile record ws://127.0.0.1:5000 grasp.mcap --layout allegro_uskin_368 --seconds 30
                                                 with taxel positions, for Foxglove
  tactile record sim: grasp.h5
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    r"""Adds the arguments of the verb.

    Args:
        parser (argparse.ArgumentParser): The parser of the verb.
    """
    parser.add_argument("source", metavar="SOURCE", help="a sensor or a recording; see below")
    parser.add_argument("file", metavar="FILE", help="the file to write (.mcap, .h5 or .hdf5)")
    parser.add_argument("--label", metavar="LABEL", help="label of the recording")
    parser.add_argument(
        "--seconds", metavar="S", type=seconds, help="stop this long after the first frame"
    )
    parser.add_argument(
        "--layout",
        metavar="LAYOUT",
        help="positions of the taxels, for viewers: a stock layout or a layout file",
    )
    parser.add_argument(
        "--map",
        metavar="MAP",
        help="reorders the taxels of the source to the layout: a stock map or a JSON file",
    )
    parser.add_argument("--overwrite", action="store_true", help="replace an existing file")


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
        raise OSError(f"'{arguments.source}' sent no frames, so '{arguments.file}' was not written")
    counts = stream.source.counts
    print(
        f"{printable(arguments.file)}: {recorder.frames} frames in {recorder.seconds:.2f} s, "
        f"{counts.lost} lost and {counts.corrupt} corrupt in transmission"
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
