r"""One encoder for all sensors, pretrained on synthetic touch: is it worth being shipped?

Pretrained as `tactile pretrain` does, the same weights in turn on many sensors of one channel:
synthetic touch of strokes, edges, blobs, rings and glyphs on random layouts (grids, hexagons,
jittered, discs, curved patches), the simulated hand, simulated fingertips and the training objects
of BTS3. Then compared at ten labels a class on sets that it has not seen, each model with the first
of its settings: an encoder runs on their layouts, with its readings scaled by the training samples.
Beside it, one with the weights that it began with. Every run is a file, so that a benchmark that
was stopped goes on.

Examples:
    python benchmarks/shipped_encoder.py --data shared/data --out shipped --minutes 60
"""

import math
import statistics
import time
from itertools import pairwise
from pathlib import Path
from typing import Any

import few_labels
import numpy as np
import torch
from few_labels import Samples
from pretraining import ENCODED, PLAIN, encoded_scores
from shared import describe_machine, parse
from torch import Tensor
from torch.nn import Module

from torch_geometric_tactile.nn.models import TaxelEncoder
from torch_geometric_tactile.predictor import PretrainedEncoder
from torch_geometric_tactile.sensors import TaxelLayout, grid, hexagonal, stock_layout
from torch_geometric_tactile.training import PretrainSettings
from torch_geometric_tactile.training.pretraining import _Pretraining

_UNSEEN = ("letters", "mat", "digits")
_OBJECTS, _PRESSES = 60, 8  # of each synthetic sensor
_LEAST, _MOST = 16, 600  # taxels of a synthetic sensor
_SYNTHETIC = 0.6  # part of the steps


def random_layout(rng: np.random.Generator) -> TaxelLayout:
    """A grid, a hexagonal array, a jittered one, a disc or a curved patch."""
    count = math.exp(rng.uniform(math.log(_LEAST), math.log(_MOST)))
    ratio = rng.uniform(0.5, 1.0)
    rows, cols = max(3, round((count * ratio) ** 0.5)), max(3, round((count / ratio) ** 0.5))
    kind = rng.choice(["grid", "hexagonal", "jittered", "disc", "curved"])
    flat = hexagonal(rows, cols, 1.0) if kind == "hexagonal" else grid(rows, cols, 1.0)
    pos = flat.pos.numpy().astype(float)
    pos = pos - pos.mean(axis=0)
    if kind == "jittered":
        pos[:, :2] += rng.uniform(-0.3, 0.3, (len(pos), 2))
    if kind == "disc":
        pos = pos[np.hypot(*(pos[:, :2] / np.abs(pos[:, :2]).max(axis=0)).T) <= 1.05]
    normal = np.zeros_like(pos)
    normal[:, 2] = 1
    if kind == "curved":
        radius = rng.uniform(0.4, 1.5) * max(rows, cols)
        angle = pos[:, 0] / radius
        normal = np.stack([np.sin(angle), 0 * angle, np.cos(angle)], axis=1)
        pos = np.stack([radius * normal[:, 0], pos[:, 1], radius * (normal[:, 2] - 1)], axis=1)
    return TaxelLayout(
        str(kind), torch.tensor(0.004 * pos), normal=torch.tensor(normal, dtype=torch.double)
    )


def _on_plane(layout: TaxelLayout) -> np.ndarray:
    # Where taxels are on the plane of the stamp, in half extents, as seen from above.
    pos = layout.pos.double().numpy()[:, :2]
    pos = pos - (pos.max(axis=0) + pos.min(axis=0)) / 2
    return pos / np.abs(pos).max()


def _stamp(rng: np.random.Generator) -> list[tuple[str, np.ndarray, float, float]]:
    # What an object consists of: kinds with points (K, 2), a width and a height.
    parts = []
    for _ in range(rng.integers(1, 4)):
        kind = str(rng.choice(["blob", "stroke", "glyph", "ring", "edge"]))
        num = {"blob": 1, "stroke": 2, "glyph": rng.integers(3, 7), "ring": 2, "edge": 2}[kind]
        points = rng.uniform(-0.9, 0.9, (num, 2))
        parts.append((kind, points, rng.uniform(0.06, 0.3), rng.uniform(0.4, 1.0)))
    return parts


def _height(parts: list[tuple[str, np.ndarray, float, float]], at: np.ndarray) -> np.ndarray:
    found = np.zeros(len(at))
    for kind, points, width, height in parts:
        if kind == "blob":
            far = np.hypot(*(at - points[0]).T)
        elif kind == "ring":
            far = np.abs(np.hypot(*(at - points[0]).T) - 0.2 - 0.5 * np.abs(points[1, 0]))
        elif kind == "edge":
            along = (points[1] - points[0]) / np.linalg.norm(points[1] - points[0]).clip(1e-6)
            far = ((at - points[0]) @ np.array([-along[1], along[0]])).clip(min=0)
        else:
            far = np.full(len(at), np.inf)
            for a, b in pairwise(points):
                part = ((at - a) @ (b - a) / ((b - a) @ (b - a)).clip(1e-9)).clip(0, 1)
                far = np.minimum(far, np.hypot(*(at - a - part[:, None] * (b - a)).T))
        found = np.maximum(found, height * np.exp(-((far / width) ** 2)))
    return found


def synthetic(rng: np.random.Generator) -> tuple[Tensor, Tensor, TaxelLayout]:
    """Readings (S, N, 1) of a random sensor and the object of each: presses differ in place,
    turn, depth, tilt and noise."""
    layout = random_layout(rng)
    at, frames = _on_plane(layout), []
    shift, turn, noise = rng.uniform(0, 0.2), rng.uniform(0, 0.4), rng.uniform(0, 0.04)
    gain = np.exp(rng.uniform(0, 0.3) * rng.normal(size=len(at)))  # of each taxel
    offset = rng.uniform(0, 0.05) * rng.normal(size=len(at))
    for _ in range(_OBJECTS):
        stamp = _stamp(rng)
        for _ in range(_PRESSES):
            angle = turn * rng.normal()
            rotation = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
            height = _height(stamp, (at - shift * rng.normal(size=2)) @ rotation)
            height /= max(float(height.max()), 1e-6)
            depth = rng.uniform(0.4, 1.0) + 0.2 * (at @ rng.normal(size=2))
            pressed = (
                (height - 1 + depth).clip(min=0) * (height > 0.05) * np.exp(0.3 * rng.normal())
            )
            frames.append(gain * pressed + offset + noise * rng.normal(size=len(at)))
    x = torch.tensor(np.array(frames), dtype=torch.float32).unsqueeze(-1)
    return x, torch.arange(_OBJECTS).repeat_interleave(_PRESSES), layout


def recorded(data: Path, made: Path) -> list[tuple[Tensor, Tensor, TaxelLayout]]:
    """The channels of the simulated hand, of simulated fingertips and of BTS3, one by one."""
    from torch_geometric_tactile.io import read_recording

    found: list[tuple[Tensor, Tensor, TaxelLayout]] = []
    for name, layout, objects, more in (
        ("hand_shapes", "allegro_uskin", "shapes", ("--preset", "ci", "--trials", "2")),
        ("fingertips", "biotac", "bigs", ("--grasps", "60")),
    ):
        folder = few_labels.simulated(made / name, "--objects", objects, *more)
        parts, trial = [], []
        for number, path in enumerate(sorted(folder.glob("*.h5"))):
            recording = read_recording(path)
            readings = recording.tactile - recording.tactile[:5].mean(axis=0)
            parts.append(readings[:: max(1, len(readings) // 100)])
            trial += [number] * len(parts[-1])
        x = torch.tensor(np.concatenate(parts), dtype=torch.float32)
        found.append((x, torch.tensor(trial), stock_layout(layout)))
    samples = few_labels.bts3(data, made)
    x = torch.tensor(samples.x, dtype=torch.float32)
    found.append((x, torch.as_tensor(samples.unit), samples.layout))
    return [(x[:, :, c : c + 1], t, layout) for x, t, layout in found for c in range(x.size(2))]


def _share(module: Module, of: Module) -> None:
    for name, part in module.named_modules():
        part._parameters.update(of.get_submodule(name)._parameters)


def pretrained(kind: str, seed: int, options: Any) -> TaxelEncoder:
    """The encoder of a seed, on any layout; `random` has the weights that it began with."""
    paths = {k: options.out / f"seed_{seed}_{k}.encoder" for k in ("shipped", "random")}
    if not paths[kind].is_file():
        settings = PretrainSettings(seed=seed, batch_size=options.batch_size, steps=1)
        rng = np.random.default_rng(seed)
        sources = [synthetic(rng) for _ in range(options.sensors)]
        real = recorded(options.data, options.out / "made")
        runs = [_Pretraining(*source, settings) for source in [*sources, *real]]
        first = runs[0]
        if not paths["random"].is_file():
            PretrainedEncoder(first.model, sources[0][2]).save(paths["random"])
        for run in runs[1:]:
            for name, module in run.modules.items():
                _share(module, first.modules[name])
            run.weights, run.optimizer = first.weights, first.optimizer
        step = _train(runs, len(sources), rng, options)
        told = {"steps": step, "seconds": round(60 * options.minutes), "seed": seed}
        PretrainedEncoder(first.model, sources[0][2], told).save(paths["shipped"])
    return PretrainedEncoder.load(paths[kind]).model


def _train(runs: list[Any], num_synthetic: int, rng: np.random.Generator, options: Any) -> int:
    # Steps by processor time, of which the first are timed.
    start, step, steps, losses = time.process_time(), 0, 0, []
    while not steps or step < steps:
        is_synthetic = rng.random() < _SYNTHETIC
        low, high = (0, num_synthetic) if is_synthetic else (num_synthetic, len(runs))
        losses.append(runs[rng.integers(low, high)].step(step, steps or None))
        step += 1
        if step == 200:
            steps = max(step, round(60 * options.minutes / (time.process_time() - start) * step))
        if step % 200 == 0:
            means = np.round(np.mean(losses[-200:], axis=0), 3).tolist()
            seconds = time.process_time() - start
            print(f"step {step} of {steps}, {seconds:.0f} s: {means}", flush=True)
    return step


def scores(name: str, samples: Samples, draw: int, options: Any) -> dict[str, float]:
    """Returns the accuracy of each model in percent on a draw of labels and test."""
    train, test = few_labels.drawn(samples, options.labels, draw)
    path, encoders = options.out / f"{name}_{draw}.npz", {}
    for seed in range(options.seeds):
        for kind in ("shipped", "random"):
            model = pretrained(kind, seed, options).on_layout(samples.layout)
            model.fit_scale(torch.as_tensor(samples.x[train], dtype=torch.float32))
            encoders[f"{kind} {seed}"] = options.out / f"{path.stem}_{kind}_{seed}.encoder"
            PretrainedEncoder(model, samples.layout).save(encoders[f"{kind} {seed}"])
    return encoded_scores(samples, train, test, path, encoders, options.models, options)


def table(found: dict[str, dict[str, dict[str, float]]], seeds: int, models: list[str]) -> str:
    """Returns means over draws and seeds, and paired differences with standard errors over draws,
    each the mean of its seeds."""
    lines = []
    for name, runs in found.items():
        draws = list(runs.values())
        best = max(PLAIN, key=lambda model: statistics.fmean(r[model] for r in draws))
        for model in models:
            of = {
                kind: [
                    statistics.fmean(r[f"{model}, {kind} {seed}"] for seed in range(seeds))
                    for r in draws
                ]
                for kind in ("shipped", "random")
            }
            by_seed = [
                statistics.fmean(r[f"{model}, shipped {seed}"] for r in draws)
                for seed in range(seeds)
            ]
            plain = [r[best] for r in draws]
            own = f"{statistics.fmean(of['shipped']):.1f}"
            seeds_words = ", ".join(f"{score:.1f}" for score in by_seed)
            lines.append(
                f"| {name} | {best} {statistics.fmean(plain):.1f} | {model} | {own} ({seeds_words})"
                f" | {_paired(of['shipped'], plain)} | {_paired(of['shipped'], of['random'])} |"
            )
    return "\n".join(lines)


def _paired(one: list[float], other: list[float]) -> str:
    values = [a - b for a, b in zip(one, other, strict=True)]
    error = statistics.stdev(values) / len(values) ** 0.5 if len(values) > 1 else math.nan
    return f"{statistics.fmean(values):+.1f} ± {error:.1f}"


def main() -> None:
    options = parse(
        __doc__,
        {
            "--data": (Path("shared/data"), "folder of the real data"),
            "--out": (Path("shipped_encoder"), "folder of runs and results"),
            "--sets": (list(_UNSEEN), "which data sets are unseen"),
            "--labels": (10, "labels a class"),
            "--draws": (5, "draws of labels and test"),
            "--seeds": (3, "pretraining seeds"),
            "--sensors": (200, "synthetic sensors of each seed"),
            "--batch-size": (48, "pairs of frames in a step"),
            "--models": (list(ENCODED), "rows with an encoder"),
            "--members": (1, "networks that are averaged"),
            "--epochs": (30, "epochs of each network"),
            "--minutes": (30, "minutes of processor time of each pretraining"),
        },
    )
    torch.set_num_threads(1)
    options.out.mkdir(parents=True, exist_ok=True)
    for seed in range(options.seeds):
        pretrained("shipped", seed, options)
    found: dict[str, dict[str, dict[str, float]]] = {}
    for name in options.sets:
        samples = few_labels.SETS[name](options.data, options.out / "made")
        for draw in range(options.draws):
            found.setdefault(name, {})[str(draw)] = scores(name, samples, draw, options)
            words = {m: round(s, 1) for m, s in found[name][str(draw)].items()}
            print(f"{name}, draw {draw}: {words}", flush=True)
    print(describe_machine())
    print("| set | descriptors | row | accuracy (by seed) | to descriptors | to random weights |")
    print("|---|---|---|---|---|---|")
    print(table(found, options.seeds, list(options.models)))


if __name__ == "__main__":
    main()
