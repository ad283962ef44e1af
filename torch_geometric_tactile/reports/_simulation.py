r"""Simulated grasps: a run with a progress bar, its summary and its pictures."""

import time
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.io import read_recording
from torch_geometric_tactile.reports._simulation_progress import run_with_progress
from torch_geometric_tactile.sensors import HandKinematics, stock_layout
from torch_geometric_tactile.sim import PRESETS, SPREADS, TrialReport, object_set, simulate
from torch_geometric_tactile.visualization._grasp_film import plot_grasp_film, plot_grasp_forces
from torch_geometric_tactile.visualization._new_figure import new_figure
from torch_geometric_tactile.visualization.figure import save_figure


class SimulatedRun(NamedTuple):
    r"""A finished run: the reports of its trials, how many seconds it took, its folder, and the
    names of its objects in their order.
    """

    reports: list[TrialReport]
    seconds: float
    out: Path
    object_names: list[str]

    @property
    def given_up(self) -> list[TrialReport]:
        r"""The trials in which no attempt lifted and held the object, or squeezed it."""
        return [report for report in self.reports if report.path is None]

    def describe(self) -> str:
        r"""Returns the run in one line."""
        kept = sum(report.kept for report in self.reports)
        attempts = sum(report.attempts for report in self.reports)
        rate = (len(self.reports) - len(self.given_up)) / max(attempts, 1)
        return (
            f"{len(self.reports)} trials ({kept} kept from before), {attempts} attempts, "
            f"{100 * rate:.0f} % of them successful, {self.seconds:.0f} s; "
            f"simulated data, not measured, in '{self.out}'"
        )

    def describe_given_up(self) -> str:
        r"""Returns what was given up in one line."""
        names = sorted(f"{report.object_name} {report.trial}" for report in self.given_up)
        attempts = self.given_up[0].attempts
        return f"{len(names)} trials given up after {attempts} attempts each: {', '.join(names)}"


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
    start = time.monotonic()
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
    attempts = 0

    def told(report: TrialReport) -> str:
        nonlocal attempts
        attempts += report.attempts
        return f"{attempts} attempts"

    reports = run_with_progress(running, total, out, "trial", told)
    return SimulatedRun(reports, time.monotonic() - start, Path(out), names)


def check_preview() -> None:
    r"""Tells before a long run whether its pictures can be drawn."""
    new_figure(1.0, 1.0)


def draw_preview(run: SimulatedRun) -> list[Path]:
    r"""Draws the first trial of the first object, as a film and as forces, to the folder
    :obj:`preview` below the recordings, and returns the files.
    """
    first = _first_trial(run.reports, run.object_names)
    if first is None:
        raise ValueError("a preview must have a trial to show (got none that succeeded)")
    recording, hand = read_recording(first), HandKinematics.allegro()
    layout = stock_layout(recording.meta["sensor"])
    pictures = {
        run.out / "preview" / "preview_film.png": plot_grasp_film,
        run.out / "preview" / "preview_forces.png": plot_grasp_forces,
    }
    for path, plot in pictures.items():
        save_figure(plot(recording, layout, hand), path)
    return list(pictures)


def _first_trial(reports: Iterable[TrialReport], names: list[str]) -> Path | None:
    done = [report for report in reports if report.path is not None]
    done.sort(key=lambda report: (names.index(report.object_name), report.trial))
    return done[0].path if done else None
