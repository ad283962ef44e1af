r"""``tactile pretrain``: an encoder of one sensor from recordings without labels."""

import argparse
import os
from typing import TYPE_CHECKING

from torch_geometric_tactile.commands._arguments import (
    minutes,
    not_negative,
    positive,
    small_count,
)
from torch_geometric_tactile.commands._reading import add_reading_options, reading_options
from torch_geometric_tactile.commands._runs import (
    add_grid,
    add_init,
    add_rest,
    options_named,
)
from torch_geometric_tactile.commands.compare import _init

if TYPE_CHECKING:
    from torch_geometric_tactile.training import PretrainStep

HELP = "Train an encoder on recordings without labels"
EXTRAS = "train"
DESCRIPTION = """\
Trains an encoder for one sensor on recordings without labels, in three minutes of one core:
frames of one trial are contrasted with those of others, and missing taxels are predicted.
'tactile compare --encoder FILE' tells whether it pays where labels are few.

data:
  RECORDING... recordings of trials (HDF5, npz, MCAP, CSV, XELA logs and messages)
  FOLDER       a folder of them
  FILE.npz     arrays x (S, N), (S, N, channels) or, with --grid, (S, rows, cols), and trial (S,)
  CLASS        import path of a StaticDataset class; of this package, its name is enough
"""
EXAMPLES = """\
examples:
  tactile pretrain grasps --layout allegro_uskin --out hand.encoder
  tactile pretrain day1/*.csv --layout skin.json --tactile 'pad_.*' --out skin.encoder
  tactile pretrain touches.npz --grid 28x50 --rest 10 --out mat.encoder
                                                 each trial starts with 10 frames at rest
  tactile pretrain ICubGrasp --init root=DIR --minutes 5 --out icub.encoder
  tactile pretrain grasps --layout allegro_uskin --steps 600 --seed 1 --out hand.encoder
                                                 so many steps, whatever they take
  tactile compare touches.npz --grid 28x50 --rest 10 --encoder mat.encoder

Ctrl-C or a kill loses 15 seconds: the same command goes on. docs/pretraining.md explains what is
trained, and where it pays.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    r"""Adds the arguments of the verb."""
    parser.add_argument("data", metavar="DATA", nargs="+", help="the recordings; see above")
    parser.add_argument("--out", metavar="FILE", required=True, help="the encoder to write")
    parser.add_argument(
        "--layout",
        metavar="LAYOUT",
        help="positions of the taxels: a stock layout or a layout file (default: the sensor that "
        "the recordings name)",
    )
    add_grid(parser)
    add_init(parser)
    parser.add_argument(
        "--stride", metavar="N", type=positive, default=1, help="use every N-th frame of a trial"
    )
    add_rest(parser)
    training = parser.add_argument_group("training")
    training.add_argument(
        "--minutes",
        metavar="N",
        type=minutes,
        default=3.0,
        help="how long it may take (default: 3)",
    )
    training.add_argument(
        "--steps",
        metavar="N",
        type=positive,
        help="number of steps, in place of --minutes: the same seed and number make the same "
        "encoder",
    )
    training.add_argument(
        "--seed", metavar="N", type=not_negative, default=0, help="of all draws (default: 0)"
    )
    training.add_argument(
        "--threads", metavar="N", type=small_count, default=1, help="threads (default: 1)"
    )
    add_reading_options(parser)


def run(arguments: argparse.Namespace) -> int:
    r"""Runs the verb and returns the exit status."""
    with options_named(arguments):
        return _run(arguments)


def _run(arguments: argparse.Namespace) -> int:
    import torch

    from torch_geometric_tactile._interrupts import ends_heeded
    from torch_geometric_tactile._texts import printable
    from torch_geometric_tactile.commands._status_line import StatusLine
    from torch_geometric_tactile.experiments._unlabelled_frames import unlabelled_frames
    from torch_geometric_tactile.training import PretrainSettings, pretrain

    settings = PretrainSettings(
        minutes=arguments.minutes, steps=arguments.steps, seed=arguments.seed
    )
    if os.path.isdir(arguments.out):
        raise IsADirectoryError(f"'{arguments.out}' must be a file to write (got a folder)")
    frames = unlabelled_frames(
        arguments.data,
        layout=arguments.layout,
        grid=arguments.grid,
        init=_init(arguments.init),
        options=reading_options(arguments),
        stride=arguments.stride,
        rest=arguments.rest,
    )
    threads = torch.get_num_threads()
    torch.set_num_threads(arguments.threads)
    try:
        with StatusLine() as line, ends_heeded():
            encoder = pretrain(
                frames.x,
                frames.trial,
                frames.layout,
                settings,
                checkpoint=f"{arguments.out}.checkpoint",
                trained_on={"source": frames.source, "rest": arguments.rest},
                on_step=lambda step: line.show(_shown(step)),
            )
    except KeyboardInterrupt as stop:
        raise KeyboardInterrupt("stopped: the same command goes on") from stop
    finally:
        torch.set_num_threads(threads)
    encoder.save(arguments.out)
    print(printable(f"wrote {arguments.out}: {encoder.describe()}"), flush=True)
    return 0


def _shown(step: "PretrainStep") -> str:
    of = "?" if step.steps is None else f"{step.steps:,}"
    return (
        f"step {step.step:,} of {of}  {step.seconds:.0f} s  loss of trials {step.trial_loss:.2f}  "
        f"of views {step.view_loss:.2f}  of masked taxels {step.mask_loss:.3f}"
    )
