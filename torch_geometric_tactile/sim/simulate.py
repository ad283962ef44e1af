r"""Recordings of simulated grasps with the Allegro hand, with one file per trial."""

import json
import logging
import math
from collections.abc import Generator, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache, partial
from importlib.metadata import version
from itertools import count
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io import write_hdf5
from torch_geometric_tactile.sensors import HandKinematics, TaxelLayout, stock_layout
from torch_geometric_tactile.sim._grasp import GraspPlan, GraspResult, GraspSimulator, plan_grasp
from torch_geometric_tactile.sim._object_sets import object_set
from torch_geometric_tactile.sim._squeeze import plan_squeeze
from torch_geometric_tactile.sim._trial_files import (
    SimulatedTrial,
    check_run,
    finished_metadata,
    require_simulator,
    run_trials,
)
from torch_geometric_tactile.sim.hand_model import ContactParameters
from torch_geometric_tactile.sim.objects import PROPERTIES, GraspObject
from torch_geometric_tactile.sim.skin import SkinModel
from torch_geometric_tactile.sim.spread import GraspSpread

_ENCODER_NOISE = 0.0015  # rad
_MIN_SECONDS = 1.0
#: The motions of the hand, each with the words that report its success.
MOTIONS = {"lift": "lifted", "squeeze": "squeezed"}
#: Names of the layouts of the hands that can be simulated.
HANDS = ("allegro_uskin", "allegro_uskin_240")
_logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class Preset:
    r"""The duration, time steps, frame rate and number of simulated trials.

    Args:
        duration (float): Duration of a trial in seconds.
        timestep (float): Time step of the physics in seconds.
        step (float): Time between targets of the controller in seconds.
        rate (float): Number of recorded frames per second.
        trials (int): Default number of trials of each object.

    Examples:
        >>> from torch_geometric_tactile.sim import PRESETS
        >>> PRESETS["ci"]
        Preset(duration=5.0, timestep=0.004, step=0.02, rate=50.0, trials=3)
    """

    duration: float
    timestep: float
    step: float
    rate: float
    trials: int


#: Duration, time steps, frame rate and number of trials of :func:`simulate`, by name.
PRESETS = {
    "full": Preset(duration=17.0, timestep=0.002, step=0.01, rate=100.0, trials=10),
    "ci": Preset(duration=5.0, timestep=0.004, step=0.02, rate=50.0, trials=3),
}


class TrialReport(NamedTuple):
    r"""The number of attempts at a simulated trial, and the path of its file.

    :obj:`path` is :obj:`None` if no attempt lifted and held the object, or squeezed it.
    :obj:`kept` is :obj:`True` if the file already existed.

    Examples:
        >>> report = TrialReport("sponge", 0, attempts=2, path=Path("sponge_000.h5"), kept=False)
        >>> report.attempts, report.path.name
        (2, 'sponge_000.h5')
    """

    object_name: str
    trial: int
    attempts: int
    path: Path | None
    kept: bool


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

    def finished_report(self) -> TrialReport:
        # Files of earlier versions contain neither spread nor motion, which were constants then.
        defaults = {"spread": asdict(GraspSpread()), "motion": "lift"}
        attempt = finished_metadata(self.path, self.identity(), defaults).get("attempt")
        if type(attempt) is not int or attempt < 0:
            raise ValueError(
                f"'{self.path}' must have a whole number 'attempt' in its metadata (got "
                f"{attempt!r}); delete the file to simulate it again"
            )
        return TrialReport(self.item.name, self.trial, attempt + 1, self.path, kept=True)

    def simulate(self) -> TrialReport:
        name, number = self.item.name, self.trial
        recording, attempts = self.record()
        if recording is not None:
            write_hdf5(recording, self.path)
            return TrialReport(name, number, attempts, self.path, kept=False)
        message = "%s, trial %d: not %s in %d attempts"
        _logger.warning(message, name, number, MOTIONS[self.motion], self.max_attempts)
        return TrialReport(name, number, self.max_attempts, None, kept=False)

    def record(self) -> tuple[Recording | None, int]:
        r"""Returns the recording of the first successful attempt (:obj:`None` if all failed) and
        the number of attempts.
        """
        simulator = _simulator(self.hand, self.item, self.preset.timestep)
        plan_motion = plan_squeeze if self.motion == "squeeze" else plan_grasp
        preset = self.preset
        for attempt in range(self.max_attempts):
            rng = np.random.default_rng([self.seed, self.index, self.trial, attempt])
            plan = plan_motion(self.item.size, rng, preset.duration, preset.step, self.spread)
            result = simulator.run(plan, preset.rate)
            if result.success:
                recording = _to_recording(self, attempt, plan, result, simulator.layout, rng)
                return recording, attempt + 1
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

    The seed, object, trial and attempt determine the recording of a trial bit for bit, for any
    :obj:`jobs`; other releases of MuJoCo may differ in some bits. If the file of a trial exists,
    the trial is not simulated again, so that the same call resumes an interrupted run.

    Args:
        out (str or PathLike): Folder of the recordings.
        objects (str or sequence of GraspObject): :obj:`"paper8"`, :obj:`"control8"`,
            :obj:`"twenty"` or :obj:`"shapes"` (:func:`drawn_objects`), or your own objects.
        trials (int, optional): Number of trials of each object (default: as in the preset).
        seed (int): Seed, which must not be negative.
        jobs (int): Number of processes.
        preset (str): :obj:`"full"` (17 s at 100 Hz) or :obj:`"ci"` (5 s at 50 Hz, coarse).
        max_attempts (int): Largest number of attempts at a trial.
        skin (SkinModel, optional): Model of the readings of the skin.
        hand (str, optional): :obj:`"allegro_uskin"` (384 taxels) or :obj:`"allegro_uskin_240"`
            (no taxels on the palm). The default is the hand in the paper that describes the
            objects: :obj:`"allegro_uskin_240"` for :obj:`"twenty"`, otherwise
            :obj:`"allegro_uskin"`.
        plan (GraspSpread, optional): Variation between grasps (default: a careful operator).
        seconds (float, optional): Duration of a trial in seconds, at least 1 (default: as in the
            preset).
        num_objects (int, optional): Number of objects in :obj:`"shapes"`, which are drawn with
            :obj:`seed` (default: 40).
        motion (str): :obj:`"lift"` lifts and holds the objects (:func:`plan_grasp`);
            :obj:`"squeeze"` squeezes them repeatedly in place (:func:`plan_squeeze`).

    Raises:
        ImportError: If MuJoCo or h5py is missing.
        ValueError: If an argument is unknown or too small, or if the folder contains recordings
            that were simulated with other arguments.

    Examples:
        >>> from torch_geometric_tactile.sim import simulate
        >>> for report in simulate("sim", "paper8", trials=1, preset="ci"):  # doctest: +SKIP
        ...     print(report.object_name, report.attempts)
    """
    settings = _preset_settings(preset, seconds)
    hand = hand or (HANDS[1] if objects == "twenty" else HANDS[0])
    need(hand in HANDS, f"'hand' must be one of {list(HANDS)}", f"'{hand}'")
    need(motion in MOTIONS, f"'motion' must be one of {list(MOTIONS)}", f"'{motion}'")
    trials = settings.trials if trials is None else trials
    check_run(seed, trials=trials, jobs=jobs, max_attempts=max_attempts)
    if plan is not None and not isinstance(plan, GraspSpread):
        raise ValueError(f"'plan' must be a GraspSpread, such as GraspSpread.wide() (got {plan!r})")
    set_name, items = object_set(objects, num_objects, seed)
    require_simulator("the simulated hand")
    simulated_trials = [
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
    summarize = partial(_summarize, simulated_trials[0])
    return run_trials(simulated_trials, Path(out), jobs, summarize)


def _preset_settings(preset: str, seconds: float | None) -> Preset:
    need(preset in PRESETS, f"'preset' must be one of {list(PRESETS)}", f"'{preset}'")
    if seconds is None:
        return PRESETS[preset]
    is_valid = _MIN_SECONDS <= seconds < math.inf
    need(is_valid, f"'seconds' must be at least {_MIN_SECONDS:g}", seconds)
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
    r"""Yields an endless stream of simulated grasps: the recordings that :func:`simulate` would
    write, cycling through the objects. Each grasp is simulated when it is requested. Failed trials
    are skipped.

    Args:
        objects, seed, preset: As in :func:`simulate`.
        rate (float, optional): Frames per second. This must be the rate of the preset divided by a
            whole number (default: the rate of the preset).
        only (str, optional): Name of the only object in the set to grasp (default: all objects).
        motion (str): :obj:`"lift"` or :obj:`"squeeze"`.

    Raises:
        ImportError: If MuJoCo or h5py is missing.
        ValueError: If an argument is unknown.

    Examples:
        >>> recordings = grasp_recordings(only="sponge", rate=25.0)  # simulates on request only
        >>> next(recordings).label  # doctest: +SKIP
        'sponge'
    """
    settings = _preset_settings(preset, None)
    if rate is not None:
        if not 0 < rate <= settings.rate:
            raise ValueError(f"'rate' must be above 0 and at most {settings.rate:g} (got {rate})")
        settings = replace(settings, rate=float(rate))
    need(motion in MOTIONS, f"'motion' must be one of {list(MOTIONS)}", f"'{motion}'")
    check_run(seed)
    set_name, items = object_set(objects, None, seed)
    selected = [(index, item) for index, item in enumerate(items) if only in (None, item.name)]
    if not selected:
        raise ValueError(f"'only' must be one of {[item.name for item in items]} (got '{only}')")
    require_simulator("the simulated hand")
    hand = HANDS[1] if objects == "twenty" else HANDS[0]
    constants = (10, settings, SkinModel(), GraspSpread(), motion)
    trials = (
        _Trial("", hand, set_name, item, index, number, seed, *constants)
        for number in count()
        for index, item in selected
    )
    return (recording for trial in trials if (recording := trial.record()[0]) is not None)


@lru_cache(maxsize=1)
def _stock_hand(name: str) -> tuple[TaxelLayout, HandKinematics]:
    return stock_layout(name), HandKinematics.allegro()


@lru_cache(maxsize=4)
def _simulator(hand: str, item: GraspObject, timestep: float) -> GraspSimulator:
    layout, kinematics = _stock_hand(hand)
    return GraspSimulator(layout, kinematics, item, ContactParameters(timestep=timestep))


def _to_recording(
    trial: _Trial,
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
        tactile=trial.skin.readings(result.force, result.time, layout, rng),
        joint=joint.astype(np.float32),
        label=trial.item.name,
        meta={
            **trial.identity(),
            **_grasp_metadata(trial, plan),
            "attempt": attempt,
            "unit": "count",
            "rate": trial.preset.rate,
            "synthetic": True,
            "labels": list(trial.item.labels),
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


def _grasp_metadata(trial: _Trial, plan: GraspPlan) -> dict[str, Any]:
    # Properties that a data set can use as targets or for splits.
    item, (lateral, yaw) = trial.item, plan.gantry[:, [1, 3]].mean(axis=0).tolist()
    return {
        "shape": item.shape,
        "width": item.width,
        "mass": item.mass,
        "friction": item.friction,
        "palm_lateral": lateral,
        "palm_yaw": yaw,
        "placement": trial.spread.placement(lateral, yaw),
        "size": int(item.width * 100 + 1e-9),  # whole centimetres of width
    }


def _summarize(first_trial: _Trial, reports: list[TrialReport]) -> dict[str, Any]:
    given_up = [report for report in reports if report.path is None]
    return {
        "synthetic": True,
        "note": "Simulated. Masses, frictions, skin constants and patch places are plausible, not "
        "measured.",
        "hand": first_trial.hand,
        "object_set": first_trial.object_set,
        "seed": first_trial.seed,
        "preset": asdict(first_trial.preset),
        "spread": asdict(first_trial.spread),
        "motion": first_trial.motion,
        "trials": len(reports),
        "attempts": sum(report.attempts for report in reports),
        "successes": len(reports) - len(given_up),
        "given_up": sorted(f"{report.object_name}_{report.trial:03d}" for report in given_up),
        "mujoco": version("mujoco"),
    }
