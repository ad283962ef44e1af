r"""Runs simulations with a progress bar, and summarises and draws the results."""

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Generator
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.io import read_recording
from torch_geometric_tactile.sensors import HandKinematics, TaxelLayout, as_layout, stock_layout
from torch_geometric_tactile.sim import (
    LETTERS,
    PRESETS,
    SPREADS,
    BigsReport,
    LetterReport,
    TrialReport,
    simulate,
    simulate_bigs,
    simulate_letters,
)
from torch_geometric_tactile.sim._object_sets import object_set
from torch_geometric_tactile.sim.simulate_bigs import BIGS_GRASPS
from torch_geometric_tactile.sim.simulate_letters import LETTER_PRESSES, num_letter_files
from torch_geometric_tactile.visualization import plot_bigs_grasps, plot_presses, save_figure
from torch_geometric_tactile.visualization._grasp_film import plot_grasp_film, plot_grasp_forces

_Report = TypeVar("_Report", TrialReport, BigsReport, LetterReport)


@dataclass(frozen=True)
class FinishedRun(ABC, Generic[_Report]):
    r"""A finished run: its reports, its duration in seconds and its folder."""

    reports: list[_Report]
    seconds: float
    out: Path

    @property
    def failures(self) -> list[_Report]:
        r"""The reports of trials without a successful attempt."""
        return []

    def describe(self) -> str:
        r"""Returns a summary of the run in one line."""
        end = f"{self.seconds:.0f} s; simulated data, not measured, in '{self.out}'"
        return f"{self._counts()}, {end}"

    @abstractmethod
    def _counts(self) -> str: ...

    @abstractmethod
    def draw_preview(self) -> list[Path]:
        r"""Draws examples of the run to files in its folder, and returns their paths."""


@dataclass(frozen=True)
class SimulatedRun(FinishedRun[TrialReport]):
    r"""Trials of the Allegro hand, and the names of their objects in the order of the object
    set.
    """

    object_names: list[str]

    @property
    def failures(self) -> list[TrialReport]:
        r"""The reports of trials in which no attempt lifted and held, or squeezed, the object."""
        return [report for report in self.reports if report.path is None]

    def _counts(self) -> str:
        num_reused = sum(report.kept for report in self.reports)
        num_attempts = sum(report.attempts for report in self.reports)
        rate = (len(self.reports) - len(self.failures)) / max(num_attempts, 1)
        return (
            f"{len(self.reports)} trials ({num_reused} from an earlier run), "
            f"{num_attempts} attempts, {100 * rate:.0f} % of them successful"
        )

    def describe_failures(self) -> str:
        r"""Returns one line that lists the failed trials."""
        names = sorted(f"{report.object_name} {report.trial}" for report in self.failures)
        attempts = self.failures[0].attempts
        return f"{len(names)} trials failed after {attempts} attempts each: {', '.join(names)}"

    def draw_preview(self) -> list[Path]:
        r"""Draws the first trial of the first object, as a film and as forces."""
        successes = [report for report in self.reports if report.path is not None]
        successes.sort(
            key=lambda report: (self.object_names.index(report.object_name), report.trial)
        )
        need(successes, "a preview must have a successful trial (got none)")
        assert successes[0].path is not None
        recording, hand = read_recording(successes[0].path), HandKinematics.allegro()
        layout = stock_layout(recording.meta["sensor"])
        pictures = {
            self.out / "preview" / "preview_film.png": plot_grasp_film,
            self.out / "preview" / "preview_forces.png": plot_grasp_forces,
        }
        for path, plot in pictures.items():
            save_figure(plot(recording, layout, hand), path)
        return list(pictures)


@dataclass(frozen=True)
class BigsRun(FinishedRun[BigsReport]):
    r"""Grasps in the format of BiGS."""

    def _counts(self) -> str:
        num_reused = sum(report.kept for report in self.reports)
        rates = []
        for name in sorted({report.object_name for report in self.reports}):
            successes = [report.success for report in self.reports if report.object_name == name]
            rates.append(f"{name} {sum(successes)} of {len(successes)}")
        return (
            f"{len(self.reports)} grasps ({num_reused} from an earlier run), "
            f"held: {', '.join(rates)}"
        )

    def draw_preview(self) -> list[Path]:
        r"""Draws the first stable grasp and a grasp that lost its object. The second grasp is
        preferably of the same object and lost during the shake.
        """
        path = self.out / "preview" / "preview_grasps.png"
        ordered = sorted(self.reports, key=lambda report: report.trial)
        stable = [report for report in ordered if report.success][:1]
        object_name = (stable or ordered)[0].object_name
        lost = [report for report in ordered if report.lost is not None]
        # The shake begins by 2.25 s, so objects lost after 2.5 s were lost in the shake.
        lost.sort(
            key=lambda report: ((report.lost or 0.0) < 2.5, report.object_name != object_name)
        )
        recordings = [read_recording(report.path) for report in [*stable, *lost[:1]]]
        save_figure(plot_bigs_grasps(recordings), path)
        return [path]


@dataclass(frozen=True)
class LettersRun(FinishedRun[LetterReport]):
    r"""Presses of letters, and the layout (:obj:`None`: the letter array)."""

    layout: TaxelLayout | None = None

    def _counts(self) -> str:
        num_presses = sum(report.presses for report in self.reports)
        num_reused = sum(report.presses for report in self.reports if report.kept)
        num_letters = len({report.letter for report in self.reports})
        return f"{num_presses} presses ({num_reused} from an earlier run) of {num_letters} letters"

    def draw_preview(self) -> list[Path]:
        r"""Draws the first press of each letter. The picture is not in a subfolder, because the
        data set reads every subfolder as a letter.
        """
        path = self.out / "preview_letters.png"
        first_files = {report.letter: report.path for report in self.reports if report.first == 0}
        presses = np.stack([np.load(first_files[letter], mmap_mode="r")[0] for letter in LETTERS])
        title = "Simulated letters: the first press of each"
        save_figure(plot_presses(presses, LETTERS, self.layout, label="kPa", title=title), path)
        return [path]


def run_simulation(
    out: PathLike,
    *,
    objects: str = "paper8",
    trials: int | None = None,
    seed: int = 0,
    jobs: int = 1,
    preset: str = "full",
    max_attempts: int = 10,
    hand: str | None = None,
    spread: str = "careful",
    seconds: float | None = None,
    num_objects: int | None = None,
    motion: str = "lift",
) -> SimulatedRun:
    r"""Runs :func:`~torch_geometric_tactile.sim.simulate` with a progress bar on the terminal."""
    simulation = simulate(
        out,
        objects,
        trials,
        seed,
        jobs,
        preset=preset,
        max_attempts=max_attempts,
        hand=hand,
        plan=SPREADS[spread],
        seconds=seconds,
        num_objects=num_objects,
        motion=motion,
    )
    names = [item.name for item in object_set(objects, num_objects, seed)[1]]
    total = len(names) * (trials or PRESETS[preset].trials)

    def format_progress(reports: list[TrialReport]) -> str:
        return f"{sum(report.attempts for report in reports)} attempts"

    return SimulatedRun(
        *_run_with_progress(simulation, total, out, "trial", format_progress), names
    )


def run_bigs(out: PathLike, *, grasps: int | None = None, seed: int = 0, jobs: int = 1) -> BigsRun:
    r"""Runs :func:`~torch_geometric_tactile.sim.simulate_bigs` with a progress bar on the
    terminal.
    """
    total = BIGS_GRASPS if grasps is None else grasps

    def format_progress(reports: list[BigsReport]) -> str:
        return f"{sum(report.success for report in reports)} held"

    return BigsRun(
        *_run_with_progress(
            simulate_bigs(out, total, seed, jobs), total, out, "grasp", format_progress
        )
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
    num_presses = LETTER_PRESSES if presses is None else presses
    layout = None if layout is None else as_layout(layout)
    simulation = simulate_letters(out, num_presses, seed, jobs, layout=layout)

    def format_progress(reports: list[LetterReport]) -> str:
        return f"letter {reports[-1].letter}"

    total, file_pattern = num_letter_files(num_presses), "[A-Z]/*.npy"
    return LettersRun(
        *_run_with_progress(simulation, total, out, "file", format_progress, file_pattern), layout
    )


def _run_with_progress(
    simulation: Generator[_Report, None, None],
    total: int,
    out: PathLike,
    unit: str,
    format_progress: Callable[[list[_Report]], str],
    file_pattern: str = "*.h5",
) -> tuple[list[_Report], float, Path]:
    # Returns the reports of a simulation, its duration in seconds and its folder.
    from tqdm import tqdm

    start = time.monotonic()
    reports: list[_Report] = []
    try:
        # disable=None hides the bar without a terminal, leave=False clears it after Ctrl-C.
        with (
            tqdm(total=total, desc="Simulate", unit=unit, disable=None, leave=False) as bar,
            closing(simulation),
        ):
            for report in simulation:
                reports.append(report)
                bar.set_postfix_str(format_progress(reports), refresh=False)
                bar.update()
    except KeyboardInterrupt:
        num_finished = len(list(Path(out).glob(file_pattern)))
        raise KeyboardInterrupt(f"stopped; {num_finished} finished {unit}s are kept") from None
    except BrokenProcessPool as error:
        raise OSError(
            "a process of the simulation was killed, perhaps for lack of memory: run the same "
            f"command with fewer jobs (finished {unit}s are kept)"
        ) from error
    return reports, time.monotonic() - start, Path(out)
