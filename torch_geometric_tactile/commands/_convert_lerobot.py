r"""``tactile convert RECORDINGS x.lerobot``: writes recordings as a LeRobot data set."""

import argparse
from pathlib import Path
from typing import Any

from torch_geometric_tactile.commands._arguments import positive
from torch_geometric_tactile.commands._paths import input_path

SUFFIX = ".lerobot"
_FPS = 30
_RECORDING_SUFFIXES = (".h5", ".hdf5", ".npz", ".mcap", ".csv", ".jsonl", ".ndjson")
_OPTIONS = (
    "fps",
    "every_frame",
    "nearest",
    "task",
    "robot_type",
    "add_to",
    "start",
    "gaps",
    "max_gap",
)


def add_lerobot_options(parser: argparse.ArgumentParser) -> None:
    r"""Adds the options of LeRobot data sets."""
    options = parser.add_argument_group("LeRobot data sets (OUT ends in .lerobot)")
    options.add_argument(
        "--fps", type=positive, metavar="N", help=f"steps per second (default: {_FPS})"
    )
    options.add_argument(
        "--every-frame",
        action="store_true",
        default=None,
        help="keep all frames since the last step as well, for touch faster than the steps",
    )
    options.add_argument(
        "--nearest",
        action="store_true",
        default=None,
        help="take the nearest frame for each step (default: the last one before it)",
    )
    options.add_argument(
        "--gaps",
        choices=("nan", "error"),
        help="how to treat steps in a gap without frames: write NaN, or raise an error (default: "
        "nan)",
    )
    options.add_argument(
        "--max-gap",
        type=float,
        metavar="SECONDS",
        help="longest time without frames that does not count as a gap (default: five frames)",
    )
    options.add_argument(
        "--task",
        metavar="TEXT",
        type=str,
        help="the task of all episodes (default: the label of each)",
    )
    options.add_argument("--robot-type", metavar="NAME", type=str, help="name of the robot")
    options.add_argument(
        "--add-to",
        metavar="DATASET",
        type=input_path,
        help="add the touch to a copy of this LeRobot data set: one recording per episode, in the "
        "order of the episodes",
    )
    options.add_argument(
        "--start",
        action="append",
        type=float,
        metavar="SECONDS",
        help="with --add-to: start of an episode by the clock of its recording; repeat it for each "
        "episode (default: the first frame)",
    )


def lerobot_options(arguments: argparse.Namespace) -> dict[str, Any]:
    r"""Returns the LeRobot options present on the command line, by name."""
    options = {name: getattr(arguments, name) for name in _OPTIONS}
    return {name: value for name, value in options.items() if value is not None}


def run(arguments: argparse.Namespace, reading: dict[str, Any]) -> int:
    r"""Writes the data set and returns the exit status."""
    from torch_geometric_tactile.io import add_to_lerobot, read_recording, write_lerobot

    options = lerobot_options(arguments)
    source = options.pop("add_to", None)
    shared_options = {"every_frame", "gaps", "max_gap"}
    allowed = shared_options | {"start"} if source else {*_OPTIONS} - {"start"}
    misplaced = next((name for name in options if name not in allowed), None)
    if misplaced is not None:
        requirement = "not be given with" if source else "be given with"
        raise ValueError(
            f"'--{misplaced.replace('_', '-')}' must {requirement} '--add-to' "
            f"(got {options[misplaced]})"
        )
    recordings = [read_recording(path, **reading) for path in _recording_files(arguments.source)]
    if source:
        add_to_lerobot(
            source,
            recordings,
            arguments.target,
            starts=options.get("start"),
            **{name: value for name, value in options.items() if name in shared_options},
        )
        remark = f"touch added to '{source}'"
    else:
        options.setdefault("fps", _FPS)
        write_lerobot(recordings, arguments.target, **options)
        remark = f"{options['fps']} steps per second"
    print(f"{arguments.target}: {len(recordings)} episodes, {remark}")
    return 0


def _recording_files(sources: list[str]) -> list[Path]:
    from torch_geometric_tactile.io._folder_tables import TABLES

    files: list[Path] = []
    for source in map(Path, sources):
        entries = sorted(source.iterdir()) if source.is_dir() else []
        entries = [
            path
            for path in entries
            if path.suffix.lower() in _RECORDING_SUFFIXES and path.name not in TABLES
        ]
        if source.is_dir() and not entries:
            suffixes = ", ".join(_RECORDING_SUFFIXES)
            raise ValueError(f"'{source}' must hold recordings with one of {suffixes} (got none)")
        files += entries or [source]
    return files
