r"""What the command ``tactile table`` does: runs with a progress bar, and the table of them."""

from collections.abc import Sequence
from pathlib import Path

from tabulate import tabulate
from tqdm import tqdm

from torch_geometric_tactile.experiments.experiment import Experiment
from torch_geometric_tactile.experiments.plan import Settings, TableRun, run_table
from torch_geometric_tactile.experiments.tables import load_table
from torch_geometric_tactile.parallel import Backend
from torch_geometric_tactile.reports.table import write_table
from torch_geometric_tactile.typing import PathLike
from torch_geometric_tactile.visualization.figure import new_figure

_HEADERS = {"accuracy": "accuracy (%)", "spread": "±", "auc": "ROC", "memory": "memory (MB)"}


def list_table(name: str) -> str:
    r"""Returns the experiments of a table, with the numbers that the paper prints.

    Args:
        name (str): Name of the table.

    Raises:
        ValueError: If there is no such table.
    """
    table = load_table(name)
    keys = [key for key in _HEADERS if any(key in cell.published for cell in table.cells)]
    rows = [
        [cell.experiment, cell.row, cell.column, cell.section]
        + [cell.published.get(key) for key in keys]
        for cell in table.cells
    ]
    headers = ["experiment", "model", "inputs", "", *(_HEADERS[key] for key in keys)]
    return (
        f"{table.title}\n{len(rows)} experiments; published numbers ({table.place}), of a real "
        f"hand with private recordings:\n\n{tabulate(rows, headers)}\n\n"
        f"One of them alone: tactile fit --config {table.template}/{table.cells[0].experiment}"
    )


def make_table(
    name: str,
    root: PathLike | None,
    out: PathLike,
    seeds: int,
    epochs: int | None,
    stride: int,
    phases: Sequence[str] | None,
    split_by: Sequence[str],
    accelerator: str,
    threads: int,
    only: Sequence[str] | None,
    jobs: int,
    backend: Backend,
    scheduler: str | None,
    train: bool,
) -> tuple[TableRun, list[Path]]:
    r"""Runs the experiments of a table with a progress bar on the terminal, writes the table, and
    returns what was run and the files.

    Args:
        name (str): Name of the table.
        root (str or PathLike, optional): Folder of the recordings.
        out (str or PathLike): Folder of the results.
        seeds (int): Runs of each experiment.
        epochs (int, optional): Epochs, instead of those of the configurations.
        stride (int): Only every :obj:`stride`-th frame.
        phases (sequence of str, optional): Only frames in these phases.
        split_by (sequence of str): :obj:`"trial"`, :obj:`"frame"` or both.
        accelerator (str): :obj:`"cpu"` or :obj:`"gpu"`.
        threads (int): Threads of a run.
        only (sequence of str, optional): Train only experiments with names like these patterns.
        jobs (int): Runs at a time.
        backend (str): :obj:`"loky"`, :obj:`"dask"` or :obj:`"ray"`.
        scheduler (str, optional): Address of a running cluster.
        train (bool): Whether to train what is missing.

    Raises:
        FileNotFoundError: If there are no recordings.
        ImportError: If matplotlib or the package of the backend is missing.
        KeyboardInterrupt: On Ctrl-C; the message tells how many runs are kept.
        OSError: If a process was killed, or a file cannot be written.
        ValueError: If an argument is wrong.
    """
    new_figure(1.0, 1.0)  # tells before a long run whether its picture can be drawn
    settings = Settings(seeds, epochs, stride, phases, split_by, accelerator, threads)
    # Without a terminal there is no bar, and with Ctrl-C none stays.
    with tqdm(desc=name, unit="run", disable=None, leave=False) as bar:

        def show(experiment: Experiment, ended: int, all_runs: int) -> None:
            bar.total = all_runs
            bar.set_postfix_str(experiment.label, refresh=False)
            bar.update(ended - bar.n)

        run = run_table(
            name, root, out, settings, only, jobs, backend, scheduler, train, on_progress=show
        )
    return run, write_table(run, out)
