r"""A progress bar for runs."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from torch_geometric_tactile.experiments._experiment import Experiment
    from torch_geometric_tactile.experiments.run_plan import OnProgress


@contextmanager
def progress(title: str, unit: str) -> Iterator["OnProgress"]:
    r"""Shows a progress bar, and yields what is to be called with each run that ended. There is
    none without a terminal, and none stays after Ctrl-C.
    """
    from tqdm import tqdm

    with tqdm(desc=title, unit=unit, disable=None, leave=False) as bar:

        def show(experiment: "Experiment", ended: int, all_runs: int) -> None:
            bar.total = all_runs
            bar.set_postfix_str(experiment.label, refresh=False)
            bar.update(ended - bar.n)

        yield show
