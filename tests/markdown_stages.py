"""What the reader of a page has before its first line, and what holds after its last."""

import os
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from torch_geometric_tactile import Predictor
from torch_geometric_tactile.cli import main
from torch_geometric_tactile.data import FrameRing, Recording, StaticData, StaticDataset, Windows
from torch_geometric_tactile.io import read_recording, write_recording
from torch_geometric_tactile.sensors import allegro_uskin, grid
from torch_geometric_tactile.transforms import TaxelPose, ZScore

STAGES, CHECKS = {}, {}
EXTRAS = {  # modules of extras that the blocks of a page need
    "docs/analysis.md": ("lightning", "matplotlib"),
    "docs/command_line.md": ("lightning",),
    "docs/compare.md": ("lightning", "yaml"),
    "docs/experiments.md": ("lightning", "joblib"),
    "docs/hand.md": ("matplotlib",),
    "docs/lerobot.md": ("pyarrow",),
    "docs/live.md": ("serial", "websockets", "mcap"),
    "docs/metrics.md": ("lightning",),
    "docs/mixed_sensors.md": ("lightning",),
    "docs/models.md": ("lightning", "cv2"),
    "docs/predictor.md": ("lightning", "onnxruntime", "onnxscript"),
    "docs/recordings.md": ("h5py", "matplotlib"),
    "docs/results/hand_study.md": ("mujoco",),
    "docs/serial_formats.md": ("cobs",),
    "docs/simulated_fingertips.md": ("mujoco", "h5py"),
    "docs/simulation.md": ("mujoco", "h5py"),
    "docs/touch_policies.md": ("mujoco",),
    "docs/your_own_classes.md": ("lightning",),
    "docs/your_own_data.md": ("lightning", "matplotlib"),
}
SLOW = {"docs/mixed_sensors.md", "docs/your_own_classes.md"}
FULL = {  # whole pages that only `make check` runs
    *("docs/analysis.md", "docs/command_line.md", "docs/live.md", "docs/models.md"),
    *("docs/predictor.md", "docs/simulated_fingertips.md", "docs/your_own_data.md"),
}
_PHASES = ["hover", "approach", "squeeze", "lift", "hold", "release"]


def stage(name):
    """Names the function that prepares a page."""
    return lambda function: STAGES.setdefault(name, function)


def check(name):
    """Names the function that checks what a page has made; it is given what was printed as well."""
    return lambda function: CHECKS.setdefault(name, function)


def hand_recording(frames=6, count=False, **meta):
    """A recording of an Allegro hand, of noise."""
    draw = np.random.default_rng(0)
    tactile = draw.normal(size=(frames, 384, 3))
    if count:
        tactile = np.round(30_000 + 100 * tactile)
    return Recording(
        time=np.arange(frames) / 100,
        tactile=tactile.astype(np.float32),
        joint=draw.uniform(0, 0.3, (frames, 16)),
        meta={"unit": "count" if count else "newton", "phase_names": _PHASES, **meta},
        privileged={"phase": np.arange(frames) % 6},
    )


def write_hand(folder):
    """Writes four trials of each of four objects whose properties are known."""
    Path(folder).mkdir(parents=True)
    for item in ("sponge", "purse", "potato_chip_can", "saran_wrap"):
        for number in range(4):
            write_recording(hand_recording(), Path(folder, f"{item}_{number:03d}.npz"))


def hand_names(names):
    """Readings and joint angles of a hand."""
    names["readings"], names["joints"] = torch.rand(2, 384, 3), 0.2 * torch.rand(2, 16)
    names["reading"], names["joint"] = names["readings"][0], names["joints"][0]
    names["rest"], names["rest_joints"] = 0.1 * torch.rand(5, 384, 3), torch.zeros(5, 16)


def train_hand(folder):
    """Trains MT-GCN for one epoch on recordings in a folder; its run is in the working folder."""
    write_hand(Path(folder, "AllegroUSkin"))
    os.environ["TACTILE_DATA"] = folder  # the autouse fixture gives it back
    quiet = ["--trainer.max_epochs", "1", "--trainer.enable_progress_bar", "false"]
    assert main(["fit", "--config", "p1_table2/mt_gcn_te_joint", *quiet]) == 0
    return Path("runs/mt_gcn_te_joint/version_0/checkpoints/last.ckpt")


def write_grasp_predictor():
    """Writes a predictor of a pad with 4 taxels, not trained."""
    from torch_geometric_tactile.nn import TactileFNN

    arrays = np.random.default_rng(0).normal(33_000, 100, (8, 4, 3)).astype(np.float32)
    dataset = StaticDataset.from_arrays(arrays, np.arange(8) % 2, layout=grid(2, 2, pitch=0.004))
    model = TactileFNN(dataset.layout, 2, widths=(4,), pools=(1,))
    scale = ZScore(per="channel").fit(dataset.data)
    Predictor.from_dataset(model, dataset, scale).save("grasp.predictor")


@check("docs/quick_start.md")
def _(names, out):
    dataset, split = names["dataset"], names["split"]
    assert not {*dataset.group[split.train].tolist()} & {*dataset.group[split.test].tolist()}
    assert out.startswith("accuracy on new objects: 0.")


@stage("docs/analysis.md")
def _(names):
    run = train_hand("data").parents[1]
    Path("last.ckpt").write_bytes((run / "checkpoints" / "last.ckpt").read_bytes())
    Path("config.yaml").write_bytes((run / "config.yaml").read_bytes())
    hand_names(names)


@stage("docs/predictor.md")
def _(names):
    from torch_geometric_tactile.nn import TemporalTaxelNet

    write_grasp_predictor()
    train_hand("data")
    hand_names(names)
    names["recording"] = hand_recording(70)
    trial = torch.zeros(70, dtype=torch.long)
    time = torch.arange(70) / 100
    frames = StaticDataset.from_arrays(
        torch.rand(70, 384, 3), trial, trial=trial, time=time, layout=allegro_uskin()
    )
    windows = Windows(frames, length=60, hop=10)
    model = TemporalTaxelNet(allegro_uskin(), 2, in_channels=3)
    slip = Predictor.from_dataset(model, windows)
    slip.save("slip.predictor")
    ring = FrameRing(length=60, num_taxels=384, num_channels=3)
    for frame in frames.data.x[:60]:
        ring.push(frame)
    names["ring"] = ring


@stage("docs/bigs.md")
def _(names):
    from torch_geometric_tactile.datasets import BiGS

    names["BiGS"] = BiGS


@stage("docs/compare.md")
def _(names):
    layout = allegro_uskin()
    names["x"], names["y"] = torch.rand(12, 24, 3), torch.arange(12) % 2
    names["trial"] = torch.arange(12) // 3
    names["x_new"], names["windows"] = torch.rand(3, 24, 3), torch.rand(12, 24, 3 * 20)
    samples = StaticData(x=torch.rand(12, 384, 3), joint=0.2 * torch.rand(12, 16))
    names["samples"] = TaxelPose(layout, tangent=True)(samples)


@stage("docs/hand.md")
def _(names):
    names["message"] = np.zeros((368, 3), dtype=np.float32)


@stage("docs/layers.md")
def _(names):
    names["x"] = torch.rand(2, 384, 3)
    names["edge_index"] = allegro_uskin().edge_index("original")


@stage("docs/lerobot.md")
def _(names):
    names["paths"] = ["a.npz", "b.npz"]
    for path in names["paths"]:
        write_recording(hand_recording(40, object="mug"), path)


@stage("docs/letters.md")
def _(names):
    from torch_geometric_tactile.sim import simulate_letters

    list(simulate_letters("letters", presses=10))


@stage("docs/live.md")
def _(names):
    write_recording(hand_recording(400, count=True), "grasp.mcap")


def write_glove(path, label):
    """A CSV file of six pads and two bend sensors."""
    header = "time," + ",".join([*(f"pad_{i}" for i in range(6)), "bend_1", "bend_2", "grasp"])
    rows = [f"{10 * i},1,2,3,4,5,{i},0.1,0.2,{label}" for i in range(4)]
    Path(path).parent.mkdir(exist_ok=True)
    Path(path).write_text("\n".join([header, *rows, ""]))


@stage("docs/recordings.md")
def _(names):
    names["layout"] = allegro_uskin()
    hand = hand_recording()
    long = replace(hand, time=np.linspace(0.0, 2.0, hand.num_frames))
    write_recording(long, "trial.h5")
    write_glove("mug_003.csv", "pinch")
    for number, label in enumerate(("pinch", "power", "pinch")):
        write_glove(f"grasps/mug_{number}.csv", label)
    grid(2, 4, pitch=0.01).save("glove.json")


@stage("docs/scaling.md")
def _(names):
    write_hand("sim")


@check("docs/bigs.md")
def _(names, out):
    assert "extra        pressure (500, 3)" in out
    dataset = names["dataset"]
    assert "pac" in dataset.data or "pac" in dataset[0]
    assert dataset.group_names == ["ball", "box", "cylinder"]
    assert dataset.y.view(3, 401)[:, 0].tolist() == [1, 0, 1]  # 2 s up to pick-up and 2 s after it
    stored = np.load("log_1.npz")
    rec = read_recording("bigs/log_1.npz")
    assert (rec.label, rec.meta["object"], rec.meta["trial"]) == ("failure", "box", 1)
    # Electrode 5 of the middle finger, the fourth PAC value of a frame, a joint in its second step.
    assert np.array_equal(rec.tactile[:, 4, 1], stored["elec"][:, 19 + 4])
    assert np.array_equal(rec.extra["pac"][7, 2], stored["pac"][7 * 22 : 8 * 22, 2])
    arm = np.deg2rad(stored["arm"][3 * 7 + 1])
    assert np.allclose(rec.extra["robot_joint"][7, 1], arm, atol=1e-5)


@check("docs/models.md")
def _(names, out):
    assert names["logits"].shape == (32, 6)
    assert type(names["model"]).__name__ == "MTGCN"


@check("docs/your_own_data.md")
def _(names, out):
    assert len(names["dataset"]) == 3 * 6 * 40
    assert names["metrics"]["test/accuracy"] > 0.9  # the generated grasps are easy to tell apart
    assert names["probabilities"].shape == (2,)
    assert "runs/glove/version_0/checkpoints/last.ckpt" in out
    rows = Path("predictions.csv").read_text(encoding="utf-8").splitlines()
    assert rows[0] == "index,prediction,p_pinch,p_power"
    assert names["Predictor"].load("glove.predictor").class_names == ("pinch", "power")


@check("docs/predictor.md")
def _(names, out):
    assert names["predictor"].window.length == 60
    assert names["info"]["num_taxels"] == 4
    assert names["probability"].sum() == pytest.approx(1, abs=1e-5)


def _prints(page, count):
    text = (Path(__file__).parents[1] / page).read_text(encoding="utf-8")
    code = "".join(re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL))
    said = re.findall(r"^ *print\(.*\)  # (.*)$", code, flags=re.MULTILINE)

    def check_prints(names, out):
        assert len(said) == count
        assert out.splitlines() == said

    CHECKS[page] = check_prints


_prints("docs/time.md", 5)
_prints("docs/serial_formats.md", 2)


@check("docs/your_own_classes.md")
def _(names, out):
    assert names["metrics"]["test/accuracy"] > 0.9  # the generated presses are easy to tell apart
