r"""Simulations: a run with a progress bar, its summary and its pictures."""

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
    BIGS_GRASPS,
    LETTER_PRESSES,
    LETTERS,
    PRESETS,
    SPREADS,
    BigsReport,
    LetterReport,
    TrialReport,
    num_letter_files,
    object_set,
    simulate,
    simulate_bigs,
    simulate_letters,
)
from torch_geometric_tactile.visualization import plot_bigs_grasps, plot_presses, save_figure
from torch_geometric_tactile.visualization._grasp_film import plot_grasp_film, plot_grasp_forces

_Report = TypeVar("_Report", TrialReport, BigsReport, LetterReport)


@dataclass(frozen=True)
class FinishedRun(ABC, Generic[_Report]):
    r"""A finished run: its reports, how many seconds it took, and its folder."""

    reports: list[_Report]
    seconds: float
    out: Path

    @property
    def given_up(self) -> list[_Report]:
        r"""What was tried in vain."""
        return []

    def describe(self) -> str:
        r"""Returns the run in one line."""
        end = f"{self.seconds:.0f} s; simulated data, not measured, in '{self.out}'"
        return f"{self._counts()}, {end}"

    @abstractmethod
    def _counts(self) -> str: ...

    @abstractmethod
    def draw_preview(self) -> list[Path]:
        r"""Draws some of the run to files beside the recordings, and returns them."""


@dataclass(frozen=True)
class SimulatedRun(FinishedRun[TrialReport]):
    r"""Trials of the Allegro hand, and the names of their objects in their order."""

    object_names: list[str]

    @property
    def given_up(self) -> list[TrialReport]:
        r"""The trials in which no attempt lifted and held the object, or squeezed it."""
        return [report for report in self.reports if report.path is None]

    def _counts(self) -> str:
        kept = sum(report.kept for report in self.reports)
        attempts = sum(report.attempts for report in self.reports)
        rate = (len(self.reports) - len(self.given_up)) / max(attempts, 1)
        return (
            f"{len(self.reports)} trials ({kept} kept from before), {attempts} attempts, "
            f"{100 * rate:.0f} % of them successful"
        )

    def describe_given_up(self) -> str:
        r"""Returns what was given up in one line."""
        names = sorted(f"{report.object_name} {report.trial}" for report in self.given_up)
        attempts = self.given_up[0].attempts
        return f"{len(names)} trials given up after {attempts} attempts each: {', '.join(names)}"

    def draw_preview(self) -> list[Path]:
        r"""Draws the first trial of the first object, as a film and as forces."""
        done = [report for report in self.reports if report.path is not None]
        done.sort(key=lambda report: (self.object_names.index(report.object_name), report.trial))
        need(done, "a preview must have a trial to show (got none that succeeded)")
        assert done[0].path is not None
        recording, hand = read_recording(done[0].path), HandKinematics.allegro()
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
    r"""Grasps of the BiGS form."""

    def _counts(self) -> str:
        kept = sum(report.kept for report in self.reports)
        rates = []
        for name in sorted({report.object_name for report in self.reports}):
            mine = [report.success for report in self.reports if report.object_name == name]
            rates.append(f"{name} {sum(mine)} of {len(mine)}")
        return f"{len(self.reports)} grasps ({kept} kept from before), held: {', '.join(rates)}"

    def draw_preview(self) -> list[Path]:
        r"""Draws the first grasp that held and, beside it, the first of the same object that was
        lost in the shake, or if there is none any that was lost.
        """
        path = self.out / "preview" / "preview_grasps.png"
        ordered = sorted(self.reports, key=lambda report: report.trial)
        held = [report for report in ordered if report.success][:1]
        name = (held or ordered)[0].object_name
        lost = [report for report in ordered if report.lost is not None]
        lost.sort(key=lambda report: ((report.lost or 0.0) < 2.5, report.object_name != name))
        shown = [read_recording(report.path) for report in [*held, *lost[:1]]]
        save_figure(plot_bigs_grasps(shown), path)
        return [path]


@dataclass(frozen=True)
class LettersRun(FinishedRun[LetterReport]):
    r"""Presses of letters, and the taxels if they are not those of the letter array."""

    layout: TaxelLayout | None = None

    def _counts(self) -> str:
        total = sum(report.presses for report in self.reports)
        kept = sum(report.presses for report in self.reports if report.kept)
        letters = len({report.letter for report in self.reports})
        return f"{total} presses ({kept} kept from before) of {letters} letters"

    def draw_preview(self) -> list[Path]:
        r"""Draws the first press of each letter; not to a folder, which would be a letter."""
        path = self.out / "preview_letters.png"
        first = {report.letter: report.path for report in self.reports if report.first == 0}
        presses = np.stack([np.load(first[letter], mmap_mode="r")[0] for letter in LETTERS])
        title = "Simulated presses of letters: the first of each"
        save_figure(plot_presses(presses, LETTERS, self.layout, title=title), path)
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
    running = simulate(
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

    def in_words(reports: list[TrialReport]) -> str:
        return f"{sum(report.attempts for report in reports)} attempts"

    return SimulatedRun(*_watched(running, total, out, "trial", in_words), names)


def run_bigs(out: PathLike, *, grasps: int | None = None, seed: int = 0, jobs: int = 1) -> BigsRun:
    r"""Runs :func:`~torch_geometric_tactile.sim.simulate_bigs` likewise."""
    total = BIGS_GRASPS if grasps is None else grasps

    def in_words(reports: list[BigsReport]) -> str:
        return f"{sum(report.success for report in reports)} held"

    return BigsRun(*_watched(simulate_bigs(out, total, seed, jobs), total, out, "grasp", in_words))


def run_letters(
    out: PathLike,
    *,
    presses: int | None = None,
    seed: int = 0,
    jobs: int = 1,
    layout: TaxelLayout | PathLike | None = None,
) -> LettersRun:
    r"""Runs :func:`~torch_geometric_tactile.sim.simulate_letters` likewise."""
    number = LETTER_PRESSES if presses is None else presses
    layout = None if layout is None else as_layout(layout)
    running = simulate_letters(out, number, seed, jobs, layout=layout)

    def in_words(reports: list[LetterReport]) -> str:
        return f"letter {reports[-1].letter}"

    total, files = num_letter_files(number), "[A-Z]/*.npy"
    return LettersRun(*_watched(running, total, out, "file", in_words, files), layout)


def _watched(
    running: Generator[_Report, None, None],
    total: int,
    out: PathLike,
    unit: str,
    in_words: Callable[[list[_Report]], str],
    files: str = "*.h5",
) -> tuple[list[_Report], float, Path]:
    # The reports of a simulation with a progress bar, its seconds and its folder.
    from tqdm import tqdm

    start = time.monotonic()
    reports: list[_Report] = []
    try:
        # Without a terminal there is no bar, and with Ctrl-C none stays.
        with (
            tqdm(total=total, desc="Simulate", unit=unit, disable=None, leave=False) as bar,
            closing(running),
        ):
            for report in running:
                reports.append(report)
                bar.set_postfix_str(in_words(reports), refresh=False)
                bar.update()
    except KeyboardInterrupt:
        finished = len(list(Path(out).glob(files)))
        raise KeyboardInterrupt(f"stopped; {finished} finished {unit}s are kept") from None
    except BrokenProcessPool as error:
        raise OSError(
            "a process of the simulation was killed, perhaps for lack of memory: run the same "
            f"command with fewer jobs (finished {unit}s are kept)"
        ) from error
    return reports, time.monotonic() - start, Path(out)
