r"""Seconds of processor time of a training step on windows of frames: TemporalTaxelNet, also with
the logits of all frames, TaxelNet on every frame, an LSTM of 128 cells on flattened readings, and
GraspGCN, which sees all frames of a taxel at once.

All take the same windows in turn, and the fastest of several rounds counts.

Examples:
    python benchmarks/temporal_training.py
    python benchmarks/temporal_training.py --layouts allegro_uskin --rounds 10
"""

import sys
import time
from argparse import Namespace
from collections.abc import Callable
from functools import partial

import torch
from shared import FlatLSTM, in_turns, parse
from torch import Tensor
from torch.nn import Module

from torch_geometric_tactile.data import join_frames
from torch_geometric_tactile.nn import GraspGCN, TaxelNet, TemporalTaxelNet
from torch_geometric_tactile.sensors import stock_layout

_CLASSES = 2
_CHANNELS = 3


OPTIONS = {
    "--layouts": (["biotac", "biotac_sp", "allegro_uskin"], "names"),
    "--batch-size": (32, "windows in a batch"),
    "--frames": (60, "frames of a window"),
    "--rounds": (5, "timed steps of each"),
    "--threads": (1, "threads that torch may use"),
}


def steps(name: str, args: Namespace) -> dict[str, tuple[Module, Callable[[], Tensor]]]:
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
    lstm = FlatLSTM(layout.num_taxels * _CHANNELS, _CLASSES)
    gcn = GraspGCN(layout, _CLASSES, in_channels=args.frames, num_fingers=_CHANNELS)
    return {
        "TemporalTaxelNet": (temporal, lambda: temporal(window)),
        "TemporalTaxelNet, all frames": (temporal, lambda: temporal(window, per_frame=True)),
        "TaxelNet on every frame": (taxel, lambda: taxel(single)),
        "LSTM": (lstm, lambda: lstm(flat)),
        "GraspGCN": (gcn, lambda: gcn(window, edges)),
    }


def _step(model: Module, call: Callable[[], Tensor]) -> None:
    model.zero_grad()
    call().square().sum().backward()


def main(argv: list[str] | None = None) -> int:
    args = parse(__doc__, OPTIONS, argv)
    torch.set_num_threads(args.threads)
    print(
        f"a training step, batch {args.batch_size}, {args.frames} frames, {_CHANNELS} channels, "
        f"float32, {args.threads} thread(s), torch {torch.__version__}"
    )
    for name in args.layouts:
        found = steps(name, args)
        calls = {kind: partial(_step, *one) for kind, one in found.items()}
        for kind, taken in in_turns(calls, args.rounds, time.process_time).items():
            weights = sum(parameter.numel() for parameter in found[kind][0].parameters())
            print(f"{name:14s} {kind:29s} {min(taken) * 1e3:8.1f} ms {weights:9,d} weights")
    return 0


if __name__ == "__main__":
    sys.exit(main())
