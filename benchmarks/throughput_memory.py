r"""Memory of a data set and of training, each measured in a process of its own."""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import torch
from hand_frames import LAYOUT, Frames, fused_adam, pose_and_edges, train_step
from plain_pyg import PlainGCN
from shared import memory
from torch import Tensor
from torch_geometric.data import Data
from torch_geometric.loader import DataLoader

from torch_geometric_tactile.loader import StaticLoader
from torch_geometric_tactile.nn.models import TactileGCN

_MIB = 2**20


def measured(what: str, frames: int, threads: int) -> dict[str, float]:
    command = [sys.executable, __file__, what, str(frames), str(threads)]
    # Memory that is freed goes back at once, so that the peak is what was in use.
    environment = {**os.environ, "MALLOC_TRIM_THRESHOLD_": "0", "MALLOC_MMAP_THRESHOLD_": "65536"}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"measuring '{what}' failed:\n{done.stderr}")
    found: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
    return found


def _memory(*keys: str) -> float:
    return memory(*keys) / _MIB


def measure_here(what: str, frames: int, threads: int) -> dict[str, float]:
    torch.set_num_threads(threads)
    if what == "list-of-data":
        return _list_of_data(frames)
    if what == "static-data":
        return _static_data(frames)
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
    with tempfile.TemporaryDirectory() as root:
        written = subprocess.run(
            [sys.executable, __file__, f"write:{root}", str(num_frames), "1"],
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
    model = PlainGCN() if name == "plain" else TactileGCN(LAYOUT, 8, segments=segments[name])
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


def main() -> None:
    what, frames, threads = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
    if what.startswith("write:"):
        Frames(frames, what.removeprefix("write:"))
    else:
        print(json.dumps(measure_here(what, frames, threads)))


if __name__ == "__main__":
    main()
