r"""``tactile record``: writes the frames of a source to a file."""

import argparse
from typing import TYPE_CHECKING

from torch_geometric_tactile.commands._arguments import LABELS, MAP, SOURCE, seconds, taxel_map
from torch_geometric_tactile.commands._paths import input_path, input_source, recording_file

if TYPE_CHECKING:
    from torch_geometric_tactile.live import Recorder
    from torch_geometric_tactile.sensors import TaxelLayout

_UPDATE_SECONDS = 0.1
HELP = "Record a sensor to a file"
DESCRIPTION = """\
Writes every frame of a sensor to FILE until Ctrl-C, or for --seconds. An .mcap file is handed
to the operating system every quarter of a second: a crash of the program loses at most a
quarter of a second, and a power cut a few seconds. An interrupted file is still readable;
'tactile replay FILE --repair OUT' repairs it.

An .h5 file, such as grasp.h5, is written at the end and holds only frames, events and
annotations. Until then the frames are in grasp.mcap; after a crash, convert them with
'tactile convert grasp.mcap grasp.h5'. If no frame arrives for five frame periods and at least
50 ms, the file gets an annotation 'gap'.

Keys: m marks this moment in the file, 1 to 9 start and end an annotation in it (--labels),
q or Ctrl-C ends the recording.
"""
EXAMPLES = f"""\
{SOURCE}
examples:
  tactile record "serial:/dev/ttyACM0?protocol=anyskin" mug.mcap --label mug
  tactile record "serial:/dev/ttyACM0?protocol=lines&time=ms" mug.mcap
                                                 lines of numbers; the first is the time in ms
  tactile record ws://127.0.0.1:5000 grasp.mcap --layout allegro_uskin_368 --seconds 30
                                                 an Allegro hand, in the order of the layout,
                                                 with taxel positions for Foxglove
  tactile record sim: grasp.h5 --labels open,slip,hold
                                                 key 2 starts and ends the annotation 'slip'
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    r"""Adds the arguments of the command to a parser."""
    parser.add_argument(
        "source",
        metavar="SOURCE",
        type=input_source,
        help="a sensor or a recording; see below",
    )
    parser.add_argument(
        "file",
        metavar="FILE",
        type=recording_file("FILE"),
        help="the file to write (.mcap, .h5 or .hdf5)",
    )
    parser.add_argument("--label", metavar="LABEL", type=str, help="label of the recording")
    parser.add_argument(
        "--seconds",
        metavar="S",
        type=seconds,
        help="time to record after the first frame, and the longest time to wait for the first "
        "frame",
    )
    parser.add_argument(
        "--layout",
        metavar="LAYOUT",
        type=input_path,
        help="order and positions of the taxels, for models and viewers: a stock layout or a "
        "layout file",
    )
    parser.add_argument("--map", **MAP)
    parser.add_argument("--labels", **LABELS)
    parser.add_argument("--overwrite", action="store_true", help="replace an existing file")


def run(arguments: argparse.Namespace) -> int:
    r"""Runs the command and returns the exit status."""
    from torch_geometric_tactile._interrupts import termination_as_interrupt
    from torch_geometric_tactile._texts import printable
    from torch_geometric_tactile.live import Recorder, Stream, open_source

    layout, order = _load_layout(arguments.layout), taxel_map(arguments.map)
    stream = Stream(
        open_source(arguments.source),
        taxel_map=None if order == "none" else order,
        layout=None if order == "none" else layout,
    )
    recorder = Recorder(
        arguments.file,
        stream,
        layout=layout,
        label=arguments.label,
        overwrite=arguments.overwrite,
        max_seconds=arguments.seconds,
    )
    with termination_as_interrupt():
        recorder.start()
        try:
            with stream:
                _wait_until_end(recorder, arguments.seconds, arguments.labels)
        except KeyboardInterrupt:
            pass  # Ctrl-C is the usual way to end a recording
        finally:
            stream.close()
            recorder.close()
    stream.require_frames()
    print(
        f"{printable(arguments.file)}: {recorder.frames} frames in {recorder.seconds:.2f} s, "
        f"{stream.health().losses()}"
    )
    return 0


def _load_layout(name: str | None) -> "TaxelLayout | None":
    if name is None:
        return None
    from torch_geometric_tactile.sensors import as_layout

    return as_layout(name)


def _wait_until_end(recorder: "Recorder", seconds: float | None, labels: list[str] | None) -> None:
    import threading
    import time

    from torch_geometric_tactile.commands._keys import key_bindings, label_keys, mark
    from torch_geometric_tactile.commands._status_line import StatusLine
    from torch_geometric_tactile.live.recorder import LATE_SECONDS

    stream, quit_pressed, line = recorder.stream, threading.Event(), StatusLine()
    actions = {
        "m": lambda: mark(recorder, line),
        "q": quit_pressed.set,
        **label_keys(labels, lambda: recorder, line),
    }
    with line, key_bindings(actions) as handle_keys:
        while recorder.error is None and stream.state not in ("ended", "closed"):
            handle_keys()
            # The last frames are still on their way when the time is over.
            grace_seconds = LATE_SECONDS if recorder.frames else 0.0
            is_over = seconds is not None and stream.seconds >= seconds + grace_seconds
            if quit_pressed.is_set() or is_over or recorder.is_over:
                return
            open_label = "" if recorder.annotation is None else f"[{recorder.annotation}]  "
            line.show(f"{open_label}{recorder.frames} frames, {stream.health().line()}")
            time.sleep(_UPDATE_SECONDS)
