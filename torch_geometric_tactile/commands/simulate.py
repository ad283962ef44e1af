r"""``tactile simulate``: grasps of a simulated hand, and presses of letters."""

import argparse
import sys

from torch_geometric_tactile.commands.arguments import few, not_negative, seconds

# The names in `sim`, which is too heavy to import for them.
_OBJECT_SETS = ("paper8", "control8", "twenty", "shapes")
_BIGS = "bigs"
_LETTERS = "letters"
_HANDS = ("allegro_uskin", "allegro_uskin_240")
_PRESETS = ("full", "ci")
_SPREADS = ("careful", "wide")
_MOTIONS = ("lift", "squeeze")

# What only the Allegro hand has, and with other --objects has to stay as it is.
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

# What the number of other objects is called.
_NUMBERS = {_BIGS: "grasps", _LETTERS: "presses"}

HELP = (
    "simulate grasps with an Allegro hand of 384 taxels or three fingertips, or letters pressed on "
    "an array"
)
DESCRIPTION = """\
Simulates an Allegro hand covered with 384 magnetic taxels that grasps, lifts and holds
(or, with --motion squeeze, squeezes) objects of different mass, softness and friction, and
writes one HDF5 recording a trial: readings, joint angles, the object's properties and, apart,
the true forces and poses.
With --objects bigs, three BioTac-like fingertips grasp, lift and shake a cylinder, a box or
a ball instead, and failed grasps are kept, as in the BiGS set. Both need the extra 'sim'.
With --objects letters, stamps of the letters A to Z are pressed on an array of 32 x 32 pixels,
and each letter gets a folder of .npy files in kPa, which the data set LetterShape reads.
"""
EXAMPLES = """\
examples:
  tactile simulate --out grasps                          80 trials of 17 s of eight objects
  tactile simulate --out small --preset ci --preview     24 short and coarse trials in a minute
  tactile simulate --out control --objects control8      objects of one shape and size
  tactile simulate --out wide --objects shapes --num-objects 40 --trials 10 \\
    --spread wide --seconds 5                            400 short trials that differ widely
  tactile simulate --out twenty --objects twenty --motion squeeze --trials 30 \\
    --spread wide --seconds 10                           600 trials of twenty objects, squeezed
                                                         and not lifted
  tactile simulate --out bigs --objects bigs             2000 grasps that hold or slip, 6 s each:
                                                         375 MB, ten minutes on two cores
  tactile simulate --out few --objects bigs --grasps 40 --preview
                                                         the first 40 of them, and a picture
  tactile simulate --out letters --objects letters --preview
                                                         13000 presses, 500 of each letter: 53 MB,
                                                         a minute on two cores, and a picture
  tactile simulate --out some --objects letters --presses 20 --seed 1
                                                         520 others
  tactile simulate --out hexagonal --objects letters --layout hexagonal.json
                                                         the same letters on another array, a file
                                                         of TaxelLayout.save

Finished trials are kept: the same command goes on where a run was stopped, and with
--preview draws the pictures of a finished one. The same seed gives the same recordings,
whatever --jobs is. Masses, frictions, the skin and the array are plausible, not measured.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    r"""Adds the arguments of the verb.

    Args:
        parser (argparse.ArgumentParser): The parser of the verb.
    """
    parser.add_argument(
        "--out", metavar="DIR", required=True, help="folder of the recordings, made if missing"
    )
    parser.add_argument(
        "--objects",
        choices=(*_OBJECT_SETS, _BIGS, _LETTERS),
        default="paper8",
        help="which objects: eight of different shapes, every combination of light or heavy, hard "
        "or soft, slippery or not (paper8, the default); the same combinations in one shape and "
        "size (control8); five shapes in four sizes (twenty); spheres, cylinders, boxes and "
        "ellipsoids with drawn sizes, masses and frictions (shapes); a cylinder, a box and a ball "
        "for three fingertips (bigs); letters pressed on an array (letters)",
    )
    parser.add_argument(
        "--num-objects",
        metavar="N",
        type=few,
        help="how many objects of shapes are drawn (default: 40); --seed decides which",
    )
    parser.add_argument(
        "--hand",
        choices=_HANDS,
        help="384 taxels, or 240 with none on the palm (default: the second for the objects "
        "twenty, else the first)",
    )
    parser.add_argument(
        "--trials",
        metavar="N",
        type=few,
        help="trials of each object (default: 10, or 3 with the preset ci)",
    )
    parser.add_argument(
        "--grasps",
        metavar="N",
        type=few,
        help="grasps of bigs in all, half of them of the cylinder, a quarter each of box and ball "
        "(default: 2000); more of them begin with the same",
    )
    parser.add_argument(
        "--presses",
        metavar="N",
        type=few,
        help="presses of each of the letters (default: 500); more of them begin with the same",
    )
    parser.add_argument(
        "--layout",
        metavar="FILE",
        help="the taxels that letters are pressed on: a layout file, such as that of "
        "sensors.hexagonal(34, 30, 0.00134).save('hexagonal.json') (default: 32 x 32, 1.25 mm "
        "apart)",
    )
    parser.add_argument(
        "--seed", type=not_negative, default=0, help="decides all randomness (default: 0)"
    )
    parser.add_argument("--jobs", metavar="N", type=few, default=2, help="processes (default: 2)")
    parser.add_argument(
        "--preset",
        choices=_PRESETS,
        default="full",
        help="trials of 17 s with 100 frames a second (full, the default), or of 5 s with 50, "
        "coarser and about ten times as fast (ci)",
    )
    parser.add_argument(
        "--seconds",
        metavar="S",
        type=seconds,
        help="length of a trial, from 1 on (default: the preset's)",
    )
    parser.add_argument(
        "--spread",
        choices=_SPREADS,
        default="careful",
        help="how much the grasps differ in place, turn and posture: an operator who takes care "
        "(careful, the default), or up to twice as much, and now and then a finger that hardly "
        "closes (wide)",
    )
    parser.add_argument(
        "--motion",
        choices=_MOTIONS,
        default="lift",
        help="what the hand does: lift and hold the object (lift, the default), or squeeze it "
        "three to five times where it is (squeeze)",
    )
    parser.add_argument(
        "--max-attempts",
        metavar="N",
        type=few,
        default=10,
        help="grasps tried until the object is lifted and held, or squeezed, before a trial is "
        "given up (default: 10)",
    )
    parser.add_argument(
        "--preview",
        action="store_true",
        help="draw the first trial of the first object to DIR/preview: preview_film.png and "
        "preview_forces.png; of bigs a success and a failure: preview_grasps.png; of letters the "
        "first press of each, to DIR/preview_letters.png",
    )


def run(arguments: argparse.Namespace) -> int:
    r"""Runs the verb and returns the exit status.

    Args:
        arguments (argparse.Namespace): The arguments.
    """
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
    from torch_geometric_tactile.reports import simulation
    from torch_geometric_tactile.texts import printable

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
    from torch_geometric_tactile.reports import simulated_bigs
    from torch_geometric_tactile.reports.simulation import check_preview
    from torch_geometric_tactile.texts import printable

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
    from torch_geometric_tactile.reports import simulated_letters
    from torch_geometric_tactile.reports.simulation import check_preview
    from torch_geometric_tactile.texts import printable

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
