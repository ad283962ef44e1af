r"""``tactile live``: a source that is judged, recorded and shown."""

import argparse
import webbrowser
from contextlib import closing, suppress
from typing import TYPE_CHECKING

from torch_geometric_tactile.commands.arguments import seconds

if TYPE_CHECKING:
    from torch_geometric_tactile.live import Judge, LiveSession, Status
    from torch_geometric_tactile.sensors import TaxelLayout

HELP = "judge, record and show what a sensor sends now"
DESCRIPTION = """\
Opens a source, and tells on one quiet line how it is doing: frames a second, losses, what
the model says and how long it took. The recorder gets every frame; the model and the viewer
get the newest, so that they never lag. A model whose readings are tared waits until the
sensor has been still for a second. A port or socket that is lost is opened again.

SOURCE is serial:/dev/ttyACM0?protocol=anyskin ('tactile ports' lists them), the address of
XELA's server (ws://host:5000), a recording (grasp.h5, replayed at its own speed) or sim: (the
simulated hand). Keys on the terminal: t measures the rest anew, r starts and stops
recording, q ends; Ctrl-C ends as well. What was recorded is kept, whatever ends it.
"""
EXAMPLES = """\
examples:
  tactile live serial:/dev/ttyACM0?protocol=anyskin --view
  tactile live ws://127.0.0.1:5000 --model slip.onnx --record grasp.mcap
                                                 a file of 'tactile export': needs no PyTorch
  tactile live grasp.h5 --model grasp.predictor  a recording, as if it came now
  tactile live sim: --view                       the simulated hand (extra 'sim')
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    r"""Adds the arguments of the verb.

    Args:
        parser (argparse.ArgumentParser): The parser of the verb.
    """
    parser.add_argument("source", metavar="SOURCE", help="where the frames come from")
    parser.add_argument(
        "--model",
        metavar="PREDICTOR",
        help="a file of 'tactile predict --save', or one of 'tactile export' (.onnx)",
    )
    parser.add_argument("--record", metavar="FILE", help="record to .mcap or .h5 from the start")
    parser.add_argument("--label", metavar="LABEL", help="what the recording is an example of")
    parser.add_argument(
        "--overwrite", action="store_true", help="replace the file of --record, if there is one"
    )
    parser.add_argument("--view", action="store_true", help="show it on a page in the browser")
    parser.add_argument("--port", type=int, default=0, help="of the page (default: any free one)")
    parser.add_argument(
        "--no-browser", action="store_true", help="tell the address of the page only"
    )
    parser.add_argument(
        "--layout",
        metavar="NAME",
        help="taxels of the source: a stock layout or its file (default: the source's or model's)",
    )
    parser.add_argument(
        "--map",
        metavar="NAME",
        help="from the order of the source to that of the layout: a stock map or a JSON file",
    )
    parser.add_argument(
        "--tare",
        action="store_true",
        help="subtract the rest from what the model gets, if it was trained on tared recordings",
    )
    parser.add_argument(
        "--rest",
        metavar="SECONDS",
        type=seconds,
        default=1.0,
        help="how long the sensor must be still for its rest (default: 1)",
    )
    parser.add_argument(
        "--policy",
        choices=("newest", "all"),
        help="which frames are judged (default: the newest; a model of windows sees those between)",
    )
    parser.add_argument("--seconds", metavar="S", type=seconds, help="end after so long")


def run(arguments: argparse.Namespace) -> int:
    r"""Runs the verb and returns the exit status.

    Args:
        arguments (argparse.Namespace): The arguments.
    """
    from torch_geometric_tactile.commands.keys import keys_heeded
    from torch_geometric_tactile.commands.status_line import StatusLine

    if arguments.label is not None and arguments.record is None:
        raise ValueError("'--label' is for a recording: give '--record FILE' as well")
    if arguments.tare and arguments.model is None:
        raise ValueError("'--tare' is for what the model gets: give '--model PREDICTOR' as well")
    session = _session(arguments)
    with StatusLine() as line:

        def toggle() -> None:
            path = session.toggle_recording()
            line.tell(f"{'wrote' if session.recorder is None else 'recording'} {path}")

        def show(status: "Status") -> None:
            heed()
            line.show(status.line())

        keys = {"t": session.tare, "r": toggle, "q": session.stop}
        with keys_heeded(keys) as heed, closing(session):
            url = session.view(port=arguments.port) if arguments.view else None
            if url is not None:
                line.tell(f"the page is at {url}")
            if arguments.record is not None:
                session.record(arguments.record, arguments.label, arguments.overwrite)
            session.open()
            if url is not None and not arguments.no_browser:
                webbrowser.open(url)
            with suppress(KeyboardInterrupt):  # the usual end of a live source
                session.run(arguments.seconds, show)
            frames = session.stream.health().frames
            path = session.stop_recording()
        line.tell(f"{frames} frames, {session.judged} judged")
        if path is not None:
            line.tell(f"wrote {path}")
    return 0


def _session(arguments: argparse.Namespace) -> "LiveSession":
    from torch_geometric_tactile.live import (
        Judge,
        LiveSession,
        Rest,
        TaxelMap,
        open_source,
    )

    source = open_source(arguments.source)
    rest = Rest(arguments.rest)
    judge = None if arguments.model is None else Judge(arguments.model, rest)
    return LiveSession(
        source,
        judge=judge,
        rest=rest,
        tare=arguments.tare,
        taxel_map=None if arguments.map is None else TaxelMap.load(arguments.map),
        layout=arguments.layout or _layout_of(judge, arguments),
        policy=arguments.policy,
    )


def _layout_of(judge: "Judge | None", arguments: argparse.Namespace) -> "TaxelLayout | None":
    # Of the model, for what shows taxels in space; a robot without PyTorch goes without.
    if judge is None or not (arguments.view or arguments.record):
        return None
    with suppress(ImportError, OSError, ValueError):
        from torch_geometric_tactile.sensors import as_layout

        return as_layout(judge.info["layout"])
    return None
