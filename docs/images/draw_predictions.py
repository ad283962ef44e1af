"""Draws docs/images/predictions.png: a grasp, and when a model takes it for slipping.

The model is trained on all other grasps of the folder; the one that is drawn is new to it.

Examples:
    tactile simulate --objects bigs --out few --grasps 60 --seed 0
    python docs/images/draw_predictions.py few
"""

import argparse
from pathlib import Path

import torch
from PIL import Image
from torch.nn.functional import cross_entropy

from torch_geometric_tactile import Predictor
from torch_geometric_tactile.data import Windows
from torch_geometric_tactile.datasets import RecordingFrames
from torch_geometric_tactile.io import read_recording
from torch_geometric_tactile.nn import TaxelNet
from torch_geometric_tactile.sensors import biotac
from torch_geometric_tactile.transforms import ZScore
from torch_geometric_tactile.visualization import plot_predictions, save_figure

LENGTH, HOP, EPOCHS = 20, 5, 15  # frames, frames


def trained(paths: list[Path]) -> Predictor:
    """A model of windows of 0.2 s that tells slip from hold."""
    trials = [read_recording(path) for path in paths]
    frames = RecordingFrames(layout=biotac(), recordings=trials, target="slip")
    windows = Windows(frames, LENGTH, HOP)
    scaler = ZScore().fit(windows.data)
    data = scaler(windows.batch(range(len(windows))))
    torch.manual_seed(0)
    model = TaxelNet(biotac(), 2, in_channels=data.x.size(-1))
    optimizer = torch.optim.AdamW(model.parameters(), 1e-3)
    share = data.y.bincount() / len(data.y)
    for _ in range(EPOCHS):
        for batch in torch.randperm(len(data.y)).split(64):
            optimizer.zero_grad()
            cross_entropy(model(data.x[batch]), data.y[batch], 1 / share).backward()
            optimizer.step()
    predictor = Predictor.from_dataset(model, windows, scaler)
    predictor.class_names = ("hold", "slip")
    return predictor


def main() -> None:
    """Writes the picture beside this file."""
    parser = argparse.ArgumentParser()
    parser.add_argument("root", type=Path)
    parser.add_argument("--grasp", default="ball_0007")
    parser.add_argument("--out", type=Path, default=Path(__file__).with_name("predictions.png"))
    args = parser.parse_args()
    paths = sorted(path for path in args.root.rglob("*.h5"))
    (shown,) = (path for path in paths if path.stem == args.grasp)
    predictor = trained([path for path in paths if path != shown])
    save_figure(plot_predictions(predictor, read_recording(shown)), args.out)
    with Image.open(args.out) as picture:
        small = picture.convert("RGB").quantize(128, dither=Image.Dither.NONE)
    small.save(args.out, optimize=True)


if __name__ == "__main__":
    main()
