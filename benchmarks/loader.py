r"""Seconds per epoch of PyG's DataLoader and of StaticLoader, on the same data set.

Both loaders draw the same samples in the same order, epoch by epoch in turn, so that whatever else
the machine does meets both. The numbers that come out of them are compared as well.

Examples:
    python benchmarks/loader.py
    python benchmarks/loader.py --root ~/data/BioTacSP --batch-size 32
"""

import argparse
import statistics
import sys
import time

import torch
from shared import parse, print_setting, run_in_both_states
from torch_geometric.loader import DataLoader

from torch_geometric_tactile.data import StaticDataset
from torch_geometric_tactile.datasets import BioTacSP, FakeTactileDataset
from torch_geometric_tactile.loader import StaticLoader
from torch_geometric_tactile.transforms import KNNGraph

_ALLOWED_DIFFERENCE = 1e-5
_NAMES = ("torch_geometric DataLoader", "StaticLoader")


OPTIONS = {
    "--root": (
        None,
        "folder of the BioTac SP stability set, whose CSV files are in its folder raw or are "
        "downloaded there (default: 5000 generated samples of the same form)",
    ),
    "--batch-size": (64, "samples in a batch"),
    "--epochs": (5, "timed passes of each loader"),
    "--seed": (0, "seed of the data and of their order"),
    "--threads": (1, "threads that torch may use"),
    "--at-least": (20.0, "how many times faster StaticLoader must be for the exit code 0"),
}
EPILOG = (
    "The exit code is 0 if StaticLoader yields the same numbers and is fast enough, 1 if it is "
    "not, and 2 if an argument is wrong."
)


def build_dataset(root: str | None, seed: int) -> tuple[StaticDataset, str]:
    if root is not None:
        return BioTacSP(root, pre_transform=KNNGraph(k=2)), "BioTac SP stability set v2, measured"
    dataset = FakeTactileDataset(5000, seed=seed, pre_transform=KNNGraph(k=2))
    return dataset, f"generated (FakeTactileDataset, seed {seed})"


def loaders(
    dataset: StaticDataset, batch_size: int, seed: int
) -> list[torch.utils.data.DataLoader]:
    return [
        loader(dataset, batch_size, shuffle=True, generator=torch.Generator().manual_seed(seed))
        for loader in (DataLoader, StaticLoader)
    ]


def largest_difference(dataset: StaticDataset, batch_size: int, seed: int) -> float:
    largest = 0.0
    for theirs, ours in zip(*loaders(dataset, batch_size, seed), strict=True):
        for key in ("x", "y"):
            found, expected = ours[key].double(), theirs[key].double()
            difference = (found.reshape(expected.shape) - expected).abs().max()
            largest = max(largest, float(difference.nan_to_num(nan=torch.inf)))
    return largest


def seconds_per_epoch(dataset: StaticDataset, args: argparse.Namespace) -> list[list[float]]:
    seconds: list[list[float]] = [[], []]
    for epoch in range(args.epochs + 1):
        pair = list(enumerate(loaders(dataset, args.batch_size, args.seed + epoch)))
        for i, loader in pair if epoch % 2 else reversed(pair):
            start = time.perf_counter()
            num_samples = sum(len(batch.y) for batch in loader)
            passed = time.perf_counter() - start
            assert num_samples == len(dataset)
            if epoch > 0:  # the first pass warms up
                seconds[i].append(passed)
    return seconds


def main(argv: list[str] | None = None) -> int:
    args = parse(__doc__, OPTIONS, argv, EPILOG)
    exit_code = run_in_both_states(__file__, argv)
    if exit_code is not None:
        return exit_code
    torch.set_num_threads(args.threads)
    dataset, source = build_dataset(args.root, args.seed)
    difference = largest_difference(dataset, args.batch_size, args.seed)
    seconds = seconds_per_epoch(dataset, args)
    medians = [statistics.median(values) for values in seconds]
    ratio = medians[0] / medians[1]

    data = dataset.data
    sample = f"{data.num_nodes} taxels x {data.num_features}, {data.edge_index.size(1)} edges"
    print_setting(
        *("torch", "torch_geometric", "torch_geometric_tactile"),
        threads=args.threads,
        data=f"{source}: {len(dataset)} samples of {sample}",
        setting=f"batch size {args.batch_size}, {args.epochs} epochs, seed {args.seed}",
    )
    print(f"\n{'seconds per epoch':<28}{'median':>10}{'min':>10}{'max':>10}")
    for name, median, values in zip(_NAMES, medians, seconds, strict=True):
        print(f"{name:<28}{median:>10.4f}{min(values):>10.4f}{max(values):>10.4f}")
    print(f"\nratio of the medians         {ratio:.1f}")
    print(f"largest difference in x, y   {difference:.3g}")

    status = 0
    if not difference <= _ALLOWED_DIFFERENCE:
        print(f"FAILED: the loaders differ by more than {_ALLOWED_DIFFERENCE:g}", file=sys.stderr)
        status = 1
    if ratio < args.at_least:
        print(
            f"FAILED: StaticLoader is {ratio:.1f} times as fast, less than {args.at_least:g} times",
            file=sys.stderr,
        )
        status = 1
    return status


if __name__ == "__main__":
    sys.exit(main())
