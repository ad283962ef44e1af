r"""``tactile view``: shows a source or a recording on a page in the browser."""

import argparse
import re
import time
from typing import TYPE_CHECKING, Any

from torch_geometric_tactile.commands._arguments import MAP, SOURCE, port, taxel_map
from torch_geometric_tactile.commands._paths import input_path, input_source

if TYPE_CHECKING:
    from torch_geometric_tactile.live import Source, Stream, Viewer

HELP = "Show a sensor or a recording in the browser"
DESCRIPTION = """\
Shows the readings of a sensor relative to its reading at rest: pressure as colour and shear as
arrows, on the posed hand or on a flat layout. A recording is replayed in a loop at its own speed.
The sensor should be at rest in the first second; the button of the page, or key T, measures the
rest again. To run a model or to record as well, use 'tactile live --view'. Ctrl-C quits.
"""
EXAMPLES = f"""\
{SOURCE}
examples:
  tactile view grasp.h5
  tactile view ws://127.0.0.1:5000 --layout allegro_uskin_368
  tactile view 'serial:/dev/ttyUSB0?protocol=text&shape=12x32' --layout 12x32
  tactile view sim: --port 8000 --no-browser     on a robot; on the machine with the browser:
                                                 ssh -L 8000:127.0.0.1:8000 ROBOT
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
        "--layout",
        metavar="LAYOUT",
        type=input_path,
        help="positions of the taxels: a stock layout, a layout file, or the rows and columns of a "
        "grid, such as 16x16 (default: the layout of the source, else a grid in taxel order)",
    )
    parser.add_argument("--map", **MAP)
    parser.add_argument(
        "--port", metavar="N", type=port, default=0, help="port of the page (default: any free one)"
    )
    parser.add_argument(
        "--no-browser", action="store_true", help="only print the address of the page"
    )


def run(arguments: argparse.Namespace) -> int:
    r"""Runs the command and returns the exit status."""
    from torch_geometric_tactile.live import Stream, Viewer

    layout = None if arguments.layout is None else _parse_layout(arguments.layout)
    order = taxel_map(arguments.map)
    stream = Stream(
        _open_source(arguments.source),
        taxel_map=None if order == "none" else order,
        layout=None if order == "none" else layout,
    )
    viewer = Viewer(stream, layout, port=arguments.port)
    try:
        with viewer, stream:
            print(f"{viewer.url}  (Ctrl-C quits)", flush=True)
            if not arguments.no_browser:
                import webbrowser

                webbrowser.open(viewer.url)
            _show_until_end(stream, viewer)
    except KeyboardInterrupt:
        print()
    if stream.error is not None:
        raise stream.error
    stream.require_frames()
    return 0


def _show_until_end(stream: "Stream", viewer: "Viewer") -> None:
    _measure_rest(stream, viewer)
    while stream.state != "ended":
        time.sleep(0.1)
    if stream.error is None:
        print("the source has ended", flush=True)


def _measure_rest(stream: "Stream", viewer: "Viewer") -> None:
    # The reading at rest is measured when the stream starts, even if a page opens later.
    from torch_geometric_tactile.live._viewer.page import FirstSecond

    rest = FirstSecond()
    for frame in stream:
        if rest.add(frame):
            viewer.rest = rest.value
            return


def _open_source(text: str) -> "Source":
    from torch_geometric_tactile.live import ReplaySource, open_source

    source = open_source(text)
    if isinstance(source, ReplaySource) and "loop=" not in text:  # an explicit setting wins
        source.loop = True
    return source


def _parse_layout(text: str) -> Any:
    from torch_geometric_tactile.sensors import as_layout, grid

    size = re.fullmatch(r"([0-9]{1,4})x([0-9]{1,4})", text)
    if size is None:
        return as_layout(text)
    return grid(int(size[1]), int(size[2]), pitch=0.005)
