r"""``tactile simulate``: simulates grasps of a tactile hand, or presses of letters."""

import argparse
import sys
from typing import Any

from torch_geometric_tactile.commands._arguments import not_negative, small_count, trial_seconds
from torch_geometric_tactile.commands._file_kinds import PICTURE, text_kind
from torch_geometric_tactile.commands._paths import (
    OutputFolder,
    OutputPath,
    files_in_folder,
    input_path,
)

# Repeats the names in `sim`, which is too slow to import for the help.
_OBJECT_SETS = ("paper8", "control8", "twenty", "shapes")
_BIGS = "bigs"
_LETTERS = "letters"
_HANDS = ("allegro_uskin", "allegro_uskin_240")
_PRESETS = ("full", "ci")
_SPREADS = ("careful", "wide")
_MOTIONS = ("lift", "squeeze")

# Options that count the samples of the simulations without an Allegro hand.
_COUNT_OPTIONS = {_BIGS: "grasps", _LETTERS: "presses"}

HELP = "Simulate grasps of a tactile hand, or letters pressed on an array"
DESCRIPTION = """\
Simulates an Allegro hand with 384 magnetic taxels that grasps, lifts and holds objects of
different mass, stiffness and friction. Writes one HDF5 recording per trial: readings, joint
angles, properties of the object and, separately, the true forces and poses. All objects except
letters need the extra 'sim'.

objects:
  paper8     eight shapes: all combinations of light or heavy, hard or soft, slippery or not
  control8   the same combinations in one shape and size
  twenty     five shapes in four sizes
  shapes     spheres, cylinders, boxes and ellipsoids of random size, mass and friction
  bigs       a cylinder, a box and a ball, lifted and shaken by three BioTac-like fingertips;
             failed grasps are kept, as in the BiGS data set
  letters    stamps of A to Z pressed on an array of 32 x 32 pixels; writes a folder of .npy
             files in kPa for each letter, which the data set LetterShape reads
"""
EXAMPLES = """\
examples:
  tactile simulate --out grasps                          80 trials of 17 s of eight objects
  tactile simulate --out small --preset ci --preview     24 short and coarse trials in a minute
  tactile simulate --out control --objects control8      objects of one shape and size
  tactile simulate --out wide --objects shapes --num-objects 40 --trials 10 \\
    --spread wide --seconds 5                            400 short, varied trials
  tactile simulate --out twenty --objects twenty --motion squeeze --trials 30 \\
    --spread wide --seconds 10                           600 trials of twenty objects, squeezed
                                                         in place
  tactile simulate --out bigs --objects bigs             2000 grasps that hold or slip, 6 s each:
                                                         375 MB, ten minutes on two cores
  tactile simulate --out few --objects bigs --grasps 40 --preview
                                                         the first 40 grasps, and a plot
  tactile simulate --out letters --objects letters --preview
                                                         13000 presses, 500 of each letter: 53 MB,
                                                         a minute on two cores, and a plot
  tactile simulate --out some --objects letters --presses 20 --seed 1
                                                         520 different presses
  tactile simulate --out hexagonal --objects letters --layout hexagonal.json
                                                         the same letters on another array

Finished trials are kept: the same command resumes an interrupted run, or adds --preview to a
finished one. The same seed gives the same recordings for any --jobs. With more grasps or presses,
the first recordings stay the same. The values of mass, friction, skin and array are plausible,
not measured.
"""


def _option_settings(text: str, default: Any = None, **settings: Any) -> dict[str, Any]:
    return {**settings, "default": default, "help": text}


_OPTIONS = {
    "num_objects": _option_settings(
        "with --objects shapes: number of random objects (default: 40)",
        metavar="N",
        type=small_count,
    ),
    "hand": _option_settings(
        "a hand of 384 taxels, or of 240 with a bare palm (default: allegro_uskin_240 with "
        "--objects twenty, else allegro_uskin)",
        choices=_HANDS,
    ),
    "trials": _option_settings(
        "trials per object (default: 10, or 3 with --preset ci)", metavar="N", type=small_count
    ),
    "grasps": _option_settings(
        "with --objects bigs: number of grasps, half with the cylinder, a quarter each with "
        "box and ball (default: 2000)",
        metavar="N",
        type=small_count,
    ),
    "presses": _option_settings(
        "with --objects letters: presses per letter (default: 500)", metavar="N", type=small_count
    ),
    "layout": _option_settings(
        "with --objects letters: layout file of the array, such as one written by "
        "sensors.hexagonal(34, 30, 0.00134).save('hexagonal.json') (default: 32 x 32 pixels, "
        "1.25 mm apart)",
        metavar="FILE",
        type=input_path,
    ),
    "seed": _option_settings("seed (default: 0)", 0, metavar="N", type=not_negative),
    "jobs": _option_settings("processes (default: 2)", 2, metavar="N", type=small_count),
    "preset": _option_settings(
        "full: trials of 17 s at 100 Hz; ci: 5 s at 50 Hz, coarser and about ten times faster "
        "to simulate (default: full)",
        "full",
        choices=_PRESETS,
    ),
    "seconds": _option_settings(
        "length of a trial in seconds, 1 to 3600 (default: as in --preset)",
        metavar="S",
        type=trial_seconds,
    ),
    "spread": _option_settings(
        "variation of the grasps in position, rotation and posture; wide: up to twice as much as "
        "careful, and occasionally a finger that hardly closes (default: careful)",
        "careful",
        choices=_SPREADS,
    ),
    "motion": _option_settings(
        "lift: lift and hold the object; squeeze: squeeze it three to five times in place "
        "(default: lift)",
        "lift",
        choices=_MOTIONS,
    ),
    "max_attempts": _option_settings(
        "grasps to try before a trial is given up (default: 10)", 10, metavar="N", type=small_count
    ),
}
_SHARED_OPTIONS = ("seed", "jobs")
_FINGERTIP_AND_LETTER_OPTIONS = ("grasps", "presses", "layout")
_HAND_OPTIONS = tuple(
    name for name in _OPTIONS if name not in (*_SHARED_OPTIONS, *_FINGERTIP_AND_LETTER_OPTIONS)
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    r"""Adds the arguments of the command to a parser."""
    parser.add_argument(
        "--out",
        metavar="DIR",
        type=OutputFolder("--out"),
        required=True,
        help="folder for the recordings",
    )
    parser.add_argument(
        "--objects",
        choices=(*_OBJECT_SETS, _BIGS, _LETTERS),
        default="paper8",
        help="objects to grasp (default: paper8; see above)",
    )
    hand = parser.add_argument_group("Allegro hand")
    fingertips_and_letters = parser.add_argument_group("three fingertips and letters")
    groups = dict.fromkeys(_FINGERTIP_AND_LETTER_OPTIONS, fingertips_and_letters)
    groups |= dict.fromkeys(_HAND_OPTIONS, hand)
    for name, settings in _OPTIONS.items():
        group = groups.get(name, parser)
        group.add_argument(f"--{name.replace('_', '-')}", **settings)
    parser.add_argument(
        "--preview",
        action="store_true",
        help="plot the first trial to DIR/preview; for bigs a success and a failure, for letters "
        "the first press of each letter",
    )


def list_outputs(arguments: argparse.Namespace) -> list[OutputPath]:
    r"""Returns the files that the command writes, except the trials: existing trials are kept."""
    kinds = {
        "simulation.json": text_kind("the description of simulated trials", r'\{\s*"synthetic": '),
        **{f"preview/preview_{name}.png": PICTURE for name in ("film", "forces", "grasps")},
        "preview_letters.png": PICTURE,
    }
    return files_in_folder(arguments.out, kinds)


def run(arguments: argparse.Namespace) -> int:
    r"""Runs the command and returns the exit status."""
    _check_options(arguments)
    from torch_geometric_tactile._texts import printable
    from torch_geometric_tactile.reports import _simulation as simulation
    from torch_geometric_tactile.visualization._style import new_figure

    if arguments.preview:
        new_figure(1.0, 1.0)  # a missing matplotlib must fail before the long run
    simulations: dict[str, tuple[Any, tuple[str, ...]]] = {
        _BIGS: (simulation.run_bigs, ("grasps",)),
        _LETTERS: (simulation.run_letters, ("presses", "layout")),
    }
    hand_simulation = simulation.run_simulation, ("objects", *_HAND_OPTIONS)
    simulate, option_names = simulations.get(arguments.objects, hand_simulation)
    options = {name: getattr(arguments, name) for name in (*_SHARED_OPTIONS, *option_names)}
    run_report = simulate(arguments.out, **options)
    print(printable(run_report.describe()), flush=True)
    if run_report.failures:
        print(f"tactile: error: {run_report.describe_failures()}", file=sys.stderr, flush=True)
    if arguments.preview and len(run_report.failures) < len(run_report.reports):
        for path in run_report.draw_preview():
            print(printable(f"drew {path}"))
    return 1 if run_report.failures else 0


def _check_options(arguments: argparse.Namespace) -> None:
    count_option = _COUNT_OPTIONS.get(arguments.objects, "trials")
    for objects, name in _COUNT_OPTIONS.items():
        value = getattr(arguments, name)
        if value is not None and arguments.objects != objects:
            raise ValueError(
                f"'--{name}' must be left out for objects other than '{objects}' (got {value}): "
                f"use '--{count_option}'"
            )
    if arguments.layout is not None and arguments.objects != _LETTERS:
        raise ValueError(
            f"'--layout' must be left out for objects other than '{_LETTERS}' (got "
            f"'{arguments.layout}'): '--hand' selects the taxels of a hand"
        )
    # An option without effect is an error, because its user expects an effect.
    for name in _HAND_OPTIONS if arguments.objects in _COUNT_OPTIONS else ():
        if (value := getattr(arguments, name)) != _OPTIONS[name]["default"]:
            option = f"--{name.replace('_', '-')}"
            advice = f": use '--{count_option}'" if name == "trials" else ""
            raise ValueError(
                f"'{option}' must be left out for '{arguments.objects}' (got {value}){advice}"
            )
