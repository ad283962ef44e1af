"""Jobs that write, which ``kills.py`` kills: all writers of the package."""

import argparse
import json
from collections.abc import Callable
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch

FRAMES = 300


class Job(NamedTuple):
    """What is run in a folder, and what it made; :obj:`made` must not change, whatever is killed.

    ``prepare`` fills the folder, ``run`` writes in it, and ``read`` returns what is finished by
    name; all that it returns must be whole. ``weight`` is its share of the kills.
    """

    name: str
    prepare: Callable[[Path], None]
    run: Callable[[Path], None]
    read: Callable[[Path], dict[str, Any]]
    weight: int


def jobs() -> list[Job]:
    """Returns all jobs whose extras are installed."""
    found = [processing(), convert("convert", ".npz", 4), grasps(), simulated_letters()]
    for make in (
        partial(convert, "convert-hdf5", ".h5", 5, "h5py"),
        partial(convert, "convert-mcap", ".mcap", 2, "google.protobuf", "mcap"),
        export,
        store,
        fit,
        report,
        demo,
        simulation,
        simulated_bigs,
    ):
        try:
            found.append(make())
        except ImportError:
            continue
    return found


def nothing(folder: Path) -> None:
    """Prepares nothing."""


def a_recording(start: int, stop: int):
    """Returns frames that are known by their number."""
    from torch_geometric_tactile.data import Recording

    values = np.arange(start, stop)
    return Recording(values / 100, values[:, None, None] * np.ones((1, 24, 3)))


def numbers(recording) -> list[float]:
    """Returns the number of each frame, which all its taxels must show."""
    assert (recording.tactile == recording.tactile[:, :1, :1]).all()
    return recording.tactile[:, 0, 0].tolist()


def processing() -> Job:
    """Reads recordings and writes a processed file."""
    from torch_geometric_tactile.data._processed_file import read_processed
    from torch_geometric_tactile.datasets import RecordingFrames
    from torch_geometric_tactile.io._recording_npz import write_npz
    from torch_geometric_tactile.sensors import grid

    layout = grid(4, 6, pitch=0.01)

    def prepare(folder):
        for i in range(8):
            write_npz(a_recording(0, FRAMES), folder / f"{('cup', 'box')[i % 2]}_{i}.npz")

    def run(folder):
        assert len(RecordingFrames(folder, layout=layout)) == 8 * FRAMES

    def read(folder):
        paths = folder.glob("processed/*.pt")
        return {path.name: read_processed(path).data.x.sum().item() for path in paths}

    return Job("processing", prepare, run, read, 4)


def convert(name: str, suffix: str, weight: int, *needed: str) -> Job:
    """Converts a CSV file by the command line."""
    from torch_geometric_tactile.cli import main
    from torch_geometric_tactile.io import read_recording
    from torch_geometric_tactile.io._wide_csv import write_wide_csv

    for package in needed:
        import_module(package)

    def prepare(folder):
        write_wide_csv(a_recording(0, FRAMES), folder / "a.csv")

    def run(folder):
        assert main(["convert", str(folder / "a.csv"), str(folder / f"b{suffix}")]) == 0

    def read(folder):
        whole = {"recover": False} if suffix == ".mcap" else {}
        paths = folder.glob(f"*{suffix}")
        return {path.name: numbers(read_recording(path, **whole)) for path in paths}

    return Job(name, prepare, run, read, weight)


def grasps() -> Job:
    """Brings in grasps of the BiGS data set by the command line, and processes them."""
    from torch_geometric_tactile.cli import main
    from torch_geometric_tactile.data._processed_file import read_processed
    from torch_geometric_tactile.datasets import BiGS
    from torch_geometric_tactile.io._recording_npz import read_npz

    def prepare(folder):
        (folder / "in").mkdir()
        for i in range(4):
            frames = np.arange(FRAMES) + 1000 * i
            electrodes = frames[:, None, None] * np.ones((1, 19, 3))
            pac = np.ones((FRAMES, 3, 22), dtype=np.int16) * i
            np.savez(folder / "in" / f"cup_{i}.npz", electrodes=electrodes, pac=pac, success=i % 2)

    def run(folder):
        assert main(["convert", "bigs", str(folder / "in"), str(folder / "out"), "--npz"]) == 0
        assert len(BiGS(folder / "out", until=None)) == 4 * FRAMES

    def read(folder):
        found = {p.name: numbers(read_npz(p)) for p in folder.glob("out/*.npz")}
        for path in folder.glob("out/processed/*.pt"):
            data = read_processed(path).data
            found[path.name] = data.x.sum().item(), data.pac.sum().item()
        return found

    return Job("grasps", prepare, run, read, 4)


def store() -> Job:
    """Writes the results of the runs of a table."""
    from torch_geometric_tactile.data import Protocol
    from torch_geometric_tactile.experiments._experiment import Experiment
    from torch_geometric_tactile.experiments._run_store import RunStore
    from torch_geometric_tactile.experiments.source import DataSource

    source = DataSource("a.B", {}, fingerprint="d")
    runs = [
        Experiment(
            name="a",
            model={"x": 1},
            data=source,
            protocol=Protocol("trial"),
            protocol_name="by trial",
            epochs=2,
            seed=seed,
        )
        for seed in range(60)
    ]

    def run(folder):
        kept = RunStore(folder)
        try:
            for experiment in runs:
                if kept.read(experiment) is None:
                    kept.write(experiment, {"seed": experiment.seed, "scores": [0.5] * 3000})
        finally:
            kept.clean(runs)

    def read(folder):
        kept = RunStore(folder)
        return {r.file_name: result for r in runs if (result := kept.read(r)) is not None}

    return Job("table", nothing, run, read, 3)


def fit() -> Job:
    """Trains for three epochs with a checkpoint after each."""
    import lightning as L
    from lightning.pytorch.callbacks import ModelCheckpoint

    from torch_geometric_tactile.datasets import FakeTactileDataset
    from torch_geometric_tactile.nn.models import GraspGCN
    from torch_geometric_tactile.training import TactileDataModule, TactileModule
    from torch_geometric_tactile.training._checkpoint import AtomicCheckpointIO
    from torch_geometric_tactile.transforms import KNNGraph

    train = FakeTactileDataset(64, "train", pre_transform=KNNGraph(2))
    test = FakeTactileDataset(64, "test", pre_transform=KNNGraph(2))
    L.Trainer(accelerator="cpu", logger=False, enable_checkpointing=False)  # imports the rest

    def run(folder):
        L.seed_everything(0, verbose=False)
        saved = ModelCheckpoint(folder, "{epoch}", save_top_k=-1, enable_version_counter=False)
        L.Trainer(
            accelerator="cpu",
            devices=1,
            max_epochs=3,
            logger=False,
            enable_progress_bar=False,
            enable_model_summary=False,
            plugins=[AtomicCheckpointIO()],
            callbacks=[saved],
        ).fit(TactileModule(GraspGCN()), datamodule=TactileDataModule(train, test, batch_size=16))

    def read(folder):
        return {
            path.name: sum(
                value.double().sum().item()
                for value in torch.load(path, weights_only=True)["state_dict"].values()
            )
            for path in folder.glob("*.ckpt")
        }

    return Job("fit", nothing, run, read, 2)


def report() -> Job:
    """Writes the pages of a report as the demo does, without its training."""
    from torch_geometric_tactile import Predictor
    from torch_geometric_tactile.nn import TactileFNN
    from torch_geometric_tactile.reports.html import write_report
    from torch_geometric_tactile.sensors import grid
    from torch_geometric_tactile.visualization._style import new_figure
    from torch_geometric_tactile.visualization.figure import save_figure

    torch.manual_seed(0)
    model = TactileFNN(4, 2, widths=(64,), pools=(1,))
    predictor = Predictor(model, grid(2, 2, pitch=0.01), None, ("a", "b"), num_channels=3)

    def run(folder):
        for i in range(4):
            figure = new_figure(2.0, 2.0)
            figure.add_subplot().plot(range(i + 3))
            save_figure(figure, folder / f"{i}.png")
            predictor.save(folder / f"{i}.predictor")
            write_report(
                folder / f"{i}.html",
                title="x" * 10000,
                notice="generated",
                facts=[],
                tables=[],
                pictures=[],
            )

    def read(folder):
        names = ("*.png", "*.html", "*.predictor")
        return {path.name: path.read_bytes() for name in names for path in folder.glob(name)}

    return Job("report", nothing, run, read, 2)


def export() -> Job:
    """Exports a predictor by the command line."""
    import onnxruntime  # noqa: F401
    import onnxscript  # noqa: F401

    from torch_geometric_tactile import Predictor
    from torch_geometric_tactile.cli import main
    from torch_geometric_tactile.live import OnnxModel
    from torch_geometric_tactile.nn import TactileFNN
    from torch_geometric_tactile.sensors import grid

    def prepare(folder):
        torch.manual_seed(0)
        model = TactileFNN(4, 2, widths=(64,), pools=(1,))
        predictor = Predictor(model, grid(2, 2, pitch=0.01), None, ("a", "b"), num_channels=3)
        predictor.save(folder / "a.predictor")

    def run(folder):
        assert main(["export", str(folder / "a.predictor"), str(folder / "b.onnx")]) == 0

    def read(folder):
        return {path.name: OnnxModel(path).info for path in folder.glob("*.onnx")}

    return Job("export", prepare, run, read, 1)


def demo() -> Job:
    """Runs the whole demo: generated data, one seed, one epoch."""
    from torch_geometric_tactile.commands import demo as verb
    from torch_geometric_tactile.experiments import _demo

    _demo._GENERATED_ARGUMENTS = {"num_samples": 120, "num_test": 60, "num_objects": 6}
    given = ["--generated", "--seeds", "1", "--folds", "2", "--epochs", "1", "--jobs", "1"]
    parser = argparse.ArgumentParser()
    verb.add_arguments(parser)

    def run(folder):
        assert verb.run(parser.parse_args([*given, "--out", str(folder / "report")])) == 0

    def read(folder):
        made = {}
        for path in folder.glob("report/runs/*.json"):
            content = json.loads(path.read_text(encoding="utf-8"))
            made[path.name] = content["result"]["predictions"]
        for path in folder.glob("report/comparisons.json"):
            comparisons = json.loads(path.read_text(encoding="utf-8"))
            models = [model for comparison in comparisons for model in comparison["models"]]
            made[path.name] = [model["scores"] for model in models]
        made |= {path.name: path.read_bytes() for path in folder.glob("report/*.png")}
        return made

    return Job("demo", nothing, run, read, 1)


def simulation() -> Job:
    """Simulates one grasp of each of two objects."""
    import h5py  # noqa: F401
    import mujoco  # noqa: F401

    from torch_geometric_tactile.io import read_hdf5
    from torch_geometric_tactile.sim import paper8, simulate
    from torch_geometric_tactile.sim._object_sets import OBJECT_SETS

    OBJECT_SETS["two"] = lambda: paper8()[:2]

    def run(folder):
        assert len([*simulate(folder, "two", 1, preset="ci")]) == 2

    def read(folder):
        return {path.name: read_hdf5(path).tactile.tolist() for path in folder.glob("*.h5")}

    return Job("simulate", nothing, run, read, 1)


def simulated_bigs() -> Job:
    """Simulates three grasps in the form of the BiGS data set."""
    import h5py  # noqa: F401
    import mujoco  # noqa: F401

    from torch_geometric_tactile.io import read_hdf5
    from torch_geometric_tactile.sim import simulate_bigs

    def run(folder):
        assert len([*simulate_bigs(folder, 3)]) == 3

    def read(folder):
        found = {}
        for path in folder.glob("*.h5"):
            recording = read_hdf5(path)
            found[path.name] = recording.tactile.tolist(), recording.extra["pac"].tolist()
        for path in folder.glob("*.json"):
            found[path.name] = json.loads(path.read_text(encoding="utf-8"))["objects"]
        return found

    return Job("simulate-bigs", nothing, run, read, 1)


def simulated_letters() -> Job:
    """Simulates presses of three letters in blocks of a hundred."""
    from torch_geometric_tactile.sensors import TaxelLayout, letter_array
    from torch_geometric_tactile.sim import simulate_letters

    layout = TaxelLayout("plain", letter_array().pos)

    def run(folder):
        assert len([*simulate_letters(folder, 250, letters="ABC", layout=layout)]) == 9

    def read(folder):
        found = {path.name: np.load(path).tolist() for path in folder.rglob("*.npy")}
        for path in folder.glob("layout.json"):
            found[path.name] = TaxelLayout.load(path).pos.tolist()
        for path in folder.glob("simulation.json"):
            found[path.name] = json.loads(path.read_text(encoding="utf-8"))
        assert not found or {"layout.json"} <= set(found)
        return found

    return Job("simulate-letters", nothing, run, read, 2)
