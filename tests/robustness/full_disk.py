r"""Fills a small disk under each writer. By hand, as root, on Linux:

    python tests/robustness/full_disk.py --sizes 8

Each writer replaces a file on a disk with room for a part of what it writes. It must
end with an error that names the file, or succeed; the old content must read as before, or the new;
and nothing else may lie in the folder.
"""

import argparse
import atexit
import gc
import json
import logging
import os
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch

PAGE = 4096
DISK = 8 * 2**20


class Writer(NamedTuple):
    """What is written, and how it is read; ``old`` and ``new`` are contents that differ."""

    name: str
    suffix: str
    write: Callable[[Any, Path], None]
    read: Callable[[Path], Any]
    old: Any
    new: Any


def writers() -> Iterator[Writer]:
    """Yields all writers whose extras are installed."""
    yield from recording_writers()
    yield from torch_writers()
    yield from text_writers()


def recordings():
    """Returns a short recording and a longer one."""
    from torch_geometric_tactile.data import Recording

    draw = np.random.default_rng(0)

    def make(start, stop):
        return Recording(
            np.arange(start, stop) / 100,
            draw.integers(0, 60000, (stop - start, 24, 3)).astype(float),
            meta={"unit": "count"},
            extra={"pac": draw.integers(0, 4096, (stop - start, 3, 22))},
        )

    return make(0, 40), make(40, 700)


def readings(recording):
    """Returns what two recordings must have in common."""
    return recording.time.round(6).tolist(), recording.tactile.tolist()


def recording_writers() -> Iterator[Writer]:
    """Yields the writers of recordings."""
    from torch_geometric_tactile import io
    from torch_geometric_tactile.io._recording_npz import read_npz, write_npz
    from torch_geometric_tactile.io._wide_csv import read_wide_csv, write_wide_csv
    from torch_geometric_tactile.io._xela_messages import read_xela_messages, write_xela_messages

    old, new = recordings()

    yield Writer("npz", ".npz", write_npz, lambda p: readings(read_npz(p)), old, new)
    yield Writer("wide CSV", ".csv", write_wide_csv, lambda p: readings(read_wide_csv(p)), old, new)
    yield Writer(
        "XELA messages",
        ".jsonl",
        write_xela_messages,
        lambda p: readings(read_xela_messages(p)),
        old,
        new,
    )
    try:
        import google.protobuf  # noqa: F401
        import mcap  # noqa: F401
    except ImportError:
        pass
    else:
        yield Writer("MCAP", ".mcap", io.write_mcap, lambda p: readings(io.read_mcap(p)), old, new)
    try:
        import h5py  # noqa: F401
    except ImportError:
        return
    yield Writer("write_hdf5", ".h5", io.write_hdf5, lambda p: readings(io.read_hdf5(p)), old, new)


def torch_writers() -> Iterator[Writer]:
    """Yields the writers of samples, weights and predictors."""
    from torch_geometric_tactile import Predictor
    from torch_geometric_tactile.data import StaticData
    from torch_geometric_tactile.data._processed_file import read_processed, save_static
    from torch_geometric_tactile.nn import TactileFNN
    from torch_geometric_tactile.sensors import grid

    def samples(count):
        return StaticData(x=torch.arange(count * 12.0).view(count, 4, 3), y=torch.zeros(count))

    def sum_of(path):
        return read_processed(path).data.x.double().sum().item()

    yield Writer(
        "processed file",
        ".pt",
        lambda d, p: save_static(d, {}, p),
        sum_of,
        samples(9),
        samples(9000),
    )

    def predictor(width):
        torch.manual_seed(0)
        model = TactileFNN(4, 2, widths=(width,), pools=(1,))
        return Predictor(model, grid(2, 2, pitch=0.01), None, ("a", "b"), num_channels=3)

    def width_of(path):
        return sum(p.double().sum().item() for p in Predictor.load(path).model.parameters())

    yield Writer(
        "predictor",
        ".predictor",
        lambda content, path: content.save(path),
        width_of,
        predictor(8),
        predictor(4000),
    )

    try:
        import onnxruntime  # noqa: F401
        import onnxscript  # noqa: F401
    except ImportError:
        pass
    else:
        from torch_geometric_tactile.live import OnnxModel
        from torch_geometric_tactile.predictor import export_onnx

        yield Writer(
            "graph",
            ".onnx",
            lambda content, path: export_onnx(content, path),
            lambda path: (OnnxModel(path).info["model"], path.stat().st_size),
            predictor(8),
            predictor(4000),
        )
    try:
        from torch_geometric_tactile.training._checkpoint import AtomicCheckpointIO
    except ImportError:
        return

    def weights(count):
        return {"state_dict": {"a": torch.arange(count * 1.0), "b": torch.ones(count)}}

    def loaded(path):
        state = torch.load(path, weights_only=True)["state_dict"]
        return state["a"].sum().item(), state["b"].sum().item()

    yield Writer(
        "checkpoint",
        ".ckpt",
        AtomicCheckpointIO().save_checkpoint,
        loaded,
        weights(100),
        weights(50000),
    )


def text_writers() -> Iterator[Writer]:
    """Yields the writers of layouts, presses, results, pictures and pages."""
    from torch_geometric_tactile.sensors import TaxelLayout, grid
    from torch_geometric_tactile.sim.simulate_letters import _write_block
    from torch_geometric_tactile.transforms import Calibrate

    yield Writer(
        "layout",
        ".json",
        lambda layout, path: layout.save(path),
        lambda path: TaxelLayout.load(path).num_taxels,
        grid(2, 2, pitch=0.01),
        grid(40, 40, pitch=0.01),
    )
    yield Writer(
        "calibration",
        ".json",
        lambda calibrate, path: calibrate.save(path),
        lambda path: Calibrate.load(path).coefficients.tolist(),
        Calibrate(np.ones((4, 3))),
        Calibrate(np.ones((400, 20, 3)), degree=3),
    )
    draw_presses = np.random.default_rng(0)
    yield Writer(
        "letters",
        ".npy",
        _write_block,
        lambda path: np.load(path).tolist(),
        draw_presses.random((2, 32, 32), dtype=np.float32),
        draw_presses.random((100, 32, 32), dtype=np.float32),
    )
    try:
        from torch_geometric_tactile.data import Protocol
        from torch_geometric_tactile.experiments._experiment import Experiment
        from torch_geometric_tactile.experiments._run_store import RunStore
        from torch_geometric_tactile.experiments.source import DataSource
        from torch_geometric_tactile.reports.html import write_report
        from torch_geometric_tactile.visualization._style import new_figure
        from torch_geometric_tactile.visualization.figure import save_figure
    except ImportError:
        return

    run = Experiment(
        data=DataSource("a.B", {}, fingerprint="d"),
        protocol=Protocol("trial"),
        protocol_name="by trial",
        name="a",
        model={"x": 1},
        epochs=2,
    )

    def store(result, path):
        RunStore(path.parent).write(run, result)

    def stored(path):
        return RunStore(path.parent).read(run)

    yield Writer("run store", run.file_name, store, stored, {"a": 1}, {"a": list(range(30000))})

    def draw(size, path):
        picture = new_figure(size, size)
        noise = np.random.default_rng(0).random((int(100 * size), int(100 * size)))
        picture.add_subplot().imshow(noise)
        save_figure(picture, path)

    yield Writer("figure", ".png", draw, lambda path: path.read_bytes(), 1.0, 4.0)
    yield Writer(
        "report",
        ".html",
        lambda title, path: write_report(
            path, title=title, notice="generated", facts=[], tables=[], pictures=[]
        ),
        lambda path: path.read_text(encoding="utf-8"),
        "short",
        "long " * 30000,
    )


@contextmanager
def small_disk(folder: Path) -> Iterator[Path]:
    """Mounts a small disk in memory; ``PermissionError`` where this is not allowed."""
    command = ["mount", "-t", "tmpfs", "-o", f"size={DISK}", "tmpfs", str(folder)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    except FileNotFoundError as error:
        raise PermissionError("there is no command 'mount'") from error
    if done.returncode:
        raise PermissionError(f"a disk in memory cannot be mounted: {done.stderr.strip()}")
    try:
        yield folder
    finally:
        gc.collect()
        subprocess.run(["umount", "-l", str(folder)], check=True)


def leave_free(disk: Path, room: int) -> Path:
    """Fills a disk but for some bytes, in whole pages, with a file that it returns."""
    state = os.statvfs(disk)
    ballast = disk / "ballast"
    with ballast.open("wb") as file:
        os.posix_fallocate(file.fileno(), 0, state.f_bavail * state.f_frsize - room)
    return ballast


def try_in_child(write: Callable[[], None]) -> dict[str, Any]:
    """Runs something in a process of its own, up to its end, and tells what became of it."""
    reader, speaker = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reader)
        found: dict[str, Any] = {"ended": "written"}
        try:
            write()
        except Exception as error:
            name = getattr(error, "filename", None)
            found = {"ended": type(error).__name__, "text": f"{error} {name}"}
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
        gc.collect()
        atexit._run_exitfuncs()
        os.write(speaker, json.dumps(found).encode())
        os._exit(0)
    os.close(speaker)
    with os.fdopen(reader, "rb") as file:
        said = file.read()
    status = os.waitpid(child, 0)[1]
    if status or not said:
        return {"ended": f"crash ({status})", "text": ""}
    return json.loads(said)


def check_writer(writer: Writer, disk: Path, sizes: int) -> tuple[Counter[str], list[str]]:
    """Writes on disks that are full to different degrees: what became of it, and what was wrong."""
    is_name = not writer.suffix.startswith(".")
    path = disk / (writer.suffix if is_name else f"target{writer.suffix}")
    writer.write(writer.old, path)
    old = writer.read(path)
    writer.write(writer.new, path)
    new, size = writer.read(path), path.stat().st_size
    ended: Counter[str] = Counter()
    wrong = []
    for step in range(sizes):
        path.unlink()
        writer.write(writer.old, path)
        room = int(size * step / max(sizes - 1, 1) * 1.1) // PAGE * PAGE
        ballast = leave_free(disk, room)
        found = try_in_child(lambda: writer.write(writer.new, path))
        ballast.unlink()
        ended[found["ended"]] += 1
        now = writer.read(path)
        said = found["ended"]
        problems = {
            said: said not in ("written", "OSError"),
            f"does not name the file: {found.get('text')}": said != "written"
            and str(path) not in found.get("text", ""),
            "neither old nor new": now not in (old, new),
            "not what it said": now != (new if said == "written" else old),
            f"left {sorted(p.name for p in disk.iterdir())}": len([*disk.iterdir()]) != 1,
        }
        wrong += [
            f"{writer.name}, room {room} of {size}: {p}" for p, true in problems.items() if true
        ]
    path.unlink()
    return ended, wrong


def main() -> int:
    """Prints a table, and what was wrong."""
    logging.disable(logging.WARNING)
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sizes", type=int, default=8)
    parser.add_argument("--only", nargs="*", metavar="WRITER")
    arguments = parser.parse_args()
    wrong: list[str] = []
    folder = Path(tempfile.mkdtemp())  # not TemporaryDirectory, which the children would remove
    with small_disk(folder) as disk:
        for writer in writers():
            if arguments.only and writer.name not in arguments.only:
                continue
            ended, found = check_writer(writer, disk, arguments.sizes)
            wrong += found
            sys.stdout.write(f"{writer.name:16} {dict(ended)} {len(found)} wrong\n")
    folder.rmdir()
    sys.stdout.write("\n".join([*wrong, f"{len(wrong)} wrong\n"]))
    return 1 if wrong else 0


if __name__ == "__main__":
    torch.set_num_threads(1)  # threads do not survive a fork
    sys.exit(main())
