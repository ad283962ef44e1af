r"""``tactile convert bigs``: imports grasps of the BiGS data set from the owner's files."""

import argparse
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from torch_geometric_tactile._texts import printable
from torch_geometric_tactile.commands._file_kinds import RECORDING
from torch_geometric_tactile.commands._paths import OutputFolder, OutputPath, input_path

_SUFFIXES = (".h5", ".hdf5", ".npz")
_PICKUP_WARNING = (
    "tactile: warning: {} grasps have no pick-up time, so BiGS can read only whole grasps "
    "(until=None): add --field pickup_time=NAME or --ends-after-pickup SECONDS"
)
HELP = "Convert grasps of the BiGS data set for datasets.BiGS"
DESCRIPTION = """\
Converts grasps of the BiGS data set, one HDF5 or npz file per grasp, to the form that
datasets.BiGS reads: 19 electrodes on each of three BioTac fingertips (left, middle, right)
and any other signals. No copy of the original data was available, and its format is not known.
Specify names, axis orders, units and rates; the command guesses nothing. See docs/bigs.md.

A file that fails does not stop the others. The exit status is 1 if any file failed.
"""
EXAMPLES = """\
Fields: electrodes, time, pressure, pac, robot_joint, finger_joint, wrench, object_pose, phase and
slip; single values: success, object, trial, session and pickup_time. Only electrodes,
success and object are required. Without --field, a field is read under the name listed here.

Give the axis order of an array in brackets after its name. Parentheses join axes that share
one dimension, with the fastest-varying axis last. The default orders are
  electrodes    frame electrode finger     robot_joint   frame step joint
  pressure      frame finger               finger_joint  frame step joint
  pac           frame finger step          object_pose   frame value
  wrench        frame value
with 22 PAC and 3 joint steps per frame. LEFT | MIDDLE | RIGHT joins three arrays.

examples:
  tactile convert bigs grasps/ bigs/                files with these names and orders
  tactile convert bigs grasps/*.h5 bigs/ \\
    --field 'electrodes=biotac/elec [frame (finger electrode)]' \\
    --field 'pac=biotac/pac [(frame step) finger]' \\
    --field 'robot_joint=arm/q [(frame step) joint]' --angle-unit deg \\
    --field time=biotac/stamp --time-unit us \\
    --field success=@success --field object=@object --field pickup_time=@lift
  tactile convert bigs may/*.npz bigs/ --value session=may --ends-after-pickup 2 \\
    --field 'electrodes=e_left | e_middle | e_right [frame electrode]' \\
    --pattern '(?P<object>.+)_(?P<trial>\\d+)_(?P<success>[01])'
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    r"""Adds the arguments of the command to a parser."""
    parser.add_argument(
        "sources",
        metavar="IN",
        nargs="+",
        type=input_path,
        help="files, or folders with files (.h5, .hdf5, .npz)",
    )
    parser.add_argument(
        "out", metavar="OUT_DIR", type=OutputFolder("OUT_DIR"), help="folder to write to"
    )
    parser.add_argument(
        "--npz", action="store_true", help="write npz files (no h5py needed) instead of HDF5"
    )
    names = parser.add_argument_group("names and axis orders")
    names.add_argument(
        "--field",
        action="append",
        default=[],
        metavar="OURS=THEIRS",
        type=str,
        help="name of a field in your files: 'electrodes=NAME' or 'electrodes=NAME [ORDER]'; "
        "GROUP@NAME is an HDF5 attribute",
    )
    names.add_argument(
        "--value",
        action="append",
        default=[],
        metavar="OURS=VALUE",
        type=str,
        help="a value for all files, such as 'session=may'",
    )
    names.add_argument(
        "--pattern",
        metavar="REGEX",
        type=str,
        help="regular expression for file names without suffix, with the groups object, trial, "
        "session or success (default: <object>_<trial>)",
    )
    names.add_argument(
        "--fingers",
        metavar="ORDER",
        type=str,
        help="order of the fingers in arrays with all three (default: 'left middle right')",
    )
    units = parser.add_argument_group("units and rates")
    units.add_argument(
        "--rate", metavar="HZ", type=float, help="electrode frames per second (default: 100)"
    )
    units.add_argument(
        "--rate-of",
        action="append",
        default=[],
        metavar="OURS=HZ",
        type=str,
        help="values per second of pac (default: 2200), robot_joint or finger_joint (300)",
    )
    units.add_argument(
        "--time-unit", choices=("s", "ms", "us", "ns"), help="unit of time and pickup_time"
    )
    units.add_argument(
        "--angle-unit", choices=("rad", "deg"), help="unit of joint angles (default: rad)"
    )
    units.add_argument("--length-unit", choices=("m", "mm"), help="unit of positions (default: m)")
    units.add_argument(
        "--quaternion", choices=("wxyz", "xyzw"), help="order of quaternions (default: wxyz)"
    )
    units.add_argument(
        "--ends-after-pickup",
        type=float,
        metavar="SECONDS",
        help="time from pick-up to the end of each file, for files without a pick-up time",
    )


def list_outputs(arguments: argparse.Namespace) -> list[OutputPath]:
    r"""Returns the files that the command writes."""
    suffix = ".npz" if arguments.npz else ".h5"
    targets = _target_paths(arguments.sources, _output_folder(arguments.out), suffix)
    return [OutputPath(str(path), "OUT_DIR", RECORDING) for path in targets.values()]


def run(arguments: argparse.Namespace) -> int:
    r"""Runs the command and returns the exit status."""
    from torch_geometric_tactile.io import BiGSFormat, read_bigs, write_recording

    plain = ("pattern", "fingers", "rate", "time_unit", "angle_unit", "length_unit", "quaternion")
    options = {name: getattr(arguments, name) for name in (*plain, "ends_after_pickup")}
    file_format = BiGSFormat(
        fields=_parse_pairs("--field", arguments.field),
        values=_parse_values(_parse_pairs("--value", arguments.value)),
        rates={
            key: _parse_number("--rate-of", text)
            for key, text in _parse_pairs("--rate-of", arguments.rate_of).items()
        },
        **{name: value for name, value in options.items() if value is not None},
    )
    out = _output_folder(arguments.out)
    targets = _target_paths(arguments.sources, out, ".npz" if arguments.npz else ".h5")
    num_failed = num_without_pickup = 0
    for source, target in targets.items():
        try:
            recording = read_bigs(source, file_format)
            write_recording(recording, target)
        except (MemoryError, OSError, ValueError) as error:
            # One bad file must not stop the conversion of many.
            num_failed += 1
            text = " ".join(str(error).split()) or type(error).__name__
            print(printable(f"tactile: error: {text}"), file=sys.stderr, flush=True)
        else:
            num_without_pickup += not {"pickup_time", "ends_after_pickup"} & {*recording.meta}
            print(printable(f"{target}: {recording}"), flush=True)
    print(
        printable(f"{len(targets) - num_failed} of {len(targets)} grasps are in '{arguments.out}'")
    )
    if num_without_pickup:
        print(_PICKUP_WARNING.format(num_without_pickup), file=sys.stderr)
    return 1 if num_failed else 0


def _output_folder(name: str) -> Path:
    out = Path(name)
    if out.is_file() or (out.suffix.lower() in _SUFFIXES and not out.is_dir()):
        raise ValueError(f"'OUT_DIR' must be a folder (got the file '{name}')")
    return out


def _parse_pairs(option: str, texts: Iterable[str]) -> dict[str, str]:
    pairs: dict[str, str] = {}
    for text in texts:
        key, equals, value = text.partition("=")
        if not equals or not key.strip() or not value.strip() or key.strip() in pairs:
            raise ValueError(f"'{option}' must be OURS=THEIRS, once per name (got {text!r})")
        pairs[key.strip()] = value.strip()
    return pairs


def _parse_values(texts: dict[str, str]) -> dict[str, Any]:
    return {k: _parse_number("--value", v) if k == "pickup_time" else v for k, v in texts.items()}


def _parse_number(option: str, text: str) -> float:
    try:
        return float(text)
    except ValueError as error:
        raise ValueError(f"'{option}' must have a number (got {text!r})") from error


def _target_paths(sources: Iterable[str], out: Path, suffix: str) -> dict[Path, Path]:
    r"""Returns the output file of each grasp file."""
    files: list[Path] = []
    for name in sources:
        source = Path(name)
        if not source.is_dir():
            files.append(source)
            continue
        grasp_files = sorted(p for p in source.iterdir() if p.suffix.lower() in _SUFFIXES)
        if not grasp_files:
            raise ValueError(
                f"'{source}' must hold grasps with one of {', '.join(_SUFFIXES)} (got none)"
            )
        files += grasp_files
    targets: dict[Path, Path] = {}
    sources_by_target: dict[Path, Path] = {}
    for path in files:
        target = out / f"{path.stem}{suffix}"
        first_path = sources_by_target.setdefault(target, path)
        if first_path is not path:
            raise ValueError(
                f"grasps must have different file names (got '{first_path}' and '{path}', which "
                f"would both become '{target}')"
            )
        if target.exists() and target.samefile(path):
            raise ValueError(f"'OUT_DIR' must not be the folder of '{path}'")
        targets[path] = target
    return targets
