"""The frames of the study of the simulated hand, and what becomes of them in a test."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from torch_geometric_tactile._files import atomic_path
from torch_geometric_tactile.data import Protocol, StaticData
from torch_geometric_tactile.datasets import AllegroUSkin
from torch_geometric_tactile.io import read_recording
from torch_geometric_tactile.sensors import TaxelLayout, stock_layout
from torch_geometric_tactile.sim import SkinModel
from torch_geometric_tactile.transforms import DropTaxels, TaxelPose

TOUCH = ("squeeze", "lift", "hold")
DEVICES = (1, 2, 3)  # the recordings are of device 0
_KEPT = ("joint", "time", "trial", "group", "shape", "width", "placement", "size")


@dataclass(frozen=True)
class Frames:
    """Frames with their taxels placed, and the names of their trials and shapes."""

    data: StaticData
    layout: TaxelLayout
    names: np.ndarray
    shapes: list[str]

    def y(self, task: str) -> Tensor:
        """Classes, or widths in millimetres."""
        return self.data.shape if task == "shape" else 1000 * self.data.width.float()

    def trial_count(self, rows: Tensor | None = None) -> int:
        trial = self.data.trial if rows is None else self.data.trial[rows]
        return len(trial.unique())


def read(root: str, stride: int, hand: str = "allegro_uskin") -> Frames:
    """Frames with touch, less the mean reading of their trial's hover."""
    layout = stock_layout(hand)
    dataset = AllegroUSkin(
        root, "shape", None, layout=layout, phases=TOUCH, stride=stride, tare="hover"
    )
    found = dataset.batch(range(len(dataset)))
    data = StaticData(x=found.x.float(), **{key: found[key] for key in _KEPT})
    data = TaxelPose(layout, tangent=True)(data)
    names = np.asarray(dataset.trial_names)[found.trial.numpy()]
    return Frames(data, layout, names, dataset.shape_names)


def other_devices(root: str, frames: Frames, cache: Path) -> dict[int, Tensor]:
    """The same frames as other devices would have read them, tared: other gains, offsets, mixing of
    axes, drift and noise of the same forces."""
    if cache.is_file():
        with np.load(cache) as file:
            return {seed: torch.from_numpy(file[str(seed)]) for seed in DEVICES}
    out = {seed: np.zeros(tuple(frames.data.x.shape), np.float32) for seed in DEVICES}
    files = {path.stem: path for path in Path(root).rglob("*.h5")}
    for name in np.unique(frames.names):
        rows, trial = np.flatnonzero(frames.names == name), read_recording(files[name])
        hover = trial.privileged["phase"] == trial.meta["phase_names"].index("hover")
        chosen = np.searchsorted(trial.time, frames.data.time[rows].numpy() - 1e-6)
        for seed in DEVICES:
            rng = np.random.default_rng([seed, rows[0]])
            skin = SkinModel(device_seed=seed)
            x = skin.readings(trial.privileged["force"], trial.time, frames.layout, rng)
            out[seed][rows] = x[chosen] - x[hover].mean(axis=0)
    with atomic_path(cache) as path, path.open("wb") as file:
        np.savez(file, **{str(seed): x for seed, x in out.items()})
    return other_devices(root, frames, cache)


def with_readings(data: StaticData, x: Tensor) -> StaticData:
    """The same samples with other readings."""
    return StaticData(**{**data.to_dict(), "x": x})


def with_dead_taxels(data: StaticData, part: float, seed: int) -> StaticData:
    """Some taxels of each sample read as if nothing touched them."""
    generator = torch.Generator().manual_seed(seed)
    return with_readings(data, DropTaxels(part, generator=generator)(data).x)


def split(frames: Frames, by: str, fold: int) -> tuple[Tensor, Tensor]:
    """Rows to train and to test on."""
    if by == "size":  # the largest objects, which are larger than all that are trained on
        held = frames.data["size"] == frames.data["size"].max()
        return (~held).nonzero().view(-1), held.nonzero().view(-1)
    folds = {"trial": 5, "placement": 3}[by]
    protocol = Protocol(by, folds=folds, stratify="group" if by == "trial" else None)
    parts = protocol.split(frames.data, fold=fold)
    return parts.train, parts.test


def some_trials(frames: Frames, rows: Tensor, number: int, seed: int) -> Tensor:
    """The rows of a number of trials, as many of each shape."""
    generator, kept = torch.Generator().manual_seed(seed), []
    trial, shape = frames.data.trial[rows], frames.data.shape[rows]
    for kind in range(len(frames.shapes)):
        mine = trial[shape == kind].unique()
        order = torch.randperm(len(mine), generator=generator)
        kept.append(mine[order[: number // len(frames.shapes)]])
    return rows[torch.isin(trial, torch.cat(kept))]


def on_layout(data: StaticData, own: TaxelLayout, other: TaxelLayout) -> Tensor:
    """Readings of one layout on the taxels of another: each goes to the nearest of its link, the
    mean where several do; taxels without any read zero."""
    x = data.x.new_zeros(len(data.x), other.num_taxels, data.x.size(2))
    count = x.new_zeros(other.num_taxels)
    for number, link in enumerate(own.link_names):
        mine = (own.link == number).nonzero().view(-1)
        if len(mine) == 0:
            continue
        there = (other.link == other.link_names.index(link)).nonzero().view(-1)
        nearest = there[torch.cdist(own.pos[mine], other.pos[there]).argmin(dim=1)]
        x.index_add_(1, nearest, data.x[:, mine])
        count.index_add_(0, nearest, torch.ones(len(mine)))
    return x / count.clamp(min=1).view(-1, 1)
