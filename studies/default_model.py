r"""Accuracy on validation parts of TaxelNet and of plain models, on four data sets that differ:
what its defaults were chosen on.

* ``digits``: scikit-learn's 8 x 8 digits as a grid; ``digits150`` with 150 samples to train on.
* ``images``: 28 x 50 pressure images that are generated here: ten shapes, shifted, turned, pressed
  unevenly, with noise and dead spots.
* ``event``: counts of 39 taxels in twelve bins of time, generated here: twenty patterns.
* ``bts3``: the training part of BTS3, common mode subtracted, folds by object. Its test part is not
  read. The folder of the CSV files is an argument.

Examples:
    PYTHONPATH=benchmarks python studies/default_model.py digits images event
    PYTHONPATH=benchmarks python studies/default_model.py bts3 --root data/biotacsp --models svm taxel_net
"""

import argparse
import time
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from sklearn.datasets import load_digits
from sklearn.ensemble import RandomForestClassifier
from sklearn.model_selection import GroupShuffleSplit, StratifiedShuffleSplit
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.svm import SVC
from torch import Tensor, nn
from torch.nn.functional import cross_entropy, max_pool2d

from torch_geometric_tactile.io._biotac_sp_csv import read_biotac_sp_csv
from torch_geometric_tactile.nn import TaxelNet
from torch_geometric_tactile.sensors import TaxelLayout, biotac_sp, grid
from torch_geometric_tactile.training import training_recipe

_TAXEL_NETS: dict[str, dict[str, Any]] = {
    "taxel_net": {},
    "taxel_net_all_taxels": {"taxel_dropout": 0.0},
    "taxel_net_tenth_dropped": {"taxel_dropout": 0.1},
    "taxel_net_third_dropped": {"taxel_dropout": 0.3},
    "taxel_net_without_direct": {"direct_channels": 0},
    "taxel_net_self": {"conv": "self"},
    "taxel_net_difference": {"conv": "difference"},
    "taxel_net_flat": {"head": "flat"},
    "taxel_net_max": {"head": "max"},
}


class Samples(NamedTuple):
    """Readings, labels, and what leaves together."""

    layout: TaxelLayout
    x: np.ndarray
    y: np.ndarray
    group: np.ndarray | None = None
    num_train: int | None = None


def digits(num_train: int | None = None) -> Samples:
    data = load_digits()
    x = data.images.reshape(-1, 64, 1).astype(np.float32)
    return Samples(grid(8, 8, pitch=0.004), x, data.target, num_train=num_train)


def images(number: int = 800, rows: int = 28, cols: int = 50) -> Samples:
    draw = np.random.default_rng(0)
    x, y = np.zeros((number, rows, cols), np.float32), draw.integers(10, size=number)
    down, right = np.mgrid[:rows, :cols]
    for i, kind in enumerate(y):
        angle, scale = draw.uniform(-0.5, 0.5), draw.uniform(0.8, 1.25)
        right_of = right - cols / 2 - draw.uniform(-10, 10)
        below = down - rows / 2 - draw.uniform(-5, 5)
        u = (right_of * np.cos(angle) + below * np.sin(angle)) / scale
        v = (below * np.cos(angle) - right_of * np.sin(angle)) / scale
        tilt = 1 + 0.4 * draw.normal() * u / 8 + 0.4 * draw.normal() * v / 6
        pressure = _shape(kind, u, v) * tilt.clip(0.1) * draw.uniform(0.4, 1.4)
        if draw.random() < 0.5:
            pressure *= draw.random((rows, cols)) > 0.1
        x[i] = (pressure + draw.normal(0, 0.08, (rows, cols))).clip(0)
    return Samples(grid(rows, cols, pitch=0.005), x.reshape(number, -1, 1), y)


def _shape(kind: int, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    radius, a, b = np.hypot(u, v), abs(u), abs(v)
    box = (a < 7) & (b < 5)
    shapes = (
        radius < 7,
        (radius < 8) & (radius > 4.5),
        box,
        box & ~((a < 4) & (b < 2.2)),
        (a < 9) & (b < 1.8),
        ((a < 7) & (b < 1.6)) | ((b < 7) & (a < 1.6)),
        (b < 5) & (a < (v + 5) * 0.7),
        ((a < 7) & (abs(v + 4) < 1.8)) | ((abs(u + 5) < 1.8) & (b < 5)),
        (np.hypot(u - 4, v) < 3) | (np.hypot(u + 4, v) < 3),
        (a < 8) & (abs(v - 3 * np.sin(u * 0.6)) < 1.6),
    )
    return shapes[kind].astype(float)


def event(number: int = 600, bins: int = 12, classes: int = 20) -> Samples:
    draw = np.random.default_rng(0)
    places = np.array([(5.0 * c + 2.5 * (r % 2), 4.4 * r) for r in range(7) for c in range(6)])[:39]
    layout = TaxelLayout("skin39", torch.from_numpy(places / 1000).float())
    centre = draw.uniform([0, 0], [25, 26], (classes, 3, 2))
    when, size = draw.uniform(0, bins, (classes, 3)), draw.uniform(0.5, 1.5, (classes, 3))
    y, x = draw.integers(classes, size=number), np.zeros((number, 39, bins), np.float32)
    for i, kind in enumerate(y):
        shift, delay, gain = draw.normal(0, 1.5, 2), draw.normal(), draw.uniform(0.6, 1.5)
        rate = np.zeros((39, bins))
        for at, start, much in zip(centre[kind], when[kind], size[kind], strict=True):
            near = np.exp(-((places - at - shift) ** 2).sum(axis=1) / 32)
            soon = np.exp(-((np.arange(bins) - start - delay) ** 2) / 4)
            rate += much * np.outer(near, soon)
        x[i] = draw.poisson(1.2 * gain * rate + 0.15)
    return Samples(layout, x, y)


def bts3(root: Path) -> Samples:
    tables = [
        read_biotac_sp_csv(root / f"bts3v2_palm_{palm}.csv") for palm in ("down", "side", "45")
    ]
    x = np.concatenate([table.reading for table in tables]).astype(np.float32)
    y = np.concatenate([table.slipped for table in tables]).astype(int)
    group = np.array([name for table in tables for name in table.object_names])
    return Samples(biotac_sp(), x - x.mean(axis=1, keepdims=True), y, group)


class FullyConnected(nn.Sequential):
    def __init__(self, size: int, classes: int) -> None:
        norm = nn.BatchNorm1d(size, affine=False)
        layers = [nn.Linear(size, 128), nn.ReLU(), nn.Dropout(0.2), nn.Linear(128, 64), nn.ReLU()]
        super().__init__(nn.Flatten(), norm, *layers, nn.Dropout(0.2), nn.Linear(64, classes))


class SmallCNN(nn.Module):
    def __init__(self, layout: TaxelLayout, in_channels: int, classes: int) -> None:
        super().__init__()
        self.cell = layout.image_map
        self.norm = nn.BatchNorm1d(in_channels, affine=False)
        sizes = (in_channels, 16, 32, 64)
        self.convs = nn.ModuleList(
            nn.Sequential(nn.Conv2d(a, b, 3, padding=1, bias=False), nn.BatchNorm2d(b), nn.ReLU())
            for a, b in pairwise(sizes)
        )
        self.head = nn.Sequential(
            nn.AdaptiveMaxPool2d((4, 4)), nn.Flatten(), nn.Dropout(0.3), nn.Linear(1024, classes)
        )

    def forward(self, x: Tensor) -> Tensor:
        x = self.norm(x.flatten(0, 1)).view_as(x)
        rows, cols = (self.cell.amax(dim=0) + 1).tolist()
        image = x.new_zeros(len(x), x.size(2), rows, cols)
        image[:, :, self.cell[:, 0], self.cell[:, 1]] = x.transpose(1, 2)
        for i, conv in enumerate(self.convs):
            image = conv(max_pool2d(image, 2, ceil_mode=True) if i else image)
        return self.head(image)


def train(model: nn.Module, x: Tensor, y: Tensor, seed: int) -> nn.Module:
    recipe = training_recipe(len(x))
    steps = len(x) // recipe.batch_size
    optimizer = torch.optim.AdamW(model.parameters(), recipe.lr, weight_decay=recipe.weight_decay)
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimizer, recipe.lr, total_steps=recipe.max_epochs * steps
    )
    torch.manual_seed(seed)
    for _ in range(recipe.max_epochs):
        for rows in torch.randperm(len(x)).split(recipe.batch_size)[:steps]:
            optimizer.zero_grad()
            loss = cross_entropy(model(x[rows]), y[rows], label_smoothing=recipe.label_smoothing)
            loss.backward()
            optimizer.step()
            schedule.step()
    return model.eval()


def predict(name: str, samples: Samples, rows: np.ndarray, others: np.ndarray, seed: int) -> Any:
    layout, x, y = samples[:3]
    classes = int(y.max()) + 1
    if name in ("svm", "forest"):
        forest = RandomForestClassifier(200, random_state=seed)
        model = forest if name == "forest" else make_pipeline(StandardScaler(), SVC(C=10.0))
        flat = x.reshape(len(x), -1)
        return model.fit(flat[rows], y[rows]).predict(flat[others])
    torch.manual_seed(seed)
    network: nn.Module
    if name == "fnn":
        network = FullyConnected(x[0].size, classes)
    elif name == "cnn":
        network = SmallCNN(layout, x.shape[2], classes)
    else:
        network = TaxelNet(layout, classes, in_channels=x.shape[2], **_TAXEL_NETS[name])
    train(network, torch.from_numpy(x[rows]), torch.from_numpy(y[rows]).long(), seed)
    with torch.no_grad():
        parts = [network(part).argmax(dim=1) for part in torch.from_numpy(x[others]).split(256)]
    return torch.cat(parts).numpy()


def splits(samples: Samples, number: int) -> Any:
    if samples.group is not None:
        split = GroupShuffleSplit(number, test_size=0.25, random_state=0)
    else:
        size = samples.num_train or 0.7
        split = StratifiedShuffleSplit(number, train_size=size, test_size=0.3, random_state=0)
    return split.split(samples.x, samples.y, samples.group)


def main() -> None:
    models = ("svm", "forest", "fnn", "cnn", *_TAXEL_NETS)
    parser = argparse.ArgumentParser(description="Compares TaxelNet on validation parts.")
    names = ("digits", "digits150", "images", "event", "bts3")
    parser.add_argument("data", nargs="+", choices=names)
    parser.add_argument("--models", nargs="+", default=models, choices=models)
    parser.add_argument("--splits", type=int, default=3)
    parser.add_argument("--root", type=Path, default=Path("biotacsp"), help="folder of BTS3")
    args = parser.parse_args()
    torch.set_num_threads(1)
    makers = {
        "digits": digits,
        "digits150": lambda: digits(150),
        "images": images,
        "event": event,
        "bts3": lambda: bts3(args.root),
    }
    for data in args.data:
        samples = makers[data]()
        for name in args.models:
            if name == "cnn" and samples.layout.image_map is None:
                continue
            start, found = time.perf_counter(), []
            for seed, (rows, others) in enumerate(splits(samples, args.splits)):
                right = predict(name, samples, rows, others, seed) == samples.y[others]
                found.append(100 * right.mean())
            seconds = time.perf_counter() - start
            scores = " ".join(f"{score:.1f}" for score in found)
            print(f"{data:10s} {name:28s} {np.mean(found):6.2f}  ({scores})  {seconds:.0f} s")


if __name__ == "__main__":
    main()
