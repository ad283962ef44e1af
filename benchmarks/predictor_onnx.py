"""Time of one judgement, from a decoded frame to its label, with a predictor in PyTorch and with
its graph in ONNX, in one thread: segmentation II with poses, edge features and joint angles.

Both judge the same frames, a hundred each in turn: frame by frame, each would push the weights of
the other out of the cache, which on a robot nothing does.

Examples:
    python benchmarks/predictor_onnx.py
    python benchmarks/predictor_onnx.py --encoder dense --rounds 20 --json onnx.json
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


OPTIONS = {
    "--encoder": ("message", "encoder of the edge features"),
    "--rounds": (10, "rounds of a hundred frames each"),
    "--at-least": (2.5, "ratio for exit code 0"),
    "--json": (None, "where to write the numbers"),
}
EPILOG = "The exit code is 0 if the ratio is high enough and both say the same, else 1."


def build(encoder: str) -> tuple[Predictor, StaticData]:
    layout = allegro_uskin()
    draw = torch.Generator().manual_seed(0)
    frames = StaticData(
        x=33000 + 200 * torch.randn(256, layout.num_taxels, 3, generator=draw),
        joint=torch.rand(256, 16, generator=draw),
        session=torch.zeros(256, dtype=torch.long),
        pos=layout.pos,
        edge_index=layout.edge_index("original"),
    )
    parts = [Tare(first=50), ZScore(per="channel"), TaxelPose(), GeometricEdgeAttr()]
    parts += [ZScore(attr="edge_attr", per="channel"), ZScore(attr="joint")]
    transform = Compose(parts)
    fit_parts(transform, frames)
    torch.manual_seed(0)
    model = TactileGCN(
        layout,
        8,
        segments="patch",
        inputs=("tactile", "edge"),
        num_edges=frames.edge_index.size(1),
        num_joints=16,
        encoder=encoder,
    )
    known: dict[str, Any] = {"num_channels": 3, "num_joints": 16}
    return Predictor(model, layout, transform, adjacency="original", **known), frames


def measure(args: Namespace) -> dict[str, Any]:
    torch.set_num_threads(1)
    predictor, frames = build(args.encoder)
    x, joint = frames.x.numpy(), frames.joint.numpy()
    rest = x[:50].astype(np.float64).mean(axis=0)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "model.onnx"
        exported = export_onnx(predictor, path)
        judges = {"eager": Judge(predictor, rest), "onnx": Judge(path, rest)}

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
    for _ in range(args.rounds):
        for name in judges:
            rows = [run(name, i)[0] for i in range(_WARM + 100)]
            rounds[name].append(rows[_WARM:])
    milliseconds = {
        name: {
            **{f"p{q}": round(float(np.percentile(values, q)), 3) for q in (50, 99)},
            # What other processes did to the machine is in the others.
            "p50 of the quietest round": round(min(map(statistics.median, values)), 3),
        }
        for name, values in rounds.items()
    }
    p50 = {name: values["p50"] for name, values in milliseconds.items()}
    return {
        "model": f"TactileGCN, segments by patch, encoder '{args.encoder}', 384 taxels, 16 joints",
        "machine": _machine(),
        "megabytes": round(exported.num_bytes / 1e6, 1),
        "difference": difference,
        "same_labels": same,
        "milliseconds": milliseconds,
        "ratio": round(p50["eager"] / p50["onnx"], 2),
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
    return 0 if result["same_labels"] and result["ratio"] >= args.at_least else 1


if __name__ == "__main__":
    sys.exit(main())
