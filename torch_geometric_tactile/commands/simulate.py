r"""``tactile simulate``: grasps of a simulated hand, and presses of letters."""

import argparse
import sys

from torch_geometric_tactile.commands._arguments import few, not_negative, trial_seconds

# The names in `sim`, which is too heavy to import for them.
_OBJECT_SETS = ("paper8", "control8", "twenty", "shapes")
_BIGS = "bigs"
_LETTERS = "letters"
_HANDS = ("allegro_uskin", "allegro_uskin_240")
_PRESETS = ("full", "ci")
_SPREADS = ("careful", "wide")
_MOTIONS = ("lift", "squeeze")

# Options of the Allegro hand only, with their defaults.
_OF_THE_HAND = {
    "num_objects": None,
    "hand": None,
    "trials": None,
    "preset": "full",
    "seconds": None,
    "spread": "careful",
    "motion": "lift",
    "max_attempts": 10,
}

# The option that counts the samples of the other simulations.
_NUMBERS = {_BIGS: "grasps", _LETTERS: "presses"}

HELP = "Simulate grasps of a tactile hand, or letters pressed on an array"
DESCRIPTION = """\
Simulates an Allegro hand with 384 magnetic taxels that grasps, lifts and holds objects of
different mass, stiffness and friction. Writes one HDF5 recording per trial: readings, joint
angles, properties of the object and, separately, the true forces and poses. All objects but
letters need the extra 'sim'.

objects:
  paper8     eight shapes: all combinations of light or heavy, hard or soft, slippery or not
  control8   the same combinations in one shape and size
  twenty     five shapes in four sizes
  shapes     spheres, cylinders, boxes and ellipsoids of random size, mass and friction
  bigs       a cylinder, a box and a ball, lifted and shaken by three BioTac-like fingertips;
             failed grasps are kept, as in the BiGS data set
  letters    stamps of A to Z pressed on an array of 32 x 32 pixels; a folder of .npy files
             in kPa per letter, which the data set LetterShape reads
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
                                                         the first 40 of them, and a plot
  tactile simulate --out letters --objects letters --preview
                                                         13000 presses, 500 of each letter: 53 MB,
                                                         a minute on two cores, and a plot
  tactile simulate --out some --objects letters --presses 20 --seed 1
                                                         520 others
  tactile simulate --out hexagonal --objects letters --layout hexagonal.json
                                                         the same letters on another array

Finished trials are kept: the same command resumes an interrupted run, or adds --preview to a
finished one. The same seed gives the same recordings for any --jobs. A larger number of grasps
or presses starts with the same ones. Masses, frictions, skin and array are plausible, not
measured.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    r"""Adds the arguments of the verb."""
    parser.add_argument("--out", metavar="DIR", required=True, help="folder for the recordings")
    parser.add_argument(
        "--objects",
        choices=(*_OBJECT_SETS, _BIGS, _LETTERS),
        default="paper8",
        help="what is grasped (default: paper8; see above)",
    )
    hand = parser.add_argument_group("Allegro hand")
    hand.add_argument(
        "--num-objects",
        metavar="N",
        type=few,
        help="objects drawn at random, with --objects shapes (default: 40)",
    )
    hand.add_argument(
        "--hand",
        choices=_HANDS,
        help="a hand of 384 taxels, or of 240 with a bare palm (default: allegro_uskin_240 with "
        "--objects twenty, else allegro_uskin)",
    )
    hand.add_argument(
        "--trials",
        metavar="N",
        type=few,
        help="trials per object (default: 10, or 3 with --preset ci)",
    )
    other = parser.add_argument_group("three fingertips and letters")
    other.add_argument(
        "--grasps",
        metavar="N",
        type=few,
        help="with --objects bigs: number of grasps, half with the cylinder, a quarter each with "
        "box and ball (default: 2000)",
    )
    other.add_argument(
        "--presses",
        metavar="N",
        type=few,
        help="with --objects letters: presses per letter (default: 500)",
    )
    other.add_argument(
        "--layout",
        metavar="FILE",
        help="with --objects letters: layout file of the array, such as that of "
        "sensors.hexagonal(34, 30, 0.00134).save('hexagonal.json') (default: 32 x 32 pixels, "
        "1.25 mm apart)",
    )
    parser.add_argument(
        "--seed",
        metavar="N",
        type=not_negative,
        default=0,
        help="seed (default: 0)",
    )
    parser.add_argument("--jobs", metavar="N", type=few, default=2, help="processes (default: 2)")
    hand.add_argument(
        "--preset",
        choices=_PRESETS,
        default="full",
        help="full: trials of 17 s at 100 Hz; ci: 5 s at 50 Hz, coarser and about ten times faster "
        "to simulate (default: full)",
    )
    hand.add_argument(
        "--seconds",
        metavar="S",
        type=trial_seconds,
        help="length of a trial, 1 to 3600 (default: the preset's)",
    )
    hand.add_argument(
        "--spread",
        choices=_SPREADS,
        default="careful",
        help="variation of the grasps in position, rotation and posture; wide: up to twice that of "
        "careful, and now and then a finger that hardly closes (default: careful)",
    )
    hand.add_argument(
        "--motion",
        choices=_MOTIONS,
        default="lift",
        help="lift: lift and hold the object; squeeze: squeeze it three to five times in place "
        "(default: lift)",
    )
    hand.add_argument(
        "--max-attempts",
        metavar="N",
        type=few,
        default=10,
        help="grasps to try before a trial is given up (default: 10)",
    )
    parser.add_argument(
        "--preview",
        action="store_true",
        help="plot the first trial to DIR/preview; of bigs a success and a failure, of letters the "
        "first press of each",
    )


def run(arguments: argparse.Namespace) -> int:
    r"""Runs the verb and returns the exit status."""
    number = _NUMBERS.get(arguments.objects, "trials")
    for objects, name in _NUMBERS.items():
        value = getattr(arguments, name)
        if value is not None and arguments.objects != objects:
            raise ValueError(
                f"'{name}' must be left out for objects other than '{objects}' (got {value}); "
                f"'{number}' is their number"
            )
    if arguments.layout is not None and arguments.objects != _LETTERS:
        raise ValueError(
            f"'layout' must be left out for objects other than '{_LETTERS}' (got "
            f"'{arguments.layout}'); 'hand' chooses the taxels of a hand"
        )
    if arguments.objects in _NUMBERS:
        _check_left_out(arguments)
        return _run_bigs(arguments) if arguments.objects == _BIGS else _run_letters(arguments)
    from torch_geometric_tactile._texts import printable
    from torch_geometric_tactile.reports import _simulation as simulation

    if arguments.preview:
        simulation.check_preview()
    finished = simulation.run_simulation(
        arguments.out,
        objects=arguments.objects,
        trials=arguments.trials,
        seed=arguments.seed,
        jobs=arguments.jobs,
        preset=arguments.preset,
        max_attempts=arguments.max_attempts,
        hand=arguments.hand,
        spread=arguments.spread,
        seconds=arguments.seconds,
        num_objects=arguments.num_objects,
        motion=arguments.motion,
    )
    print(printable(finished.describe()), flush=True)
    if finished.given_up:
        print(f"tactile: error: {finished.describe_given_up()}", file=sys.stderr, flush=True)
    if arguments.preview and len(finished.given_up) < len(finished.reports):
        for path in simulation.draw_preview(finished):
            print(printable(f"drew {path}"))
    return 1 if finished.given_up else 0


def _check_left_out(arguments: argparse.Namespace) -> None:
    objects = arguments.objects
    for name, default in _OF_THE_HAND.items():
        if (value := getattr(arguments, name)) != default:
            instead = f"; '{_NUMBERS[objects]}' is their number" if name == "trials" else ""
            raise ValueError(f"'{name}' must be left out for '{objects}' (got {value}){instead}")


def _run_bigs(arguments: argparse.Namespace) -> int:
    from torch_geometric_tactile._texts import printable
    from torch_geometric_tactile.reports import _simulated_bigs as simulated_bigs
    from torch_geometric_tactile.reports._simulation import check_preview

    if arguments.preview:
        check_preview()
    finished = simulated_bigs.run_bigs(
        arguments.out, grasps=arguments.grasps, seed=arguments.seed, jobs=arguments.jobs
    )
    print(printable(finished.describe()), flush=True)
    if arguments.preview:
        print(printable(f"drew {simulated_bigs.draw_bigs_preview(finished)}"))
    return 0


def _run_letters(arguments: argparse.Namespace) -> int:
    from torch_geometric_tactile._texts import printable
    from torch_geometric_tactile.reports import _simulated_letters as simulated_letters
    from torch_geometric_tactile.reports._simulation import check_preview

    if arguments.preview:
        check_preview()
    finished = simulated_letters.run_letters(
        arguments.out,
        presses=arguments.presses,
        seed=arguments.seed,
        jobs=arguments.jobs,
        layout=arguments.layout,
    )
    print(printable(finished.describe()), flush=True)
    if arguments.preview:
        print(printable(f"drew {simulated_letters.draw_letters_preview(finished)}"))
    return 0
