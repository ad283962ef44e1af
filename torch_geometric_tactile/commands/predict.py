r"""``tactile predict``: the probabilities of each frame, or the file of a predictor."""

import argparse

from torch_geometric_tactile.commands.arguments import add_allow

HELP = "write the predictions of a checkpoint or predictor for recordings or a test part"
DESCRIPTION = """\
Predicts each frame of some recordings (.h5, .hdf5, .npz, .mcap, .csv, XELA logs and messages), or,
without recordings, each sample of the test part of the data that a checkpoint was trained
with, and writes a CSV table: a row for each frame with the predicted class or labels and
all probabilities; a model of windows or whole trials has a row for each of these, with its
last frame. MODEL is a checkpoint of 'tactile fit' or a file that --save wrote.
"""
EXAMPLES = """\
examples:
  tactile predict last.ckpt grasps/sponge_000.h5 --out sponge.csv
  tactile predict runs/mt_gcn/version_0/checkpoints/last.ckpt
                                                 the test part of its data, to predictions.csv
  tactile predict last.ckpt --config grasp_gcn_df --root data/BioTacSP
  tactile predict last.ckpt --save grasp.predictor
                                                 layout, transforms, model and class names in
                                                 one file, which needs no extra to be used
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    r"""Adds the arguments of the verb.

    Args:
        parser (argparse.ArgumentParser): The parser of the verb.
    """
    parser.add_argument(
        "model", metavar="MODEL", help="a checkpoint of 'tactile fit', or a file of --save"
    )
    parser.add_argument(
        "recordings",
        metavar="RECORDING",
        nargs="*",
        help="recordings; without any, the test part of the data is predicted",
    )
    parser.add_argument(
        "--out",
        metavar="CSV",
        default="predictions.csv",
        help="the table to write (default: predictions.csv)",
    )
    parser.add_argument(
        "--save",
        metavar="FILE",
        help="write the predictor to one file that needs neither configuration nor Lightning; "
        "predict only if there are recordings",
    )
    parser.add_argument(
        "--adapt",
        action="store_true",
        help="measure each recording as a session of its own first, without labels, for models "
        "whose readings are scaled session by session",
    )
    parser.add_argument(
        "--config",
        metavar="CONFIG",
        help="the configuration of the data, a file or a shipped one; by default the config.yaml "
        "that the run has beside its checkpoints",
    )
    parser.add_argument(
        "--root", metavar="DIR", help="folder of the data, instead of the configuration's"
    )
    add_allow(parser)


def run(arguments: argparse.Namespace) -> int:
    r"""Runs the verb and returns the exit status.

    Args:
        arguments (argparse.Namespace): The arguments.
    """
    from torch_geometric_tactile.reports import predictions, run_data
    from torch_geometric_tactile.texts import printable

    if arguments.recordings and arguments.root is not None:
        raise ValueError("'--root' is for the test part of the data: leave out the recordings")
    if arguments.adapt and not arguments.recordings:
        raise ValueError("'--adapt' is for recordings: the sessions of a test part are measured")
    predictor = run_data.open_predictor(arguments.model, arguments.config, arguments.allow)
    if arguments.save is not None:
        predictor.save(arguments.save)
        print(printable(f"wrote {arguments.save}: {predictor}"), flush=True)
        if not arguments.recordings:
            return 0
    if arguments.recordings:
        count = predictions.write_recordings(
            predictor, arguments.recordings, arguments.out, arguments.adapt
        )
    else:
        data = run_data.load_data(
            arguments.model, arguments.config, arguments.root, arguments.allow
        )
        samples = run_data.test_part(data, predictor)
        count = predictions.write_samples(predictor, samples, arguments.out)
    of_windows = predictor.window is not None
    print(printable(predictions.describe_counts(count, arguments.out, of_windows)))
    return 0
