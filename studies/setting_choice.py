r"""Which settings should `tactile compare` try for networks on images and on windows judged as a
whole? Ten labels of each class, one network, scored on a validation part.

The samples that `few_labels.py` tests on in the same draw are left out; a third of the units that
remain is the validation part. `textures` are made up: patterns of 12 kinds that slide over 3 x 4
taxels, 48 frames each, at varying speed, place, angle and pressure, under drift and noise.

Examples:
    PYTHONPATH=benchmarks:studies python studies/setting_choice.py --sets letters digits mat
    PYTHONPATH=benchmarks:studies python studies/setting_choice.py --sets textures icub --data shared/data
"""

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import few_labels
import numpy as np
from few_labels import Samples
from shared import describe_machine, parse

from torch_geometric_tactile import datasets
from torch_geometric_tactile._files import atomic_path
from torch_geometric_tactile.experiments._compared_models import MIXED_TAXELS, PYRAMID
from torch_geometric_tactile.experiments._compared_task import ComparedTask
from torch_geometric_tactile.experiments._run_experiment import run_experiment
from torch_geometric_tactile.experiments.compared_windows import data_source
from torch_geometric_tactile.experiments.comparison import ComparisonSettings, comparison_plan
from torch_geometric_tactile.experiments.plan import Plan
from torch_geometric_tactile.sensors import grid

_MAX_VALIDATED = 600
_TRANSFORMS = "torch_geometric_tactile.transforms"


def textures(data: Path, made: Path) -> tuple[Samples, int]:
    """Slides over 12 patterns of three waves each, 60 of each."""
    rng, layout = np.random.default_rng(0), grid(3, 4, 0.004)
    places = layout.pos.numpy()[:, :2]
    kinds = [
        [(rng.uniform(150, 900), rng.uniform(0, np.pi), rng.uniform(0.3, 1)) for _ in range(3)]
        for _ in range(12)
    ]
    x, y, seconds = [], [], np.arange(48) / 100
    for label, waves in enumerate(kinds):
        for _ in range(60):
            speed, angle = 0.02 * rng.uniform(0.8, 1.25), rng.normal(0, 0.15)
            way = (speed * seconds)[:, None, None] * np.array([np.cos(angle), np.sin(angle)])
            at = places[None] + 0.1 * rng.uniform(0, 1, 2) + way
            height = sum(
                size * np.sin(waves_per_metre * (at @ np.array([np.cos(turn), np.sin(turn)])))
                for waves_per_metre, turn, size in waves
            )
            pressure = 1 + 0.3 * rng.normal() + 0.2 * np.cumsum(rng.normal(0, 0.05, 48))
            noise = rng.normal(0, 0.25, height.shape) + rng.normal(0, 0.3, (1, 12))
            x.append(((2 + height) * pressure[:, None] + noise).T)
            y.append(label)
    return Samples(np.stack(x), np.array(y), np.arange(len(y)), layout), 48


def _trials(dataset: Any, num_frames: int, rest: int) -> tuple[Samples, int]:
    # Whole trials, less their rest, resampled.
    trial, x, y, unit = np.asarray(dataset.data.trial), [], [], []
    for number in np.unique(trial):
        rows = np.flatnonzero(trial == number)
        if len(rows) < 4:
            continue
        frames = dataset.data.x[rows].numpy().astype(float)
        frames -= frames[:rest].mean(axis=0)
        at = np.linspace(0, len(rows) - 1, num_frames)
        below = np.minimum(at.astype(int), len(rows) - 2)
        share = (at - below)[:, None, None]
        frames = frames[below] * (1 - share) + frames[below + 1] * share  # (T, N, C)
        x.append(frames.transpose(1, 2, 0).reshape(frames.shape[1], -1))
        y.append(int(dataset.data.y[rows[0]]))
        unit.append(int(number))
    return Samples(np.stack(x), np.array(y), np.array(unit), dataset.layout), num_frames


def _copied(data: Path, made: Path, name: str) -> str:
    if not (made / name).is_dir():  # what the data set processes stays out of `data`
        shutil.copytree(data / name, made / name)
    return str(made / name)


def icub(data: Path, made: Path) -> tuple[Samples, int]:
    """Ten objects; whole trials as ten frames."""
    return _trials(datasets.ICubGrasp(_copied(data, made, "icub_grasp")), 10, 1)


def eflesh(data: Path, made: Path) -> tuple[Samples, int]:
    """Slip or hold; whole trials as 30 frames."""
    return _trials(datasets.EFleshSlip(_copied(data, made, "eflesh_slip")), 30, 10)


def picks(data: Path, made: Path) -> tuple[Samples, int]:
    """Does the object fall; whole trials as 40 frames."""
    return _trials(datasets.USkinPick(_copied(data, made, "uskin_pick")), 40, 5)


WINDOWS: dict[str, Callable[[Path, Path], tuple[Samples, int]]] = {
    "textures": textures,
    "icub": icub,
    "eflesh": eflesh,
    "picks": picks,
}


def _model(**arguments: Any) -> dict[str, Any]:
    return {"model": {"init_args": arguments}}


def _shift(cells: int) -> dict[str, Any]:
    arguments = {"rows": cells, "columns": cells}
    step = {"class_path": f"{_TRANSFORMS}.RandomShift", "init_args": arguments}
    return {"train_transform": step}


def image_settings(widths: list[int]) -> dict[str, tuple[str, dict[str, Any]]]:
    """Returns settings of networks on images, by their names."""
    pyramid = _model(**PYRAMID, widths=widths)
    deep = _model(taxel_dropout=0.0, max_taxels=4)
    return {
        "taxel_net": ("taxel_net", {}),
        "no taxel dropout": ("taxel_net", _model(taxel_dropout=0.0)),
        "to 16 taxels": ("taxel_net", _model(taxel_dropout=0.0, max_taxels=16)),
        "to 4 taxels": ("taxel_net", deep),
        "to 4 taxels, shifts of 1": ("taxel_net", deep | _shift(1)),
        "to 4 taxels, shifts of 2": ("taxel_net", deep | _shift(2)),
        "pyramid": ("taxel_net", pyramid),
        "pyramid, shifts of 1": ("taxel_net", pyramid | _shift(1)),
        "pyramid, shifts of 2": ("taxel_net", pyramid | _shift(2)),
        "cnn": ("cnn", {}),
        "cnn, shifts of 1": ("cnn", _shift(1)),
        "cnn, shifts of 2": ("cnn", _shift(2)),
    }


def window_settings() -> dict[str, tuple[str, dict[str, Any]]]:
    """Returns settings of networks on windows, by their names."""
    step = {"class_path": f"{_TRANSFORMS}.RandomTimeShift", "init_args": {"steps": 3}}
    mixed, shifts = _model(**MIXED_TAXELS), {"train_transform": step}
    return {
        "temporal": ("temporal", {}),
        "no taxel dropout": ("temporal", _model(taxel_dropout=0.0)),
        "mean": ("temporal", _model(taxel_dropout=0.0, pool="mean")),
        "mean and maximum": ("temporal", _model(taxel_dropout=0.0, pool="mean_max")),
        "mixed": ("temporal", mixed),
        "mixed, 64 channels": ("temporal", _model(**MIXED_TAXELS | {"mixed_channels": 64})),
        "mixed, dropout 0.3": ("temporal", _model(**MIXED_TAXELS | {"dropout": 0.3})),
        "mixed, 16 filters": (
            "temporal",
            _model(**MIXED_TAXELS | {"num_filters": 16, "filter_size": 1}),
        ),
        "mixed, hidden layer": ("temporal", _model(**MIXED_TAXELS | {"hidden_channels": 64})),
        "mixed, last frame": ("temporal", _model(**MIXED_TAXELS | {"pool": "last"})),
        "mixed, shifts in time": ("temporal", mixed | shifts),
        "temporal_cnn": ("temporal_cnn", {}),
        "temporal_cnn, widths of the paper": (
            "temporal_cnn",
            _model(widths=[64, 128, 128], kernel_sizes=[7, 5, 3]),
        ),
        "temporal_cnn, dropout 0.3": ("temporal_cnn", _model(dropout=0.3)),
        "temporal_cnn, shifts in time": ("temporal_cnn", shifts),
    }


def parts(samples: Samples, labels: int, draw: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns the samples to train on and those to validate on; none is tested in this draw."""
    rng = np.random.default_rng(draw)
    kept = np.flatnonzero(~few_labels._held_out(samples, rng))
    inner = Samples(samples.x[kept], samples.y[kept], samples.unit[kept], samples.layout)
    rng = np.random.default_rng(1000 + draw)
    validated = few_labels._held_out(inner, rng)
    train = few_labels._labelled(inner, ~validated, labels, rng)
    val = rng.permutation(np.flatnonzero(validated))[:_MAX_VALIDATED]
    return kept[train], kept[val]


def plan_of(samples: Samples, num_frames: int | None, draw: int, options: Any, name: str) -> Plan:
    """Returns the plan of a comparison whose test part is the validation part."""
    path = options.out / f"{name}_{options.labels}_{draw}.npz"
    samples.layout.save(options.out / f"{name}.json")
    x = samples.x
    if num_frames is not None:  # (S, N, C, T)
        x = x.reshape(*x.shape[:2], -1, num_frames)
    few_labels._write_samples(samples._replace(x=x), *parts(samples, options.labels, draw), path)
    axis = {} if num_frames is None else {"time_axis": 3}
    source = data_source(path, layout=str(options.out / f"{name}.json"), **axis)
    models = ("temporal", "temporal_cnn") if num_frames else ("taxel_net", "cnn")
    settings = ComparisonSettings(models=models, by="given", members=1)
    return comparison_plan(source, settings, name=path.stem)


def accuracy(plan: Plan, model: str, setting: dict[str, Any]) -> float:
    """Returns the accuracy of one setting in percent."""
    (experiment,) = (e for e in plan.experiments if e.name == model)
    choice = replace(experiment.choice, settings=[setting], num_validation_cuts=0)
    return 100 * run_experiment(replace(experiment, choice=choice))["metrics"]["accuracy"]


def main() -> None:
    options = parse(
        __doc__,
        {
            "--data": (Path("shared/data"), "folder of the real data"),
            "--out": (Path("setting_choice"), "folder of the results"),
            "--sets": (["letters", "mat", "digits", "textures"], "which data sets"),
            "--labels": (10, "labels a class"),
            "--draws": (3, "draws of labels and validation part"),
            "--first": (10, "the first draw"),
        },
    )
    options.out.mkdir(parents=True, exist_ok=True)
    result = options.out / "result.json"
    scores = json.loads(result.read_text()) if result.is_file() else {}
    scores["machine"] = describe_machine()
    for name in options.sets:
        made = options.out / "made"
        is_window = name in WINDOWS
        load = WINDOWS[name] if is_window else few_labels.SETS[name]
        samples, num_frames = load(options.data, made) if is_window else (load(options.data, made), None)
        for draw in range(options.first, options.first + options.draws):
            plan = plan_of(samples, num_frames, draw, options, name)
            if is_window:
                settings = window_settings()
            else:
                task = ComparedTask(samples.layout, "accuracy", len(samples.y))
                settings = image_settings(task.cnn_widths)
            for title, (model, setting) in settings.items():
                of_draw = scores.setdefault(name, {}).setdefault(title, {})
                if str(draw) in of_draw:
                    continue
                of_draw[str(draw)] = accuracy(plan, model, setting)
                with atomic_path(result) as temporary:
                    temporary.write_text(json.dumps(scores, indent=1))
                print(f"{name}, draw {draw}, {title}: {of_draw[str(draw)]:.1f}", flush=True)


if __name__ == "__main__":
    main()
