r"""What the defaults of TemporalTaxelNet were chosen on: generated windows in which a contact holds
still, shakes, or slips in one of four directions, and only its motion tells.

Every electrode has an offset, a drift and noise of its own in each window, and the pressure rises
and falls in all classes. Accuracy is that of a validation part; there is no test part. All networks
are trained by training_recipe, with the rate given for each.

Examples:
    PYTHONPATH=benchmarks python studies/temporal_model_choice.py
    PYTHONPATH=benchmarks python studies/temporal_model_choice.py --layout 8x8 --models temporal gcn --seeds 0
"""

import time
from collections.abc import Callable

import torch
from shared import FlatLSTM, layout_or_grid, parse
from torch import Tensor
from torch.nn import BatchNorm1d, Conv1d, Dropout, Linear, Module, ModuleList, ReLU, Sequential
from torch.nn.functional import cross_entropy, pad
from torch_geometric.data import Data

from torch_geometric_tactile.nn import GraspGCN, TemporalTaxelNet
from torch_geometric_tactile.sensors import TaxelLayout
from torch_geometric_tactile.training import training_recipe
from torch_geometric_tactile.transforms import KNNGraph

_FRAMES = 40
_CLASSES = 6  # hold, shake, four directions
_OFFSET, _DRIFT, _NOISE = 0.5, 0.2, 0.15  # in units of a contact's pressure, about


class WindowLSTM(FlatLSTM):
    """As the others, on windows (S, N, T)."""

    def forward(self, x: Tensor, edge_index: Tensor) -> Tensor:
        return super().forward(x.transpose(1, 2))


class FlatTCN(Module):
    """Dilated causal convolutions on the readings of all taxels side by side."""

    def __init__(self, num_taxels: int, width: int = 64, num_blocks: int = 5) -> None:
        super().__init__()
        self.first = self._block(num_taxels, width, 1, 1, 0.0)
        self.blocks = ModuleList(self._block(width, width, 3, 2**i, 0.3) for i in range(num_blocks))
        self.lin = Linear(width, _CLASSES)

    def _block(self, before: int, after: int, size: int, dilation: int, dropout: float) -> Module:
        conv = Conv1d(before, after, size, dilation=dilation, bias=False)
        return Sequential(conv, BatchNorm1d(after), ReLU(), Dropout(dropout))

    def forward(self, x: Tensor, edge_index: Tensor) -> Tensor:
        h = self.first(x)
        for i, block in enumerate(self.blocks):
            h = h + block(pad(h, (2 * 2**i, 0)))
        return self.lin(h[..., -1])


MODELS: dict[str, tuple[float, Callable[[TaxelLayout], Module]]] = {
    "temporal": (4e-3, lambda layout: TemporalTaxelNet(layout, _CLASSES)),
    "gcn": (4e-3, lambda layout: GraspGCN(layout, _CLASSES, in_channels=_FRAMES, num_fingers=1)),
    "tcn": (4e-3, lambda layout: FlatTCN(layout.num_taxels)),
    "lstm": (2e-3, lambda layout: WindowLSTM(layout.num_taxels, _CLASSES)),
}


OPTIONS = {
    "--layout": ("biotac", "name, or rows x columns of a grid"),
    "--models": ([*MODELS], "which", MODELS),
    "--num-train": (1000, "windows to train on"),
    "--num-val": (1000, "windows to judge by"),
    "--seeds": ([0, 1, 2], "of the weights"),
}


def windows(layout: TaxelLayout, num: int, seed: int) -> tuple[Tensor, Tensor]:
    """Returns windows (S, N, T) and their classes."""
    draw = torch.Generator().manual_seed(seed)

    def uniform(low: float, high: float) -> Tensor:
        return low + (high - low) * torch.rand(num, 1, generator=draw)

    def normal(*size: int) -> Tensor:
        return torch.randn(num, *size, generator=draw)

    place = layout.pos[:, :2] - layout.pos[:, :2].mean(dim=0)
    place = place / place.std()
    t = torch.arange(_FRAMES) / _FRAMES
    y = torch.randint(_CLASSES, (num,), generator=draw)
    slips, shakes = (y >= 2).view(-1, 1), (y == 1).view(-1, 1)
    first = torch.randint(len(place), (num,), generator=draw)
    start = 0.7 * place[first] + 0.2 * normal(2)
    along = (y - 2).view(-1, 1) * torch.pi / 2 + uniform(-0.35, 0.35)
    angle = torch.where(slips, along, uniform(0, 2 * torch.pi))
    direction = torch.stack([angle.cos(), angle.sin()], dim=-1)
    across = torch.stack([-angle.sin(), angle.cos()], dim=-1)
    onset = uniform(0.1, 0.6)
    slip = uniform(0.8, 2.2) * (t - onset).clamp(min=0) / (1 - onset)
    turns = uniform(1, 3) * t + uniform(0, 1)
    shake = uniform(0.2, 0.6) * (2 * torch.pi * turns).sin()
    moved = torch.where(slips, slip, torch.where(shakes, shake, 0.0)).unsqueeze(-1)
    aside = torch.where(slips & (uniform(0, 1) < 0.5), 0.5 * shake, 0.0).unsqueeze(-1)
    contact = start.unsqueeze(1) + moved * direction + aside * across
    far = (place[:, None] - contact[:, None]).square().sum(dim=-1)  # (S, N, T)
    wave = (2 * torch.pi * (uniform(0.3, 1.5) * t + uniform(0, 1))).sin()
    pressure = uniform(0.6, 1.4) * (1 + 0.3 * wave)
    x = pressure.unsqueeze(1) * (-far / (2 * uniform(0.5, 1.0).unsqueeze(-1) ** 2)).exp()
    num_taxels = len(place)
    x = x + _OFFSET * normal(num_taxels, 1) + _DRIFT * normal(num_taxels, 1) * t
    return x + _NOISE * normal(num_taxels, _FRAMES), y


def accuracy(
    model: Module, edge_index: Tensor, train: tuple[Tensor, ...], val: tuple[Tensor, ...], lr: float
) -> float:
    """Trains a network, and returns its accuracy."""
    (x, y), recipe = train, training_recipe(len(train[0]))
    optimizer = torch.optim.AdamW(model.parameters(), lr, weight_decay=recipe.weight_decay)
    steps = recipe.max_epochs * (len(x) // recipe.batch_size)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, lr, total_steps=steps)
    model.train()
    for _ in range(recipe.max_epochs):
        for rows in torch.randperm(len(x)).split(recipe.batch_size):
            if len(rows) == recipe.batch_size:
                optimizer.zero_grad()
                logits = model(x[rows], edge_index)
                cross_entropy(logits, y[rows], label_smoothing=recipe.label_smoothing).backward()
                optimizer.step()
                schedule.step()
    model.eval()
    with torch.no_grad():
        found = torch.cat([model(part, edge_index) for part in val[0].split(100)]).argmax(dim=1)
    return float((found == val[1]).double().mean())


def main(argv: list[str] | None = None) -> None:
    args = parse(__doc__, OPTIONS, argv)
    torch.set_num_threads(1)
    layout = layout_or_grid(args.layout)
    edge_index = KNNGraph(2)(Data(pos=layout.pos, num_nodes=layout.num_taxels)).edge_index
    train, val = windows(layout, args.num_train, 0), windows(layout, args.num_val, 1)
    center, scale = train[0].mean(dim=(0, 2), keepdim=True), train[0].std(dim=(0, 2), keepdim=True)
    train, val = (((x - center) / scale, y) for x, y in (train, val))
    for name in args.models:
        lr, make = MODELS[name]
        for seed in args.seeds:
            torch.manual_seed(seed)
            model, start = make(layout), time.process_time()
            found = accuracy(model, edge_index, train, val, lr)
            weights = sum(parameter.numel() for parameter in model.parameters())
            print(
                f"{args.layout:8s} {name:9s} seed {seed}: {100 * found:5.1f} % on validation, "
                f"{weights:7,d} weights, {time.process_time() - start:5.1f} s of the processor",
                flush=True,
            )


if __name__ == "__main__":
    main()
