r"""Runs experiments in a separate process, which measures its peak memory and may be killed.

:func:`run_worker` reads pickled experiments, one line of base64 each, and answers with one line of
JSON each. It ends with its input, so that it never outlives the process that started it, and after
some idle seconds.
"""

import base64
import json
import os
import pickle
import queue
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Any

# PyTorch imports it when a process ends, and would then take a file of the working directory where
# this comes first on the search path, as in 'python -c' and 'python -m'.
import tabulate  # noqa: F401

from torch_geometric_tactile._checks import ArgumentError
from torch_geometric_tactile._parallel import MALLOC_VARIABLES
from torch_geometric_tactile.experiments._experiment import Experiment
from torch_geometric_tactile.experiments._memory import PeakMemory
from torch_geometric_tactile.experiments._run_experiment import run_experiment

# With the search path of the process that starts it behind its own, and without the working
# directory, whose files must not take the place of installed modules.
_START = f"""\
import sys
sys.path += [folder for folder in sys.argv[1:] if folder not in sys.path]
from {__name__} import run_worker
run_worker()
"""
_THREADS = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")
_IDLE_SECONDS = 20.0
_SIGKILL = -9
_mine = threading.local()  # a worker of a cluster may run several jobs in threads


def run_safely(experiment: Experiment) -> dict[str, Any]:
    r"""Runs an experiment and returns its result, or :obj:`{"error": ...}` if it failed: in a
    process of its own if its memory is to be measured, and otherwise here.
    """
    return run_in_process(experiment) if experiment.measure_memory else run_here(experiment)


def run_here(experiment: Experiment) -> dict[str, Any]:
    r"""Runs an experiment in this process and returns its result, or :obj:`{"error": ...}` if it
    failed.
    """
    try:
        return run_experiment(experiment)
    except Exception as error:
        name = "ValueError" if isinstance(error, ArgumentError) else type(error).__name__
        return {"error": " ".join(f"{name}: {error}".split())[:1000]}


def run_in_process(experiment: Experiment) -> dict[str, Any]:
    r"""Runs an experiment in another process and returns its result, or :obj:`{"error": ...}` if it
    failed or was killed.

    The process is used again for the next experiment of this thread, which saves its start, if it
    can measure the peak memory of each.
    """
    while True:
        process = getattr(_mine, "process", None)
        if process is None or process.threads != experiment.threads or not process.alive:
            close_process()
            process = _mine.process = _Process(experiment.threads)
        try:
            result = process.run(experiment)
        except BaseException:
            close_process()
            raise
        if result is not None:
            return result


def close_process() -> None:
    r"""Ends the process of this thread, if there is one."""
    process = getattr(_mine, "process", None)
    if process is not None:
        _mine.process = None
        process.close()


class _Process:
    def __init__(self, threads: int) -> None:
        self.threads = threads
        self._said = tempfile.TemporaryFile()  # noqa: SIM115 - closed with the process
        environment = {**MALLOC_VARIABLES, **os.environ, **dict.fromkeys(_THREADS, str(threads))}
        self._popen = subprocess.Popen(
            [sys.executable, "-P", "-c", _START, *filter(None, sys.path)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._said,
            env=environment,
        )

    @property
    def alive(self) -> bool:
        return self._popen.poll() is None

    def run(self, experiment: Experiment) -> dict[str, Any] | None:
        # None if the process had nothing to do and ended just now.
        assert self._popen.stdin is not None
        assert self._popen.stdout is not None
        with suppress(BrokenPipeError):  # it has ended
            self._popen.stdin.write(base64.b64encode(pickle.dumps(experiment)) + b"\n")
            self._popen.stdin.flush()
        line = self._popen.stdout.readline()
        if line:
            result: dict[str, Any] = json.loads(line)
            return result
        status = self._popen.wait()
        if status == 0:
            return None
        if status == _SIGKILL:
            return {"error": "its process was killed, perhaps for lack of memory"}
        self._said.seek(0)
        said = self._said.read().decode("utf-8", "replace").strip().splitlines()
        return {"error": said[-1] if said else f"its process ended with status {status}"}

    def close(self) -> None:
        self._popen.kill()
        self._popen.wait()
        for file in (self._popen.stdin, self._popen.stdout, self._said):
            if file is not None:
                with suppress(BrokenPipeError):  # it was killed before it read all
                    file.close()


def run_worker() -> None:
    r"""Serves :func:`run_in_process`."""
    lines: queue.Queue[bytes] = queue.Queue()
    threading.Thread(target=_read, args=(lines.put,), daemon=True).start()
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # what libraries print must not get between
    while True:
        try:
            line = lines.get(timeout=_IDLE_SECONDS)
        except queue.Empty:
            return
        result = run_here(pickle.loads(base64.b64decode(line)))
        answers.write(json.dumps(result) + "\n")
        answers.flush()
        if "error" in result or not PeakMemory.can_start_anew():
            return


def _read(put: Callable[[bytes], None]) -> None:
    # Not through sys.stdin, whose lock this thread would hold when the process ends.
    with open(0, "rb", buffering=0, closefd=False) as file:
        for line in iter(file.readline, b""):
            put(line)
    os._exit(1)
