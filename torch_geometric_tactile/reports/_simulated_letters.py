r"""Simulated presses of letters: a run with a progress bar, and its picture."""

import time
from pathlib import Path
from typing import NamedTuple

import numpy as np

from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.reports._simulation_progress import run_with_progress
from torch_geometric_tactile.sensors import TaxelLayout, as_layout
from torch_geometric_tactile.sim import (
    LETTER_PRESSES,
    LETTERS,
    LetterReport,
    num_letter_files,
    simulate_letters,
)
from torch_geometric_tactile.visualization.figure import save_figure
from torch_geometric_tactile.visualization.letters import plot_presses


class LettersRun(NamedTuple):
    r"""A finished run: the reports of its files, how many seconds it took, its folder, and the
    taxels if they are not those of the letter array.
    """

    reports: list[LetterReport]
    seconds: float
    out: Path
    layout: TaxelLayout | None = None

    def describe(self) -> str:
        r"""Returns the run in one line."""
        total = sum(report.presses for report in self.reports)
        kept = sum(report.presses for report in self.reports if report.kept)
        letters = len({report.letter for report in self.reports})
        return (
            f"{total} presses ({kept} kept from before) of {letters} letters, "
            f"{self.seconds:.0f} s; simulated data, not measured, in '{self.out}'"
        )


def run_letters(
    out: PathLike,
    *,
    presses: int | None = None,
    seed: int = 0,
    jobs: int = 1,
    layout: TaxelLayout | PathLike | None = None,
) -> LettersRun:
    r"""Runs :func:`~torch_geometric_tactile.sim.simulate_letters` with a progress bar on the
    terminal.
    """
    start = time.monotonic()
    number = LETTER_PRESSES if presses is None else presses
    layout = None if layout is None else as_layout(layout)
    reports = run_with_progress(
        simulate_letters(out, number, seed, jobs, layout=layout),
        num_letter_files(number),
        out,
        "file",
        lambda report: f"letter {report.letter}",
        "[A-Z]/*.npy",
    )
    return LettersRun(reports, time.monotonic() - start, Path(out), layout)


def draw_letters_preview(run: LettersRun) -> Path:
    r"""Draws the first press of each letter to :obj:`preview_letters.png` beside the folders of the
    letters, and returns the file.
    """
    path = run.out / "preview_letters.png"
    first = {report.letter: report.path for report in run.reports if report.first == 0}
    presses = [np.load(first[letter], mmap_mode="r")[0] for letter in LETTERS]
    title = "Simulated presses of letters: the first of each"
    save_figure(plot_presses(np.stack(presses), LETTERS, run.layout, title=title), path)
    return path
