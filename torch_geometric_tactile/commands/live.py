r"""``tactile live``: runs a model on a live sensor, and records and shows its frames."""

import argparse
import webbrowser
from contextlib import closing, suppress
from typing import TYPE_CHECKING

from torch_geometric_tactile.commands._arguments import (
    CONTACT,
    LABELS,
    MAP,
    SOURCE,
    contact_rule,
    port,
    seconds,
    taxel_map,
)
from torch_geometric_tactile.commands._paths import input_path, input_source, recording_file

if TYPE_CHECKING:
    from torch_geometric_tactile.live import Judge, LiveSession, Status
    from torch_geometric_tactile.sensors import TaxelLayout

HELP = "Run a model on a live sensor, and record and show it"
DESCRIPTION = """\
Reads a sensor, runs a model on its frames, and shows the state on one line: frames per
second, lost frames, the prediction and its latency. All frames are recorded; the model and
the viewer always get the newest frame, so they never lag. A model trained on tared readings
first waits until the sensor has been still for a second (--rest); --contact does the same. A
lost port or connection is reopened. Recorded frames are kept, however the command ends.

Keys: t measures the reading at rest again, r starts and stops recording, m marks this moment
in the recording, 1 to 9 start and end an annotation in it (--labels), q or Ctrl-C quits.
"""
EXAMPLES = f"""\
{SOURCE}
examples:
  tactile live "serial:/dev/ttyACM0?protocol=anyskin" --view
  tactile live ws://127.0.0.1:5000 --model slip.onnx --record grasp.mcap
                                                 an exported model: needs no PyTorch
  tactile live grasp.h5 --model grasp.predictor  a recording, replayed as if live
  tactile live grasp.h5 --model simulated_hand_shape --rest 0.5
                                                 a trained model of the package
  tactile live "serial:/dev/ttyACM0?protocol=anyskin" --model slip.onnx --contact
                                                 "no contact" while nothing is touched
  tactile live sim: --record grasp.mcap --labels open,slip,hold
                                                 key 2 starts and ends the annotation 'slip'
  tactile live sim: --view                       the simulated hand
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    r"""Adds the arguments of the command to a parser."""
    parser.add_argument(
        "source",
        metavar="SOURCE",
        type=input_source,
        help="a sensor or a recording; see below",
    )
    model = parser.add_argument_group("model")
    model.add_argument(
        "--model",
        metavar="FILE",
        type=input_path,
        help="an .onnx file from 'tactile export', a predictor from 'tactile predict --save', a "
        "checkpoint, or the name of a predictor in docs/pretrained.md; all contain the scaling of "
        "the readings",
    )
    recording = parser.add_argument_group("recording")
    recording.add_argument(
        "--record",
        metavar="FILE",
        type=recording_file("--record"),
        help="record to this .mcap or .h5 file",
    )
    recording.add_argument("--label", metavar="LABEL", type=str, help="label of the recording")
    recording.add_argument("--labels", **LABELS)
    recording.add_argument("--overwrite", action="store_true", help="replace an existing file")
    page = parser.add_argument_group("page in the browser")
    page.add_argument("--view", action="store_true", help="show the readings in the browser")
    page.add_argument(
        "--port", metavar="N", type=port, default=0, help="port of the page (default: any free one)"
    )
    page.add_argument(
        "--no-browser", action="store_true", help="only print the address of the page"
    )
    parser.add_argument(
        "--layout",
        metavar="LAYOUT",
        type=input_path,
        help="order and positions of the taxels: a stock layout or a layout file (default: the "
        "layout of the source or the model)",
    )
    parser.add_argument("--map", **MAP)
    model.add_argument(
        "--tare",
        action="store_true",
        help="subtract the reading at rest, for a model trained on tared recordings",
    )
    model.add_argument(
        "--contact",
        **CONTACT,
        help='say "no contact" while no two taxels differ from their reading at rest by more than '
        "THRESHOLD, in the unit of the readings (default: 6 times their noise at rest)",
    )
    model.add_argument(
        "--rest",
        metavar="SECONDS",
        type=seconds,
        help="how long the sensor must be still to measure its reading at rest (default: as in "
        "the training of the model, or 1)",
    )
    model.add_argument(
        "--policy",
        choices=("newest", "all"),
        help="frames passed to the model (default: newest, or all for models that read windows)",
    )
    parser.add_argument(
        "--seconds",
        metavar="S",
        type=seconds,
        help="time to run after the first frame, and the longest time to wait for the first frame",
    )


def run(arguments: argparse.Namespace) -> int:
    r"""Runs the command and returns the exit status."""
    from torch_geometric_tactile._interrupts import termination_as_interrupt
    from torch_geometric_tactile.commands._keys import key_bindings, label_keys, mark
    from torch_geometric_tactile.commands._status_line import StatusLine

    if arguments.label is not None and arguments.record is None:
        raise ValueError("'--label' must come with '--record FILE' (got no file)")
    if arguments.tare and arguments.model is None:
        raise ValueError("'--tare' must come with '--model FILE' (got no model)")
    if arguments.contact is not None and arguments.model is None:
        raise ValueError("'--contact' must come with '--model FILE' (got no model)")
    session = _open_session(arguments)
    with StatusLine() as line:

        def toggle_recording() -> None:
            path = session.toggle_recording()
            line.write(f"{'wrote' if session.recorder is None else 'recording'} {path}")

        def show_status(status: "Status") -> None:
            handle_keys()
            line.show(status.line())

        actions = {
            "t": session.tare,
            "r": toggle_recording,
            "m": lambda: mark(session.recorder, line),
            "q": session.stop,
            **label_keys(arguments.labels, lambda: session.recorder, line),
        }
        with termination_as_interrupt(), key_bindings(actions) as handle_keys, closing(session):
            url = session.view(port=arguments.port) if arguments.view else None
            if url is not None:
                line.write(f"page: {url}")
            if arguments.record is not None:
                session.record(
                    arguments.record, arguments.label, arguments.overwrite, arguments.seconds
                )
            session.open()
            if url is not None and not arguments.no_browser:
                webbrowser.open(url)
            with suppress(KeyboardInterrupt):  # Ctrl-C is the usual way to end
                session.run(arguments.seconds, show_status)
            session.stream.require_frames()
            session.stream.close()
            health = session.stream.health()
            path = session.stop_recording()
        line.write(f"{health.frames} frames, {session.judged} judged, {health.losses()}")
        if path is not None:
            line.write(f"wrote {path}")
    return 0


def _open_session(arguments: argparse.Namespace) -> "LiveSession":
    from torch_geometric_tactile.live import Judge, LiveSession, Rest, open_source

    source = open_source(arguments.source)
    rest = Rest(1.0 if arguments.rest is None else arguments.rest)
    rule = contact_rule(arguments.contact)
    judge = None if arguments.model is None else Judge(arguments.model, rest, contact=rule)
    # By default, rest is measured for as long as in the training of the model.
    if judge is not None and arguments.rest is None and judge.frame_info.rest is not None:
        rest.seconds = judge.frame_info.rest
    return LiveSession(
        source,
        judge=judge,
        rest=rest,
        tare=arguments.tare,
        taxel_map=taxel_map(arguments.map),
        layout=arguments.layout or _model_layout(judge, arguments),
        policy=arguments.policy,
    )


def _model_layout(judge: "Judge | None", arguments: argparse.Namespace) -> "TaxelLayout | None":
    # The layout of the model, to show taxels in space; None on a robot without PyTorch.
    if judge is None or not (arguments.view or arguments.record):
        return None
    # A layout only improves the picture: without one, taxels are drawn in a grid.
    with suppress(ImportError, OSError, ValueError):
        from torch_geometric_tactile.sensors import TaxelLayout, as_layout

        content = judge.info.get("layout_content")  # absent in files of version 0.2.0
        return (
            as_layout(judge.info["layout"]) if content is None else TaxelLayout.from_dict(content)
        )
    return None
