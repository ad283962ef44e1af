r"""Kills jobs that write at random moments. By hand, on Linux or macOS:

    python tests/robustness/kills.py --kills 200 --seed 0

Each trial forks a job, kills it at a random moment of its usual time (alone, or beside a second one
on the same target that goes on), looks whether all that was finished reads whole, lets the job run
once more, and compares what it made with an undisturbed run. No temporary may be left.
"""

import argparse
import logging
import os
import signal
import sys
import tempfile
import time
import traceback
import warnings
from functools import partial
from pathlib import Path
from shutil import rmtree
from typing import Any

import numpy as np

TESTS = Path(__file__).resolve().parents[1]
if __name__ == "__main__":
    sys.path.insert(0, str(TESTS))

import torch  # noqa: E402
from robustness import kill_jobs  # noqa: E402
from robustness.kill_jobs import Job, jobs  # noqa: E402


def start(job: Job, folder: Path) -> int:
    """Starts a job in a new process, and returns its number."""
    child = os.fork()
    if child:
        return child
    status = 1
    try:
        os.environ["TMPDIR"] = tempfile.tempdir = str(folder)
        quiet = os.open(os.devnull, os.O_WRONLY)
        os.dup2(quiet, 1)
        job.run(folder)
        status = 0
    except BaseException:
        traceback.print_exc()
    finally:
        os._exit(status)
    raise AssertionError("unreachable")


def succeeded(child: int) -> bool:
    """Waits for a job."""
    return os.waitpid(child, 0)[1] == 0


def differences(job: Job, folder: Path, wanted: dict[str, Any], done: bool) -> list[str]:
    """Returns what is wrong with what lies in a folder."""
    try:
        found = job.read(folder)
    except Exception as error:
        return [f"unreadable: {error!r}"]
    wrong = [f"{name} differs" for name, value in found.items() if value != wanted[name]]
    if done and found.keys() != wanted.keys():
        wrong.append(f"finished {sorted(found)}")
    return wrong


def temporaries(folder: Path) -> list[str]:
    """Returns what is hidden, or named as a temporary, in a folder."""
    names = [path.name for path in folder.rglob("*")]
    return sorted(
        name for name in names if name.startswith((".", "tmp", "torch_geometric_tactile_"))
    )


def kill_once(job: Job, seconds: float, wanted: dict[str, Any], draw: Any, two: bool) -> list[str]:
    """Kills a job once and returns what was wrong afterwards."""
    folder = Path(tempfile.mkdtemp(prefix="kills_"))
    job.prepare(folder)
    first = start(job, folder)
    second = start(job, folder) if two else None
    time.sleep(draw.uniform(0, seconds))
    os.kill(first, signal.SIGKILL)
    succeeded(first)
    wrong = []
    if second is not None and not succeeded(second):
        wrong.append("the second one failed")
    wrong += differences(job, folder, wanted, done=second is not None)
    for _ in range(1 + two):
        if not succeeded(start(job, folder)):
            wrong.append("the next run failed")
    wrong += differences(job, folder, wanted, done=True)
    wrong += [f"left {name}" for name in temporaries(folder)]
    rmtree(folder)
    return wrong


def undisturbed(job: Job) -> tuple[float, dict[str, Any]]:
    """Runs a job twice: the time of the second, and what it made."""
    for _ in range(2):
        folder = Path(tempfile.mkdtemp(prefix="kills_"))
        job.prepare(folder)
        begin = time.perf_counter()
        assert succeeded(start(job, folder)), job.name
        seconds = time.perf_counter() - begin
        made = job.read(folder)
        assert made, job.name
        assert temporaries(folder) == [], job.name
        rmtree(folder)
    return seconds, made


def main() -> int:
    """Prints a table, and what was wrong."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", nargs="*", metavar="JOB")
    parser.add_argument("--frames", type=int, default=kill_jobs.FRAMES, help="of a recording")
    arguments = parser.parse_args()
    kill_jobs.FRAMES = arguments.frames
    logging.disable(logging.WARNING)
    warnings.simplefilter("ignore")
    chosen = [job for job in jobs() if not arguments.only or job.name in arguments.only]
    share = arguments.kills / sum(job.weight for job in chosen)
    wrong: list[str] = []
    total = 0
    for job in chosen:
        draw = np.random.default_rng(arguments.seed)
        seconds, wanted = undisturbed(job)
        kills = max(1, round(share * job.weight))
        kill = partial(kill_once, job, seconds, wanted, draw)
        found = [f"{job.name}: {text}" for i in range(kills) for text in kill(two=i % 4 == 3)]
        sys.stdout.write(f"{job.name:12} {kills:4} kills in {seconds:.3f} s  {len(found)} wrong\n")
        sys.stdout.flush()
        total += kills
        wrong += found
    sys.stdout.write("\n".join([*wrong, f"{total} kills, {len(wrong)} wrong\n"]))
    return 1 if wrong else 0


if __name__ == "__main__":
    torch.set_num_threads(1)  # threads do not survive a fork
    sys.exit(main())
