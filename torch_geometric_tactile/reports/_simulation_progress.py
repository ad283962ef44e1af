r"""A simulation with a progress bar."""

from collections.abc import Callable, Generator
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing
from pathlib import Path
from typing import TypeVar

from torch_geometric_tactile._typing import PathLike

_Report = TypeVar("_Report")


def run_with_progress(
    running: Generator[_Report, None, None],
    total: int,
    out: PathLike,
    unit: str,
    told: Callable[[_Report], str],
    files: str = "*.h5",
) -> list[_Report]:
    r"""Runs a simulation with a progress bar on the terminal, and returns its reports."""
    from tqdm import tqdm

    reports: list[_Report] = []
    try:
        # Without a terminal there is no bar, and with Ctrl-C none stays.
        with (
            tqdm(total=total, desc="Simulate", unit=unit, disable=None, leave=False) as bar,
            closing(running),
        ):
            for report in running:
                reports.append(report)
                bar.set_postfix_str(told(report), refresh=False)
                bar.update()
    except KeyboardInterrupt:
        finished = len(list(Path(out).glob(files)))
        raise KeyboardInterrupt(f"stopped; {finished} finished {unit}s are kept") from None
    except BrokenProcessPool as error:
        raise OSError(
            "a process of the simulation was killed, perhaps for lack of memory: run the same "
            f"command with fewer jobs (finished {unit}s are kept)"
        ) from error
    return reports
