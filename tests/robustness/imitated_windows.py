"""Runs every writer where a module or call that Windows lacks is lacking, and prints what failed.

Imitated: no `fcntl`, `termios`, `resource` and `select.poll`; `os.fsync` asks for a handle that may
be written; a file that is open cannot be removed or replaced.
"""

import builtins
import os
import select
import sys
from pathlib import Path

LACKING = ("fcntl", "termios", "tty", "resource", "pwd", "grp")
REAL_IMPORT = builtins.__import__


def lacking_import(name, globals=None, *args, **kwargs):
    """Refuses what Windows lacks to our package; other libraries are those of this machine."""
    importer = (globals or {}).get("__name__", "")
    if name in LACKING and importer.startswith("torch_geometric_tactile"):
        raise ImportError(f"No module named '{name}'")
    return REAL_IMPORT(name, globals, *args, **kwargs)


REAL_FSYNC, REAL_REPLACE, REAL_UNLINK = os.fsync, os.replace, os.unlink


def fsync(handle):
    """As `_commit` of Windows, which refuses handles that are for reading only."""
    flags = Path(f"/proc/self/fdinfo/{handle}").read_text().split("flags:")[1].split()[0]
    if int(flags, 8) & os.O_ACCMODE == os.O_RDONLY:
        raise OSError(9, "Bad file descriptor")
    REAL_FSYNC(handle)


def is_open(path):
    """Whether this process has the file open (Windows then neither removes nor replaces it)."""
    if not os.path.exists(path):
        return False
    wanted = os.stat(path)
    for name in os.listdir("/proc/self/fd"):
        try:
            found = os.fstat(int(name))
        except OSError:
            continue
        if os.path.samestat(found, wanted):
            return True
    return False


def replace(source, target, **options):
    for path in (source, target):
        if is_open(path):
            raise PermissionError(13, "The file is used by another process", str(path))
    REAL_REPLACE(source, target, **options)


def unlink(path, **options):
    if "dir_fd" not in options and is_open(path):
        raise PermissionError(13, "The file is used by another process", str(path))
    REAL_UNLINK(path, **options)


def imitate():
    builtins.__import__ = lacking_import
    if hasattr(select, "poll"):
        del select.poll
    os.fsync, os.replace, os.unlink = fsync, replace, unlink


def recording():
    import numpy as np

    from torch_geometric_tactile.data import Recording

    return Recording(time=np.arange(5) / 10, tactile=np.ones((5, 4, 3)), label="mug")


def write(name):
    def run(folder):
        from torch_geometric_tactile import io

        path = folder / name
        for _ in range(2):  # a new file, and one that is there
            io.write_recording(recording(), path)
        assert io.read_recording(path).num_frames == 5

    return run


def lerobot(folder):
    from torch_geometric_tactile.io import read_lerobot, write_lerobot

    write_lerobot([recording()], folder / "set", fps=10)
    assert len(read_lerobot(folder / "set")) == 1


def layout(folder):
    from torch_geometric_tactile.sensors import TaxelLayout, grid

    grid(2, 2, pitch=0.01).save(folder / "pad.json")
    TaxelLayout.load(folder / "pad.json")


def calibration(folder):
    from torch_geometric_tactile.transforms import Calibrate

    Calibrate([[0.0], [1.0]]).save(folder / "skin.json")
    Calibrate.load(folder / "skin.json")


def predictor(folder):
    from torch_geometric_tactile.nn import TaxelNet
    from torch_geometric_tactile.predictor import Predictor
    from torch_geometric_tactile.sensors import grid

    pad = grid(2, 2, pitch=0.01)
    Predictor(TaxelNet(pad, 2, in_channels=3), pad).save(folder / "a.predictor")
    Predictor.load(folder / "a.predictor")


def processed(folder):
    from torch_geometric_tactile import io
    from torch_geometric_tactile.datasets import RecordingFrames
    from torch_geometric_tactile.sensors import grid

    io.write_recording(recording(), folder / "mug_0.npz")
    for _ in range(2):
        dataset = RecordingFrames(folder, grid(2, 2, pitch=0.01), target="label")
        assert len(dataset) == 5


def checkpoint(folder):
    from fuzz import model_bases

    from torch_geometric_tactile.training import TactileModule
    from torch_geometric_tactile.training._checkpoint import AtomicCheckpointIO

    model_bases.checkpoint(folder)
    content = AtomicCheckpointIO().load_checkpoint(folder / "a.ckpt")
    AtomicCheckpointIO().save_checkpoint(content, folder / "a.ckpt")
    TactileModule.load_from_checkpoint(folder / "a.ckpt")


def run_store(folder):
    from fuzz import model_bases

    model_bases.run_store(folder)


def mcap_lock(folder):
    from torch_geometric_tactile.io._mcap_output import McapOutput

    first = McapOutput(folder / "a.mcap", True, True)
    try:
        McapOutput(folder / "a.mcap", True, True)
    except BlockingIOError:
        pass
    else:
        raise AssertionError("a second writer was let in")
    first.close()
    McapOutput(folder / "a.mcap", True, True).close()


def recorder(folder):
    from torch_geometric_tactile.cli import main

    source = f"{folder / 'in.npz'}"
    write("in.npz")(folder)
    out = folder / "out.mcap"
    assert main(["record", source, str(out), "--seconds", "1"]) == 0
    assert out.is_file()


def ports(folder):
    from torch_geometric_tactile.cli import main

    assert main(["ports"]) == 0


def memory(folder):
    from torch_geometric_tactile.experiments import _memory as peak

    assert isinstance(peak._peak_megabytes(), float)


WRITERS = {
    **{name: write(name) for name in ("a.npz", "a.h5", "a.csv", "a.mcap", "a.jsonl")},
    "lerobot": lerobot,
    "layout": layout,
    "calibration": calibration,
    "predictor": predictor,
    "processed": processed,
    "checkpoint": checkpoint,
    "run": run_store,
    "mcap lock": mcap_lock,
    "record": recorder,
    "ports": ports,
    "memory": memory,
}

if __name__ == "__main__":
    import tempfile
    import traceback

    imitate()
    failed = []
    for name, run in WRITERS.items():
        with tempfile.TemporaryDirectory() as made:
            try:
                run(Path(made))
            except Exception:
                failed.append(name)
                traceback.print_exc()
    sys.stdout.write(f"{len(WRITERS)} writers, failed: {failed}\n")
    sys.exit(bool(failed))
