r"""One training epoch on 6 GB of windows with little memory, and what orders of reading cost.

A data set in the form of BiGS is generated in chunks and written as a processed file. Then, each in
a process of its own: an epoch of training on windows of 60 frames, shuffled by blocks, during which
the anonymous memory of the process is watched (RssAnon: all but pages of files, which the system
takes back when it needs them); the same under a limit of the data segment (RLIMIT_DATA, as
`ulimit -d`), which counts private writable mappings of files as well; and batches of 1024 frames in
three orders, after the file was dropped from the page cache as far as the system lets it go.

Examples:
    python benchmarks/larger_than_memory.py --folder /data/temporary
    python benchmarks/larger_than_memory.py --folder /tmp/small --gigabytes 0.2
"""

import argparse
import json
import os
import platform
import resource
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import torch
from shared import memory, two_nearest, write_json
from torch import Tensor
from torch.nn import functional

from torch_geometric_tactile.data import StaticData, StaticDataset, Windows
from torch_geometric_tactile.data._processed_file import save_static
from torch_geometric_tactile.loader import StaticLoader
from torch_geometric_tactile.nn.models import GraspGCN
from torch_geometric_tactile.sensors import biotac

_FRAMES = 1000  # of a trial: 10 s at 100 Hz
_LIMIT = 1_500_000_000  # bytes
_FILE = "frames.pt"
# The attributes of a frame: shape and type.
_COLUMNS: dict[str, tuple[tuple[int, ...], torch.dtype]] = {
    "x": ((19, 3), torch.float),
    "pac": ((3, 22), torch.float),
    "pressure": ((3,), torch.float),
    "robot_joint": ((3, 7), torch.float),
    "joint": ((48,), torch.float),
    "object_pose": ((7,), torch.float),
    "y": ((), torch.long),
    "trial": ((), torch.long),
    "group": ((), torch.long),
    "phase": ((), torch.long),
    "time": ((), torch.double),
}


class Frames(StaticDataset):
    """The generated frames, from their file."""

    processed_file_names = _FILE

    def __init__(self, root: str, transform: Any = None) -> None:
        self.layout = biotac()
        super().__init__(root, transform)

    @property
    def processed_dir(self) -> str:
        return str(self.root)


def bytes_of_a_frame() -> int:
    return sum(torch.empty(shape, dtype=kind).nbytes for shape, kind in _COLUMNS.values())


def generate(folder: Path, gigabytes: float) -> None:
    trials = max(20, round(gigabytes * 1e9 / bytes_of_a_frame() / _FRAMES))
    size = trials * _FRAMES
    columns: dict[str, Tensor] = {}
    for key, (shape, kind) in _COLUMNS.items():
        numbers = torch.empty(shape, dtype=kind).numel() * size
        file = str(folder / f"{key}.raw")
        columns[key] = torch.from_file(file, True, numbers, dtype=kind).view(size, *shape)
    generator = torch.Generator().manual_seed(0)
    for trial in range(trials):
        rows = slice(trial * _FRAMES, (trial + 1) * _FRAMES)
        success = trial % 2
        for value in columns.values():
            if value.is_floating_point():
                value[rows] = torch.randn(value[rows].shape, generator=generator)
        columns["x"][rows] += success
        columns["y"][rows] = success
        columns["trial"][rows] = trial
        columns["group"][rows] = trial % 50
        columns["phase"][rows] = torch.arange(_FRAMES) // 250
        columns["time"][rows] = torch.arange(_FRAMES, dtype=torch.double) / 100
    layout = biotac()
    data = StaticData(
        **columns, edge_index=two_nearest(layout), pos=layout.pos, normal=layout.normal
    )
    settings = Frames.__new__(Frames)
    settings.layout, settings.pre_transform, settings.pre_filter = layout, None, None
    save_static(data, {"class": ["failure", "success"]}, folder / _FILE, settings._settings())
    for key in _COLUMNS:
        (folder / f"{key}.raw").unlink()


def epoch(folder: str, hop: int) -> dict[str, Any]:
    """Trains on all windows once, and returns the largest anonymous memory meanwhile."""
    highest, ended = [0], threading.Event()

    def watch() -> None:
        while not ended.wait(0.02):
            highest[0] = max(highest[0], memory("RssAnon"))

    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    start = time.perf_counter()
    torch.manual_seed(0)
    frames = Frames(folder)
    windows = Windows(frames, 60, hop, label="trial")
    opened = time.perf_counter()
    model = GraspGCN(frames.layout, 2, in_channels=60)
    optimizer = torch.optim.Adam(model.parameters(), lr=1e-3)
    loss = torch.tensor(0.0)
    for batch in StaticLoader(windows, 256, shuffle="blocks"):
        optimizer.zero_grad()
        loss = functional.cross_entropy(model(batch.x, batch.edge_index), batch.y)
        loss.backward()
        optimizer.step()
    ended.set()
    watcher.join()
    return {
        "bytes": frames.nbytes,
        "frames": len(frames),
        "windows": len(windows),
        "seconds_to_open": round(opened - start, 1),
        "seconds_of_the_epoch": round(time.perf_counter() - opened, 1),
        "last_loss": round(loss.item(), 4),
        "highest_RssAnon_MB": round(highest[0] / 1e6),
        "RssFile_MB_at_the_end": round(memory("RssFile") / 1e6),
    }


def limited(folder: str, hop: int) -> dict[str, Any]:
    resource.setrlimit(resource.RLIMIT_DATA, (_LIMIT, _LIMIT))
    return {"RLIMIT_DATA_MB": round(_LIMIT / 1e6), **epoch(folder, hop)}


def order(folder: str, shuffle: str) -> dict[str, Any]:
    """Times batches of 1024 frames in one order, after the page cache was emptied of the file."""
    kind = {"consecutive": False, "blocks": "blocks", "random": True}[shuffle]
    frames = Frames(folder)
    with open(Path(folder) / _FILE, "rb") as file:
        os.posix_fadvise(file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)
    generator = torch.Generator().manual_seed(0)
    times: list[float] = []
    batches: Iterator[Any] = iter(StaticLoader(frames, 1024, shuffle=kind, generator=generator))
    next(batches)
    for _ in range(min(300, len(frames) // 1024 - 1)):
        start = time.perf_counter()
        assert next(batches).x.sum() != 0
        times.append(time.perf_counter() - start)
    times.sort()
    return {
        "median_ms": round(1e3 * times[len(times) // 2], 2),
        "mean_ms": round(1e3 * sum(times) / len(times), 2),
    }


def in_a_process(*arguments: object) -> Any:
    command = [sys.executable, __file__, "--step", *map(str, arguments)]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False)
    if done.returncode:
        return {"failed": done.returncode}
    return json.loads(done.stdout.splitlines()[-1])


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--folder", type=Path, help="a new folder, removed at the end")
    parser.add_argument("--gigabytes", type=float, default=6.0, help="size of the data set")
    parser.add_argument("--hop", type=int, default=10, help="frames between windows")
    parser.add_argument("--json", help="file for the figures")
    parser.add_argument("--step", nargs=3, help=argparse.SUPPRESS)
    args = parser.parse_args()
    torch.set_num_threads(1)
    if args.step:
        name, folder, argument = args.step
        steps: dict[str, Any] = {"epoch": epoch, "limited": limited, "order": order}
        given = argument if name == "order" else int(argument)
        print(json.dumps(steps[name](folder, given)))
        return 0
    args.folder.mkdir(parents=True)
    try:
        generate(args.folder, args.gigabytes)
        print("generated", flush=True)
        found: dict[str, Any] = {
            "machine": f"{platform.machine()}, {os.cpu_count()} CPUs, "
            f"{os.sysconf('SC_PHYS_PAGES') * os.sysconf('SC_PAGE_SIZE') / 1e9:.0f} GB of memory",
            "versions": f"torch {torch.__version__}",
            "epoch": in_a_process("epoch", args.folder, args.hop),
            "limited": in_a_process("limited", args.folder, args.hop),
        }
        for shuffle in ("consecutive", "blocks", "random"):
            found[shuffle] = in_a_process("order", args.folder, shuffle)
    finally:
        shutil.rmtree(args.folder)
    print(json.dumps(found, indent=2))
    if args.json:
        write_json(args.json, found, indent=2)
    return int(
        any(found[key].get("highest_RssAnon_MB", 9999) > 1500 for key in ("epoch", "limited"))
    )


if __name__ == "__main__":
    raise SystemExit(main())
