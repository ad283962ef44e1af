r"""Few labels with an encoder that was pretrained on the unlabelled recordings of the same sensor.

Of each set, three splits hold out units (trials, persons, blocks); an encoder is pretrained on all
unlabelled frames of the others, with the number of the split as seed, and another one of the same
architecture stays as it was drawn. Five draws of labels on each split are compared as `tactile
compare --by given --encoder` compares them, each model with the first of its settings. The table is
of differences to models on descriptors, each on the same split and draw. Every run is a file, so
that a benchmark that was stopped goes on.

Examples:
    python benchmarks/pretraining.py --data shared/data --out pretraining
    python benchmarks/pretraining.py --data shared/data --out pretraining --sets eflesh --draws 2
"""

import json
import statistics
import zipfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import few_labels
import numpy as np
import torch
from few_labels import Samples
from shared import describe_machine, parse

from torch_geometric_tactile._files import atomic_path
from torch_geometric_tactile.experiments.comparison import ComparisonSettings
from torch_geometric_tactile.io import read_recording
from torch_geometric_tactile.nn.models import TaxelEncoder
from torch_geometric_tactile.predictor import PretrainedEncoder
from torch_geometric_tactile.sensors import TaxelLayout
from torch_geometric_tactile.training import PretrainSettings, pretrain

PLAIN = ("descriptors_forest", "descriptors_svm")
ENCODED = ("encoder_forest", "encoder_svm", "encoder_tuned")
_MOST_TESTED = 1000
_SLIPS, _HOLDS = 86, 17  # sequences of eFlesh to train on: the first run, and half of the holds


class Recorded(NamedTuple):
    """Labelled samples, all frames without labels (S, N, C), their trials, and their units."""

    samples: Samples
    frames: np.ndarray
    trial: np.ndarray
    unit: np.ndarray


def hand(data: Path, made: Path) -> Recorded:
    """Twenty simulated objects; a trial is held out. Frames less their rest, every second one."""
    samples = few_labels.hand(data, made)
    parts = []
    for path in sorted((made / "hand").glob("*.h5")):
        readings = read_recording(path).tactile
        parts.append((readings - readings[:10].mean(axis=0))[::2])
    trial = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
    return Recorded(samples, np.concatenate(parts), trial, trial)


def mat(data: Path, made: Path) -> Recorded:
    """Postures on a mat; a person is held out. A trial is the file of a person and a posture."""
    parts, persons = [], []
    with zipfile.ZipFile(data / "pressure_mat/pmd-1.0.0.zip") as file:
        names = [name for name in file.namelist() if "experiment-i/" in name]
        for name in sorted(name for name in names if name.endswith(".txt")):
            frames = np.loadtxt(file.read(name).decode().splitlines())[3:]
            frames = frames.reshape(-1, 32, 2, 16, 2).mean(axis=(2, 4))
            parts.append(frames.reshape(-1, 512, 1))
            persons.append(int(name.split("/")[-2][1:]))
    count = [len(part) for part in parts]
    trial = np.repeat(np.arange(len(parts)), count)
    return Recorded(
        few_labels.mat(data, made), np.concatenate(parts), trial, np.repeat(persons, count)
    )


def eflesh(data: Path, made: Path) -> Recorded:
    """Slip or hold on a magnetic skin; the last runs are tested. A trial is a sequence, whose
    frames are less its first ten.

    The places of the ten magnetometers are not published: two rows of five."""
    folder = data / "eflesh_slip"
    labels = [int(line) for line in (folder / "labels").read_text().split()]
    frames = [torch.load(folder / f"seq_{i}.pt", weights_only=True) for i in range(len(labels))]
    x = torch.stack(frames).numpy().reshape(len(labels), -1, 10, 3)
    x = x - x[:, :10].mean(axis=1, keepdims=True)  # which drifted between the runs
    trial = np.repeat(np.arange(len(labels)), x.shape[1])
    label = np.repeat(labels, x.shape[1])
    rows = np.arange(len(trial)) % x.shape[1] % 30 == 15
    whole = x.reshape(-1, 10, 3)
    places = torch.cartesian_prod(torch.arange(2.0), torch.arange(5.0)) * 0.01
    samples = Samples(whole[rows], label[rows], trial[rows], TaxelLayout("eflesh", places))
    return Recorded(samples, whole, trial, trial)


def icub(data: Path, made: Path) -> Recorded:
    """Ten objects in the hand of an iCub; a trial is held out."""
    from torch_geometric_tactile.datasets import ICubGrasp

    dataset = ICubGrasp(str(_writable(data / "icub_grasp", made / "icub")), contact=True)
    x, y, trial = (dataset.column(key).numpy() for key in ("x", "y", "trial"))
    return Recorded(Samples(x, y, trial, dataset.layout), x, trial, trial)


SETS: dict[str, Callable[[Path, Path], Recorded]] = {
    "hand": hand,
    "mat": mat,
    "eflesh": eflesh,
    "icub": icub,
}


def _writable(folder: Path, copy: Path) -> Path:
    import shutil

    if not copy.is_dir():  # what the data set processes stays out of `data`
        shutil.copytree(folder, copy)
    return copy


def tested(name: str, samples: Samples, split: int) -> np.ndarray:
    """Returns which samples are tested (S,): of eFlesh always the same."""
    if name != "eflesh":
        return few_labels.held_out(samples, np.random.default_rng(split))
    of_units = {unit: samples.y[samples.unit == unit][0] for unit in np.unique(samples.unit)}
    slips = [unit for unit, label in of_units.items() if label == 1]
    holds = [unit for unit, label in of_units.items() if label == 0]
    return ~np.isin(samples.unit, slips[:_SLIPS] + holds[:_HOLDS])


def encoders(name: str, found: Recorded, split: int, options: Any) -> dict[str, Path]:
    """Writes the pretrained encoder of a split and one with the weights that it began with."""
    paths = {
        kind: options.out / f"{name}_{split}_{kind}.encoder" for kind in ("pretrained", "random")
    }
    is_tested = tested(name, found.samples, split)
    kept = ~np.isin(found.unit, np.unique(found.samples.unit[is_tested]))
    x = torch.as_tensor(found.frames[kept], dtype=torch.float32)
    layout = found.samples.layout
    if not paths["random"].is_file():
        torch.manual_seed(split)
        model = TaxelEncoder(layout, 1, in_channels=x.size(2)).fit_scale(x[:: 1 + len(x) // 2000])
        PretrainedEncoder(model, layout).save(paths["random"])
    if not paths["pretrained"].is_file():
        settings = PretrainSettings(minutes=options.minutes, steps=options.steps, seed=split)
        checkpoint = f"{paths['pretrained']}.checkpoint"
        encoder = pretrain(x, found.trial[kept], layout, settings, checkpoint=checkpoint)
        print(f"{name}, split {split}: {encoder.describe()}", flush=True)
        encoder.save(paths["pretrained"])
    return paths


def scores(name: str, found: Recorded, split: int, draw: int, options: Any) -> dict[str, float]:
    """Returns the accuracy of each model in percent, those of the random encoder by this name."""
    samples, rng = found.samples, np.random.default_rng([split, draw])
    is_tested = tested(name, samples, split)
    train = few_labels.labelled(samples, ~is_tested, options.labels, rng)
    test = np.random.default_rng(split).permutation(np.flatnonzero(is_tested))[:_MOST_TESTED]
    path = options.out / f"{name}_{split}_{draw}.npz"
    found_encoders = encoders(name, found, split, options)
    return encoded_scores(samples, train, test, path, found_encoders, ENCODED, options)


def encoded_scores(
    samples: Samples,
    train: np.ndarray,
    test: np.ndarray,
    path: Path,
    encoders: Mapping[str, Path],
    models: Sequence[str],
    options: Any,
) -> dict[str, float]:
    """Returns the accuracy in percent of models on descriptors, and of models with each encoder,
    whose name follows theirs; the samples are written to a file first."""
    layout = path.with_suffix(".json")
    samples.layout.save(layout)
    few_labels.write_samples(samples, train, test, path)
    out = options.out / path.stem
    settings = ComparisonSettings(models=PLAIN, by="given")
    result = few_labels.accuracies(path, layout, settings, out, as_given=True)
    for kind, encoder in encoders.items():
        settings = ComparisonSettings(
            models=tuple(models),
            by="given",
            members=options.members,
            epochs=options.epochs,
            encoder=str(encoder),
        )
        of_kind = few_labels.accuracies(path, layout, settings, out, as_given=True)
        result |= {f"{model}, {kind}": score for model, score in of_kind.items()}
    return result


def table(found: dict[str, Any]) -> str:
    """Returns means over all draws, and differences to descriptors with the standard errors over
    splits, each the mean of its draws."""
    lines = []
    for name, runs in found.items():
        if name == "machine":
            continue
        models = list(next(iter(runs.values())))
        best = max(PLAIN, key=lambda model: statistics.fmean(r[model] for r in runs.values()))
        for model in models:
            values = {run: r[model] - r[best] for run, r in runs.items()}
            by_split: dict[str, list[float]] = {}
            for run, value in values.items():
                by_split.setdefault(run.split(",")[0], []).append(value)
            splits = [statistics.fmean(of_split) for of_split in by_split.values()]
            draws = list(values.values())
            errors = [
                statistics.stdev(part) / len(part) ** 0.5 if len(part) > 1 else float("nan")
                for part in (splits, draws)
            ]
            mean = statistics.fmean(r[model] for r in runs.values())
            lines.append(
                f"| {name} | {model} | {mean:.1f} | {statistics.fmean(draws):+.1f} | "
                f"{errors[0]:.1f} | {errors[1]:.1f} | {len(draws)} |"
            )
    return "\n".join(lines)


def main() -> None:
    options = parse(
        __doc__,
        {
            "--data": (Path("shared/data"), "folder of the real data"),
            "--out": (Path("pretraining"), "folder of runs and results"),
            "--sets": (list(SETS), "which data sets"),
            "--labels": (10, "labels a class"),
            "--splits": (3, "splits, each with a pretraining seed of its own"),
            "--draws": (5, "draws of the labels on each split"),
            "--members": (1, "networks that are averaged"),
            "--epochs": (30, "epochs of each network"),
            "--minutes": (3, "minutes of each pretraining"),
            "--steps": (int, "steps of each pretraining, in place of minutes"),
        },
    )
    torch.set_num_threads(1)
    options.out.mkdir(parents=True, exist_ok=True)
    for name in options.sets:
        result = options.out / f"{name}_result.json"
        found = json.loads(result.read_text()) if result.is_file() else {}
        recorded = SETS[name](options.data, options.out / "made")
        for draw in range(options.draws):
            for split in range(options.splits):
                found[f"split {split}, draw {draw}"] = scores(name, recorded, split, draw, options)
                with atomic_path(result) as temporary:
                    temporary.write_text(json.dumps(found, indent=1))
                words = {m: round(s, 1) for m, s in found[f"split {split}, draw {draw}"].items()}
                print(f"{name}, split {split}, draw {draw}: {words}", flush=True)
    print(describe_machine())
    paths = sorted(options.out.glob("*_result.json"))
    of_all = {p.name.removesuffix("_result.json"): json.loads(p.read_text()) for p in paths}
    print("| set | model | accuracy | to the better of descriptors | ± splits | ± draws | runs |")
    print("|---|---|---|---|---|---|---|")
    print(table(of_all))


if __name__ == "__main__":
    main()
