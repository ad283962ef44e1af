r"""What live use must hold: damaged cables, lost ports, latency, kills, slow readers, memory.

The other side is a second process on a real pty, or a real WebSocket server. Figures of one run are
written as JSON; parts that are not measured keep what an earlier run found.

Examples:
    python benchmarks/live.py                                       # all but the hour: six minutes
    python benchmarks/live.py --short                               # half a minute
    python benchmarks/live.py --only label replay
    python benchmarks/live.py --only hour                           # 15 minutes, 2 GB of disk
    python benchmarks/live.py --out docs/results/live.json
"""

import argparse
import json
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from live_files import measure_cuts, measure_kills
from live_hour import measure_hour, measure_idle, measure_slow_viewers
from live_label import measure_frame, measure_label, measure_replay
from live_page import measure_page
from live_wire import measured
from predictor_onnx import build
from shared import describe_machine, parse, write_json

from torch_geometric_tactile.predictor import export_onnx

Part = Callable[[argparse.Namespace, Path], dict[str, Any]]
OPTIONS = {
    "--seconds": (60.0, "of a stream"),
    "--times": (100, "that the port is gone"),
    "--hour": (3600.0, "seconds of the long recording"),
    "--rate": (100.0, "its frames a second"),
    "--speed": (4.0, "how much faster it is replayed"),
    "--folder": (None, "for large files (default: a temporary one)"),
    "--out": (None, "JSON file of the figures"),
    "--short": (False, "only what a live frame costs, a few seconds each"),
}
SHORT = ["frame", "packets", "xela", "label"]
SHORT_SECONDS = 8.0
EPILOG = "The exit code is 0 if all that was measured holds, and 1 if not."


def _models(folder: Path) -> tuple[Any, Path]:
    torch.set_num_threads(1)
    predictor, _ = build("message")
    path = folder / "model.onnx"
    if not path.exists():
        export_onnx(predictor, path)
    return predictor, path


def _label(arguments: argparse.Namespace, folder: Path) -> dict[str, Any]:
    return measure_label(*_models(folder), seconds=arguments.seconds)


def _replay(arguments: argparse.Namespace, folder: Path) -> dict[str, Any]:
    return measure_replay(*_models(folder), seconds=arguments.seconds)


def _hour(arguments: argparse.Namespace, folder: Path) -> dict[str, Any]:
    onnx = _models(folder)[1]
    return measure_hour(onnx, folder, arguments.hour, arguments.rate, arguments.speed)


def _frame(_: argparse.Namespace, folder: Path) -> dict[str, Any]:
    return measure_frame(_models(folder)[1])


PARTS: dict[str, Part] = {
    "frame": _frame,
    "packets": lambda arguments, _: measured("packets", arguments.seconds),
    "bytes": lambda arguments, _: measured("bytes", arguments.seconds),
    "returns": lambda arguments, _: measured("returns", arguments.times),
    "xela": lambda arguments, _: measured("xela", arguments.seconds),
    "label": _label,
    "replay": _replay,
    "kills": lambda arguments, _: measure_kills(10),
    "cuts": lambda _, folder: measure_cuts(folder, 100),
    "slow viewers": lambda arguments, folder: measure_slow_viewers(folder, arguments.seconds / 3),
    "idle": lambda arguments, _: measure_idle(arguments.seconds / 3),
    "page": lambda _, folder: measure_page(folder),
    "hour": _hour,
}

# What each part must hold.
HOLDS: dict[str, Callable[[dict[str, Any]], bool]] = {
    "frame": lambda f: f["judge / model alone"] <= 1.1,
    "packets": lambda f: f["in order"] and f["missing"] == 0 and f["wrong"] == 0,
    "bytes": lambda f: f["intact delivered (%)"] >= 98,
    "returns": lambda f: (
        f["slowest return (s)"] <= 0.5 and f["missing"] == f["counted as lost"] and f["wrong"] == 0
    ),
    "xela": lambda f: (
        f["delivered"] == f["messages"] and f["in order"] and f["wrong"] == 0 and f["core (%)"] < 20
    ),
    # From the decoded frame on, back to back and beside PyTorch: benchmarks/predictor_onnx.py.
    "label": lambda f: f["onnx"]["first byte to label"]["p50 (ms)"] <= 3,
    "replay": lambda f: all(
        one["same classes"]
        and one["largest difference"] <= 1e-5
        and one["drift (ms a minute)"] < 5
        and one["times increase"]
        for one in f.values()
    ),
    "kills": lambda f: f["most lost (s)"] <= 0.3 and f["wrong frames"] == 0,
    "cuts": lambda f: f["most lost (s)"] <= 0.3 and f["wrong frames"] == 0,
    "slow viewers": lambda f: f["frames"] == f["recorded"] and f["same"],
    "idle": lambda f: True,
    "page": lambda f: (
        f["foreign requests"] == 0
        and f["foreign host"] == f["foreign origin"] == 403
        and all(one["age p50 (ms)"] < 100 for one in f.values() if isinstance(one, dict))
    ),
    "hour": lambda f: (
        f["frames"] == f["recorded"]
        and f["same"]
        and f["lost"] == 0
        and f["highest after (MB)"] - f["memory at 10 % (MB)"] <= 20
    ),
}


def main(argv: list[str] | None = None) -> int:
    quick = [name for name in PARTS if name != "hour"]
    options = {"--only": (quick, "what to measure", PARTS), **OPTIONS}
    arguments = parse(__doc__, options, argv, EPILOG)
    if arguments.short:
        arguments.only, arguments.seconds = SHORT, SHORT_SECONDS
    out = None if arguments.out is None else Path(arguments.out)
    kept = json.loads(out.read_text()) if out is not None and out.exists() else {}
    failed = []
    with tempfile.TemporaryDirectory(dir=arguments.folder) as folder:
        for name in arguments.only:
            found = PARTS[name](arguments, Path(folder))
            holds = bool(HOLDS[name](found))
            kept[name] = {**found, "holds": holds, "machine": describe_machine()}
            failed += [] if holds else [name]
            print(json.dumps({name: kept[name]}, indent=2), flush=True)
            if out is not None:
                write_json(out, kept, indent=2)
    print(f"does not hold: {', '.join(failed)}" if failed else "all of it holds")
    return int(bool(failed))


if __name__ == "__main__":
    sys.exit(main())
