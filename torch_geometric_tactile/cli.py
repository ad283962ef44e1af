r"""The ``tactile`` command. Nothing heavy is imported before the arguments are known."""

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import PurePath

from torch_geometric_tactile import __version__

_LIGHTNING = {
    "fit": "train a model from a configuration",
    "validate": "measure a checkpoint on the validation part",
    "test": "measure a checkpoint on the test part, also by recording session",
    "predict": "write what a checkpoint predicts to a CSV file",
}

_READABLE = ".h5, .hdf5, .npz, .csv, .json, .jsonl, .ndjson or .txt"
# The names in `sim`, which is not to be imported for them.
_OBJECT_SETS = ("paper8", "control8", "twenty")
_HANDS = ("allegro_uskin", "allegro_uskin_240")
_PRESETS = ("full", "ci")
# The names in `training`, likewise.
_TABLES = ("p1-table2", "p1-table3", "p2-table2", "p2-table4")
_BACKENDS = ("loky", "dask", "ray")
_WRITABLE = ".h5, .hdf5, .npz, .csv, .jsonl or .ndjson"

_SIMULATE = """\
Simulates an Allegro hand covered with 384 magnetic taxels that grasps, lifts and holds
objects of different mass, softness and friction, and writes one HDF5 recording a trial:
readings, joint angles, the object's properties and, apart, the true forces and poses.
Needs the extra 'sim'.
"""

_SIMULATE_EXAMPLES = """\
examples:
  tactile simulate --out grasps                          80 trials of 17 s of eight objects
  tactile simulate --out small --preset ci --preview     24 short and coarse trials in a minute
  tactile simulate --out control --objects control8      objects of one shape and size

Finished trials are kept: the same command goes on where a run was stopped, and with
--preview draws the pictures of a finished one. The same seed gives the same recordings,
whatever --jobs is. Masses, frictions and the skin are plausible, not measured.
"""

_TABLE = """\
Trains and tests the models of a table of the papers on recordings of an Allegro hand with 384
taxels, by trial and by frame, and writes the table beside the published numbers: DIR/NAME.md,
NAME.csv and NAME.png. Needs the extras 'train' and 'viz'.

tables:
  p1-table2   object properties by inputs: 36 GCNs, CNNs and FNNs, with and without joint angles
  p1-table3   object properties by adjacency: the best of them on four graphs
  p2-table2   objects by segmentation of the hand: 18 GCNs (and their ROC values, Table III)
  p2-table4   memory that training these 18 takes
"""

_TABLE_EXAMPLES = """\
examples:
  tactile simulate --out sim --jobs 2                    recordings to train on, if you have none
  tactile table p2-table2 --list                         the experiments and the published numbers
  tactile table p2-table2 --root sim --stride 200 --epochs 1 --seeds 1
                                                         a first look, in minutes
  tactile table p1-table2 --root sim --stride 20 --epochs 30 --jobs 2
  tactile table p1-table2 --root sim --stride 20 --epochs 30 --only '*gcn_te*'
                                                         only some models; the table has the rest
                                                         where it was trained before
  tactile table p1-table2 --root sim --stride 20 --backend dask --scheduler tcp://host:8786

Each run (a model, a seed, a split) is a file in DIR/runs when it is finished. The same command
goes on where it was stopped or killed. Tables of one DIR share their runs. Nothing is chosen by
the test part: the number of epochs is fixed, and the model is tested once, at the end.
One experiment alone: tactile fit --config p1_table2/mt_gcn_te_joint
"""

_EXAMPLES = """\
examples:
  tactile demo                                   from data to a judged model and a report
  tactile fit --config grasp_gcn_df              train GCN-DF on the BioTac SP stability set
  tactile fit --config grasp_gcn_df --ckpt_path runs/grasp_gcn_df/version_0/checkpoints/last.ckpt
                                                 go on where that training was stopped
  tactile test --config grasp_gcn_df --ckpt_path CHECKPOINT
  tactile fit --help                             every option of fit
  tactile analyze CHECKPOINT --out analysis      what a checkpoint has learnt, in pictures
  tactile inspect recording.h5                   what stands in a recording, and a picture of it
  tactile convert messages.jsonl recording.h5    another format, by the suffix
  tactile simulate --out grasps --trials 2 --preview
                                                 grasps of a simulated Allegro hand, with pictures
  tactile table p1-table2 --root grasps          the models of a paper, beside its published numbers

Data sets are read from $TACTILE_DATA (a folder with one folder for each data set), or
from a folder in the user's cache, where they are downloaded if missing.
"""


def build_parser() -> argparse.ArgumentParser:
    r"""Returns the parser of the command line."""
    parser = argparse.ArgumentParser(
        prog="tactile",
        description="Machine learning on robot touch with PyTorch Geometric.",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"tactile {__version__}")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)

    demo = commands.add_parser(
        "demo",
        help="train and judge grasp stability models on real grasps, and write a report",
        description="Trains GCN-DF, GCN-FF, one-finger GCNs, an SVM and a majority baseline on the "
        "BioTac SP stability set, judges each with random folds, with objects left out, and on the "
        "official test of unseen objects (also by palm pose), raw and scaled by session, and "
        "writes report.html, its pictures, metrics.json and the checkpoint of GCN-DF.",
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    demo.add_argument(
        "--root",
        default=os.environ.get("TACTILE_DATA"),
        help="folder with the six CSV files of the set, or with a folder 'BioTacSP' or 'biotacsp' "
        "that has them; by default $TACTILE_DATA, else they are downloaded, and with no network "
        "the data is generated",
    )
    demo.add_argument("--out", default="report", help="folder of the report")
    demo.add_argument("--seeds", type=_positive, default=3, help="trainings of every model")
    demo.add_argument("--folds", type=_positive, default=5, help="folds, at least 2")
    demo.add_argument(
        "--epochs", type=_positive, default=None, help="epochs, instead of the configurations' own"
    )
    demo.add_argument("--jobs", type=_positive, default=os.cpu_count() or 1, help="processes")
    demo.add_argument(
        "--generated", action="store_true", help="use generated data, whatever there is"
    )
    _add_inspect(commands)
    _add_convert(commands)
    _add_simulate(commands)
    _add_analyze(commands)
    _add_table(commands)
    for name, text in _LIGHTNING.items():
        commands.add_parser(name, help=text, add_help=False)
    return parser


def _add_inspect(commands: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    inspect = commands.add_parser(
        "inspect",
        help="tell and draw what stands in the file of a recording",
        description="Reads an HDF5, npz or CSV file of a recording, a log of xela_log or messages "
        "of XELA's server, prints frames, rate, taxels, readings, joints, dead taxels and "
        "metadata, and draws readings, contact and joints over time.",
    )
    inspect.add_argument("file", metavar="FILE", help=f"the recording ({_READABLE})")
    picture = inspect.add_mutually_exclusive_group()
    picture.add_argument(
        "--out",
        metavar="PICTURE",
        help="PNG file to draw; by default the name of the file with '_inspect.png', in the "
        "current folder",
    )
    picture.add_argument("--no-picture", action="store_true", help="print only")


def _add_convert(commands: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    convert = commands.add_parser(
        "convert",
        help="write a recording in another format",
        description="Reads a recording and writes it in the format of the other suffix. What that "
        "format cannot hold is named in a warning.",
    )
    convert.add_argument("source", metavar="IN", help=f"the recording ({_READABLE})")
    convert.add_argument("target", metavar="OUT", help=f"the file to write ({_WRITABLE})")
    convert.add_argument(
        "--forces", action="store_true", help="forces in newtons instead of counts, from XELA files"
    )


def _add_simulate(commands: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    simulate = commands.add_parser(
        "simulate",
        help="simulate grasps with an Allegro hand of 384 taxels, and write recordings",
        description=_SIMULATE,
        epilog=_SIMULATE_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    simulate.add_argument(
        "--out", metavar="DIR", required=True, help="folder of the recordings, made if missing"
    )
    simulate.add_argument(
        "--objects",
        choices=_OBJECT_SETS,
        default="paper8",
        help="which objects: eight of different shapes, every combination of light or heavy, hard "
        "or soft, slippery or not (paper8, the default); the same combinations in one shape and "
        "size (control8); five shapes in four sizes (twenty)",
    )
    simulate.add_argument(
        "--hand",
        choices=_HANDS,
        help="384 taxels, or 240 with none on the palm (default: the second for the objects "
        "twenty, else the first)",
    )
    simulate.add_argument(
        "--trials",
        metavar="N",
        type=_positive,
        help="trials of each object (default: 10, or 3 with the preset ci)",
    )
    simulate.add_argument(
        "--seed", type=_not_negative, default=0, help="decides all randomness (default: 0)"
    )
    simulate.add_argument(
        "--jobs", metavar="N", type=_positive, default=2, help="processes (default: 2)"
    )
    simulate.add_argument(
        "--preset",
        choices=_PRESETS,
        default="full",
        help="trials of 17 s with 100 frames a second (full, the default), or of 5 s with 50, "
        "coarser and about ten times as fast (ci)",
    )
    simulate.add_argument(
        "--max-attempts",
        metavar="N",
        type=_positive,
        default=10,
        help="grasps tried until the object is lifted and held, before a trial is given up "
        "(default: 10)",
    )
    simulate.add_argument(
        "--preview",
        action="store_true",
        help="draw the first trial of the first object to DIR/preview: preview_film.png and "
        "preview_forces.png",
    )


def _add_analyze(commands: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    analyze = commands.add_parser(
        "analyze",
        help="draw what a checkpoint has learnt: encoder map, embeddings, attribution, errors",
        description="Looks into a checkpoint of 'tactile fit' on its test part, and writes "
        "DIR/analysis.md with its pictures: confusion and ROC, the map of the edge encoder, node "
        "features by t-SNE and UMAP, and which taxels and patches count, each with numbers and "
        "beside untrained models.",
    )
    analyze.add_argument("checkpoint", metavar="CHECKPOINT", help="a checkpoint of 'tactile fit'")
    analyze.add_argument("--out", metavar="DIR", required=True, help="folder of page and pictures")
    analyze.add_argument(
        "--config",
        metavar="CONFIG",
        help="the configuration of its data, a file or a shipped one; by default the config.yaml "
        "that the run has beside its checkpoints",
    )
    analyze.add_argument(
        "--root", metavar="DIR", help="folder of the data, instead of the configuration's"
    )
    analyze.add_argument(
        "--frames",
        metavar="N",
        type=_positive,
        default=200,
        help="frames of the test part that are embedded and explained (default: 200)",
    )
    analyze.add_argument(
        "--seed",
        type=_not_negative,
        default=0,
        help="of embeddings and untrained models (default: 0)",
    )


def _analyze(arguments: argparse.Namespace) -> int:
    from torch_geometric_tactile.reports import analysis as analyze

    page = analyze.main(
        arguments.checkpoint,
        arguments.out,
        config=arguments.config,
        root=arguments.root,
        frames=arguments.frames,
        seed=arguments.seed,
    )
    print(f"analysis: {page}")
    return 0


def _add_table(commands: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    table = commands.add_parser(
        "table",
        help="train the models of a table of the papers, and write it beside the published numbers",
        description=_TABLE,
        epilog=_TABLE_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    table.add_argument("name", metavar="TABLE", choices=_TABLES, help=", ".join(_TABLES))
    table.add_argument(
        "--list", action="store_true", help="print the experiments with their published numbers"
    )
    table.add_argument(
        "--root",
        metavar="DIR",
        help="folder of the recordings; by default $TACTILE_DATA/AllegroUSkin, or a folder in the "
        "user's cache",
    )
    table.add_argument(
        "--out", metavar="DIR", default="tables", help="folder of table and runs (default: tables)"
    )
    table.add_argument(
        "--seeds",
        metavar="N",
        type=_positive,
        default=5,
        help="runs of each experiment; a seed decides split and training (default: 5)",
    )
    table.add_argument(
        "--epochs", metavar="N", type=_positive, help="epochs, instead of the configurations' 50"
    )
    table.add_argument(
        "--stride",
        metavar="N",
        type=_positive,
        default=1,
        help="use every N-th frame of each trial (default: 1, all)",
    )
    table.add_argument(
        "--phases",
        metavar="PHASE",
        nargs="+",
        help="use only frames in these phases of the grasp, such as: squeeze lift hold",
    )
    table.add_argument(
        "--split-by",
        nargs="+",
        choices=("trial", "frame"),
        default=("trial", "frame"),
        help="hold out whole trials, or random frames of all trials (default: both, one after the "
        "other, never mixed)",
    )
    table.add_argument(
        "--only", metavar="GLOB", nargs="+", help="train only experiments with such names"
    )
    table.add_argument(
        "--no-train", action="store_true", help="train nothing: the table of the finished runs"
    )
    table.add_argument(
        "--jobs", metavar="N", type=_positive, default=1, help="runs at a time (default: 1)"
    )
    table.add_argument(
        "--threads", metavar="N", type=_positive, default=1, help="threads of a run (default: 1)"
    )
    table.add_argument(
        "--accelerator", choices=("cpu", "gpu"), default="cpu", help="where to train (default: cpu)"
    )
    table.add_argument(
        "--backend",
        choices=_BACKENDS,
        default="loky",
        help="what starts the runs: processes of this machine (loky, the default), or Dask or Ray, "
        "which know many machines; they are extras of the same names",
    )
    table.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="a running cluster of Dask or Ray; by default one of --jobs processes is started here",
    )


def _inspect(arguments: argparse.Namespace) -> int:
    from torch_geometric_tactile.reports import recording as inspect

    recording, facts = inspect.describe_file(arguments.file)
    print(facts, flush=True)
    if not arguments.no_picture:
        picture = arguments.out or f"{PurePath(arguments.file).stem}_inspect.png"
        inspect.draw_recording(recording, picture)
        print(f"{'picture':<13}{picture}")
    return 0


def _convert(arguments: argparse.Namespace) -> int:
    from torch_geometric_tactile.reports import recording as inspect

    recording = inspect.convert_file(arguments.source, arguments.target, arguments.forces)
    print(f"{arguments.target}: {recording}")
    return 0


def _simulate(arguments: argparse.Namespace) -> int:
    from torch_geometric_tactile.commands import simulate as simulate_command

    if arguments.preview:
        simulate_command.check_preview()
    run = simulate_command.run_simulation(
        out=arguments.out,
        objects=arguments.objects,
        trials=arguments.trials,
        seed=arguments.seed,
        jobs=arguments.jobs,
        preset=arguments.preset,
        max_attempts=arguments.max_attempts,
        hand=arguments.hand,
    )
    print(run.describe(), flush=True)
    if run.given_up:
        print(f"tactile: error: {run.describe_given_up()}", file=sys.stderr, flush=True)
    if arguments.preview and len(run.given_up) < len(run.reports):
        for path in simulate_command.draw_preview(run, arguments.objects):
            print(f"drew {path}")
    return 1 if run.given_up else 0


def _table(arguments: argparse.Namespace) -> int:
    from torch_geometric_tactile.commands import table as table_command

    if arguments.list:
        print(table_command.list_table(arguments.name))
        return 0
    run, paths = table_command.make_table(
        arguments.name,
        root=arguments.root,
        out=arguments.out,
        seeds=arguments.seeds,
        epochs=arguments.epochs,
        stride=arguments.stride,
        phases=arguments.phases,
        split_by=arguments.split_by,
        accelerator=arguments.accelerator,
        threads=arguments.threads,
        only=arguments.only,
        jobs=arguments.jobs,
        backend=arguments.backend,
        scheduler=arguments.scheduler,
        train=not arguments.no_train,
    )
    print(run.describe(), flush=True)
    for path in paths:
        print(f"wrote {path}", flush=True)
    for name, reason in run.failed.items():
        print(f"tactile: error: {name}: {reason}", file=sys.stderr)
    return 1 if run.failed else 0


def _positive(text: str) -> int:
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError(f"must be at least 1 (got {number})")
    return number


def _not_negative(text: str) -> int:
    number = int(text)
    if number < 0:
        raise argparse.ArgumentTypeError(f"must not be negative (got {number})")
    return number


def _demo(arguments: argparse.Namespace) -> int:
    from torch_geometric_tactile.reports import grasp

    grasp.main(
        root=arguments.root,
        out=arguments.out,
        seeds=arguments.seeds,
        folds=arguments.folds,
        epochs=arguments.epochs,
        num_processes=arguments.jobs,
        generated=arguments.generated,
    )
    return 0


_COMMANDS = {
    "demo": _demo,
    "inspect": _inspect,
    "convert": _convert,
    "simulate": _simulate,
    "analyze": _analyze,
    "table": _table,
}


def main(argv: Sequence[str] | None = None) -> int:
    r"""Runs the command line.

    Args:
        argv (list of str, optional): The arguments; those of the process if left out.

    Returns:
        int: The exit status: 0, 1 for an error that was explained, 130 for Ctrl-C.
    """
    argv = list(sys.argv[1:] if argv is None else argv)
    try:
        if argv and argv[0] in _LIGHTNING:
            from torch_geometric_tactile.training import lightning_cli

            lightning_cli.main(argv)
        else:
            arguments = build_parser().parse_args(argv)
            return _COMMANDS[arguments.command](arguments)
    except BrokenPipeError:  # whoever read our output, such as `head`, has what it wanted
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except (ImportError, OSError, ValueError) as error:
        if os.environ.get("TACTILE_TRACEBACK"):
            raise
        print(f"tactile: error: {error}", file=sys.stderr)
        print("(TACTILE_TRACEBACK=1 shows where it came from)", file=sys.stderr)
        return 1
    except KeyboardInterrupt as stop:
        print(f"tactile: {str(stop) or 'stopped'}", file=sys.stderr)
        return 130
    return 0
