r"""``tactile convert RECORDINGS x.lerobot``: recordings as a LeRobot data set."""

import argparse
from pathlib import Path
from typing import Any

from torch_geometric_tactile.commands._arguments import positive
from torch_geometric_tactile.commands._paths import input_path

SUFFIX = ".lerobot"
_FPS = 30
_IN_FOLDERS = (".h5", ".hdf5", ".npz", ".mcap", ".csv", ".jsonl", ".ndjson")
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
        help="what steps in a gap without frames are: NaN, or an error (default: nan)",
    )
    options.add_argument(
        "--max-gap",
        type=float,
        metavar="SECONDS",
        help="the longest time without frames that is no gap (default: five frames)",
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
        help="add the touch to a copy of this LeRobot data set: one recording for each episode, in "
        "their order",
    )
    options.add_argument(
        "--start",
        action="append",
        type=float,
        metavar="SECONDS",
        help="with --add-to: when the episode starts by the clock of its recording; once for each "
        "(default: the first frame)",
    )


def lerobot_options(arguments: argparse.Namespace) -> dict[str, Any]:
    r"""Returns the options that were given, by name."""
    given = {name: getattr(arguments, name) for name in _OPTIONS}
    return {name: value for name, value in given.items() if value is not None}


def run(arguments: argparse.Namespace, reading: dict[str, Any]) -> int:
    r"""Writes the data set and returns the exit status."""
    from torch_geometric_tactile.io import add_to_lerobot, read_recording, write_lerobot

    given = lerobot_options(arguments)
    source = given.pop("add_to", None)
    both = {"every_frame", "gaps", "max_gap"}
    allowed = both | {"start"} if source else {*_OPTIONS} - {"start"}
    wrong = next((name for name in given if name not in allowed), None)
    if wrong is not None:
        word = "not be given with" if source else "be given with"
        raise ValueError(
            f"'--{wrong.replace('_', '-')}' must {word} '--add-to' (got {given[wrong]})"
        )
    recordings = [read_recording(path, **reading) for path in _files(arguments.source)]
    if source:
        add_to_lerobot(
            source,
            recordings,
            arguments.target,
            starts=given.get("start"),
            **{name: value for name, value in given.items() if name in both},
        )
        done = f"touch added to '{source}'"
    else:
        given.setdefault("fps", _FPS)
        write_lerobot(recordings, arguments.target, **given)
        done = f"{given['fps']} steps per second"
    print(f"{arguments.target}: {len(recordings)} episodes, {done}")
    return 0


def _files(sources: list[str]) -> list[Path]:
    from torch_geometric_tactile.io._folder_tables import TABLES

    files: list[Path] = []
    for source in map(Path, sources):
        inner = sorted(source.iterdir()) if source.is_dir() else []
        inner = [p for p in inner if p.suffix.lower() in _IN_FOLDERS and p.name not in TABLES]
        if source.is_dir() and not inner:
            known = ", ".join(_IN_FOLDERS)
            raise ValueError(f"'{source}' must hold recordings with one of {known} (got none)")
        files += inner or [source]
    return files
