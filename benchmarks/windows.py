r"""Windows of 60 frames: StaticLoader on `Windows`, and PyG's DataLoader on a plain data set.

The plain data set is what a user of PyG would write: the recording is one tensor in memory, and a
window is a slice of it, put into the form of a window, in a `Data` object. Both loaders draw the
same windows in the same order, round by round in turn; their numbers are compared first.

Examples:
    python benchmarks/windows.py
    python benchmarks/windows.py --frames 20000 --rounds 3
"""

import json
import os
import platform
from argparse import Namespace
from functools import partial
from typing import Any

import torch
import torch_geometric
from shared import in_turns, parse, two_nearest, write
from torch import Tensor
from torch.utils.data import DataLoader, Dataset
from torch_geometric.data import Data
from torch_geometric.loader import DataLoader as PyGLoader

from torch_geometric_tactile.data import StaticDataset, Windows
from torch_geometric_tactile.loader import StaticLoader
from torch_geometric_tactile.sensors import TaxelLayout, allegro_uskin, biotac

_LENGTH = 60
_AT_LEAST = {"hand": 3.0, "biotac": 15.0}


class PlainWindows(Dataset):
    def __init__(self, x: Tensor, y: Tensor, edge_index: Tensor) -> None:
        self.x, self.y, self.edge_index = x, y, edge_index

    def __len__(self) -> int:
        return len(self.x) - _LENGTH + 1

    def __getitem__(self, i: int) -> Data:
        frames = self.x[i : i + _LENGTH]
        x = frames.permute(1, 2, 0).reshape(frames.size(1), -1)
        last = i + _LENGTH - 1
        return Data(x=x, edge_index=self.edge_index, y=self.y[last : last + 1])


OPTIONS = {
    "--frames": (136_000, "frames of the recording"),
    "--batches": (60, "batches of a round"),
    "--rounds": (7, "timed rounds of each loader"),
    "--threads": (1, "threads that torch may use"),
    "--json": (None, "file for the figures"),
}


def sensors() -> dict[str, tuple[TaxelLayout, Tensor, int]]:
    hand, finger = allegro_uskin(), biotac()
    return {
        "hand": (hand, hand.edge_index("original"), 32),
        "biotac": (finger, two_nearest(finger), 64),
    }


def read_all(loader: DataLoader) -> None:
    for batch in loader:
        assert batch.x.numel()


def measure(name: str, args: Namespace) -> dict[str, Any]:
    layout, edge_index, batch_size = sensors()[name]
    generator = torch.Generator().manual_seed(0)
    x = torch.randn(args.frames, layout.num_taxels, 3, generator=generator)
    y = torch.arange(args.frames) % 2
    frames = StaticDataset.from_arrays(
        x, y, layout=layout, trial=torch.zeros_like(y), edge_index=edge_index
    )
    theirs, ours = PlainWindows(x, y, edge_index), Windows(frames, _LENGTH)
    order = torch.randperm(len(ours), generator=generator)[: batch_size * args.batches].tolist()
    loaders = {
        "torch_geometric": PyGLoader(theirs, batch_size, sampler=order),
        "StaticLoader": StaticLoader(ours, batch_size, sampler=order),
    }
    for a, b in zip(*loaders.values(), strict=True):
        assert a.x.equal(b.x.flatten(0, 1))
        assert a.y.equal(b.y)
    calls = {key: partial(read_all, loader) for key, loader in loaders.items()}
    times = in_turns(calls, args.rounds)
    best = {key: min(values) / args.batches for key, values in times.items()}
    return {
        "data": f"{args.frames} frames, {layout.num_taxels} taxels x 3, generated",
        "batch_size": batch_size,
        "milliseconds_per_batch": {key: round(1000 * value, 3) for key, value in best.items()},
        "ratio": round(best["torch_geometric"] / best["StaticLoader"], 1),
    }


def main() -> int:
    args = parse(__doc__, OPTIONS)
    torch.set_num_threads(args.threads)
    found: dict[str, Any] = {
        "machine": f"{platform.machine()}, {os.cpu_count()} CPUs, {args.threads} threads of torch",
        "versions": f"torch {torch.__version__}, torch_geometric {torch_geometric.__version__}",
    }
    for name in _AT_LEAST:
        found[name] = measure(name, args)
        print(name, json.dumps(found[name], indent=2), flush=True)
    if args.json:
        write(args.json, json.dumps(found, indent=2))
    return int(any(found[name]["ratio"] < wanted for name, wanted in _AT_LEAST.items()))


if __name__ == "__main__":
    raise SystemExit(main())
