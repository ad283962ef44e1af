r"""Recordings of simulated grasps: many trials, on many processes, finished ones kept."""

import json
import logging
import math
from collections.abc import Generator, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from importlib.metadata import version
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io import write_hdf5
from torch_geometric_tactile.sensors import HandKinematics, TaxelLayout, stock_layout
from torch_geometric_tactile.sim._presets import PRESETS, Preset, TrialReport
from torch_geometric_tactile.sim._trial_files import (
    end_without,
    kept_meta,
    require_simulator,
    run_trials,
    write_summary,
)
from torch_geometric_tactile.sim.grasp import GraspPlan, GraspResult, GraspSimulator, plan_grasp
from torch_geometric_tactile.sim.hand_model import ContactParameters
from torch_geometric_tactile.sim.object_sets import object_set
from torch_geometric_tactile.sim.objects import PROPERTIES, GraspObject
from torch_geometric_tactile.sim.skin import SkinModel
from torch_geometric_tactile.sim.spread import GraspSpread
from torch_geometric_tactile.sim.squeeze import plan_squeeze

_ENCODER_NOISE = 0.0015  # rad
_SHORTEST = 1.0  # s
#: What the hand does with the object, and the word of its success.
MOTIONS = {"lift": "lifted", "squeeze": "squeezed"}
#: The layouts of hands that can be simulated.
HANDS = ("allegro_uskin", "allegro_uskin_240")
_logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class _Task:
    # All that decides the bits of a trial, and where it goes.
    out: str
    hand: str
    object_set: str
    item: GraspObject
    index: int
    trial: int
    seed: int
    max_attempts: int
    preset: Preset
    skin: SkinModel
    spread: GraspSpread
    motion: str = "lift"

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
                    "spread": asdict(self.spread),
                    "motion": self.motion,
                }
            )
        )
        return identity


def simulate(
    out: PathLike,
    objects: str | Sequence[GraspObject] = "paper8",
    trials: int | None = None,
    seed: int = 0,
    jobs: int = 1,
    *,
    preset: str = "full",
    max_attempts: int = 10,
    skin: SkinModel | None = None,
    hand: str | None = None,
    plan: GraspSpread | None = None,
    seconds: float | None = None,
    num_objects: int | None = None,
    motion: str = "lift",
) -> Generator[TrialReport, None, None]:
    r"""Simulates grasps with the Allegro hand and writes one HDF5 recording per trial. Yields a
    report when the file of a trial is finished, and writes :obj:`simulation.json` at the end.

    A trial is a function of seed, object, trial and attempt, bit for bit whatever :obj:`jobs` is
    (another release of MuJoCo may give other bits). Trials whose file is there already are kept,
    so that a run that was stopped or killed goes on where it was.

    Args:
        out (str or PathLike): Folder of the recordings.
        objects (str or sequence of GraspObject): :obj:`"paper8"`, :obj:`"control8"`,
            :obj:`"twenty"` or :obj:`"shapes"` (:func:`drawn_objects`), or objects of your own.
        trials (int, optional): Trials of each object; the preset's if left out.
        seed (int): Seed, not negative.
        jobs (int): Processes.
        preset (str): :obj:`"full"` (17 s at 100 Hz) or :obj:`"ci"` (5 s at 50 Hz, coarse).
        max_attempts (int): Attempts at a trial before it is given up.
        skin (SkinModel, optional): What the skin makes of the forces.
        hand (str, optional): :obj:`"allegro_uskin"` (384 taxels) or :obj:`"allegro_uskin_240"`
            (none on the palm). If left out, that of the paper which the objects are of: the
            second for :obj:`"twenty"`, else the first.
        plan (GraspSpread, optional): How much the grasps differ from each other; that of an
            operator who takes care if left out.
        seconds (float, optional): Length of a trial, from 1 on; the preset's if left out.
        num_objects (int, optional): How many objects of :obj:`"shapes"` are drawn; 40 if left out.
            The seed decides which.
        motion (str): :obj:`"lift"` lifts and holds the objects (:func:`plan_grasp`),
            :obj:`"squeeze"` squeezes them again and again where they are (:func:`plan_squeeze`).

    Raises:
        ImportError: If MuJoCo or h5py is missing.
        ValueError: If an argument is unknown or too small, or the folder holds recordings that were
            made with other arguments.

    Examples:
        >>> from torch_geometric_tactile.sim import simulate
        >>> for report in simulate("sim", "paper8", trials=1, preset="ci"):  # doctest: +SKIP
        ...     print(report.object_name, report.attempts)
    """
    settings = _settings(preset, seconds)
    hand = hand or (HANDS[1] if objects == "twenty" else HANDS[0])
    if hand not in HANDS:
        raise ValueError(f"'hand' must be one of {list(HANDS)} (got '{hand}')")
    _check_motion(motion, seed)
    trials = settings.trials if trials is None else trials
    for name, number in (("trials", trials), ("jobs", jobs), ("max_attempts", max_attempts)):
        if number < 1:
            raise ValueError(f"'{name}' must be at least 1 (got {number})")
    if plan is not None and not isinstance(plan, GraspSpread):
        raise ValueError(f"'plan' must be a GraspSpread, such as GraspSpread.wide() (got {plan!r})")
    set_name, items = object_set(objects, num_objects, seed)
    require_simulator("the simulated hand")
    tasks = [
        _Task(
            out=str(out),
            hand=hand,
            object_set=set_name,
            item=item,
            index=index,
            trial=trial,
            seed=seed,
            max_attempts=max_attempts,
            preset=settings,
            skin=skin or SkinModel(),
            spread=plan or GraspSpread(),
            motion=motion,
        )
        for trial in range(trials)
        for index, item in enumerate(items)
    ]
    return _run(tasks, Path(out), jobs)


def _check_motion(motion: str, seed: int) -> None:
    if motion not in MOTIONS:
        raise ValueError(f"'motion' must be one of {list(MOTIONS)} (got '{motion}')")
    if seed < 0:
        raise ValueError(f"'seed' must not be negative (got {seed})")


def _settings(preset: str, seconds: float | None) -> Preset:
    if preset not in PRESETS:
        raise ValueError(f"'preset' must be one of {list(PRESETS)} (got '{preset}')")
    if seconds is None:
        return PRESETS[preset]
    if not _SHORTEST <= seconds < math.inf:
        raise ValueError(f"'seconds' must be at least {_SHORTEST:g} (got {seconds})")
    return replace(PRESETS[preset], duration=float(seconds))


def _run(tasks: list[_Task], out: Path, jobs: int) -> Generator[TrialReport, None, None]:
    reports = yield from run_trials(tasks, out, jobs, _kept, _simulate_trial)
    _write_summary(out, tasks, reports)


def _kept(task: _Task) -> TrialReport:
    # Recordings of earlier versions name neither spread nor motion: they were always these.
    meta = kept_meta(task, before={"spread": asdict(GraspSpread()), "motion": "lift"})
    attempt = meta.get("attempt")
    if type(attempt) is not int or attempt < 0:
        raise ValueError(
            f"'{task.path}' must tell its 'attempt', a whole number, in its metadata (got "
            f"{attempt!r}); delete the file to simulate it again"
        )
    return TrialReport(task.item.name, task.trial, attempt + 1, task.path, kept=True)


def grasp_recordings(
    objects: str | Sequence[GraspObject] = "paper8",
    seed: int = 0,
    *,
    preset: str = "ci",
    rate: float | None = None,
    only: str | None = None,
    motion: str = "lift",
) -> Iterator[Recording]:
    r"""Yields simulated grasps endlessly: the recordings that :func:`simulate` would write, cycling
    through the objects. A grasp is simulated when it is asked for; one that fails is skipped.

    Args:
        objects, seed, preset: As of :func:`simulate`.
        rate (float, optional): Frames per second, the preset's or a whole part of it.
        only (str, optional): Name of the one object that is grasped, of those of the set.
        motion (str): :obj:`"lift"` or :obj:`"squeeze"`.

    Raises:
        ImportError: If MuJoCo or h5py is missing.
        ValueError: If an argument is unknown.

    Examples:
        >>> recordings = grasp_recordings(only="sponge", rate=25.0)  # simulates nothing yet
        >>> next(recordings).label  # doctest: +SKIP
        'sponge'
    """
    settings = _settings(preset, None)
    if rate is not None:
        if not 0 < rate <= settings.rate:
            raise ValueError(f"'rate' must be above 0 and at most {settings.rate:g} (got {rate})")
        settings = replace(settings, rate=float(rate))
    _check_motion(motion, seed)
    set_name, items = object_set(objects, None, seed)
    chosen = [(index, item) for index, item in enumerate(items) if only in (None, item.name)]
    if not chosen:
        raise ValueError(f"'only' must be one of {[item.name for item in items]} (got '{only}')")
    require_simulator("the simulated hand")
    hand = HANDS[1] if objects == "twenty" else HANDS[0]
    made = (10, settings, SkinModel(), GraspSpread(), motion)
    trials = ((trial, *one) for trial in count() for one in chosen)
    tasks = (_Task("", hand, set_name, item, i, trial, seed, *made) for trial, i, item in trials)
    return (recording for task in tasks if (recording := _attempted(task)[0]) is not None)


def _attempted(task: _Task, parent: int | None = None) -> tuple[Recording | None, int]:
    # The trial, if an attempt at it succeeded, and the number of attempts.
    simulator = _simulator(task.hand, task.item, task.preset.timestep)
    for attempt in range(task.max_attempts):
        if parent is not None:
            end_without(parent)
        rng = np.random.default_rng([task.seed, task.index, task.trial, attempt])
        plan = _planned(task, rng)
        result = simulator.run(plan, task.preset.rate)
        if result.success:
            return _recording(task, attempt, plan, result, simulator.layout, rng), attempt + 1
    return None, task.max_attempts


def _simulate_trial(task: _Task, parent: int) -> TrialReport:
    name = task.item.name
    recording, attempts = _attempted(task, parent)
    if recording is not None:
        write_hdf5(recording, task.path)
        return TrialReport(name, task.trial, attempts, task.path, kept=False)
    _logger.warning(
        "%s, trial %d: not %s in %d attempts",
        name,
        task.trial,
        MOTIONS[task.motion],
        task.max_attempts,
    )
    return TrialReport(name, task.trial, task.max_attempts, None, kept=False)


def _planned(task: _Task, rng: np.random.Generator) -> GraspPlan:
    planned = plan_squeeze if task.motion == "squeeze" else plan_grasp
    return planned(task.item.size, rng, task.preset.duration, task.preset.step, task.spread)


@lru_cache(maxsize=1)
def _hand(name: str) -> tuple[TaxelLayout, HandKinematics]:
    return stock_layout(name), HandKinematics.allegro()


@lru_cache(maxsize=4)
def _simulator(hand: str, item: GraspObject, timestep: float) -> GraspSimulator:
    layout, kinematics = _hand(hand)
    return GraspSimulator(layout, kinematics, item, ContactParameters(timestep=timestep))


def _recording(
    task: _Task,
    attempt: int,
    plan: GraspPlan,
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
            **_facts(task, plan),
            "attempt": attempt,
            "unit": "count",
            "rate": task.preset.rate,
            "synthetic": True,
            "labels": list(task.item.labels),
            "label_names": list(PROPERTIES),
            "phase_names": list(plan.phase_names),
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


def _facts(task: _Task, plan: GraspPlan) -> dict[str, Any]:
    # What a data set may ask for, or split by.
    item, (lateral, yaw) = task.item, plan.gantry[:, [1, 3]].mean(axis=0).tolist()
    return {
        "shape": item.shape,
        "width": item.width,
        "mass": item.mass,
        "friction": item.friction,
        "palm_lateral": lateral,
        "palm_yaw": yaw,
        "placement": task.spread.placement(lateral, yaw),
        "size": int(item.width * 100 + 1e-9),
    }


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
        "spread": asdict(tasks[0].spread),
        "motion": tasks[0].motion,
        "trials": len(reports),
        "attempts": sum(report.attempts for report in reports),
        "successes": len(reports) - len(given_up),
        "given_up": sorted(f"{report.object_name}_{report.trial:03d}" for report in given_up),
        "mujoco": version("mujoco"),
    }
    write_summary(out, content)
