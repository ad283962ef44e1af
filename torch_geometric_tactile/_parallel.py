r"""Parallel jobs by joblib, on the processes of this machine or on the caller's joblib backend.

joblib is imported when something runs: it comes with scikit-learn, and takes a while.
"""

import os
import time
import warnings
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import cache, partial
from itertools import islice
from threading import Thread
from typing import TypeVar

from torch_geometric_tactile._checks import need_argument
from torch_geometric_tactile._interrupts import interrupts_ignored

# By default glibc gives every activation back to the system and asks for it again in the next
# step. Processes started with these variables keep theirs, which makes small networks faster.
KEPT_MEMORY = dict.fromkeys(("MALLOC_MMAP_THRESHOLD_", "MALLOC_TRIM_THRESHOLD_"), str(2**29))

# Processes that are started as a module would import files of the working directory in place of
# installed modules.
_SAFE_PATH = {"PYTHONSAFEPATH": "1"}

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


@contextmanager
def kept_memory() -> Iterator[None]:
    r"""Lets processes that are started inside keep the memory that they free."""
    with _environment(KEPT_MEMORY):
        yield


@contextmanager
def _environment(variables: Mapping[str, str]) -> Iterator[None]:
    # Variables that are set already stay as they are.
    added = [name for name in variables if name not in os.environ]
    os.environ.update({name: variables[name] for name in added})
    try:
        yield
    finally:
        for name in added:
            os.environ.pop(name, None)


def run_parallel(
    function: Callable[[_Item], _Result], items: Iterable[_Item], jobs: int | None = None
) -> Generator[_Result, None, None]:
    r"""Yields the result of each item as soon as it is ready, in any order.

    The backend of a surrounding :func:`joblib.parallel_config` is used; without one, processes of
    this machine, which compute with one thread each unless the function sets another number. With
    one job the items are processed here, one after the other. Workers ignore Ctrl-C, which reaches
    all processes of a terminal: they are stopped from here, when the generator is closed.

    Args:
        function (callable): The work, which must be importable by other processes.
        items (iterable): The arguments, one for each call.
        jobs (int, optional): Number of calls at a time; that of :func:`joblib.parallel_config`, or
            else one, if left out.

    Raises:
        ValueError: If :obj:`jobs` is below one.
    """
    need_argument(jobs is None or jobs >= 1, "jobs", "must be at least 1", jobs)
    from joblib import Parallel, delayed, effective_n_jobs, parallel_config
    from joblib.parallel import BACKENDS, get_active_backend

    backend, _ = get_active_backend()
    num_jobs = effective_n_jobs(jobs)
    if isinstance(backend, BACKENDS["loky"]):
        threads = backend.inner_max_num_threads or 1
        if num_jobs > 1:
            function = partial(_run_in_worker, os.getpid(), os.getcwd(), function)
        with parallel_config("loky", inner_max_num_threads=threads):
            parallel = Parallel(num_jobs, return_as="generator_unordered", batch_size=1)
    elif backend.supports_return_generator:
        parallel = Parallel(
            num_jobs, return_as="generator_unordered", batch_size=1, pre_dispatch="all"
        )
    else:  # results come in groups, so that those of finished groups are stored
        calls = (delayed(function)(item) for item in items)
        while group := list(islice(calls, num_jobs)):
            yield from Parallel(num_jobs)(group)
        return
    with interrupts_ignored(), _environment(_SAFE_PATH):
        results = parallel(delayed(function)(item) for item in items)
    try:
        yield from results
    finally:
        with warnings.catch_warnings():  # joblib warns of results that nobody waits for
            warnings.simplefilter("ignore")
            results.close()


def _run_in_worker(
    parent: int, folder: str, function: Callable[[_Item], _Result], item: _Item
) -> _Result:
    # A worker outlives a run, and would stay in the folder in which it was started.
    _end_with(parent)
    os.chdir(folder)
    return function(item)


def _end_with(parent: int) -> None:
    # A worker whose parent was killed would finish the dispatched work, or wait for minutes.
    if os.getppid() != parent:
        os._exit(1)
    _watch(parent)


@cache
def _watch(parent: int) -> None:
    def wait() -> None:
        while os.getppid() == parent:
            time.sleep(1.0)
        os._exit(1)

    Thread(target=wait, daemon=True).start()
