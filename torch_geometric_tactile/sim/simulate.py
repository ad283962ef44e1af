r"""Recordings of simulated grasps: many trials, on many processes, finished ones kept."""

import json
import logging
import math
from collections.abc import Generator, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache, partial
from importlib.metadata import version
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io import write_hdf5
from torch_geometric_tactile.sensors import HandKinematics, TaxelLayout, stock_layout
from torch_geometric_tactile.sim._presets import PRESETS, Preset, TrialReport
from torch_geometric_tactile.sim._trial_files import (
    SimulatedTrial,
    check_run,
    kept_meta,
    require_simulator,
    run_trials,
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
class _Trial(SimulatedTrial[TrialReport]):
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
    motion: str

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

    def kept(self) -> TrialReport:
        # Recordings of earlier versions name neither spread nor motion: they were always these.
        before = {"spread": asdict(GraspSpread()), "motion": "lift"}
        attempt = kept_meta(self.path, self.identity(), before).get("attempt")
        if type(attempt) is not int or attempt < 0:
            raise ValueError(
                f"'{self.path}' must tell its 'attempt', a whole number, in its metadata (got "
                f"{attempt!r}); delete the file to simulate it again"
            )
        return TrialReport(self.item.name, self.trial, attempt + 1, self.path, kept=True)

    def simulate(self) -> TrialReport:
        name, number = self.item.name, self.trial
        recording, attempts = self.attempted()
        if recording is not None:
            write_hdf5(recording, self.path)
            return TrialReport(name, number, attempts, self.path, kept=False)
        failed = "%s, trial %d: not %s in %d attempts"
        _logger.warning(failed, name, number, MOTIONS[self.motion], self.max_attempts)
        return TrialReport(name, number, self.max_attempts, None, kept=False)

    def attempted(self) -> tuple[Recording | None, int]:
        r"""Returns the trial, if an attempt at it succeeded, and the number of attempts."""
        simulator = _simulator(self.hand, self.item, self.preset.timestep)
        planned = plan_squeeze if self.motion == "squeeze" else plan_grasp
        preset = self.preset
        for attempt in range(self.max_attempts):
            rng = np.random.default_rng([self.seed, self.index, self.trial, attempt])
            plan = planned(self.item.size, rng, preset.duration, preset.step, self.spread)
            result = simulator.run(plan, preset.rate)
            if result.success:
                return _recording(self, attempt, plan, result, simulator.layout, rng), attempt + 1
        return None, self.max_attempts


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
    need(hand in HANDS, f"'hand' must be one of {list(HANDS)}", f"'{hand}'")
    need(motion in MOTIONS, f"'motion' must be one of {list(MOTIONS)}", f"'{motion}'")
    trials = settings.trials if trials is None else trials
    check_run(seed, trials=trials, jobs=jobs, max_attempts=max_attempts)
    if plan is not None and not isinstance(plan, GraspSpread):
        raise ValueError(f"'plan' must be a GraspSpread, such as GraspSpread.wide() (got {plan!r})")
    set_name, items = object_set(objects, num_objects, seed)
    require_simulator("the simulated hand")
    made = [
        _Trial(
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
    return run_trials(made, Path(out), jobs, partial(_summary, made[0]))


def _settings(preset: str, seconds: float | None) -> Preset:
    need(preset in PRESETS, f"'preset' must be one of {list(PRESETS)}", f"'{preset}'")
    if seconds is None:
        return PRESETS[preset]
    need(_SHORTEST <= seconds < math.inf, f"'seconds' must be at least {_SHORTEST:g}", seconds)
    return replace(PRESETS[preset], duration=float(seconds))


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
    need(motion in MOTIONS, f"'motion' must be one of {list(MOTIONS)}", f"'{motion}'")
    check_run(seed)
    set_name, items = object_set(objects, None, seed)
    chosen = [(index, item) for index, item in enumerate(items) if only in (None, item.name)]
    if not chosen:
        raise ValueError(f"'only' must be one of {[item.name for item in items]} (got '{only}')")
    require_simulator("the simulated hand")
    hand = HANDS[1] if objects == "twenty" else HANDS[0]
    made = (10, settings, SkinModel(), GraspSpread(), motion)
    trials = ((trial, *one) for trial in count() for one in chosen)
    tasks = (_Trial("", hand, set_name, item, i, trial, seed, *made) for trial, i, item in trials)
    return (recording for task in tasks if (recording := task.attempted()[0]) is not None)


@lru_cache(maxsize=1)
def _hand(name: str) -> tuple[TaxelLayout, HandKinematics]:
    return stock_layout(name), HandKinematics.allegro()


@lru_cache(maxsize=4)
def _simulator(hand: str, item: GraspObject, timestep: float) -> GraspSimulator:
    layout, kinematics = _hand(hand)
    return GraspSimulator(layout, kinematics, item, ContactParameters(timestep=timestep))


def _recording(
    task: _Trial,
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


def _facts(task: _Trial, plan: GraspPlan) -> dict[str, Any]:
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


def _summary(first: _Trial, reports: list[TrialReport]) -> dict[str, Any]:
    given_up = [report for report in reports if report.path is None]
    return {
        "synthetic": True,
        "note": "Simulated. Masses, frictions, skin constants and patch places are plausible, not "
        "measured.",
        "hand": first.hand,
        "object_set": first.object_set,
        "seed": first.seed,
        "preset": asdict(first.preset),
        "spread": asdict(first.spread),
        "motion": first.motion,
        "trials": len(reports),
        "attempts": sum(report.attempts for report in reports),
        "successes": len(reports) - len(given_up),
        "given_up": sorted(f"{report.object_name}_{report.trial:03d}" for report in given_up),
        "mujoco": version("mujoco"),
    }
