r"""What plain models make of simulated grasps of the BiGS form, from the input of the paper: from
the first contact to 2 s after pick-up begins, 60 frames.

Nothing here is a result on real grasps, and nothing is chosen by these numbers. With `--real`, it
also tells how much the fingers of simulated and of real grasps agree.

Examples:
    tactile simulate --objects bigs --out bigs --seed 0
    PYTHONPATH=benchmarks python studies/simulated_grasps.py bigs --real BioTacSP
"""

import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
from shared import parse
from sklearn.base import BaseEstimator
from sklearn.ensemble import RandomForestClassifier
from sklearn.linear_model import LogisticRegression
from sklearn.model_selection import GroupKFold, StratifiedKFold, cross_val_score
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.svm import SVC

from torch_geometric_tactile.baselines._features import statistical_features
from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.datasets import BioTacSP
from torch_geometric_tactile.io import read_recording

_INPUT = 2.0  # s after pick-up
_FRAMES = 60
_REST = 20  # frames at the start of a grasp, before contact


class Grasp(NamedTuple):
    """Features of the electrodes of each finger, true forces and slides, and what is known."""

    electrodes: np.ndarray  # (3, D)
    last: np.ndarray  # (19, 3) readings of the last frame, above rest
    truth: np.ndarray
    object_name: str
    session: int
    success: bool
    lost: float  # seconds after pick-up, infinite if held


def read(path: Path) -> Grasp:
    recording = read_recording(path)
    meta, truth = recording.meta, recording.privileged
    after = recording.time - meta["pickup_time"]
    used = np.flatnonzero((truth["phase"] >= 1) & (after <= _INPUT))
    frames = used[np.linspace(0, len(used) - 1, _FRAMES).round().astype(int)]
    return Grasp(
        electrodes=electrode_features(recording.tactile[frames]),
        last=recording.tactile[frames[-1]] - recording.tactile[:_REST].mean(axis=0),
        truth=true_features(recording, after),
        object_name=meta["object"],
        session=meta["session"],
        success=recording.label == "success",
        lost=np.inf if meta["lost"] is None else meta["lost"],
    )


def electrode_features(tactile: np.ndarray) -> np.ndarray:
    # The twelve features of the paper, and four that tell begin, end and restlessness.
    signal = tactile.astype(np.float64).transpose(2, 1, 0)  # (3, 19, 60)
    steps = np.abs(np.diff(signal)).mean(axis=-1)
    last, middle = signal[..., -1], signal[..., _FRAMES // 2]
    more = np.stack([last, last - middle, middle - signal[..., 0], steps], axis=-1)
    return np.concatenate([statistical_features(signal), more], axis=-1).reshape(3, -1)


def true_features(recording: Recording, after: np.ndarray) -> np.ndarray:
    truth = recording.privileged
    lifted = (after > 0) & (after <= _INPUT)
    end = (after > _INPUT - 0.3) & (after <= _INPUT)
    hold = (after > -0.15) & (after <= 0)
    parts = [truth["normal_force"][part].mean(axis=0) for part in (hold, end)]
    parts += [truth["shear_force"][end].mean(axis=0), truth["shear_force"][lifted].max(axis=0)]
    return np.concatenate([*parts, truth["slide_speed"][lifted].mean(axis=0)])


def models() -> dict[str, BaseEstimator]:
    return {
        "forest": RandomForestClassifier(300, random_state=0),
        "logistic": make_pipeline(StandardScaler(), LogisticRegression(C=0.01, max_iter=5000)),
        "svm": make_pipeline(StandardScaler(), SVC(C=3.0)),
    }


def accuracies(grasps: list[Grasp], x: np.ndarray, model: BaseEstimator) -> list[str]:
    y = np.array([grasp.success for grasp in grasps])
    names = np.array([grasp.object_name for grasp in grasps])
    late = np.array([grasp.lost > _INPUT for grasp in grasps])
    random = StratifiedKFold(5, shuffle=True, random_state=0)
    sessions = np.array([grasp.session for grasp in grasps])
    scores = [
        cross_val_score(model, x, y, cv=random).mean(),
        cross_val_score(model, x[late], y[late], cv=random).mean(),
        cross_val_score(model, x, y, cv=GroupKFold(4), groups=sessions).mean(),
    ]
    for name in ("cylinder", "box", "ball"):
        test = names == name
        scores.append(model.fit(x[~test], y[~test]).score(x[test], y[test]))
    return [f"{100 * score:.1f}" for score in scores]


def agreement(x: np.ndarray, session: np.ndarray) -> str:
    """Returns the correlations of two fingers over grasps (S, N, 3), of the mean and the standard
    deviation over the electrodes, within sessions."""
    told = []
    for name, strength in (("mean", x.mean(axis=1)), ("deviation", x.std(axis=1))):
        within = strength.astype(np.float64)
        for number in np.unique(session):
            within[session == number] -= within[session == number].mean(axis=0)
        pairs = np.corrcoef(within.T)[np.triu_indices(3, 1)]
        told.append(f"{name} {', '.join(f'{value:.2f}' for value in pairs)}")
    return "; ".join(told)


def main() -> None:
    options = {
        "folder": (..., "of the simulated grasps"),
        "--real": (Path, "folder of the BioTac SP stability set"),
    }
    arguments = parse(__doc__, options)
    folder = Path(arguments.folder)
    grasps = [read(path) for path in sorted(folder.glob("*.h5"))]
    write = sys.stdout.write
    for name in ("cylinder", "box", "ball"):
        mine = [grasp for grasp in grasps if grasp.object_name == name]
        held = np.mean([grasp.success for grasp in mine])
        early = np.mean([grasp.lost <= _INPUT for grasp in mine])
        write(f"{name}: {len(mine)} grasps, held {100 * held:.1f} %, ")
        write(f"lost before the input ends {100 * early:.1f} %\n")
    late = [grasp.success for grasp in grasps if grasp.lost > _INPUT]
    write(f"held of those not lost before the input ends: {100 * np.mean(late):.1f} %\n")
    last = np.stack([grasp.last for grasp in grasps])
    sessions = np.array([grasp.session for grasp in grasps])
    write(f"correlation of two fingers, simulated: {agreement(last, sessions)}\n")
    if arguments.real is not None:
        data = BioTacSP(arguments.real).data
        write(f"the same, real: {agreement(data.x.numpy(), data.session.numpy())}\n")
    write("features, model: random, without early losses, by session, cylinder, box, ball\n")
    electrodes = np.array([grasp.electrodes for grasp in grasps])
    inputs = {"truth": np.array([grasp.truth for grasp in grasps])}
    inputs["all fingers"] = electrodes.reshape(len(grasps), -1)
    inputs |= {name: electrodes[:, i] for i, name in enumerate(("left", "middle", "right"))}
    for features, x in inputs.items():
        for name, model in models().items():
            write(f"{features}, {name}: {', '.join(accuracies(grasps, x, model))}\n")
            sys.stdout.flush()


if __name__ == "__main__":
    main()
