r"""``tactile calibrate``: fits a map from readings to forces on recordings that contain both."""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from torch_geometric_tactile._checks import Argument, ArgumentError
from torch_geometric_tactile._texts import printable, short_list
from torch_geometric_tactile.commands._arguments import READABLE
from torch_geometric_tactile.commands._file_kinds import CALIBRATION
from torch_geometric_tactile.commands._paths import OutputFile, input_path
from torch_geometric_tactile.commands._reading import add_reading_options, reading_options
from torch_geometric_tactile.commands._runs import add_rest, option_names_in_errors

if TYPE_CHECKING:
    from torch_geometric_tactile.analysis import CalibrationFit
    from torch_geometric_tactile.data import Recording

_FILE_UNIT = "unit of the file"

HELP = "Fit a calibration from readings to forces"
DESCRIPTION = """\
Fits a polynomial from readings to forces measured in the same frames, by ridge regression. Holds
out each recording once, fits to the others, and prints the error on the held-out recording. The
degree and the ridge strength are selected without the held-out recording. At least two recordings
are needed.

A frame without a measured force has NaN, or an empty cell. Forces are one or more numbers per
frame for the whole sensor or, with --per taxel, for each taxel.
"""
EXAMPLES = """\
examples:
  tactile calibrate normal_force/* --force force        the error on three runs of eFlesh's probe
  tactile calibrate day1.h5 day2.h5 --force load_cell --force-unit newton --out skin.json
  tactile calibrate *.csv --tactile 'pad_.*' --force fz --unit count --force-unit newton --degree 1
  tactile calibrate trials/*.h5 --force force --per taxel --rest 10 --out hand.json
                                         cross-axis matrices of a simulated hand, after a tare

Calibrate.load("skin.json") in torch_geometric_tactile.transforms loads the transform.
docs/calibration.md shows its accuracy and its limits.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    r"""Adds the arguments of the command to a parser."""
    parser.add_argument(
        "recordings",
        metavar="RECORDING",
        type=input_path,
        nargs="+",
        help=f"a recording ({READABLE}), or the folder of a run of eFlesh's probe",
    )
    parser.add_argument(
        "--force",
        metavar="NAME",
        type=str,
        required=True,
        help="name of the measured forces: a signal of the recordings, or a column of CSV files",
    )
    parser.add_argument(
        "--out",
        metavar="JSON",
        type=OutputFile("--out", CALIBRATION),
        help="the calibration to write",
    )
    parser.add_argument(
        "--per",
        choices=("sensor", "taxel"),
        default="sensor",
        help="whether forces are measured for the whole sensor or for each taxel (default: sensor)",
    )
    parser.add_argument(
        "--degree",
        metavar="N",
        type=int,
        choices=(1, 2, 3),
        help="degree of the polynomial in the channels of a taxel, 1 to 3 (default: the degree "
        "with the smallest error)",
    )
    parser.add_argument(
        "--force-unit",
        choices=("newton", _FILE_UNIT),
        default=_FILE_UNIT,
        help="unit of the forces (default: 'unit of the file')",
    )
    add_rest(parser)
    add_reading_options(parser)


def run(arguments: argparse.Namespace) -> int:
    r"""Runs the command and returns the exit status."""
    with option_names_in_errors(arguments):
        return _run(arguments)


def _run(arguments: argparse.Namespace) -> int:
    import torch

    from torch_geometric_tactile.analysis import fit_calibration

    paths = [Path(text) for text in arguments.recordings]
    if len({path.resolve() for path in paths}) < max(len(paths), 2):
        raise ValueError(
            "two or more different recordings must be given, because each is held out once to "
            f"measure the error (got {short_list(arguments.recordings, 4)})"
        )
    recordings = _read_recordings(paths, arguments)
    forces = [
        _measured_force(path, recording, arguments.force)
        for path, recording in zip(paths, recordings, strict=True)
    ]
    unit = recordings[0].meta.get("unit", _FILE_UNIT)
    num_frames = torch.tensor([recording.num_frames for recording in recordings])
    fit = fit_calibration(
        torch.from_numpy(
            np.concatenate([_tared_readings(recording, arguments.rest) for recording in recordings])
        ),
        torch.from_numpy(np.concatenate(forces)),
        torch.arange(len(recordings)).repeat_interleave(num_frames),  # groups to hold out
        per=arguments.per,
        degrees=(1, 2, 3) if arguments.degree is None else (arguments.degree,),
        units=(unit, arguments.force_unit),
        source=_describe_source(paths, arguments),
    )
    print("\n".join(_summary_lines(paths, np.concatenate(forces), fit)), flush=True)
    if arguments.out is not None:
        fit.calibrate.save(arguments.out)
        print(printable(f"wrote {arguments.out}"))
    return 0


def _read_recordings(paths: Sequence[Path], arguments: argparse.Namespace) -> list["Recording"]:
    from torch_geometric_tactile.data._column_order import column_names, in_column_order
    from torch_geometric_tactile.io import read_recording
    from torch_geometric_tactile.io.recording_files import recording_format

    common_options = reading_options(arguments)
    recordings: list[Recording] = []
    for path in paths:
        options = dict(common_options)
        if recording_format(path) == "named CSV":
            # Otherwise the force column would be read as a column of readings.
            options["extra"] = [*options.get("extra", ()), arguments.force]
        recording = read_recording(path, **options)
        if recordings:
            recording = in_column_order(recording, column_names(recordings[0]))
        recordings.append(recording)
    sizes = [
        (recording.num_taxels, recording.num_channels, recording.meta.get("unit"))
        for recording in recordings
    ]
    mismatched = [str(path) for path, size in zip(paths, sizes, strict=True) if size != sizes[0]]
    if mismatched:
        raise ValueError(
            f"all recordings must be from one sensor in one unit: {sizes[0][0]} taxels and "
            f"{sizes[0][1]} channels in {sizes[0][2] or 'no unit'}, as in '{paths[0]}' (got "
            f"different ones in {short_list(mismatched, 3)})"
        )
    return recordings


def _measured_force(path: Path, recording: "Recording", name: str) -> np.ndarray:
    signals = {**recording.privileged, **recording.extra}
    if name not in signals:
        raise ArgumentError(
            Argument("force"),
            f" must be a signal of '{path}': {', '.join(signals) or 'it has none'} (got '{name}')",
        )
    force = signals[name]
    if force.dtype.kind not in "iuf":
        raise ArgumentError(
            Argument("force"), f" must be numbers in '{path}' (got {force.dtype} in '{name}')"
        )
    return force.astype(np.float64)


def _tared_readings(recording: "Recording", num_rest_frames: int | None) -> np.ndarray:
    if num_rest_frames is None:
        return recording.tactile
    rest = np.nanmean(recording.tactile[:num_rest_frames], axis=0)
    tared: np.ndarray = recording.tactile - rest
    return tared


def _describe_source(paths: Sequence[Path], arguments: argparse.Namespace) -> str:
    names = printable(", ".join(path.absolute().name for path in paths))
    rest = arguments.rest
    tare = f", less the mean of the first {rest} frames of each" if rest else ""
    return f"'{printable(arguments.force)}' of {len(paths)} recordings ({names}){tare}"


def _summary_lines(paths: Sequence[Path], force: np.ndarray, fit: "CalibrationFit") -> list[str]:
    calibrate, unit = fit.calibrate, fit.calibrate.units[1]
    unit = f"in {unit}s" if unit == "newton" else f"in the {unit}"
    rows = [["held out", f"RMSE {unit}", "standard deviation", "outside the range", "degree"]]
    errors = zip(paths, fit.rmse, fit.deviation, fit.beyond, fit.degrees, strict=True)
    for path, rmse, deviation, beyond, degree in errors:
        numbers = [
            "  ".join(f"{number:,.4g}" for number in row.tolist()) for row in (rmse, deviation)
        ]
        rows.append(
            [printable(path.absolute().name), *numbers, f"{float(beyond):.1%}", str(degree)]
        )
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = [
        "  ".join([row[0].ljust(widths[0]), *map(str.rjust, row[1:], widths[1:])]) for row in rows
    ]
    low, high = calibrate.low, calibrate.high
    # A fitted calibration has limits.
    assert low is not None
    assert high is not None
    ranges = zip(low.amin(0).tolist(), high.amax(0).tolist(), strict=True)
    return [
        *lines,
        f"fitted to all recordings: {fit.num_forces:,} forces from {np.nanmin(force):,.4g} to "
        f"{np.nanmax(force):,.4g}, degree {calibrate.degree}, ridge of strength "
        f"{fit.strength:g}",
        "range of the readings, outside of which forces are extrapolated linearly: "
        + ", ".join(f"channel {i} {a:,.5g} to {b:,.5g}" for i, (a, b) in enumerate(ranges)),
    ]
