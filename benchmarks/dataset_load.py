r"""Seconds and memory to process a folder of AllegroUSkin trials and to load it again, against a
list of PyG's Data objects that is written with torch.save and loaded whole.

Each step runs in a process of its own, whose peak of memory beyond that of an idle one counts. The
list is built from every n-th frame only, and its figures are multiplied by n. The readings that
come out of both are compared as well.

Examples:
    python benchmarks/dataset_load.py
    python benchmarks/dataset_load.py --root ~/data/grasps
"""

import sys
import tempfile
import time
from collections.abc import Callable
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
import torch
from shared import parse, print_setting

from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.datasets import AllegroUSkin
from torch_geometric_tactile.io import write_recording
from torch_geometric_tactile.sim import paper8

_MEGABYTE = 2**20


OPTIONS = {
    "--root": (
        None,
        "folder of trials, such as 'tactile simulate' writes; nothing is written into it (default: "
        "a generated one)",
    ),
    "--trials": (80, "trials to generate"),
    "--frames": (1700, "frames of each of them"),
    "--seed": (0, "seed of the generated readings"),
    "--list-every": (20, "build the list of Data from every so many frames"),
    "--at-most": (2.0, "how many seconds loading may take for the exit code 0"),
}
EPILOG = (
    "The exit code is 0 if the readings are the same and the data set loads fast enough, 1 if not, "
    "and 2 if an argument is wrong."
)


def generate(folder: Path, trials: int, frames: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    names = [item.name for item in paper8()]
    folder.mkdir()
    for trial in range(trials):
        recording = Recording(
            time=np.arange(frames) / 100,
            tactile=rng.integers(0, 4000, (frames, 384, 3), dtype=np.int16),
            joint=rng.uniform(-1, 1, (frames, 16)),
            meta={"unit": "count"},
        )
        name = f"{names[trial % len(names)]}_{trial // len(names):03d}.npz"
        write_recording(recording, folder / name)


def load_dataset(root: str, every: int) -> dict[str, Any]:
    dataset = AllegroUSkin(root, split=None)
    few = dataset._data.x[: every * 10 : every]
    return {"frames": len(dataset), "bytes": dataset._data.x.nbytes, "few": few.tolist()}


def save_list(root: str, every: int) -> dict[str, Any]:
    dataset = AllegroUSkin(root, split=None)[::every]
    # A copy of each sample, or the file would hold all readings; the edges stay one tensor.
    samples = [data.clone().update({"edge_index": data.edge_index}) for data in dataset]
    torch.save(samples, Path(root) / "list.pt")
    return {}


def load_list(root: str, every: int) -> dict[str, Any]:
    samples = torch.load(Path(root) / "list.pt", weights_only=False)
    return {"few": torch.stack([data.x for data in samples[:10]]).tolist()}


def do_nothing(root: str, every: int) -> dict[str, Any]:
    return {}


def _run(
    step: Callable[[str, int], dict[str, Any]], root: str, every: int, end: Connection
) -> None:
    import resource  # not on Windows

    start = time.perf_counter()
    result = step(root, every)
    result["seconds"] = time.perf_counter() - start
    unit = 1 if sys.platform == "darwin" else 1024
    result["memory"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit
    end.send(result)


def measure(step: Callable[[str, int], dict[str, Any]], root: str, every: int) -> dict[str, Any]:
    context = get_context("spawn")
    ours, theirs = context.Pipe(duplex=False)
    process = context.Process(target=_run, args=(step, root, every, theirs))
    process.start()
    theirs.close()
    try:
        result: dict[str, Any] = ours.recv()
    except EOFError:
        sys.exit(f"the step '{step.__name__}' failed, see above")
    process.join()
    return result


def main(argv: list[str] | None = None) -> int:
    args = parse(__doc__, OPTIONS, argv, EPILOG)
    source = args.root
    with tempfile.TemporaryDirectory() as root:
        raw = Path(root, "raw")
        if source is None:
            generate(raw, args.trials, args.frames, args.seed)
        else:
            raw.symlink_to(Path(source).expanduser().resolve(), target_is_directory=True)
        num_bytes = sum(path.stat().st_size for path in raw.iterdir() if path.is_file())
        idle = measure(do_nothing, root, args.list_every)["memory"]
        steps = {
            "process, first load": measure(load_dataset, root, args.list_every),
            "load": measure(load_dataset, root, args.list_every),
        }
        measure(save_list, root, args.list_every)
        steps["load list of Data"] = measure(load_list, root, args.list_every)
    loaded, listed = steps["load"], steps["load list of Data"]
    size = loaded["bytes"] / _MEGABYTE
    print_setting(
        *("torch", "torch_geometric", "torch_geometric_tactile"),
        data=f"{source or f'generated, seed {args.seed}'}: {loaded['frames']} frames, "
        f"{size:.0f} MB of readings, {num_bytes / _MEGABYTE:.0f} MB of files",
        setting=f"list of Data from every {args.list_every}th frame, its figures multiplied",
    )
    print(f"\n{'':<24}{'seconds':>10}{'peak MB':>10}{'of readings':>13}")
    for name, result in steps.items():
        factor = args.list_every if "list" in name else 1
        result["seconds"] *= factor
        result["peak"] = max(0, result["memory"] - idle) / _MEGABYTE * factor
        print(
            f"{name:<24}{result['seconds']:>10.2f}{result['peak']:>10.0f}"
            f"{result['peak'] / size:>12.2f}x"
        )
    print(f"\nratio of seconds to load  {listed['seconds'] / loaded['seconds']:.1f}")

    status = 0
    if loaded["few"] != listed["few"]:
        print("FAILED: the list holds other readings", file=sys.stderr)
        status = 1
    if loaded["seconds"] > args.at_most:
        print(
            f"FAILED: loading took {loaded['seconds']:.2f} s, more than {args.at_most:g} s",
            file=sys.stderr,
        )
        status = 1
    return status


if __name__ == "__main__":
    sys.exit(main())
