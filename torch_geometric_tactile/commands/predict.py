r"""``tactile predict``: writes the probabilities of each frame, or saves a predictor."""

import argparse
import sys
from importlib.util import find_spec
from pathlib import PurePath
from typing import TYPE_CHECKING

from torch_geometric_tactile.commands._arguments import (
    CONTACT,
    add_run_data,
    contact_rule,
    seconds,
)
from torch_geometric_tactile.commands._file_kinds import PICTURE, PREDICTIONS, PREDICTOR
from torch_geometric_tactile.commands._paths import OutputFile, OutputPath, input_path
from torch_geometric_tactile.commands._reading import add_reading_options, reading_options
from torch_geometric_tactile.commands._runs import option_names_in_errors

if TYPE_CHECKING:
    from collections import Counter

    from torch_geometric_tactile.predictor import Predictor
    from torch_geometric_tactile.reports._prediction_pictures import PredictionPictures
    from torch_geometric_tactile.reports._predictions import UnpredictedRecordingsError

_TABLE = "predictions.csv"
HELP = "Write the predictions of a model for recordings or the test part"
DESCRIPTION = """\
Predicts each frame of recordings (HDF5, npz, MCAP, CSV, XELA logs and messages) or, without
recordings, each sample of the test part of the model's data. Writes a CSV table with one
row per frame: the predicted class or labels and all probabilities. Models that read windows
or whole trials give one row per window or trial, with the number of its last frame. A model
trained on CSV files stores their column names.

Recordings that cannot be read or predicted are missing from the table and listed at the end; the
exit status is then 1.

For each of the first 20 recordings, a picture shows the probabilities, the predicted class,
contact and total pressure over time and, if it is recorded, the true class. Pictures need
the extra 'viz'.
"""
EXAMPLES = """\
examples:
  tactile predict last.ckpt grasps/sponge_000.h5 --out sponge.csv
                                                 the table, and the picture sponge.png
  tactile predict last.ckpt grasps/*.h5 --out day2.csv
                                                 also day2-sponge_000.png, day2-sponge_001.png, ...
  tactile predict runs/mt_gcn/version_0/checkpoints/last.ckpt
                                                 the test part of its data; writes predictions.csv
  tactile predict last.ckpt --config grasp_gcn_df --root data/BioTacSP
  tactile predict glove.predictor day2/*.h5 --rest 0.5
                                                 a model with a tare: recordings begin with half
                                                 a second at rest
  tactile predict grasp.predictor day2/*.h5 --rest 0.5 --contact
                                                 "no contact" where nothing is touched
  tactile predict glove.predictor glove.csv --tactile 'pad_.*' --joint 'bend_.*'
                                                 a CSV file with other columns than in training
  tactile predict biotac_sp_slip grasps/*.npz    a trained model of the package
  tactile predict last.ckpt --save grasp.predictor
                                                 one file with layout, transforms, model and
                                                 class names; using it needs no extra
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    r"""Adds the arguments of the command to a parser."""
    parser.add_argument(
        "model",
        metavar="MODEL",
        type=input_path,
        help="a checkpoint from 'tactile fit', a predictor from --save, or the name of a predictor "
        "in docs/pretrained.md, such as biotac_sp_slip",
    )
    parser.add_argument(
        "recordings",
        metavar="RECORDING",
        type=input_path,
        nargs="*",
        help="recordings (default: the test part of the data)",
    )
    parser.add_argument(
        "--out",
        metavar="CSV",
        type=OutputFile("--out", PREDICTIONS),
        help="table to write (default: predictions.csv)",
    )
    parser.add_argument(
        "--no-picture",
        action="store_true",
        help="write the table only",
    )
    parser.add_argument(
        "--save",
        metavar="FILE",
        type=OutputFile("--save", PREDICTOR),
        help="save the model with its preprocessing as a predictor: one file that needs neither "
        "configuration nor Lightning; without recordings, predict nothing",
    )
    parser.add_argument(
        "--adapt",
        action="store_true",
        help="for models with session scaling: measure the scaling on each recording separately, "
        "without labels; a tare then subtracts the mean of the whole recording",
    )
    parser.add_argument(
        "--rest",
        type=seconds,
        metavar="SECONDS",
        help="for models with a tare, also with --adapt, and for --contact: time at the start of "
        "each recording in which nothing touches the sensor; the reading at rest is its mean",
    )
    parser.add_argument(
        "--contact",
        **CONTACT,
        help='write "no contact" for frames and windows in which no two taxels differ from their '
        "reading at rest by more than THRESHOLD, in the unit of the readings (default: 6 times "
        "their noise at rest); their probabilities are nan. --save keeps the rule",
    )
    parser.add_argument(
        "--resample",
        action="store_true",
        help="for models that read windows: resample recordings to the frame rate of the training "
        "data",
    )
    add_run_data(parser)
    add_reading_options(parser)


def list_outputs(arguments: argparse.Namespace) -> list[OutputPath]:
    r"""Returns the files that the command writes."""
    if arguments.save is not None and not arguments.recordings:
        return []
    table = arguments.out or _TABLE
    outputs = [OutputPath(table, "--out", PREDICTIONS)]
    if arguments.recordings and not arguments.no_picture:
        base = table[:-4] if table.lower().endswith(".csv") else table
        stems = [PurePath(recording).stem for recording in arguments.recordings]
        # Recordings of the same name are numbered; some file systems ignore case.
        folded = [stem.casefold() for stem in stems]
        numbers = [folded[: i + 1].count(stem) for i, stem in enumerate(folded)]
        endings = [
            f"-{stem}{f'-{n}' if n > 1 else ''}" for stem, n in zip(stems, numbers, strict=True)
        ]
        outputs += [
            OutputPath(f"{base}{ending}.png", "--out", PICTURE) for ending in ("", *endings)
        ]
    return outputs


def run(arguments: argparse.Namespace) -> int:
    r"""Runs the command and returns the exit status."""
    with option_names_in_errors(arguments):
        return _run(arguments)


def _run(arguments: argparse.Namespace) -> int:
    arguments.out = arguments.out or _TABLE
    from torch_geometric_tactile._texts import printable
    from torch_geometric_tactile.reports import _predictions as predictions
    from torch_geometric_tactile.reports import _run_data as run_data
    from torch_geometric_tactile.reports._prediction_pictures import PredictionPictures

    _check_options(arguments)
    predictor = run_data.open_predictor(arguments.model, arguments.config)
    rule = contact_rule(arguments.contact)
    if rule is not None:
        predictor.contact = rule
    if predictor.score is not None:
        print(printable(f"{arguments.model} was selected for {predictor.score}"), flush=True)
    if arguments.adapt and arguments.rest is None and predictor.measures_rest:
        # The mean of the whole recording also includes contacts.
        print(
            "note: --adapt uses the mean of the whole recording as its reading at rest. Add "
            "--rest SECONDS if nothing touches the sensor in the first SECONDS",
            file=sys.stderr,
        )
    if arguments.save is not None:
        predictor.save(arguments.save)
        print(printable(f"wrote {arguments.save}: {predictor}"), flush=True)
        if not arguments.recordings:
            return 0
    has_pictures = arguments.recordings and not arguments.no_picture
    # The table is useful without matplotlib, so that a missing extra is only a note.
    can_draw = has_pictures and find_spec("matplotlib") is not None
    pictures = PredictionPictures(arguments.out) if can_draw else None
    count, failure = _write_table(arguments, predictor, pictures)
    has_windows = predictor.window is not None
    if count:
        print(printable(predictions.describe_counts(count, arguments.out, has_windows)), flush=True)
    if pictures is not None:
        _write_pictures(pictures)
    elif has_pictures:
        print(
            "note: no picture, because matplotlib is missing: pip install "
            '"torch-geometric-tactile[viz]", or add --no-picture',
            file=sys.stderr,
        )
    if failure is not None:
        raise failure
    return 0


def _write_table(
    arguments: argparse.Namespace,
    predictor: "Predictor",
    pictures: "PredictionPictures | None",
) -> "tuple[Counter[str], UnpredictedRecordingsError | None]":
    # Writes the table, and returns its rows by prediction and the error of other recordings.
    from torch_geometric_tactile.reports import _predictions as predictions
    from torch_geometric_tactile.reports import _run_data as run_data

    if not arguments.recordings:
        data = run_data.load_data(arguments.model, arguments.config, arguments.root)
        samples = run_data.test_part(data, predictor)
        return predictions.write_samples(predictor, samples, arguments.out), None
    try:
        count = predictions.write_recordings(
            predictor,
            arguments.recordings,
            arguments.out,
            arguments.adapt or arguments.rest is not None,
            arguments.rest,
            reading_options(arguments),
            pictures,
            arguments.resample,
        )
    except predictions.UnpredictedRecordingsError as error:
        return error.count, error
    return count, None


def _check_options(arguments: argparse.Namespace) -> None:
    # Options of recordings and options of the test part exclude each other.
    if arguments.recordings and arguments.root is not None:
        raise ValueError(
            "'--root' must be left out with recordings: it is the folder of the test part"
        )
    is_saved = arguments.save is not None
    if arguments.contact is not None and not (arguments.recordings or is_saved):
        raise ValueError(
            "'--contact' must be left out without recordings and '--save': the samples of a test "
            "part may be relative to rest already, and all of them count in the scores"
        )
    for name in ("adapt", "rest", "resample"):
        if getattr(arguments, name) and not arguments.recordings:
            raise ValueError(
                f"'--{name}' must be left out without recordings: the scaling of the sessions of a "
                "test part is always measured, and its frames are those of the data set"
            )
    options = reading_options(arguments)
    if options and not arguments.recordings:
        raise ValueError(
            f"the options {[*options]} must be left out without recordings: the configuration "
            "determines how a test part is read"
        )


def _write_pictures(pictures: "PredictionPictures") -> None:
    from torch_geometric_tactile._texts import printable

    for path in pictures.write():
        print(printable(f"{path}: picture"))
    num_left_out = pictures.num_left_out
    if num_left_out:
        print(f"{num_left_out} more recording{'s' if num_left_out > 1 else ''}: no picture")
