r"""Speed and memory of the models of the hand, ours against the same written the ordinary PyG way.

Every comparison is a ratio of two sides measured in turn in one run. The other side is `GCNConv`,
`DataLoader` and `Batch` (benchmarks/plain_pyg.py). The readings are random numbers in the form of
the AllegroUSkin data set; no figure here depends on what they are. Training is measured in both
states of glibc's allocator, each in a process of its own: as usually started, where tensors above
32 MiB are mapped and cleared page by page at each operation, and without these page faults.

Examples:
    python benchmarks/throughput.py
    python benchmarks/throughput.py --only train latency --rounds 9
    python benchmarks/throughput.py --device cuda --only train
"""

import argparse
import json
import logging
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import torch
from hand_frames import LAYOUT, Frames, fused_adam, pose_and_edges, train_step
from plain_pyg import PlainGCN, PlainSegmented
from shared import (
    ALLOCATOR_STATES,
    describe_machine,
    parse,
    run_in_each_state,
    spread,
    versions,
    write,
    write_json,
)
from throughput_memory import measured
from throughput_precision import measure_precision
from throughput_report import merged, page_lines
from torch import Tensor, nn
from torch_geometric.data import Data
from torch_geometric.loader import DataLoader
from torch_geometric.transforms import Compose

from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.loader import StaticLoader
from torch_geometric_tactile.nn.models import TactileGCN
from torch_geometric_tactile.transforms import ZScore, fit_transform

_PARTS = ("train", "precision", "latency", "data", "memory")


OPTIONS = {
    "--only": (_PARTS, "what to measure", _PARTS),
    "--batch-size": (128, "frames in a batch"),
    "--rounds": (5, "rounds, the sides in turn"),
    "--threads": (2, "threads of torch in training"),
    "--device": ("cpu", "where the models train: cpu or cuda"),
    "--frames": (136_000, "frames of the data set whose memory is measured: 80 trials x 1700"),
    "--root": (
        Path,
        "recordings of the hand, for the accuracy of a fused optimizer and bfloat16",
    ),
    "--stride": (50, "frames of them: every so many"),
    "--epochs": (20, "of that accuracy"),
    "--out": (
        Path,
        "folder for throughput.json and throughput.md; what is not measured now stays there",
    ),
    "--child": (False, "print the training of this process as JSON"),
}


def synchronize(device: str) -> None:
    if device != "cpu":
        torch.cuda.synchronize()


def measure_training(args: argparse.Namespace) -> dict[str, Any]:
    torch.set_num_threads(args.threads)
    torch.manual_seed(0)
    dataset = Frames(6 * args.batch_size, transform=None)
    dataset.data.x.sub_(30_000).div_(100)
    ours = {
        "X": TactileGCN(LAYOUT, 8).to(args.device),
        "I": TactileGCN(LAYOUT, 8, segments="digit").to(args.device),
        "II": TactileGCN(LAYOUT, 8, segments="patch").to(args.device),
    }
    plain = PlainGCN().to(args.device)
    plain.load_state_dict(ours["X"].state_dict())
    samples = [dataset[i] for i in range(len(dataset))]
    batch, data = (
        next(iter(DataLoader(samples, args.batch_size))),
        dataset.batch(range(args.batch_size)),
    )
    with torch.no_grad():
        difference = (
            plain(batch.x.to(args.device), batch.edge_index.to(args.device))
            - ours["X"](data.x.to(args.device), data.edge_index.to(args.device))
        ).abs()
    sides: dict[str, tuple[nn.Module, Any]] = {
        "plain X": (plain, DataLoader(samples, args.batch_size, shuffle=True)),
        **{
            name: (model, StaticLoader(dataset, args.batch_size, shuffle=True))
            for name, model in ours.items()
        },
    }
    optimizers = {name: fused_adam(model) for name, (model, _) in sides.items()}
    speed: dict[str, list[float]] = {name: [] for name in sides}
    for round_ in range(args.rounds + 1):
        for name, (model, loader) in sides.items():
            passes = 1 if name.startswith("plain") else 4
            synchronize(args.device)
            start = time.perf_counter()
            for _ in range(passes):
                for batch in loader:
                    train_step(model, optimizers[name], batch, args.device)
            synchronize(args.device)
            if round_ > 0:  # the first warms up
                speed[name].append(passes * len(dataset) / (time.perf_counter() - start))
    return {
        "batch_size": args.batch_size,
        "threads": args.threads,
        "device": torch.cuda.get_device_name() if args.device != "cpu" else "cpu",
        "largest_difference": float(difference.max()),
        "frames_per_second": {name: spread(values) for name, values in speed.items()},
        "ratios": {
            "X against plain PyG": _ratio(speed["X"], speed["plain X"]),
            "II against X": _ratio(speed["II"], speed["X"]),
            "I against X": _ratio(speed["I"], speed["X"]),
        },
    }


def measure_latency(args: argparse.Namespace) -> dict[str, Any]:
    torch.set_num_threads(1)
    torch.manual_seed(0)
    frames = Frames(256).data
    scale = Compose(
        [ZScore(), *pose_and_edges().transforms, ZScore(attr="edge_attr"), ZScore(attr="joint")]
    )
    fit_transform(scale, frames)
    edge_index = frames.edge_index
    segment = LAYOUT.segments("patch")
    ours = TactileGCN(
        LAYOUT,
        8,
        segments="patch",
        inputs=("tactile", "edge"),
        encoder="message",
        num_joints=16,
    ).eval()
    plain = PlainSegmented(segment, edge_index, with_edges=True).eval()
    _copy_segmented(ours, plain)

    def run_ours(i: int) -> Tensor:
        x, joint = frames.x[i : i + 1], frames.joint[i : i + 1]
        data = scale(StaticData(x=x, edge_index=edge_index, joint=joint))
        return ours(data.x, edge_index, edge_attr=data.edge_attr, joint=data.joint)

    def run_plain(i: int) -> Tensor:
        data = scale(Data(x=frames.x[i], edge_index=edge_index, joint=frames.joint[i : i + 1]))
        return plain(data.x, edge_index, data.edge_attr, data.joint)

    seconds: dict[str, list[float]] = {"ours": [], "plain": []}
    with torch.inference_mode():
        difference = max(float((run_ours(i) - run_plain(i)).abs().max()) for i in range(8))
        # A hundred frames of each side in turn: frame by frame, each would push the weights of the
        # other out of the cache, which on the robot nothing does.
        for _ in range(2 * args.rounds):
            for name, run in (("ours", run_ours), ("plain", run_plain)):
                for i in range(120):
                    start = time.perf_counter()
                    run(i % 256).argmax(dim=-1).item()
                    if i >= 20:
                        seconds[name].append(time.perf_counter() - start)
    return {
        "largest_difference": difference,
        "milliseconds": {
            name: {"p50": 1e3 * _quantile(values, 0.5), "p99": 1e3 * _quantile(values, 0.99)}
            for name, values in seconds.items()
        },
        "ratios": {
            "plain PyG against ours": statistics.median(seconds["plain"])
            / statistics.median(seconds["ours"])
        },
    }


def measure_training_in_both_states(args: argparse.Namespace) -> dict[str, Any]:
    options = ("batch_size", "rounds", "threads", "device")
    argv = [f"--{name.replace('_', '-')}={getattr(args, name)}" for name in options]
    states = run_in_each_state(__file__, argv, list(ALLOCATOR_STATES))
    resident = states["resident"]
    return {
        **states["usual"],
        "frames_per_second_resident": resident["frames_per_second"],
        "ratios": {
            **states["usual"]["ratios"],
            **{f"{name}, without page faults": r for name, r in resident["ratios"].items()},
        },
    }


def _copy_segmented(ours: TactileGCN, plain: PlainSegmented) -> None:
    with torch.no_grad():
        mlp = plain.encoder.mlp.lins
        for target, source in zip(mlp, (ours.encoder.mlp[0], ours.encoder.mlp[2]), strict=True):
            target.weight.copy_(source.weight)
            target.bias.copy_(source.bias)
        for number, thread in enumerate(plain.threads):
            for target, source in zip(thread.convs, ours.thread.convs, strict=True):
                target.lin.weight.copy_(source.weight[number])
                target.bias.copy_(source.bias[number])
        plain.head.load_state_dict(ours.head.state_dict())


def measure_data(args: argparse.Namespace) -> dict[str, Any]:
    static = measured("static-data", args.frames, args.threads)
    listed = measured("list-of-data", args.frames, args.threads)
    return {
        "frames": args.frames,
        "mib": {"list of Data": listed, "StaticDataset": static},
        "ratios": {
            "list of Data against StaticDataset, private memory": listed["private"]
            / static["private"],
            "list of Data against StaticDataset with every page of its file in memory": listed[
                "private"
            ]
            / (static["private"] + static["mapped"]),
        },
    }


def measure_memory(args: argparse.Namespace) -> dict[str, Any]:
    sizes = sorted({args.batch_size, 1024})
    found = {
        f"batch {size}": {
            name: measured(f"train-{name}-{size}", args.frames, args.threads)
            for name in ("X", "I", "II", "plain")
        }
        for size in sizes
    }
    ratios = {}
    for size, values in found.items():
        for what in ("activations", "all"):
            ratios[f"II against X, {what}, {size}"] = values["II"][what] / values["X"][what]
            ratios[f"II against plain PyG's X, {what}, {size}"] = (
                values["II"][what] / values["plain"][what]
            )
    return {"mib": found, "ratios": ratios}


def _ratio(ours: Sequence[float], theirs: Sequence[float]) -> float:
    return statistics.median(a / b for a, b in zip(ours, theirs, strict=True))


def _quantile(values: Sequence[float], part: float) -> float:
    return sorted(values)[min(len(values) - 1, int(part * len(values)))]


def _kept(out: Path | None) -> dict[str, Any]:
    path = None if out is None else out / "throughput.json"
    if path is None or not path.is_file():
        return {}
    content: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    before = f"{content.get('machine')}; {content.get('versions')}"  # of the whole page, once
    parts = {name: content[name] for name in _PARTS if name in content}
    return {name: {"where": before, **part} for name, part in parts.items()}


def main(argv: list[str] | None = None) -> int:
    args = parse(__doc__, OPTIONS, argv)
    if args.child:
        print(json.dumps(measure_training(args)))
        return 0
    measures: dict[str, Callable[[argparse.Namespace], dict[str, Any]]] = {
        "train": measure_training_in_both_states,
        "precision": lambda args: measure_precision(
            args.batch_size, args.rounds, args.threads, args.root, args.stride, args.epochs
        ),
        "latency": measure_latency,
        "data": measure_data,
        "memory": measure_memory,
    }
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    found = {name: measures[name](args) for name in _PARTS if name in args.only}
    packages = versions("torch", "torch_geometric", "torch_geometric_tactile")
    where = f"{describe_machine()}; {packages}"
    for part in found.values():
        part["where"] = where
    found = merged(_kept(args.out), found)
    lines = page_lines(found, where)
    print("\n".join(lines))
    if args.out:
        write_json(args.out / "throughput.json", found)
        write(args.out / "throughput.md", "\n".join(lines) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
