r"""Recordings of simulated grasps: many trials, on many processes, finished ones kept."""

import json
import logging
import os
from collections.abc import Generator
from contextlib import closing
from dataclasses import asdict, dataclass
from functools import lru_cache, partial
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.files import atomic_path, remove_leftovers
from torch_geometric_tactile.io import read_hdf5_head, write_hdf5
from torch_geometric_tactile.parallel import run_parallel
from torch_geometric_tactile.sensors import HandKinematics, TaxelLayout, stock_layout
from torch_geometric_tactile.sim.grasp import PHASES, GraspResult, GraspSimulator, plan_grasp
from torch_geometric_tactile.sim.hand_model import ContactParameters
from torch_geometric_tactile.sim.objects import OBJECT_SETS, PROPERTIES, GraspObject
from torch_geometric_tactile.sim.skin import SkinModel
from torch_geometric_tactile.typing import PathLike

_ENCODER_NOISE = 0.0015  # rad
_SUMMARY = "simulation.json"
HANDS = ("allegro_uskin", "allegro_uskin_240")
_logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class Preset:
    r"""How long and how finely trials are simulated.

    Args:
        duration (float): Length of a trial in seconds.
        timestep (float): Step of the physics in seconds.
        step (float): Time between targets of the controller in seconds.
        rate (float): Frames recorded per second.
        trials (int): Trials of each object, unless told otherwise.
    """

    duration: float
    timestep: float
    step: float
    rate: float
    trials: int


PRESETS = {
    "full": Preset(duration=17.0, timestep=0.002, step=0.01, rate=100.0, trials=10),
    "ci": Preset(duration=5.0, timestep=0.004, step=0.02, rate=50.0, trials=3),
}


class TrialReport(NamedTuple):
    r"""How a trial went: how many grasps it took, and its file, which is :obj:`None` where no
    attempt lifted and held the object. :obj:`kept` tells whether the file was there already.
    """

    object_name: str
    trial: int
    attempts: int
    path: Path | None
    kept: bool


@dataclass(frozen=True)
class _Task:
    # All that decides the bits of a trial, and where it goes.
    out: str
    hand: str
    object_set: str
    index: int
    trial: int
    seed: int
    max_attempts: int
    preset: Preset
    skin: SkinModel

    @property
    def item(self) -> GraspObject:
        return OBJECT_SETS[self.object_set]()[self.index]

    @property
    def path(self) -> Path:
        return Path(self.out) / f"{self.item.name}_{self.trial:03d}.h5"

    def identity(self) -> dict[str, Any]:
        identity: dict[str, Any] = json.loads(
            json.dumps(
                {
                    "sensor": self.hand,
                    "object_set": self.object_set,
                    "object": self.item.name,
                    "object_parameters": asdict(self.item),
                    "trial": self.trial,
                    "seed": self.seed,
                    "preset": asdict(self.preset),
                    "skin": asdict(self.skin),
                }
            )
        )
        return identity


def simulate(
    out: PathLike,
    objects: str = "paper8",
    trials: int | None = None,
    seed: int = 0,
    jobs: int = 1,
    *,
    preset: str = "full",
    max_attempts: int = 10,
    skin: SkinModel | None = None,
    hand: str | None = None,
) -> Generator[TrialReport, None, None]:
    r"""Simulates grasps with the Allegro hand and writes one HDF5 recording a trial. Yields a
    report for each trial when its file is finished, and writes :obj:`simulation.json` at the end.

    A trial is a function of seed, object, trial and attempt, bit for bit whatever :obj:`jobs` is
    (another release of MuJoCo may give other bits). Trials whose file is there already are kept,
    so that a run that was stopped or killed goes on where it was.

    Args:
        out (str or PathLike): Folder of the recordings.
        objects (str): :obj:`"paper8"`, :obj:`"control8"` or :obj:`"twenty"`.
        trials (int, optional): Trials of each object; the preset's if left out.
        seed (int): Seed, not negative.
        jobs (int): Processes.
        preset (str): :obj:`"full"` (17 s at 100 Hz) or :obj:`"ci"` (5 s at 50 Hz, coarse).
        max_attempts (int): Attempts at a trial before it is given up.
        skin (SkinModel, optional): What the skin makes of the forces.
        hand (str, optional): :obj:`"allegro_uskin"` (384 taxels) or :obj:`"allegro_uskin_240"`
            (none on the palm). If left out, that of the paper which the objects are of: the
            second for :obj:`"twenty"`, else the first.

    Raises:
        ImportError: If MuJoCo or h5py is missing.
        ValueError: If an argument is unknown or too small, or the folder holds recordings that were
            made with other arguments.
    """
    if objects not in OBJECT_SETS:
        raise ValueError(f"'objects' must be one of {list(OBJECT_SETS)} (got '{objects}')")
    if preset not in PRESETS:
        raise ValueError(f"'preset' must be one of {list(PRESETS)} (got '{preset}')")
    hand = hand or (HANDS[1] if objects == "twenty" else HANDS[0])
    if hand not in HANDS:
        raise ValueError(f"'hand' must be one of {list(HANDS)} (got '{hand}')")
    settings = PRESETS[preset]
    trials = settings.trials if trials is None else trials
    for name, number in (("trials", trials), ("jobs", jobs), ("max_attempts", max_attempts)):
        if number < 1:
            raise ValueError(f"'{name}' must be at least 1 (got {number})")
    if seed < 0:
        raise ValueError(f"'seed' must not be negative (got {seed})")
    for package in ("mujoco", "h5py"):
        if find_spec(package) is None:
            raise ImportError(
                f"the simulated hand needs {package}: pip install 'torch-geometric-tactile[sim]'"
            )
    skin = skin or SkinModel()
    tasks = [
        _Task(str(out), hand, objects, index, trial, seed, max_attempts, settings, skin)
        for trial in range(trials)
        for index in range(len(OBJECT_SETS[objects]()))
    ]
    return _run(tasks, Path(out), jobs)


def _run(tasks: list[_Task], out: Path, jobs: int) -> Generator[TrialReport, None, None]:
    out.mkdir(parents=True, exist_ok=True)
    reports, missing = [], []
    for task in tasks:
        if task.path.exists():
            reports.append(_kept(task))
            yield reports[-1]
        else:
            missing.append(task)
    try:
        work = partial(_simulate_trial, parent=os.getpid())
        with closing(run_parallel(work, missing, jobs)) as results:
            for report in results:
                reports.append(report)
                yield report
    finally:
        # What workers that were killed, now or in an earlier run, had begun to write.
        for task in tasks:
            remove_leftovers(task.path)
    _write_summary(out, tasks, reports)


def _kept(task: _Task) -> TrialReport:
    meta = read_hdf5_head(task.path).meta
    for key, wanted in task.identity().items():
        if meta.get(key) != wanted:
            raise ValueError(
                f"'{task.path}' was made with another '{key}' ({meta.get(key)}, not {wanted}); "
                "choose another folder or delete the file"
            )
    attempt = meta.get("attempt")
    if type(attempt) is not int or attempt < 0:
        raise ValueError(
            f"'{task.path}' must tell its 'attempt', a whole number, in its metadata (got "
            f"{attempt!r}); delete the file to simulate it again"
        )
    return TrialReport(task.item.name, task.trial, attempt + 1, task.path, kept=True)


def _simulate_trial(task: _Task, parent: int) -> TrialReport:
    name = task.item.name
    simulator = _simulator(task.hand, task.object_set, task.index, task.preset.timestep)
    for attempt in range(task.max_attempts):
        if parent not in (os.getpid(), os.getppid()):
            os._exit(1)  # the run was killed: its workers would go on with what was dispatched
        rng = np.random.default_rng([task.seed, task.index, task.trial, attempt])
        plan = plan_grasp(task.item.size, rng, task.preset.duration, task.preset.step)
        result = simulator.run(plan, task.preset.rate)
        if result.success:
            write_hdf5(_recording(task, attempt, result, simulator.layout, rng), task.path)
            return TrialReport(name, task.trial, attempt + 1, task.path, kept=False)
    _logger.warning("%s, trial %d: not lifted in %d attempts", name, task.trial, task.max_attempts)
    return TrialReport(name, task.trial, task.max_attempts, None, kept=False)


@lru_cache(maxsize=1)
def _hand(name: str) -> tuple[TaxelLayout, HandKinematics]:
    return stock_layout(name), HandKinematics.allegro()


@lru_cache(maxsize=4)
def _simulator(hand: str, object_set: str, index: int, timestep: float) -> GraspSimulator:
    layout, kinematics = _hand(hand)
    item = OBJECT_SETS[object_set]()[index]
    return GraspSimulator(layout, kinematics, item, ContactParameters(timestep=timestep))


def _recording(
    task: _Task,
    attempt: int,
    result: GraspResult,
    layout: TaxelLayout,
    rng: np.random.Generator,
) -> Recording:
    joint = result.joint + rng.normal(0.0, _ENCODER_NOISE, result.joint.shape)
    packages = ("torch-geometric-tactile", "mujoco", "numpy")
    return Recording(
        time=result.time,
        tactile=task.skin.readings(result.force, result.time, layout, rng),
        joint=joint.astype(np.float32),
        label=task.item.name,
        meta={
            **task.identity(),
            "attempt": attempt,
            "unit": "count",
            "rate": task.preset.rate,
            "synthetic": True,
            "labels": list(task.item.labels),
            "label_names": list(PROPERTIES),
            "phase_names": list(PHASES),
            "versions": {name: version(name) for name in packages},
        },
        privileged={
            "force": result.force,
            "bone_force": result.bone_force,
            "support": result.support,
            "object_pose": result.object_pose,
            "palm_pose": result.palm_pose,
            "phase": result.phase,
        },
    )


def _write_summary(out: Path, tasks: list[_Task], reports: list[TrialReport]) -> None:
    given_up = [report for report in reports if report.path is None]
    content = {
        "synthetic": True,
        "note": "Simulated. Masses, frictions, skin constants and patch places are plausible, not "
        "measured.",
        "hand": tasks[0].hand,
        "object_set": tasks[0].object_set,
        "seed": tasks[0].seed,
        "preset": asdict(tasks[0].preset),
        "trials": len(reports),
        "attempts": sum(report.attempts for report in reports),
        "successes": len(reports) - len(given_up),
        "given_up": sorted(f"{report.object_name}_{report.trial:03d}" for report in given_up),
        "mujoco": version("mujoco"),
    }
    with atomic_path(out / _SUMMARY) as temporary:
        temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
