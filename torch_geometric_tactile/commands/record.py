r"""``tactile record``: what a source sends, into a file."""

import argparse
from typing import TYPE_CHECKING

from torch_geometric_tactile.commands._arguments import LABELS, MAP, SOURCE, seconds, taxel_map
from torch_geometric_tactile.commands._paths import input_path, input_source, recording_file

if TYPE_CHECKING:
    from torch_geometric_tactile.live import Recorder
    from torch_geometric_tactile.sensors import TaxelLayout

_SHOWN_EVERY = 0.1
HELP = "Record a sensor to a file"
DESCRIPTION = """\
Writes every frame of a sensor to FILE until Ctrl-C, or for --seconds. An .mcap file is handed
to the operating system every quarter of a second: a crash of the program loses at most that
much, a power cut also what the system had not yet written, a few seconds. Such a file can be
read, and repaired with 'tactile replay FILE --repair OUT'. An .h5 file is written at the end,
and holds frames, events and annotations only: until then grasp.h5 is grasp.mcap, which stays
after a crash for 'tactile convert grasp.mcap grasp.h5'. Where no frame comes for five periods
and at least 50 ms, the file has an annotation 'gap'.

Keys: m marks this moment in the file, 1 to 9 begin and end an annotation (--labels) in it,
q or Ctrl-C ends the recording.
"""
EXAMPLES = f"""\
{SOURCE}
examples:
  tactile record serial:/dev/ttyACM0?protocol=anyskin mug.mcap --label mug
  tactile record ws://127.0.0.1:5000 grasp.mcap --layout allegro_uskin_368 --seconds 30
                                                 an Allegro hand, in the order of the layout,
                                                 with taxel positions for Foxglove
  tactile record sim: grasp.h5 --labels open,slip,hold
                                                 key 2 begins a slip, and ends it
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    r"""Adds the arguments of the verb."""
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
        help="how long to record from the first frame, or to wait for one",
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
    r"""Runs the verb and returns the exit status."""
    from torch_geometric_tactile._interrupts import ends_heeded
    from torch_geometric_tactile._texts import printable
    from torch_geometric_tactile.live import Recorder, Stream, open_source

    layout, order = _layout(arguments.layout), taxel_map(arguments.map)
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
    with ends_heeded():
        recorder.start()
        try:
            with stream:
                _wait(recorder, arguments.seconds, arguments.labels)
        except KeyboardInterrupt:
            pass  # how a recording is ended
        finally:
            stream.close()
            recorder.close()
    stream.require_frames()
    print(
        f"{printable(arguments.file)}: {recorder.frames} frames in {recorder.seconds:.2f} s, "
        f"{stream.health().losses()}"
    )
    return 0


def _layout(name: str | None) -> "TaxelLayout | None":
    if name is None:
        return None
    from torch_geometric_tactile.sensors import as_layout

    return as_layout(name)


def _wait(recorder: "Recorder", seconds: float | None, labels: list[str] | None) -> None:
    import threading
    import time

    from torch_geometric_tactile.commands._keys import keys_heeded, label_keys, mark
    from torch_geometric_tactile.commands._status_line import StatusLine
    from torch_geometric_tactile.live.recorder import LATE_SECONDS

    stream, over, line = recorder.stream, threading.Event(), StatusLine()
    keys = {
        "m": lambda: mark(recorder, line),
        "q": over.set,
        **label_keys(labels, lambda: recorder, line),
    }
    with line, keys_heeded(keys) as heed:
        while recorder.error is None and stream.state not in ("ended", "closed"):
            heed()
            late = LATE_SECONDS if recorder.frames else 0.0  # for frames that are on the way
            is_over = seconds is not None and stream.seconds >= seconds + late
            if over.is_set() or is_over or recorder.is_over:
                return
            opened = "" if recorder.annotation is None else f"[{recorder.annotation}]  "
            line.show(f"{opened}{recorder.frames} frames, {stream.health().line()}")
            time.sleep(_SHOWN_EVERY)
