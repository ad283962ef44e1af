r"""Recordings of simulated grasps in the format of the BiGS set: contact, lift and shake with three
fingertips.
"""

import json
from collections import Counter
from collections.abc import Generator, Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache, partial
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io import write_hdf5
from torch_geometric_tactile.sensors import biotac
from torch_geometric_tactile.sim._bigs_physics import BIGS_PHASES, BigsPhysics, BigsSimulator
from torch_geometric_tactile.sim._bigs_plan import BigsGrasp, draw_grasp
from torch_geometric_tactile.sim._bigs_scene import FINGERS
from torch_geometric_tactile.sim._bigs_slip import slip_onset
from torch_geometric_tactile.sim._bigs_times import (
    BIGS_ORDER,
    CONTROL_RATE,
    FRAME_RATE,
    INPUT_END,
    NUM_SESSIONS,
)
from torch_geometric_tactile.sim._trial_files import (
    SimulatedTrial,
    check_run,
    finished_metadata,
    require_simulator,
    run_trials,
)
from torch_geometric_tactile.sim.biotac_model import BioTacModel, SessionOffsets
from torch_geometric_tactile.sim.biotac_vibration import vibration

#: Default number of grasps of :func:`simulate_bigs`.
BIGS_GRASPS = 2000
_GENERATOR = "bigs"
_VERSION = 2  # version of the generator; recordings of different versions differ
_TICKS_PER_FRAME = CONTROL_RATE // FRAME_RATE
_ARM_NOISE, _FINGER_NOISE = 0.0002, 0.002  # rad
_WRENCH_NOISE = np.repeat([0.05, 0.002], 3)  # N, N m
# Denavit-Hartenberg parameters a (m), alpha (rad) and d (m) of a seven-joint WAM.
_LINKS = (
    (0.0, -np.pi / 2, 0.0),
    (0.0, np.pi / 2, 0.0),
    (0.045, -np.pi / 2, 0.55),
    (-0.045, np.pi / 2, 0.0),
    (0.0, -np.pi / 2, 0.3),
    (0.0, np.pi / 2, 0.0),
    (0.0, 0.0, 0.06),
)
# Joint angles (rad) with the hand pointing down, in front of the arm.
_POSTURE = np.array([0.0, 0.7, 0.0, 1.9, 0.0, np.pi - 2.6, 0.0])


class BigsReport(NamedTuple):
    r"""The outcome of one grasp, and the path of its file.

    :obj:`success` is :obj:`True` if the object was still in the hand after the shake. Otherwise
    :obj:`lost` is the time from the start of pick-up to the loss in seconds. :obj:`kept` is
    :obj:`True` if the file already existed.

    Examples:
        >>> report = BigsReport("ball", 3, success=False, lost=1.2, path=Path("x.h5"), kept=False)
        >>> report.success, report.lost
        (False, 1.2)
    """

    object_name: str
    trial: int
    success: bool
    lost: float | None
    path: Path
    kept: bool


@dataclass(frozen=True)
class _Trial(SimulatedTrial[BigsReport]):
    out: str
    trial: int
    seed: int
    model: BioTacModel

    @property
    def shape(self) -> Any:
        return BIGS_ORDER[self.trial % len(BIGS_ORDER)]

    @property
    def session(self) -> int:
        # Every session contains all objects, in the proportions of the set.
        return self.trial // len(BIGS_ORDER) % NUM_SESSIONS

    @property
    def path(self) -> Path:
        return Path(self.out) / f"{self.shape}_{self.trial:04d}.h5"

    def identity(self) -> dict[str, Any]:
        return {
            "generator": _GENERATOR,
            "generator_version": _VERSION,
            "sensor": "biotac",
            "object": self.shape,
            "trial": self.trial,
            "session": self.session,
            "seed": self.seed,
            "fingertip": asdict(self.model),
        }

    def finished_report(self) -> BigsReport:
        meta = finished_metadata(self.path, self.identity())
        lost = meta.get("lost", -1.0)
        if lost is not None and (type(lost) is not float or lost < 0):
            raise ValueError(
                f"'{self.path}' must have the time 'lost' of its object in its metadata, in "
                f"seconds after pick-up or null (got {meta.get('lost')!r}); delete the file to "
                "simulate it again"
            )
        return BigsReport(self.shape, self.trial, lost is None, lost, self.path, kept=True)

    def simulate(self) -> BigsReport:
        rng = np.random.default_rng([self.seed, 0, self.trial])
        grasp = draw_grasp(self.shape, rng)
        physics = BigsSimulator(grasp).run()
        write_hdf5(_to_recording(self, grasp, physics, rng), self.path)
        lost = _loss_seconds(physics)
        return BigsReport(self.shape, self.trial, lost is None, lost, self.path, kept=False)


def simulate_bigs(
    out: PathLike,
    grasps: int = BIGS_GRASPS,
    seed: int = 0,
    jobs: int = 1,
    *,
    model: BioTacModel | None = None,
) -> Generator[BigsReport, None, None]:
    r"""Simulates grasps like in the BiGS set and writes one HDF5 recording per grasp, which
    :class:`~torch_geometric_tactile.datasets.BiGS` reads. Yields a report when each file is
    finished, and writes :obj:`simulation.json` at the end.

    Three fingertips close around a cylinder, a box or a ball, then squeeze, lift and shake it.
    Size, mass, friction, grip, position, tilt and timing vary between grasps. A grasp is a success
    if the object is still in the hand after the shake. Failed grasps are recorded as well. Of every
    four grasps, two are of the cylinder, one of the box and one of the ball.

    The seed and the number of a grasp determine its recording bit for bit, for any :obj:`jobs` and
    :obj:`grasps`; other releases of MuJoCo may differ in some bits. If the file of a grasp exists,
    the grasp is not simulated again, so that the same call resumes an interrupted run. A larger
    number of grasps extends an earlier run.

    Args:
        out (str or PathLike): Folder of the recordings.
        grasps (int): Number of grasps.
        seed (int): Seed, which must not be negative.
        jobs (int): Number of processes.
        model (BioTacModel, optional): Model of the readings of the fingertips.

    Raises:
        ImportError: If MuJoCo or h5py is missing.
        ValueError: If a number is too small, or if the folder contains recordings that were
            simulated with other arguments.

    Examples:
        >>> from torch_geometric_tactile.sim import simulate_bigs
        >>> for report in simulate_bigs("bigs", grasps=4):  # doctest: +SKIP
        ...     print(report.object_name, report.success)
    """
    check_run(seed, grasps=grasps, jobs=jobs)
    model = BioTacModel() if model is None else model
    need(isinstance(model, BioTacModel), "'model' must be a BioTacModel", repr(model))
    require_simulator("the simulated grasps")
    trials = [_Trial(str(out), number, seed, model) for number in range(grasps)]
    return run_trials(trials, Path(out), jobs, partial(_summarize, trials[0]))


def _loss_seconds(physics: BigsPhysics) -> float | None:
    return None if physics.loss is None else (physics.loss - physics.pickup) / CONTROL_RATE


@lru_cache(maxsize=NUM_SESSIONS)
def _session_offsets(model: BioTacModel, seed: int, session: int) -> SessionOffsets:
    return model.session(biotac(), np.random.default_rng([seed, 1, session]))


def _to_recording(
    trial: _Trial, grasp: BigsGrasp, physics: BigsPhysics, rng: np.random.Generator
) -> Recording:
    num_frames = len(physics.phase) // _TICKS_PER_FRAME
    num_ticks = num_frames * _TICKS_PER_FRAME  # an incomplete last frame is dropped
    complete = slice(num_ticks)
    frame_ends = slice(_TICKS_PER_FRAME - 1, num_ticks, _TICKS_PER_FRAME)
    time = (np.arange(num_frames) + 1) / FRAME_RATE
    curvature = 0.0 if grasp.shape == "box" else 1 / grasp.half_width
    force, normal = physics.force[frame_ends], physics.normal[frame_ends]
    place = physics.place[frame_ends]
    response = trial.model.response(force, normal, place, biotac(), curvature)
    session = _session_offsets(trial.model, trial.seed, trial.session)
    readings = trial.model.readings(response, normal, time, session, rng)
    slide_speed = np.linalg.norm(physics.slide[complete], axis=-1)
    finger = np.empty((num_ticks, 4))
    finger[:, :3], finger[:, 3] = physics.finger[complete], grasp.spread
    finger += rng.normal(0.0, _FINGER_NOISE, finger.shape)
    arm = _arm_joints(physics.hand[complete])
    arm += rng.normal(0.0, _ARM_NOISE, arm.shape)
    onset = slip_onset(physics)
    ticks = np.arange(num_ticks)[frame_ends]
    extra = {
        "pressure": readings.pressure,
        "pac": vibration(physics.normal[complete], slide_speed, rng),
        "robot_joint": arm.reshape(num_frames, _TICKS_PER_FRAME, 7).astype(np.float32),
        "finger_joint": finger.reshape(num_frames, _TICKS_PER_FRAME, 4).astype(np.float32),
    }
    wrench = physics.wrench[frame_ends] + _WRENCH_NOISE * rng.normal(size=(num_frames, 6))
    return Recording(
        time=time,
        tactile=readings.tactile,
        label="success" if physics.success else "failure",
        meta={
            **trial.identity(),
            "unit": "count",
            "rate": float(FRAME_RATE),
            "synthetic": True,
            "pickup_time": (physics.pickup + 1) / CONTROL_RATE,
            "shake_time": (physics.pickup + 1) / CONTROL_RATE + grasp.pause,
            "lost": _loss_seconds(physics),
            "slip_time": None if onset is None else (onset + 1) / CONTROL_RATE,
            "phase_names": list(BIGS_PHASES),
            "finger_names": list(FINGERS),
            "grasp": grasp._asdict(),
            "versions": {name: version(name) for name in ("mujoco", "numpy")},
        },
        privileged={
            "phase": physics.phase[frame_ends].astype(np.int64),
            "force": force.astype(np.float32),
            "normal_force": normal.astype(np.float32),
            "shear_force": physics.shear[frame_ends].astype(np.float32),
            "contact_place": place.astype(np.float32),
            "slide_speed": slide_speed[frame_ends].astype(np.float32),
            "slip": np.asarray(ticks >= (np.inf if onset is None else onset)).astype(np.int64),
            "object_pose": physics.object_pose[frame_ends].astype(np.float32),
        },
        extra={**extra, "wrench": wrench.astype(np.float32)},
    )


def _arm_joints(hand: np.ndarray) -> np.ndarray:
    # Joint angles of an arm (K, 7) for displacements and rotations of the hand (K, 6) from the
    # posture. The physics has no arm, and the hand moves freely. These are the angles with which a
    # WAM would move the hand, to first order and with the smallest sum of squares.
    return np.asarray(_POSTURE + hand @ np.linalg.pinv(_jacobian()).T)


@lru_cache(maxsize=1)
def _jacobian() -> np.ndarray:
    frames = [np.eye(4)]
    for (a, alpha, d), angle in zip(_LINKS, _POSTURE, strict=True):
        frames.append(frames[-1] @ _link_transform(a, alpha, d, float(angle)))
    end = frames[-1][:3, 3]
    axes = [(frame[:3, 2], frame[:3, 3]) for frame in frames[:-1]]
    return np.array([np.concatenate([np.cross(z, end - p), z]) for z, p in axes]).T


def _link_transform(a: float, alpha: float, d: float, angle: float) -> np.ndarray:
    c, s, ca, sa = np.cos(angle), np.sin(angle), np.cos(alpha), np.sin(alpha)
    return np.array(
        [
            [c, -s * ca, s * sa, a * c],
            [s, c * ca, -c * sa, a * s],
            [0.0, sa, ca, d],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )


def _summarize(trial: _Trial, reports: Sequence[BigsReport]) -> dict[str, Any]:
    by_object = {}
    for name in dict.fromkeys(BIGS_ORDER):
        object_reports = [report for report in reports if report.object_name == name]
        by_object[name] = {
            "grasps": len(object_reports),
            "successes": sum(report.success for report in object_reports),
            "lost_before_input_ends": sum(
                report.lost is not None and report.lost < INPUT_END for report in object_reports
            ),
        }
    totals: Counter[str] = Counter()
    for counts in by_object.values():
        totals.update(counts)
    return {
        "synthetic": True,
        "note": "Simulated. Masses, frictions, grips and the model of the fingertips are "
        "plausible, not measured; grips were calibrated to the success rates of the BiGS set.",
        "generator": _GENERATOR,
        "generator_version": _VERSION,
        "seed": trial.seed,
        "fingertip": json.loads(json.dumps(asdict(trial.model))),
        **totals,
        "objects": by_object,
        "mujoco": version("mujoco"),
    }
