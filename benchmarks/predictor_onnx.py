"""Time of one judgement, from a decoded frame to its label, in one thread: with a predictor in
PyTorch, with its graph in ONNX, and with its graph with weights of eight bits. Models: segmentation
II with poses, edge features and joint angles, and X, the GCN of the whole hand.

All judge the same frames, a hundred each in turn: frame by frame, each would push the weights of
the other out of the cache. On a robot, other programs do so: "cold" is with caches that were
overwritten before each frame.

Examples:
    python benchmarks/predictor_onnx.py
    python benchmarks/predictor_onnx.py --model X --rounds 20 --json onnx.json
    python benchmarks/predictor_onnx.py --encoder dense
"""

import json
import os
import statistics
import sys
import tempfile
import time
from argparse import Namespace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from shared import describe_machine, parse, write_json
from torch_geometric.transforms import Compose

from torch_geometric_tactile import Predictor
from torch_geometric_tactile.data import LiveFrame, StaticData
from torch_geometric_tactile.live import Judge
from torch_geometric_tactile.nn.models import TactileGCN
from torch_geometric_tactile.predictor import export_onnx
from torch_geometric_tactile.sensors import allegro_uskin
from torch_geometric_tactile.transforms import GeometricEdgeAttr, Tare, TaxelPose, ZScore, fit_parts

_WARM = 20
_COLD = 20

_CACHE_BYTES = 64 * 2**20  # more than the last cache of a core's share

OPTIONS = {
    "--model": ("II", "model", ("II", "X")),
    "--encoder": ("message", "encoder of the edge features of II"),
    "--rounds": (10, "rounds of a hundred frames each"),
    "--at-least": (2.5, "ratio of PyTorch to ONNX for exit code 0"),
    "--at-most": (0.45, "ratio of eight bits to ONNX for exit code 0, for X"),
    "--json": (None, "where to write the numbers"),
}
EPILOG = "The exit code is 0 if the ratios are good enough and the graph says the same, else 1."


def build(encoder: str, name: str = "II") -> tuple[Predictor, StaticData]:
    layout = allegro_uskin()
    draw = torch.Generator().manual_seed(0)
    frames = StaticData(
        x=33000 + 200 * torch.randn(256, layout.num_taxels, 3, generator=draw),
        joint=torch.rand(256, 16, generator=draw),
        session=torch.zeros(256, dtype=torch.long),
        pos=layout.pos,
        edge_index=layout.edge_index("original"),
    )
    parts = [Tare(first=50), ZScore(per="channel")]
    if name == "II":
        parts += [TaxelPose(), GeometricEdgeAttr()]
        parts += [ZScore(attr="edge_attr", per="channel"), ZScore(attr="joint")]
    transform = Compose(parts)
    fit_parts(transform, frames)
    torch.manual_seed(0)
    more: dict[str, Any] = {}
    if name == "II":
        more = {"segments": "patch", "inputs": ("tactile", "edge"), "num_joints": 16}
        more |= {"num_edges": frames.edge_index.size(1), "encoder": encoder}
    model = TactileGCN(layout, 8, **more)
    known: dict[str, Any] = {"num_channels": 3, "num_joints": 16}
    return Predictor(model, layout, transform, adjacency="original", **known), frames


def measure(args: Namespace) -> dict[str, Any]:
    torch.set_num_threads(1)
    predictor, frames = build(args.encoder, args.model)
    x, joint = frames.x.numpy(), frames.joint.numpy()
    rest = x[:50].astype(np.float64).mean(axis=0)
    with tempfile.TemporaryDirectory() as folder:
        paths = {name: Path(folder) / f"{name}.onnx" for name in ("onnx", "onnx, 8 bits")}
        exported = {
            name: export_onnx(predictor, path, quantize=name != "onnx")
            for name, path in paths.items()
        }
        judges = {"eager": Judge(predictor, rest)}
        judges |= {name: Judge(path, rest) for name, path in paths.items()}

    def run(name: str, i: int) -> tuple[float, np.ndarray, str]:
        received = time.perf_counter_ns()
        frame = LiveFrame(i, received * 1e-9, received, None, x[i % 256], joint[i % 256])
        judgement = judges[name](frame)
        assert judgement is not None
        label = judgement.label
        return (time.perf_counter_ns() - received) * 1e-6, judgement.probability, label

    pairs = [(run("eager", i), run("onnx", i)) for i in range(32)]
    difference = max(float(np.abs(a[1] - b[1]).max()) for a, b in pairs)
    same = all(a[2] == b[2] for a, b in pairs)
    rounds: dict[str, list[list[float]]] = {name: [] for name in judges}
    cold: dict[str, list[float]] = {name: [] for name in judges}
    overwritten = np.zeros(_CACHE_BYTES, np.uint8)
    for _ in range(args.rounds):
        for name in judges:
            rows = [run(name, i)[0] for i in range(_WARM + 100)]
            rounds[name].append(rows[_WARM:])
            for i in range(_COLD):
                overwritten += 1
                cold[name].append(run(name, i)[0])
    milliseconds = {
        name: {
            **{f"p{q}": round(float(np.percentile(values, q)), 3) for q in (50, 99)},
            # What other processes did to the machine is in the others.
            "p50 of the quietest round": round(min(map(statistics.median, values)), 3),
            "p50, cold": round(statistics.median(cold[name]), 3),
        }
        for name, values in rounds.items()
    }
    p50 = {name: values["p50"] for name, values in milliseconds.items()}
    return {
        "model": f"{args.model}: {predictor.model}".splitlines()[0],
        "machine": _machine(),
        "megabytes": {name: round(e.num_bytes / 1e6, 1) for name, e in exported.items()},
        "agreement of 8 bits": str(exported["onnx, 8 bits"].agreement),
        "difference": difference,
        "same_labels": same,
        "milliseconds": milliseconds,
        "ratio": round(p50["eager"] / p50["onnx"], 2),
        "ratio of 8 bits": round(p50["onnx, 8 bits"] / p50["onnx"], 3),
    }


def _machine() -> dict[str, Any]:
    name, load = describe_machine().rpartition(", ")[0], round(os.getloadavg()[0], 1)
    return {"processor": name, "cores": os.cpu_count(), "load": load, "torch": torch.__version__}


def main(argv: list[str] | None = None) -> int:
    args = parse(__doc__, OPTIONS, argv, EPILOG)
    result = measure(args)
    print(json.dumps(result, indent=2))
    if args.json:
        write_json(args.json, result, indent=2)
    is_fast = result["ratio"] >= args.at_least
    is_fast &= args.model != "X" or result["ratio of 8 bits"] <= args.at_most
    return 0 if result["same_labels"] and is_fast else 1


if __name__ == "__main__":
    sys.exit(main())
