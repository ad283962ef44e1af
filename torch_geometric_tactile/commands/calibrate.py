r"""``tactile calibrate``: forces from readings, fitted on recordings of both."""

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
from torch_geometric_tactile.commands._runs import add_rest, options_named

if TYPE_CHECKING:
    from torch_geometric_tactile.analysis import CalibrationFit
    from torch_geometric_tactile.data import Recording

_OWN_UNIT = "unit of the file"

HELP = "Fit forces to readings"
DESCRIPTION = """\
Fits a polynomial from readings to forces that were measured beside them, by ridge regression,
and prints its error on each recording when it is fitted on the others. Degree and strength of
the ridge are chosen without the recording that is left out. At least two recordings are needed.

A frame without a measured force has NaN, or an empty cell. Forces are one or more numbers a
frame, of the whole sensor; with --per taxel, one or more of each taxel.
"""
EXAMPLES = """\
examples:
  tactile calibrate normal_force/* --force force        three runs of eFlesh's probe, the error only
  tactile calibrate day1.h5 day2.h5 --force load_cell --force-unit newton --out skin.json
  tactile calibrate *.csv --tactile 'pad_.*' --force fz --unit count --force-unit newton --degree 1
  tactile calibrate trials/*.h5 --force force --per taxel --rest 10 --out hand.json
                                         cross-axis matrices of a simulated hand, behind a tare

Calibrate.load("skin.json") in torch_geometric_tactile.transforms is the transform.
docs/calibration.md shows what it is good for, and where it ends.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    r"""Adds the arguments of the verb."""
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
        help="the signal of the measured forces in the recordings, or a column of CSV files",
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
        help="what a force is of (default: sensor)",
    )
    parser.add_argument(
        "--degree",
        metavar="N",
        type=int,
        choices=(1, 2, 3),
        help="how many channels of a taxel are multiplied, 1 to 3 (default: chosen by the error)",
    )
    parser.add_argument(
        "--force-unit",
        choices=("newton", _OWN_UNIT),
        default=_OWN_UNIT,
        help="unit of the forces (default: 'unit of the file')",
    )
    add_rest(parser)
    add_reading_options(parser)


def run(arguments: argparse.Namespace) -> int:
    r"""Runs the verb and returns the exit status."""
    with options_named(arguments):
        return _run(arguments)


def _run(arguments: argparse.Namespace) -> int:
    import torch

    from torch_geometric_tactile.analysis import fit_calibration

    paths = [Path(text) for text in arguments.recordings]
    if len({path.resolve() for path in paths}) < max(len(paths), 2):
        raise ValueError(
            "two or more different recordings must be given, since the error is measured on one "
            f"that is left out (got {short_list(arguments.recordings, 4)})"
        )
    found = _read(paths, arguments)
    force = [_force(path, one, arguments.force) for path, one in zip(paths, found, strict=True)]
    unit = found[0].meta.get("unit", _OWN_UNIT)
    fit = fit_calibration(
        torch.from_numpy(np.concatenate([_tared(one, arguments.rest) for one in found])),
        torch.from_numpy(np.concatenate(force)),
        torch.arange(len(found)).repeat_interleave(torch.tensor([one.num_frames for one in found])),
        per=arguments.per,
        degrees=(1, 2, 3) if arguments.degree is None else (arguments.degree,),
        units=(unit, arguments.force_unit),
        source=_source(paths, arguments),
    )
    print("\n".join(_described(paths, np.concatenate(force), fit)), flush=True)
    if arguments.out is not None:
        fit.calibrate.save(arguments.out)
        print(printable(f"wrote {arguments.out}"))
    return 0


def _read(paths: Sequence[Path], arguments: argparse.Namespace) -> list["Recording"]:
    from torch_geometric_tactile.data._column_order import column_names, in_column_order
    from torch_geometric_tactile.io import read_recording, recording_format

    given = reading_options(arguments)
    found: list[Recording] = []
    for path in paths:
        options = dict(given)
        if recording_format(path) == "named CSV":
            options["extra"] = [*options.get("extra", ()), arguments.force]
        recording = read_recording(path, **options)
        if found:
            recording = in_column_order(recording, column_names(found[0]))
        found.append(recording)
    kinds = [(one.num_taxels, one.num_channels, one.meta.get("unit")) for one in found]
    others = [str(p) for p, kind in zip(paths, kinds, strict=True) if kind != kinds[0]]
    if others:
        raise ValueError(
            f"all recordings must be of one sensor in one unit, of {kinds[0][0]} taxels and "
            f"{kinds[0][1]} channels in {kinds[0][2] or 'no unit'} as '{paths[0]}' (got others in "
            f"{short_list(others, 3)})"
        )
    return found


def _force(path: Path, recording: "Recording", name: str) -> np.ndarray:
    signals = {**recording.privileged, **recording.extra}
    if name not in signals:
        raise ArgumentError(
            Argument("force"),
            f" must be a signal of '{path}': {', '.join(signals) or 'it has none'} (got '{name}')",
        )
    value = signals[name]
    if value.dtype.kind not in "iuf":
        raise ArgumentError(
            Argument("force"), f" must be numbers in '{path}' (got {value.dtype} in '{name}')"
        )
    return value.astype(np.float64)


def _tared(recording: "Recording", rest: int | None) -> np.ndarray:
    if rest is None:
        return recording.tactile
    tared: np.ndarray = recording.tactile - np.nanmean(recording.tactile[:rest], axis=0)
    return tared


def _source(paths: Sequence[Path], arguments: argparse.Namespace) -> str:
    names = printable(", ".join(path.absolute().name for path in paths))
    rest = arguments.rest
    tared = f", less the mean of the first {rest} frames of each" if rest else ""
    return f"'{printable(arguments.force)}' of {len(paths)} recordings ({names}){tared}"


def _described(paths: Sequence[Path], force: np.ndarray, fit: "CalibrationFit") -> list[str]:
    calibrate, unit = fit.calibrate, fit.calibrate.units[1]
    unit = f"in {unit}s" if unit == "newton" else f"in the {unit}"
    rows = [["left out", f"RMSE {unit}", "of a deviation of", "beyond the range", "degree"]]
    values = zip(paths, fit.rmse, fit.deviation, fit.beyond, fit.degrees, strict=True)
    for path, rmse, deviation, beyond, degree in values:
        numbers = ["  ".join(f"{one:,.4g}" for one in row.tolist()) for row in (rmse, deviation)]
        rows.append(
            [printable(path.absolute().name), *numbers, f"{float(beyond):.1%}", str(degree)]
        )
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = [
        "  ".join([row[0].ljust(widths[0]), *map(str.rjust, row[1:], widths[1:])]) for row in rows
    ]
    low, high = calibrate.low, calibrate.high
    assert low is not None
    assert high is not None
    ends = zip(low.amin(0).tolist(), high.amax(0).tolist(), strict=True)
    return [
        *lines,
        f"fitted on all: {fit.num_forces:,} forces from {np.nanmin(force):,.4g} to "
        f"{np.nanmax(force):,.4g}, degree {calibrate.degree}, ridge of strength "
        f"{fit.strength:g}",
        "range of the readings, beyond which forces go on in a straight line: "
        + ", ".join(f"channel {i} {a:,.5g} to {b:,.5g}" for i, (a, b) in enumerate(ends)),
    ]
