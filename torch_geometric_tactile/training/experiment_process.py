r"""An experiment in a process of its own, which knows its own peak memory.

``python -m torch_geometric_tactile.training.experiment_process`` reads what to do, as JSON, from
the first line of its input and writes the result, as JSON, to its output. It ends when its input
does, so that it never outlives whoever started it.
"""

import json
import os
import subprocess
import sys
import threading
from dataclasses import asdict
from typing import Any, BinaryIO

from torch_geometric_tactile.training.experiment import Experiment, run_experiment
from torch_geometric_tactile.training.processes import KEPT_MEMORY

_MODULE = "torch_geometric_tactile.training.experiment_process"
_THREADS = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")
_SECONDS_BETWEEN_LOOKS = 1.0


def run_in_process(experiment: Experiment, parent: int | None = None) -> dict[str, Any]:
    r"""Runs an experiment in a new process and returns its result, or :obj:`{"error": ...}`, the
    end of what the process said, where it failed.

    Args:
        experiment (Experiment): What to do.
        parent (int, optional): Process without which nobody waits for the result: this process ends
            with it.
    """
    environment = {
        **os.environ,
        **{name: value for name, value in KEPT_MEMORY.items() if name not in os.environ},
        **dict.fromkeys(_THREADS, str(experiment.threads)),
    }
    process = subprocess.Popen(
        [sys.executable, "-m", _MODULE],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env=environment,
    )
    # Kept open and out of communicate(), which would close it: it is what the process lives on.
    life, process.stdin = process.stdin, None
    assert life is not None
    try:
        with life:
            _send(life, experiment)
            output, errors = _wait(process, parent)
    finally:
        process.kill()
        process.wait()
    if process.returncode == 0:
        result: dict[str, Any] = json.loads(output)
        return result
    said = errors.decode("utf-8", "replace").strip().splitlines()[-1:]
    if process.returncode < 0:
        said = [f"killed by signal {-process.returncode}, for want of memory perhaps"]
    return {"error": " ".join(said) or f"ended with status {process.returncode}"}


def _send(life: Any, experiment: Experiment) -> None:
    try:
        life.write(json.dumps(asdict(experiment)).encode() + b"\n")
        life.flush()
    except BrokenPipeError:
        pass  # it has ended already, and says why


def _wait(process: "subprocess.Popen[bytes]", parent: int | None) -> tuple[bytes, bytes]:
    while True:
        try:
            return process.communicate(timeout=_SECONDS_BETWEEN_LOOKS)
        except subprocess.TimeoutExpired:
            if parent is not None and parent not in (os.getpid(), os.getppid()):
                process.kill()
                os._exit(1)


def _end_with(life: BinaryIO) -> None:
    life.read()
    os._exit(1)


def main() -> None:
    r"""Runs the experiment that comes in, as the process that :func:`run_in_process` starts."""
    life = sys.stdin.buffer
    line = life.readline()
    threading.Thread(target=_end_with, args=(life,), daemon=True).start()
    result_pipe = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # what libraries print must not get between
    content = json.loads(line)
    phases = content.pop("phases")
    experiment = Experiment(**content, phases=None if phases is None else tuple(phases))
    with result_pipe:
        json.dump(run_experiment(experiment), result_pipe)


if __name__ == "__main__":
    main()
