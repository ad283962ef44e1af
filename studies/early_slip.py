r"""Early slip: is a slip announced before it begins? On simulated grasps, lifted and shaken.

Every window ends before the onset of slip (from which on the object moves in the hand), and is
judged as on the live robot: by the last frames alone. Alarms are counted by the time that is left,
and at the same moments in grasps that hold. Nothing here is a result on a real hand. Each training
is a file in the folder of runs, so that a run that was stopped goes on.

Examples:
    tactile simulate --objects bigs --out bigs --seed 0
    PYTHONPATH=benchmarks python studies/early_slip.py --root bigs --runs runs
    PYTHONPATH=benchmarks python studies/early_slip_report.py --runs runs
"""

import sys
import time
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from joblib import Parallel, delayed
from shared import parse
from sklearn.linear_model import Ridge
from sklearn.metrics import roc_auc_score
from torch import Tensor, nn

from torch_geometric_tactile._files import atomic_path
from torch_geometric_tactile.data import Protocol, StaticDataset, Windows, split_frames
from torch_geometric_tactile.datasets import BiGS
from torch_geometric_tactile.io import read_hdf5
from torch_geometric_tactile.loader import StaticLoader
from torch_geometric_tactile.nn.models import GraspLSTM, TemporalTaxelNet
from torch_geometric_tactile.transforms import Tare

RATE = 100  # frames per second
LENGTH = 64  # frames of a window
HOP = 5
WITHIN = 0.5  # seconds before the onset in which an alarm is right
REST = 20  # frames at the start of a grasp, before contact
_TRAIN_HOP = 2  # every second window is trained on
_EPOCHS = 6
_BATCH = 256
_LIGHTEST = 0.2  # N of normal force, below which a finger says nothing
METHODS = ("temporal", "lstm", "force", "true force", "pressure")
PROTOCOLS = {
    "by grasp": Protocol("trial", val=0.0, test=0.25, stratify="group"),
    "by object": Protocol("group", leave_one_out=True),
}
_VALIDATION = Protocol("trial", val=0.2, test=0.0, stratify="group")  # of the other grasps


class Part(NamedTuple):
    """Windows of one part: readings, force and fluid pressure of their last frames, and what is
    asked."""

    windows: Windows
    force: np.ndarray  # (S, 3, 3) N, finger, axis
    pressure: np.ndarray  # (S, 3) counts above rest, finger
    to_slip: np.ndarray
    moment: np.ndarray
    trial: np.ndarray


def frames(root: str) -> StaticDataset:
    """Returns all frames of all grasps, tared, with the time to slip and since the lift."""
    dataset = BiGS(root, until=None, signals=["pressure"])
    data = dataset.data
    trial, moment = data.trial, data.time.double()
    onset = torch.full((int(trial.max()) + 1,), torch.inf, dtype=torch.double)
    lift = onset.clone()
    slips, lifts = data.slip == 1, data.phase == dataset.phase_names.index("lift")
    onset.scatter_reduce_(0, trial[slips], moment[slips], "amin")
    lift.scatter_reduce_(0, trial[lifts], moment[lifts], "amin")
    x = Tare("trial", first=REST).fit(data)(data).x
    pressure = Tare("trial", first=REST, attr="pressure").fit(data)(data).pressure
    return StaticDataset.from_arrays(
        x,
        ((onset[trial] - moment) <= WITHIN).long(),
        layout=dataset.layout,
        trial=trial,
        group=data.group,
        time=moment,
        group_names=dataset.group_names,
        class_names=["holds", "slips soon"],
        to_slip=onset[trial] - moment,
        moment=moment - lift[trial],
        force=_forces(dataset),
        pressure=pressure,
    )


def _forces(dataset: BiGS) -> Tensor:
    # (S, 3, 3) N, of the simulator: no attribute of the samples, since no robot knows them.
    paths = {Path(path).stem: path for path in dataset.raw_paths}
    work = [paths[Path(name).stem] for name in dataset.trial_names]
    found = Parallel(n_jobs=2)(delayed(_force)(path) for path in work)
    force = torch.from_numpy(np.concatenate(found))
    if len(force) != len(dataset):
        raise ValueError(f"files must hold {len(dataset)} frames (got {len(force)}): reload them")
    return force


def _force(path: str) -> np.ndarray:
    return read_hdf5(path).privileged["force"].astype(np.float32)


def parts(dataset: StaticDataset, protocol: str, seed: int, fold: int) -> dict[str, Part]:
    """Returns the windows of training, validation and test: from the lift to the onset."""
    outer = PROTOCOLS[protocol].split(dataset, seed, fold)
    rest = dataset[outer.train]
    inner = _VALIDATION.split(rest, seed)
    found = {}
    for name, frames_of in (
        ("train", rest[inner.train]),
        ("val", rest[inner.val]),
        ("test", dataset[outer.test]),
    ):
        windows = Windows(frames_of, LENGTH, HOP, label="last")
        to_slip, moment = windows.to_slip, windows.moment
        windows = windows[(to_slip > 0.5 / RATE) & (moment >= 0)]
        found[name] = Part(
            windows,
            windows.force.numpy(),
            windows.pressure.numpy(),
            windows.to_slip.numpy().astype(float),
            windows.moment.numpy(),
            windows.trial.numpy(),
        )
    return found


def network(name: str, windows: Windows) -> nn.Module:
    """Returns a new network."""
    if name == "lstm":
        return GraspLSTM(windows.layout, 2, num_fingers=3)
    return TemporalTaxelNet(windows.layout, 2, in_channels=3)


def learnt_scores(name: str, found: dict[str, Part], seed: int) -> dict[str, np.ndarray]:
    """Trains a network, keeps the epoch with the best validation ROC, and scores all parts."""
    torch.manual_seed(seed)
    train = found["train"].windows
    scale = _scale(train)
    model = network(name, train)
    weight = 1.0 / torch.bincount(train.y, minlength=2).clamp(min=1).float()
    loss = nn.CrossEntropyLoss(2 * weight / weight.sum())
    loader = StaticLoader(train[::_TRAIN_HOP], _BATCH, shuffle=True, drop_last=True)
    optimizer = torch.optim.Adam(model.parameters(), lr=1e-3, weight_decay=1e-4, fused=True)
    steps = _EPOCHS * len(loader)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, 3e-3, total_steps=steps)
    best, scores = -1.0, {}
    for epoch in range(_EPOCHS):
        model.train()
        for batch in loader:
            optimizer.zero_grad()
            loss(model(batch.x / scale, batch.edge_index), batch.y).backward()
            nn.utils.clip_grad_norm_(model.parameters(), 1.0)
            optimizer.step()
            schedule.step()
        val = _predict(model, found["val"].windows, scale)
        auc = _auc(found["val"], val)
        print(f"  {name}, seed {seed}, epoch {epoch}: ROC {auc:.3f} on validation", flush=True)
        if auc > best:
            best, scores = auc, {"val": val}
            state = {k: v.clone() for k, v in model.state_dict().items()}
    model.load_state_dict(state)
    return scores | {"test": _predict(model, found["test"].windows, scale)}


def _scale(windows: Windows) -> Tensor:
    # One for all electrodes and fingers; readings are tared.
    some = windows[:: max(1, len(windows) // 2000)].batch(range(min(2000, len(windows))))
    return some.x.square().mean().sqrt()


@torch.no_grad()
def _predict(model: nn.Module, windows: Windows, scale: Tensor) -> np.ndarray:
    model.eval()
    parts = [
        model(batch.x / scale, batch.edge_index).diff(dim=1)[:, 0]
        for batch in StaticLoader(windows, 1024)
    ]
    return torch.cat(parts).double().numpy()


def _auc(part: Part, score: np.ndarray) -> float:
    soon = part.to_slip <= WITHIN
    judged = soon | np.isinf(part.to_slip)
    return float(roc_auc_score(soon[judged], score[judged]))


def force_scores(found: dict[str, Part], estimated: bool) -> dict[str, np.ndarray]:
    """Returns the largest ratio of shear to normal force of a finger in the last frame: of the
    simulator's forces, or of those that a ridge regression sees in the electrodes."""
    forces = {name: part.force for name, part in found.items()}
    if estimated:
        last = {name: _last_frames(part.windows) for name, part in found.items()}
        for finger in range(3):
            ridge = Ridge(1.0).fit(last["train"][..., finger], found["train"].force[:, finger])
            for name in ("val", "test"):
                forces[name] = forces[name].copy()
                forces[name][:, finger] = ridge.predict(last[name][..., finger])
    return {name: _shear_ratio(forces[name]) for name in ("val", "test")}


def _last_frames(windows: Windows) -> np.ndarray:
    chunks = [
        split_frames(batch.x, LENGTH)[:, :, -1].numpy() for batch in StaticLoader(windows, 4096)
    ]
    return np.concatenate(chunks)  # (S, electrodes, fingers)


def _shear_ratio(force: np.ndarray) -> np.ndarray:
    normal = np.abs(force[..., 2])
    shear = np.hypot(force[..., 0], force[..., 1])
    ratio = np.where(normal > _LIGHTEST, shear / np.maximum(normal, _LIGHTEST), 0.0)
    return ratio.max(axis=1)


def run(root: str, runs: Path, seeds: int, protocols: list[str], methods: list[str]) -> None:
    """Runs what is not in the folder yet."""
    runs.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(1)
    dataset = frames(root)
    objects = range(len(dataset.group_names))
    for seed, protocol in product(range(seeds), protocols):
        for fold in objects if "object" in protocol else [0]:
            found: dict[str, Part] = {}
            for method in methods:
                path = runs / f"{method}_{protocol}_{seed}_{fold}.npz".replace(" ", "-")
                if path.exists():
                    continue
                found = found or parts(dataset, protocol, seed, fold)
                start = time.perf_counter()
                scores = _scores(method, found, seed)
                _save(path, found, scores, time.perf_counter() - start)
                print(f"{path.name}: ROC {_auc(found['val'], scores['val']):.3f} on validation")


def _scores(method: str, found: dict[str, Part], seed: int) -> dict[str, np.ndarray]:
    if method == "pressure":
        return {name: -found[name].pressure.mean(axis=1) for name in ("val", "test")}
    if "force" in method:
        return force_scores(found, estimated=method == "force")
    return learnt_scores(method, found, seed)


def _save(path: Path, found: dict[str, Part], scores: dict[str, np.ndarray], took: float) -> None:
    arrays = {"seconds": np.array(took), "num_train": np.array(len(found["train"].windows))}
    for name in ("val", "test"):
        part = found[name]
        arrays |= {
            f"{name}_score": scores[name],
            f"{name}_to_slip": part.to_slip,
            f"{name}_moment": part.moment,
            f"{name}_trial": part.trial,
        }
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **arrays)


def main() -> int:
    """Runs the benchmark."""
    arguments = parse(
        __doc__,
        {
            "--root": (..., "folder of tactile simulate bigs"),
            "--runs": (..., "folder of finished runs"),
            "--seeds": (3, "of splits and weights"),
            "--protocols": (list(PROTOCOLS), "what is held out", PROTOCOLS),
            "--methods": (list(METHODS), "which", METHODS),
        },
    )
    runs, seeds = Path(arguments.runs), arguments.seeds
    run(arguments.root, runs, seeds, arguments.protocols, arguments.methods)
    return 0


if __name__ == "__main__":
    sys.exit(main())
