r"""Simulated grasps of the BiGS form: a run with a progress bar, its summary and its picture."""

import time
from pathlib import Path
from typing import NamedTuple

from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.io import read_recording
from torch_geometric_tactile.reports._simulation_progress import run_with_progress
from torch_geometric_tactile.sim import BIGS_GRASPS, BigsReport, simulate_bigs
from torch_geometric_tactile.visualization.bigs_grasp import plot_bigs_grasps
from torch_geometric_tactile.visualization.figure import save_figure


class BigsRun(NamedTuple):
    r"""A finished run: the reports of its grasps, how many seconds it took, and its folder."""

    reports: list[BigsReport]
    seconds: float
    out: Path

    def describe(self) -> str:
        r"""Returns the run in one line."""
        kept = sum(report.kept for report in self.reports)
        rates = []
        for name in sorted({report.object_name for report in self.reports}):
            mine = [report.success for report in self.reports if report.object_name == name]
            rates.append(f"{name} {sum(mine)} of {len(mine)}")
        return (
            f"{len(self.reports)} grasps ({kept} kept from before), held: {', '.join(rates)}, "
            f"{self.seconds:.0f} s; simulated data, not measured, in '{self.out}'"
        )


def run_bigs(out: PathLike, *, grasps: int | None = None, seed: int = 0, jobs: int = 1) -> BigsRun:
    r"""Runs :func:`~torch_geometric_tactile.sim.simulate_bigs` with a progress bar on the
    terminal.
    """
    start = time.monotonic()
    total = BIGS_GRASPS if grasps is None else grasps
    held = 0

    def told(report: BigsReport) -> str:
        nonlocal held
        held += report.success
        return f"{held} held"

    reports = run_with_progress(simulate_bigs(out, total, seed, jobs), total, out, "grasp", told)
    return BigsRun(reports, time.monotonic() - start, Path(out))


def draw_bigs_preview(run: BigsRun) -> Path:
    r"""Draws the first grasp that held and, beside it, the first of the same object that was lost
    in the shake, or if there is none any that was lost, to the folder :obj:`preview` below the
    recordings, and returns the file.
    """
    path = run.out / "preview" / "preview_grasps.png"
    recordings = [read_recording(report.path) for report in _shown(run.reports)]
    save_figure(plot_bigs_grasps(recordings), path)
    return path


def _shown(reports: list[BigsReport]) -> list[BigsReport]:
    ordered = sorted(reports, key=lambda report: report.trial)
    held = [report for report in ordered if report.success][:1]
    name = held[0].object_name if held else ordered[0].object_name
    lost = [report for report in ordered if report.lost is not None]
    lost.sort(key=lambda report: ((report.lost or 0.0) < 2.5, report.object_name != name))
    return [*held, *lost[:1]]
