r"""``tactile compare``: compares graph models and baselines on a data set and recommends one."""

import argparse
import json
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

from torch_geometric_tactile._checks import Argument, ArgumentError
from torch_geometric_tactile.commands._arguments import hertz, percentage, positive, small_count
from torch_geometric_tactile.commands._file_kinds import PICTURE, PREDICTOR, text_kind
from torch_geometric_tactile.commands._paths import (
    OutputFile,
    OutputFolder,
    OutputPath,
    files_in_folder,
    input_path,
    input_setting,
)
from torch_geometric_tactile.commands._reading import add_reading_options, reading_options
from torch_geometric_tactile.commands._runs import (
    add_rest,
    add_workers,
    describe_plan,
    option_names_in_errors,
    print_line,
    report_failures,
    run_with_bar,
)

if TYPE_CHECKING:
    from torch_geometric_tactile.experiments.compared_windows import FrameCut
    from torch_geometric_tactile.experiments.comparison import Comparison
    from torch_geometric_tactile.experiments.plan import PlanRun

# Repeats the names in `experiments`, which is too slow to import for the help.
MODELS = {
    "taxel_net": "TaxelNet, the default graph model",
    "posed_taxel_net": "PosedTaxelNet, for an Allegro hand with joint angles",
    "temporal": "TemporalTaxelNet, the graph model of windows and streams *",
    "gcn": "TactileGCN, plain GCN",
    "grasp_gcn": "GraspGCN, graph convolution on all frames of each taxel *",
    "fnn": "TactileFNN, fully connected",
    "cnn": "SmallCNN, for layouts with an image map, such as a grid",
    "bmf_cnn": "BMFCNN, for image maps of at least 20 x 20 cells",
    "lstm": "GraspLSTM, recurrent, on the readings of each frame *",
    "temporal_cnn": "TemporalCNN, a residual network over time on the readings of each frame *",
    "svm_rbf": "support vector machine, radial kernel",
    "svm_linear": "support vector machine, linear",
    "svm_signal": "support vector machine on 12 statistical features of each signal *",
    "minirocket": "ridge on random convolutions of windows of 9 frames or more (extra 'series') *",
    "forest": "random forest on the readings",
    "descriptors_svm": "support vector machine on descriptors of the layout",
    "descriptors_forest": "extra trees on descriptors of the layout and readings",
    "posed_forest": "random forest on force, centre, normal and count per patch",
    "posed_ridge": "ridge regression on the features of posed_forest",
    "constant": "the most frequent class, or the mean",
}

HELP = "Compare graph models and baselines on your data, and recommend one"
EXTRAS = "train,viz"
DESCRIPTION = f"""\
Trains graph models and baselines on a data set and tests each model once per split. The settings
of a model are selected on a part of the training samples. Writes DIR/NAME.md, .csv, .json and
.png. The last line recommends a model, states how well the scores support it, and ends with a
sentence to quote. Needs the extras 'train' and 'viz'.

data:
  FILE.npz     arrays x (S, N), (S, N, channels) or, with --grid, (S, rows, cols), and y (names or
               whole numbers for classes, other numbers for regression); optionally trial, group,
               session, set, joint, time (S, ...); and pos (N, 3) in metres without --layout, --grid
  FOLDER       a folder of recordings, read by the data set RecordingFrames
  CLASS        import path of a StaticDataset class, or the name of a class of this package.
               Also the import path of a PyG data set, or of a function that returns a PyG data
               set or a list of Data: samples from different sensors, for your own networks with
               forward(x, edge_index, batch)

models:
{chr(10).join(f"  {name:18} {title}" for name, title in MODELS.items())}
  * only for samples of several frames (--window, --trials); the three 'posed' models are only
    for single frames
  Name your own model by its import path: a network class, or a function or class that returns a
  scikit-learn estimator. A network class receives num_classes, layout, num_taxels, in_channels,
  ... if it has arguments of these names.
"""
EXAMPLES = """\
examples:
  tactile compare touches.npz --grid 28x50               all models, 5 folds by trial
  tactile compare touches.npz --layout skin.json --models taxel_net,svm_rbf,forest
  tactile compare touches.npz --layout biotac --by group --metric balanced_accuracy
  tactile compare touches.npz --grid 28x50 --models taxel_net,my_nets.MyNet
                                                         your own model and TaxelNet
  tactile compare grasps --layout allegro_uskin --stride 20 --jobs 2
  tactile compare glove --layout glove.json --pattern '{person}_{object}_{trial}' --by person
                                                         recordings p1_cup_003.csv: the score for a
                                                         new person
  tactile compare grasps --layout glove.json --rest 6 --label grasp --joint 'bend_.*' --unit count
                                                         CSV files with your own column names
  tactile compare grasps --layout allegro_uskin --init 'phases=[squeeze, lift, hold]' tare=hover
                                                         frames with contact only
  tactile compare my_glove.Gloves --init root=DIR --json > comparison.json
  tactile compare touches.npz --grid 8x8 --rest 10       each trial starts with 10 frames at rest
  tactile compare slips.npz --layout biotac --window 50  windows of 50 frames
  tactile compare slips.npz --layout biotac --window 50 --hop 10 --horizon 20
                                                         forecast 20 frames after the window
  tactile compare BiGS --init root=DIR --trials 60       each grasp, resampled to 60 frames
  tactile compare windows.npz --layout biotac --time-axis 1
                                                         x holds windows: (S, frames, N)
  tactile compare touches.npz --grid 8x8 --save best.predictor
                                                         also train the recommended model on all
                                                         samples, for predict, live and export
  tactile compare touches.npz --grid 8x8 --no-train --save svm.predictor --model svm_rbf
                                                         another model, from finished runs
  tactile compare touches.npz --grid 8x8 --epochs 5 --folds 2
                                                         a first look

Each finished run (a model on a split) is a file in DIR/runs: the same command resumes an
interrupted comparison. docs/compare.md explains the recommendation, and
docs/compare_settings.md how settings are selected.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    r"""Adds the arguments of the command to a parser."""
    parser.add_argument(
        "data",
        metavar="DATA",
        type=input_path,
        help="an npz file, a folder or a class; see above",
    )
    parser.add_argument(
        "--layout",
        metavar="LAYOUT",
        type=input_path,
        help="positions of the taxels: a stock layout or a layout file",
    )
    parser.add_argument(
        "--grid",
        metavar="ROWSxCOLS",
        type=str,
        help="the taxels form a planar array, such as 28x50",
    )
    parser.add_argument(
        "--task",
        choices=("multiclass", "regression"),
        help="kind of y (default: multiclass for names and whole numbers)",
    )
    parser.add_argument(
        "--init",
        metavar="KEY=VALUE",
        type=input_setting,
        nargs="+",
        action="extend",
        default=[],
        help="arguments of the data set, such as root=DIR or target=label; may be repeated",
    )
    parser.add_argument(
        "--pattern",
        metavar="PATTERN",
        type=str,
        help="form of the file names in a folder of recordings, such as "
        "'{person}_{object}_{trial}' for p1_cup_003.csv, or a regular expression with named groups "
        "(default: {object}_{trial})",
    )
    training = parser.add_argument_group("models and splits")
    training.add_argument(
        "--models",
        metavar="NAME,NAME",
        type=str,
        help="models to compare (default: all that fit the data)",
    )
    training.add_argument(
        "--by",
        metavar="NAME",
        type=str,
        help="samples that a split keeps together: trial, group (the object), session, frame "
        "(single samples), or a name in --pattern, labels.csv, the metadata of recordings or "
        "FILE.npz, such as person (default: trial; without trials, group if there are several "
        "groups; otherwise frame). 'given' uses the parts of the data set and recommends a model "
        "by validation scores",
    )
    training.add_argument(
        "--folds", metavar="N", type=small_count, default=5, help="number of folds (default: 5)"
    )
    training.add_argument(
        "--seeds",
        metavar="N",
        type=small_count,
        default=1,
        help="number of random draws of the folds or, with given parts, of training runs "
        "(default: 1)",
    )
    training.add_argument(
        "--metric",
        choices=("accuracy", "balanced_accuracy", "mae"),
        help="metric for selection and comparison (default: accuracy, or mae for regression)",
    )
    training.add_argument(
        "--epochs", metavar="N", type=positive, help="epochs per network (default: 15 to 60)"
    )
    training.add_argument(
        "--members",
        metavar="N",
        type=positive,
        help="networks in each averaged ensemble (default: 3, or 1 with many training samples or "
        "readings)",
    )
    training.add_argument(
        "--tolerance",
        metavar="POINTS",
        type=percentage,
        help="recommend a simpler model if it is at most POINTS worse than the best model and "
        "within one standard error of it (default: 1 percentage point; for regression, 2 percent "
        "of the smallest error)",
    )
    add_reading_options(parser)
    cut = parser.add_argument_group("windows and rest")
    cut.add_argument(
        "--window",
        metavar="N",
        type=positive,
        help="cut each trial into windows of N frames; a window has the label of its last frame",
    )
    cut.add_argument(
        "--hop",
        metavar="N",
        type=positive,
        help="frames between the starts of consecutive windows (default: N of --window, without "
        "overlap)",
    )
    cut.add_argument(
        "--horizon",
        metavar="N",
        type=positive,
        help="forecasting: label each window by the frame N frames after its last frame",
    )
    cut.add_argument(
        "--trials",
        metavar="N",
        type=positive,
        help="instead of windows: use each trial as one sample, resampled to N frames",
    )
    cut.add_argument(
        "--time-axis",
        metavar="AXIS",
        type=positive,
        help="for an npz file whose samples are windows: the dimension of x that is time (1 is the "
        "first after the samples)",
    )
    cut.add_argument(
        "--stride",
        metavar="N",
        type=positive,
        help="use every N-th frame of each trial (before windows are cut)",
    )
    cut.add_argument(
        "--resample",
        metavar="HZ",
        type=hertz,
        help="resample all recordings of a folder to HZ frames per second (before all other "
        "steps), for windows of recordings with different frame rates",
    )
    add_rest(cut)
    output = parser.add_argument_group("output")
    output.add_argument(
        "--out",
        metavar="DIR",
        type=OutputFolder("--out"),
        default="comparison",
        help="folder for the results (default: comparison)",
    )
    output.add_argument(
        "--save",
        metavar="FILE",
        type=OutputFile("--save", PREDICTOR),
        help="at the end, train the recommended model on all samples and write it as a predictor "
        "for 'tactile predict', 'live' and 'export'",
    )
    output.add_argument(
        "--model",
        metavar="NAME",
        type=str,
        help="with --save: the model to write instead of the recommended one",
    )
    output.add_argument(
        "--no-train",
        action="store_true",
        help="train nothing except the model for --save; write the table of the finished runs",
    )
    output.add_argument("--json", action="store_true", help="print the results as JSON")
    add_workers(parser)


def list_outputs(arguments: argparse.Namespace) -> list[OutputPath]:
    r"""Returns the files that the command writes."""
    name = _comparison_name(arguments.data)
    kinds = {
        f"{name}.md": text_kind("a page of 'tactile compare'", "# Models compared on "),
        f"{name}.csv": text_kind("a table of 'tactile compare'", "model,kind,metric,"),
        f"{name}.json": text_kind(
            "the results of 'tactile compare'", r'\{\s*"format": "tactile comparison"'
        ),
        f"{name}_predictions.csv": text_kind(
            "a table of predictions of 'tactile compare'", "model,seed,fold,"
        ),
        f"{name}.png": PICTURE,
    }
    return files_in_folder(arguments.out, kinds)


def run(arguments: argparse.Namespace) -> int:
    r"""Runs the command and returns the exit status."""
    names = {"data": "DATA", "tare": "--rest", "length": "--window", "num": "--trials"}
    with option_names_in_errors(arguments, {*_init_names(arguments.init)}, **names):
        return _run(arguments)


def _run(arguments: argparse.Namespace) -> int:
    from torch_geometric_tactile.experiments._compared_task import NO_PREDICTOR
    from torch_geometric_tactile.experiments.compared_windows import data_source
    from torch_geometric_tactile.experiments.comparison import (
        ComparisonSettings,
        comparison_plan,
        summarize,
    )
    from torch_geometric_tactile.reports._compare import write_comparison
    from torch_geometric_tactile.visualization._style import new_figure

    new_figure(1.0, 1.0)  # a missing matplotlib must fail before the long run
    settings = ComparisonSettings(
        models=None if arguments.models is None else _split_names(arguments.models),
        by=arguments.by,
        folds=arguments.folds,
        seeds=arguments.seeds,
        metric=arguments.metric,
        epochs=arguments.epochs,
        members=arguments.members,
        tare=None if arguments.rest is None else {"key": "trial", "first": arguments.rest},
        accelerator=arguments.accelerator,
        threads=arguments.threads,
        tolerance=None if arguments.tolerance is None else arguments.tolerance / 100,
    )
    source = data_source(
        arguments.data,
        layout=arguments.layout,
        grid=arguments.grid,
        task=arguments.task,
        time_axis=arguments.time_axis,
        arguments=_dataset_arguments(arguments),
        stride=arguments.stride,
        resample=arguments.resample,
        cut=_frame_cut(arguments),
    )
    plan = comparison_plan(source, settings, name=_comparison_name(arguments.data))
    _check_save_options(arguments, [cell.experiment for cell in plan.table.cells])
    if arguments.save is not None and plan.data.load().layout is None:
        raise ValueError(f"'--save' must be left out: {NO_PREDICTOR}")
    plan_run = run_with_bar(
        plan,
        arguments.out,
        arguments.jobs,
        plan.table.name,
        train=not arguments.no_train,
        on_estimate=lambda seconds: print_line(
            describe_plan(plan, arguments.jobs, seconds), arguments.json
        ),
        on_model=lambda run: print_line(_score_line(run), arguments.json),
    )
    comparison = summarize(plan_run, settings.tolerance)
    paths = write_comparison(comparison, arguments.out)
    _print_comparison(comparison, paths, arguments.json)
    status = report_failures(plan_run)
    if arguments.save is not None:
        _save_predictor(comparison, arguments)
    return status


def _check_save_options(arguments: argparse.Namespace, models: list[str]) -> None:
    # Called before the training, which may take hours.
    if arguments.model is not None and arguments.save is None:
        raise ValueError(f"'--model' must come with '--save' (got '{arguments.model}' alone)")
    if arguments.model is not None and arguments.model not in models:
        raise ValueError(
            f"'--model' must be a compared model: {', '.join(models)} (got '{arguments.model}')"
        )
    if arguments.save is not None and not Path(arguments.save).absolute().parent.is_dir():
        raise FileNotFoundError(f"the folder of '{arguments.save}' does not exist: create it")


def _save_predictor(comparison: "Comparison", arguments: argparse.Namespace) -> None:
    from torch_geometric_tactile._texts import printable
    from torch_geometric_tactile.experiments import advice, deploy, recommended

    if arguments.model is None and recommended(comparison) is None:
        raise ValueError(
            f"No model was saved. {advice(comparison)} Select a model with --model NAME"
        )
    predictor = deploy(comparison, arguments.model)
    predictor.save(arguments.save)
    text = f"wrote {arguments.save}: {predictor}\n  {predictor.score}"
    if predictor.preparation.session.transforms:
        rest = predictor.info.rest
        seconds = "SECONDS" if rest is None else f"{rest:.3g}"
        text += f"\n  measures the sensor at rest: tactile predict --rest {seconds}"
    print_line("\n".join(printable(line) for line in text.splitlines()), arguments.json)


def _frame_cut(arguments: argparse.Namespace) -> "FrameCut | None":
    from torch_geometric_tactile.experiments.compared_windows import FrameCut

    options = {name: getattr(arguments, name) for name in ("window", "hop", "horizon", "trials")}
    return None if set(options.values()) == {None} else FrameCut(**options)


def _print_comparison(comparison: "Comparison", paths: list[Path], as_json: bool) -> None:
    from tabulate import tabulate

    from torch_geometric_tactile._texts import printable
    from torch_geometric_tactile.experiments.advice import advice, to_dict
    from torch_geometric_tactile.reports._compare import comparison_rows, describe_sensors

    if as_json:
        print(json.dumps(to_dict(comparison), indent=1), flush=True)
        return
    header, rows = comparison_rows(comparison)
    if rows:
        print(tabulate(rows, header, disable_numparse=True), end="\n\n")
    sensors = describe_sensors(comparison.run.plan)
    print("\n".join(map(printable, filter(None, [sensors, comparison.run.describe()]))))
    for path in paths:
        print(printable(f"wrote {path}"))
    print(f"\n{printable(advice(comparison))}", flush=True)


def _score_line(run: "PlanRun") -> str:
    # The score of a model over all splits.
    from torch_geometric_tactile.experiments._scores import NAMES, format_score
    from torch_geometric_tactile.experiments.comparison import summarize

    comparison = summarize(run)
    (result,), metric = comparison.results, comparison.metric
    mean, sd = (format_score(metric, value) for value in result.scores[metric])
    spread = f" ± {sd}" if len(run.results) > 1 else ""
    unit = "seed" if comparison.has_given_parts else "split"
    name = result.model.name
    return f"{name:18} {NAMES[metric]} {mean}{spread}, {result.seconds:,.1f} s per {unit}"


def _split_names(text: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in text.split(",") if name.strip())


def _init_names(pairs: list[str]) -> list[str]:
    return [pair.partition("=")[0] for pair in pairs]


def _dataset_arguments(arguments: argparse.Namespace) -> dict[str, Any]:
    r"""Returns the arguments of the data set: the arguments in :obj:`--init`, the pattern, and the
    options for reading recordings.
    """
    dataset_arguments, reading = _parse_init(arguments.init), reading_options(arguments)
    folder_options = [*(["pattern"] if arguments.pattern else []), *reading]
    if folder_options and not Path(arguments.data).is_dir():
        raise ArgumentError(
            Argument(folder_options[0]),
            f" must be left out unless DATA is a folder of recordings (got '{arguments.data}')",
        )
    unit = reading.pop("unit", None)  # applies to recordings of all formats
    options = {"pattern": arguments.pattern, "unit": unit, "read_options": reading or None}
    options = {name: value for name, value in options.items() if value is not None}
    for name in {*options} & {*dataset_arguments}:
        option = next(iter(reading)) if name == "read_options" else name
        raise ValueError(
            f"'--{option.replace('_', '-')}' and '--init {name}=' must not both be given"
        )
    target = {"target": reading["label"]} if "label" in reading else {}
    return {**target, **options, **dataset_arguments}


def _parse_init(pairs: list[str]) -> dict[str, Any]:
    r"""Returns the arguments of the data set, parsed from pairs :obj:`KEY=VALUE`."""
    import yaml

    dataset_arguments = {}
    for pair in pairs:
        key, equals, value = pair.partition("=")
        if not equals or not key.isidentifier():
            raise ValueError(f"'--init' must be KEY=VALUE, such as root=DIR (got '{pair}')")
        try:
            dataset_arguments[key] = yaml.safe_load(value)
        except yaml.YAMLError as error:
            raise ValueError(f"'--init {key}' must be a plain value (got '{value}')") from error
    return dataset_arguments


def _comparison_name(data: str) -> str:
    # A part of file names: characters other than letters, digits and underscores become dashes.
    stem = Path(data).stem if data.endswith(".npz") else Path(data).name.rpartition(".")[2]
    return re.sub(r"[^\w-]+", "-", stem or Path(data).resolve().name).strip("-") or "comparison"
