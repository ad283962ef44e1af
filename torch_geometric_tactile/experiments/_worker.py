r"""Runs experiments in a separate process to measure their peak memory.

:func:`run_worker` reads pickled experiments, one line of base64 each, and writes one line of JSON
for each. It ends at the end of its input, so that it never outlives its parent process, or after it
has been idle for 20 seconds.
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

# PyTorch imports tabulate when a process ends. With 'python -c' and 'python -m' it would then
# import a file of this name from the working directory.
import tabulate  # noqa: F401

from torch_geometric_tactile._checks import ArgumentError
from torch_geometric_tactile._parallel import MALLOC_VARIABLES
from torch_geometric_tactile.experiments._experiment import Experiment
from torch_geometric_tactile.experiments._memory import PeakMemory
from torch_geometric_tactile.experiments._run_experiment import run_experiment

# Appends the search path of the parent process, with the user's modules. The working directory is
# not on the path ('-P'), so that its files cannot hide installed modules.
_START = f"""\
import sys
sys.path += [folder for folder in sys.argv[1:] if folder not in sys.path]
from {__name__} import run_worker
run_worker()
"""
_THREAD_VARIABLES = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")
_IDLE_SECONDS = 20.0
_SIGKILL = -9
_thread_state = threading.local()  # workers of a cluster may run jobs in several threads


def run_safely(experiment: Experiment) -> dict[str, Any]:
    r"""Runs an experiment and returns its result, or :obj:`{"error": ...}` if it failed. The
    experiment runs in a separate process if its memory is measured, otherwise in this process.
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

    If the recorded peak memory can be reset, the process is reused for the next experiment of this
    thread, which saves the time to start a new one.
    """
    while True:
        process = getattr(_thread_state, "process", None)
        if process is None or process.threads != experiment.threads or not process.is_alive:
            close_process()
            process = _thread_state.process = _Process(experiment.threads)
        try:
            result = process.run(experiment)
        except BaseException:
            close_process()
            raise
        if result is not None:
            return result


def close_process() -> None:
    r"""Ends the worker process of this thread, if there is one."""
    process = getattr(_thread_state, "process", None)
    if process is not None:
        _thread_state.process = None
        process.close()


class _Process:
    def __init__(self, threads: int) -> None:
        self.threads = threads
        self._stderr = tempfile.TemporaryFile()  # noqa: SIM115 - closed with the process
        environment = {
            **MALLOC_VARIABLES,
            **os.environ,
            **dict.fromkeys(_THREAD_VARIABLES, str(threads)),
        }
        self._popen = subprocess.Popen(
            [sys.executable, "-P", "-c", _START, *filter(None, sys.path)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._stderr,
            env=environment,
        )

    @property
    def is_alive(self) -> bool:
        return self._popen.poll() is None

    def run(self, experiment: Experiment) -> dict[str, Any] | None:
        # Returns None if the process had been idle and ended before it read the experiment.
        assert self._popen.stdin is not None
        assert self._popen.stdout is not None
        with suppress(BrokenPipeError):  # the process has ended
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
            return {"error": "its process was killed, possibly for lack of memory"}
        self._stderr.seek(0)
        lines = self._stderr.read().decode("utf-8", "replace").strip().splitlines()
        return {"error": lines[-1] if lines else f"its process ended with status {status}"}

    def close(self) -> None:
        self._popen.kill()
        self._popen.wait()
        for file in (self._popen.stdin, self._popen.stdout, self._stderr):
            if file is not None:
                with suppress(BrokenPipeError):  # killed before it read all its input
                    file.close()


def run_worker() -> None:
    r"""Runs the experiments that :func:`run_in_process` sends, until the input ends."""
    lines: queue.Queue[bytes] = queue.Queue()
    threading.Thread(target=_forward_lines, args=(lines.put,), daemon=True).start()
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # output of libraries must not mix with the answers
    while True:
        try:
            line = lines.get(timeout=_IDLE_SECONDS)
        except queue.Empty:
            return
        result = run_here(pickle.loads(base64.b64decode(line)))
        answers.write(json.dumps(result) + "\n")
        answers.flush()
        if "error" in result or not PeakMemory.reset_peak():
            return


def _forward_lines(put: Callable[[bytes], None]) -> None:
    # Reads the file descriptor instead of sys.stdin: this thread would hold the lock of sys.stdin
    # and block the process when it ends.
    with open(0, "rb", buffering=0, closefd=False) as file:
        for line in iter(file.readline, b""):
            put(line)
    os._exit(1)
