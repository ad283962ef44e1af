r"""Speed and memory of the models of the hand, ours against the same written the ordinary PyG way.

Every comparison is a ratio of two sides measured in turn in one run. The other side is `GCNConv`,
`DataLoader` and `Batch` (benchmarks/plain_pyg.py). The readings are random numbers in the form of
the AllegroUSkin data set; no figure here depends on what they are.

Examples:
    python benchmarks/throughput.py
    python benchmarks/throughput.py --only train latency --rounds 9
    python benchmarks/throughput.py --device cuda --only train
"""

import argparse
import json
import os
import platform
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import torch
import torch_geometric
from plain_pyg import PlainGCN, PlainSegmented
from torch import Tensor, nn
from torch_geometric.data import Data
from torch_geometric.loader import DataLoader
from torch_geometric.transforms import Compose

import torch_geometric_tactile
from torch_geometric_tactile.data import StaticData, StaticDataset
from torch_geometric_tactile.files import atomic_path
from torch_geometric_tactile.loader import StaticLoader
from torch_geometric_tactile.nn.models import TactileGCN
from torch_geometric_tactile.sensors import HandKinematics, allegro_uskin
from torch_geometric_tactile.transforms import GeometricEdgeAttr, TaxelPose, ZScore, fit_transform

_LAYOUT = allegro_uskin()
_PARTS = ("train", "latency", "data", "memory")
_MIB = 2**20


def parse(argv: list[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--only", nargs="+", choices=_PARTS, default=_PARTS, help="what to measure (default: all)"
    )
    parser.add_argument("--batch-size", type=_positive, default=128, help="default: 128")
    parser.add_argument(
        "--rounds", type=_positive, default=5, help="rounds, the sides in turn (default: 5)"
    )
    parser.add_argument(
        "--threads", type=_positive, default=2, help="threads of torch in training (default: 2)"
    )
    parser.add_argument(
        "--device", default="cpu", help="where the models train: cpu (the default) or cuda"
    )
    parser.add_argument(
        "--frames",
        type=_positive,
        default=136_000,
        help="frames of the data set whose memory is measured (default: 80 trials x 1700)",
    )
    parser.add_argument("--out", type=Path, help="folder for throughput.json and throughput.md")
    # For processes that this script starts to measure their memory.
    parser.add_argument("--measure", help=argparse.SUPPRESS)
    return parser.parse_args(argv)


def _positive(text: str) -> int:
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError(f"must be at least 1 (got {number})")
    return number


class Frames(StaticDataset):
    r"""Random readings and joint angles in the form of AllegroUSkin."""

    layout = _LAYOUT

    def __init__(self, num_frames: int, root: str | None = None, **kwargs: Any) -> None:
        self.num_frames = num_frames
        super().__init__(root, **kwargs)

    @property
    def raw_file_names(self) -> list[str]:
        return []

    @property
    def processed_file_names(self) -> str:
        return "frames.pt"

    def read(self) -> tuple[StaticData, dict[str, list[str]]]:
        generator = torch.Generator().manual_seed(0)
        data = StaticData(
            x=torch.randn(self.num_frames, 384, 3, generator=generator) * 100 + 30_000,
            edge_index=_LAYOUT.edge_index("original"),
            y=torch.randint(0, 8, (self.num_frames,), generator=generator),
            joint=torch.rand(self.num_frames, 16, generator=generator) * 0.3,
        )
        return data, {}


def pose_and_edges() -> Compose:
    return Compose(
        [TaxelPose(_LAYOUT, HandKinematics.allegro(), normal=False), GeometricEdgeAttr()]
    )


def train_step(
    model: nn.Module, optimizer: torch.optim.Optimizer, batch: Data, device: str
) -> None:
    batch = batch.to(device)
    optimizer.zero_grad()
    nn.functional.cross_entropy(model(batch.x, batch.edge_index), batch.y).backward()
    optimizer.step()


def fused_adam(model: nn.Module) -> torch.optim.Optimizer:
    return torch.optim.Adam(model.parameters(), fused=True)


def synchronize(device: str) -> None:
    if device != "cpu":
        torch.cuda.synchronize()


def measure_training(args: argparse.Namespace) -> dict[str, Any]:
    torch.set_num_threads(args.threads)
    torch.manual_seed(0)
    dataset = Frames(6 * args.batch_size, transform=None)
    dataset.data.x.sub_(30_000).div_(100)
    ours = {
        "X": TactileGCN(_LAYOUT, 8).to(args.device),
        "I": TactileGCN(_LAYOUT, 8, segments="digit").to(args.device),
        "II": TactileGCN(_LAYOUT, 8, segments="patch").to(args.device),
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
        "frames_per_second": {name: _spread(values) for name, values in speed.items()},
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
    segment = _LAYOUT.segments("patch")
    ours = TactileGCN(
        _LAYOUT,
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
    static = _measured("static-data", args)
    listed = _measured("list-of-data", args)
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
            name: _measured(f"train-{name}-{size}", args) for name in ("X", "I", "II", "plain")
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


def _measured(what: str, args: argparse.Namespace) -> dict[str, float]:
    command = [sys.executable, __file__, "--measure", what, "--threads", str(args.threads)]
    command += ["--frames", str(args.frames)]
    # Memory that is freed goes back at once, so that the peak is what was in use.
    environment = {**os.environ, "MALLOC_TRIM_THRESHOLD_": "0", "MALLOC_MMAP_THRESHOLD_": "65536"}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"measuring '{what}' failed:\n{done.stderr}")
    found: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
    return found


def _memory(*keys: str) -> float:
    values = {}
    for line in Path("/proc/self/status").read_text().splitlines():
        name, _, value = line.partition(":")
        if name in keys:
            values[name] = int(value.split()[0]) / 1024
    return sum(values.values())


def measure_here(what: str, args: argparse.Namespace) -> dict[str, float]:
    torch.set_num_threads(args.threads)
    if what == "list-of-data":
        return _list_of_data(args.frames)
    if what == "static-data":
        return _static_data(args.frames)
    _, name, size = what.split("-")
    return _training_memory(name, int(size))


def _list_of_data(num_frames: int) -> dict[str, float]:
    transform = pose_and_edges()
    dataset = Frames(min(num_frames, 17_000), transform=transform)
    dataset[0]
    before = _memory("RssAnon")
    samples = []
    for i in range(len(dataset)):
        sample = dataset[i]
        del sample.pos  # only the edge features are kept
        samples.append(sample.clone() if i == 0 else _owning(sample, samples[0].edge_index))
    grown = _memory("RssAnon") - before
    return {"private": grown * num_frames / len(samples), "measured_frames": len(samples)}


def _owning(sample: Data, edge_index: Tensor) -> Data:
    # As if read one by one: the numbers of each sample are its own, the edges are shared.
    out = sample.clone()
    out.edge_index = edge_index
    return out


def _static_data(num_frames: int) -> dict[str, float]:
    import tempfile

    with tempfile.TemporaryDirectory() as root:
        written = subprocess.run(
            [sys.executable, __file__, "--measure", f"write:{root}", "--frames", str(num_frames)],
            capture_output=True,
            text=True,
            check=False,
        )
        if written.returncode:
            raise RuntimeError(written.stderr)
        warm = Frames(256, transform=pose_and_edges())
        warm.batch(range(128))
        before, mapped = _memory("RssAnon"), _memory("RssFile")
        dataset = Frames(num_frames, root, transform=pose_and_edges())
        for _ in StaticLoader(dataset, 128, shuffle=True):
            pass
        return {
            "private": _memory("RssAnon") - before,
            "mapped": _memory("RssFile") - mapped,
        }


def _training_memory(name: str, batch_size: int) -> dict[str, float]:
    torch.manual_seed(0)
    segments = {"X": None, "I": "digit", "II": "patch"}
    model = PlainGCN() if name == "plain" else TactileGCN(_LAYOUT, 8, segments=segments[name])
    dataset = Frames(batch_size)
    dataset.data.x.sub_(30_000).div_(100)
    small = Frames(16)
    small.data.x.sub_(30_000).div_(100)
    loaders = []
    for frames in (small, dataset):
        if name == "plain":
            loaders.append(DataLoader([frames[i] for i in range(len(frames))], batch_size))
        else:
            loaders.append(StaticLoader(frames, batch_size))
    empty = _memory("RssAnon") - sum(p.nbytes for p in model.parameters()) / _MIB
    optimizer = fused_adam(model)
    for _ in range(2):  # the optimizer's state and the gradients are there from now on
        train_step(model, optimizer, next(iter(loaders[0])), "cpu")
    batch = next(iter(loaders[1]))
    Path("/proc/self/clear_refs").write_text("5")  # forget the peak until here
    before = _memory("VmRSS")
    for _ in range(3):
        train_step(model, optimizer, batch, "cpu")
    peak = _memory("VmHWM")
    return {"activations": peak - before, "all": peak - before + _memory("RssAnon") - empty}


def _spread(values: Sequence[float]) -> dict[str, float]:
    return {"median": statistics.median(values), "min": min(values), "max": max(values)}


def _ratio(ours: Sequence[float], theirs: Sequence[float]) -> float:
    return statistics.median(a / b for a, b in zip(ours, theirs, strict=True))


def _quantile(values: Sequence[float], part: float) -> float:
    return sorted(values)[min(len(values) - 1, int(part * len(values)))]


def describe_machine() -> str:
    name = platform.processor() or platform.machine()
    if Path("/proc/cpuinfo").is_file():
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        models = [line.partition(":")[2].strip() for line in lines if "model name" in line]
        name = models[0] if models else name
    return f"{name}, {os.cpu_count()} CPUs"


_TARGETS = {
    "X against plain PyG": 5.0,
    "II against X": 1.5,
    "plain PyG against ours": 3.0,
    "list of Data against StaticDataset, private memory": 10.0,
}


def lines_of(found: dict[str, Any]) -> list[str]:
    lines = []
    if "train" in found:
        train = found["train"]
        lines += [
            f"## Training, batch {train['batch_size']}, {train['threads']} threads, "
            f"{train['device']}",
            "",
            "| model | frames/s (median) | min | max |",
            "|---|---|---|---|",
        ]
        for name, value in train["frames_per_second"].items():
            cells = " | ".join(f"{value[key]:.0f}" for key in ("median", "min", "max"))
            lines.append(f"| {name} | {cells} |")
        lines += ["", f"Largest difference of the logits: {train['largest_difference']:.1e}.", ""]
    if "latency" in found:
        latency = found["latency"]
        lines += [
            "## One frame, 1 thread: segmentation II with edge features and joints, reading to "
            "label",
            "",
            "| side | p50 (ms) | p99 (ms) |",
            "|---|---|---|",
        ]
        for name, value in latency["milliseconds"].items():
            lines.append(f"| {name} | {value['p50']:.2f} | {value['p99']:.2f} |")
        lines += ["", f"Largest difference of the logits: {latency['largest_difference']:.1e}.", ""]
    if "data" in found:
        data = found["data"]
        lines += [f"## {data['frames']} frames in memory, with edge features by pose", ""]
        listed, static = data["mib"]["list of Data"], data["mib"]["StaticDataset"]
        lines += [
            f"* list of `Data`, edge features stored, edges shared: {listed['private']:.0f} MiB "
            f"(from {listed['measured_frames']:.0f} frames)",
            f"* `StaticDataset` after a pass over it, edge features on the fly: "
            f"{static['private']:.0f} MiB of its own, and {static['mapped']:.0f} MiB of its file, "
            "which the system may take back",
            "",
        ]
    if "memory" in found:
        lines += [
            "## Peak memory of training (MiB)",
            "",
            "*activations*: above weights, gradients and the optimizer's state; *all*: with them.",
            "",
            "| batch | model | activations | all |",
            "|---|---|---|---|",
        ]
        for size, values in found["memory"]["mib"].items():
            for name, value in values.items():
                lines.append(
                    f"| {size} | {name} | {value['activations']:.0f} | {value['all']:.0f} |"
                )
        lines.append("")
    lines += ["## Ratios", "", "| what | ratio | at least |", "|---|---|---|"]
    for part in found.values():
        for name, value in part.get("ratios", {}).items():
            target = _TARGETS.get(name)
            lines.append(f"| {name} | {value:.2f} | {'' if target is None else target} |")
    return lines


def main(argv: list[str] | None = None) -> int:
    args = parse(argv)
    if args.measure:
        if args.measure.startswith("write:"):
            Frames(args.frames, args.measure.removeprefix("write:"))
        else:
            print(json.dumps(measure_here(args.measure, args)))
        return 0
    measures: dict[str, Callable[[argparse.Namespace], dict[str, Any]]] = {
        "train": measure_training,
        "latency": measure_latency,
        "data": measure_data,
        "memory": measure_memory,
    }
    found = {name: measures[name](args) for name in _PARTS if name in args.only}
    versions = (
        f"Python {platform.python_version()}, torch {torch.__version__}, torch_geometric "
        f"{torch_geometric.__version__}, torch_geometric_tactile "
        f"{torch_geometric_tactile.__version__}"
    )
    lines = [
        "# Throughput",
        "",
        f"Random readings in the form of the hand (384 taxels, 1401 edges); {describe_machine()}; "
        f"{versions}. The other side is the same model in plain PyG, measured in turn in the same "
        "run. Written by `benchmarks/throughput.py`.",
        "",
        *lines_of(found),
    ]
    print("\n".join(lines))
    if args.out:
        content = {"machine": describe_machine(), "versions": versions, **found}
        for name, text in (
            ("throughput.json", json.dumps(content, indent=1)),
            ("throughput.md", "\n".join(lines)),
        ):
            with atomic_path(args.out / name) as temporary:
                temporary.write_text(text + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
