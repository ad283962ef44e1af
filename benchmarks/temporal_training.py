r"""Seconds of processor time of a training step on windows of frames: TemporalTaxelNet, also with
the logits of all frames, TaxelNet on every frame, an LSTM of 128 cells on flattened readings, and
GraspGCN, which sees all frames of a taxel at once.

All take the same windows in turn, and the fastest of several rounds counts.

Examples:
    python benchmarks/temporal_training.py
    python benchmarks/temporal_training.py --layouts allegro_uskin --rounds 10
"""

import argparse
import sys
import time
from collections.abc import Callable

import torch
from torch import Tensor
from torch.nn import LSTM, Linear, Module

from torch_geometric_tactile.data import join_frames
from torch_geometric_tactile.nn import GraspGCN, TaxelNet, TemporalTaxelNet
from torch_geometric_tactile.sensors import stock_layout

_CLASSES = 2
_CHANNELS = 3


def parse(argv: list[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description="Measures a training step on windows of frames.",
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    parser.add_argument(
        "--layouts", nargs="+", default=["biotac", "biotac_sp", "allegro_uskin"], help="names"
    )
    parser.add_argument("--batch-size", type=int, default=32, help="windows in a batch")
    parser.add_argument("--frames", type=int, default=60, help="frames of a window")
    parser.add_argument("--rounds", type=int, default=5, help="timed steps of each")
    parser.add_argument("--threads", type=int, default=1, help="threads that torch may use")
    return parser.parse_args(argv)


class FlatLSTM(Module):
    """An LSTM on the readings of all taxels side by side."""

    def __init__(self, num_signals: int) -> None:
        super().__init__()
        self.lstm = LSTM(num_signals, 128, batch_first=True)
        self.lin = Linear(128, _CLASSES)

    def forward(self, frames: Tensor) -> Tensor:
        return self.lin(self.lstm(frames)[0][:, -1])


def steps(name: str, args: argparse.Namespace) -> dict[str, tuple[Module, Callable[[], Tensor]]]:
    """Returns the models, and what they are called with."""
    layout = stock_layout(name)
    torch.manual_seed(0)
    size = (args.batch_size, layout.num_taxels, args.frames, _CHANNELS)
    frames = torch.randn(size)
    window, flat = join_frames(frames), frames.transpose(1, 2).flatten(2)
    single = frames.transpose(1, 2).flatten(0, 1)
    edges = next(iter(layout.adjacency.values()), torch.tensor([[0, 1], [1, 0]]))
    temporal = TemporalTaxelNet(layout, _CLASSES, in_channels=_CHANNELS)
    taxel = TaxelNet(layout, _CLASSES, in_channels=_CHANNELS)
    lstm = FlatLSTM(layout.num_taxels * _CHANNELS)
    gcn = GraspGCN(layout, _CLASSES, in_channels=args.frames, num_fingers=_CHANNELS)
    return {
        "TemporalTaxelNet": (temporal, lambda: temporal(window)),
        "TemporalTaxelNet, all frames": (temporal, lambda: temporal(window, per_frame=True)),
        "TaxelNet on every frame": (taxel, lambda: taxel(single)),
        "LSTM": (lstm, lambda: lstm(flat)),
        "GraspGCN": (gcn, lambda: gcn(window, edges)),
    }


def main(argv: list[str] | None = None) -> int:
    args = parse(argv)
    torch.set_num_threads(args.threads)
    print(
        f"a training step, batch {args.batch_size}, {args.frames} frames, {_CHANNELS} channels, "
        f"float32, {args.threads} thread(s), torch {torch.__version__}"
    )
    for name in args.layouts:
        found = steps(name, args)
        seconds = dict.fromkeys(found, float("inf"))
        for _ in range(args.rounds):
            for kind, (model, call) in found.items():
                model.zero_grad()
                start = time.process_time()
                call().square().sum().backward()
                seconds[kind] = min(seconds[kind], time.process_time() - start)
        for kind, (model, _) in found.items():
            weights = sum(parameter.numel() for parameter in model.parameters())
            print(f"{name:14s} {kind:29s} {seconds[kind] * 1e3:8.1f} ms {weights:9,d} weights")
    return 0


if __name__ == "__main__":
    sys.exit(main())
