r"""``tactile convert``: writes a recording in another format, or recordings as a data set."""

import argparse
from pathlib import Path
from typing import Any

from torch_geometric_tactile.commands._arguments import READABLE, hertz
from torch_geometric_tactile.commands._paths import OutputPath, input_path, recording_file
from torch_geometric_tactile.commands._reading import add_reading_options, reading_options
from torch_geometric_tactile.commands._runs import option_names_in_errors

_LEROBOT_SUFFIX = ".lerobot"
_DEFAULT_FPS = 30
_LEROBOT_OPTIONS = (
    "fps",
    "every_frame",
    "nearest",
    "task",
    "robot_type",
    "add_to",
    "start",
    "gaps",
    "max_gap",
    "key",
    "fill",
)
_WRITABLE = ".h5, .hdf5, .npz, .mcap, .csv, .jsonl, .ndjson"
HELP = "Convert a recording to another format"
DESCRIPTION = """\
Reads a recording and writes it in another format; the suffixes select the formats. A
warning names all content that the new format cannot hold. If OUT ends in .lerobot, a LeRobot
data set is written: IN may then be several recordings or folders of recordings, and each
recording becomes an episode. `tactile convert bigs IN... OUT_DIR` imports grasps of the BiGS
data set and has its own options: `tactile convert bigs --help`.
"""
EXAMPLES = """\
examples:
  tactile convert messages.jsonl recording.h5    messages of XELA's server to HDF5
  tactile convert log.csv recording.npz --forces
  tactile convert glove.csv recording.h5 --tactile 'pad_.*' --joint bend_1 --joint bend_2 \\
      --label grasp --unit count                 a CSV file with your own column names
  tactile convert numbers.csv recording.h5 --num-taxels 24 --num-joints 0
                                                 a CSV file without column names
  tactile convert grasps/ grasps.lerobot --fps 30 --every-frame
                                                 recordings as a LeRobot data set
  tactile convert skin_*.h5 touch.lerobot --add-to datasets/cups
                                                 the same, added to a copy of a data set
  tactile convert grasps/ grasps.lerobot --key observation.environment_state --fill 0
                                                 touch that ACT and diffusion policies read
  tactile convert bigs grasps/*.h5 bigs/         grasps of the BiGS data set
"""
# First arguments that select another parser, with the module of the parser.
KINDS = {"bigs": "_convert_bigs"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    r"""Adds the arguments of the command to a parser."""
    parser.add_argument(
        "source",
        metavar="IN",
        nargs="+",
        type=input_path,
        help=f"the recording ({READABLE})",
    )
    parser.add_argument(
        "target",
        metavar="OUT",
        type=_parse_target,
        help=f"the file to write ({_WRITABLE}), or a folder (.lerobot)",
    )
    add_reading_options(parser)
    _add_lerobot_options(parser)


def _parse_target(text: str) -> OutputPath:
    path = recording_file("OUT")(text)
    is_folder = Path(path).suffix.lower() == _LEROBOT_SUFFIX
    return OutputPath(path, path.argument, None) if is_folder else path


def run(arguments: argparse.Namespace) -> int:
    r"""Runs the command and returns the exit status."""
    with option_names_in_errors(arguments):
        return _run(arguments)


def _run(arguments: argparse.Namespace) -> int:
    from torch_geometric_tactile.io import read_recording, write_recording

    if Path(arguments.target).suffix.lower() == _LEROBOT_SUFFIX:
        return _convert_to_lerobot(arguments)
    option_names = [*_lerobot_options(arguments)]
    if option_names:
        raise ValueError(
            f"'OUT' must end in {_LEROBOT_SUFFIX} with "
            f"'--{option_names[0].replace('_', '-')}' (got '{arguments.target}')"
        )
    if len(arguments.source) > 1:
        raise ValueError(
            f"'IN' must be one recording unless 'OUT' ends in {_LEROBOT_SUFFIX} "
            f"(got {len(arguments.source)})"
        )
    recording = read_recording(arguments.source[0], **reading_options(arguments))
    write_recording(recording, arguments.target)
    print(f"{arguments.target}: {recording}")
    return 0


def _add_lerobot_options(parser: argparse.ArgumentParser) -> None:
    r"""Adds the options of LeRobot data sets to a parser."""
    options = parser.add_argument_group("LeRobot data sets (OUT ends in .lerobot)")
    options.add_argument(
        "--fps",
        type=hertz,
        metavar="N",
        help=f"steps per second, such as 30 or 29.97 (default: {_DEFAULT_FPS})",
    )
    options.add_argument(
        "--every-frame",
        action="store_true",
        default=None,
        help="also keep all frames since the previous step, for sensors faster than the steps",
    )
    options.add_argument(
        "--nearest",
        action="store_true",
        default=None,
        help="use the frame nearest to each step (default: the last frame before the step)",
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
        "--key",
        metavar="FEATURE",
        type=str,
        help="feature for the readings: observation.environment_state, observation.state (joined "
        "to the joint angles) or another name (default: observation.tactile, which no policy of "
        "LeRobot reads)",
    )
    options.add_argument(
        "--fill",
        type=float,
        metavar="NUMBER",
        help="number that replaces missing readings (default: NaN, which makes the loss of a "
        "policy NaN)",
    )
    options.add_argument(
        "--task",
        metavar="TEXT",
        type=str,
        help="task of all episodes (default: the label of each recording)",
    )
    options.add_argument("--robot-type", metavar="NAME", type=str, help="name of the robot")
    options.add_argument(
        "--add-to",
        metavar="DATASET",
        type=input_path,
        help="add the tactile readings to a copy of this LeRobot data set: give one recording per "
        "episode, in the order of the episodes",
    )
    options.add_argument(
        "--start",
        action="append",
        type=float,
        metavar="SECONDS",
        help="with --add-to: start of an episode on the clock of its recording; repeat it for each "
        "episode (default: the first frame)",
    )


def _lerobot_options(arguments: argparse.Namespace) -> dict[str, Any]:
    r"""Returns the LeRobot options present on the command line, by name."""
    options = {name: getattr(arguments, name) for name in _LEROBOT_OPTIONS}
    return {name: value for name, value in options.items() if value is not None}


def _convert_to_lerobot(arguments: argparse.Namespace) -> int:
    r"""Writes the data set and returns the exit status."""
    from torch_geometric_tactile.io import add_to_lerobot, read_recording, write_lerobot

    options = _lerobot_options(arguments)
    source = options.pop("add_to", None)
    shared_options = {"every_frame", "gaps", "max_gap", "key", "fill"}
    allowed = shared_options | {"start"} if source else {*_LEROBOT_OPTIONS} - {"start"}
    misplaced = next((name for name in options if name not in allowed), None)
    if misplaced is not None:
        requirement = "not be given with" if source else "be given with"
        raise ValueError(
            f"'--{misplaced.replace('_', '-')}' must {requirement} '--add-to' "
            f"(got {options[misplaced]})"
        )
    reading = reading_options(arguments)
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
        options.setdefault("fps", _DEFAULT_FPS)
        write_lerobot(recordings, arguments.target, **options)
        remark = f"{options['fps']:g} steps per second"
    print(f"{arguments.target}: {len(recordings)} episodes, {remark}")
    return 0


def _recording_files(sources: list[str]) -> list[Path]:
    from torch_geometric_tactile.io._folder_recordings import RECORDING_SUFFIXES, list_recordings

    files: list[Path] = []
    for source in map(Path, sources):
        entries = list_recordings(source) if source.is_dir() else []
        if source.is_dir() and not entries:
            suffixes = ", ".join(RECORDING_SUFFIXES)
            raise ValueError(f"'{source}' must hold recordings with one of {suffixes} (got none)")
        files += entries or [source]
    return files
