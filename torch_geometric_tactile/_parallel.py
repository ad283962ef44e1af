r"""Parallel jobs with joblib, in processes on this machine or on the caller's joblib backend.

joblib is imported when the first job runs, because the import is slow.
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
from torch_geometric_tactile._interrupts import ignore_interrupts

# By default, glibc returns the memory of every activation to the system and requests it again in
# the next step. Processes started with these variables keep this memory, which makes small networks
# faster.
MALLOC_VARIABLES = dict.fromkeys(("MALLOC_MMAP_THRESHOLD_", "MALLOC_TRIM_THRESHOLD_"), str(2**29))

# Processes that are started as a module would import files in the working directory instead of
# installed modules.
_SAFE_PATH = {"PYTHONSAFEPATH": "1"}

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


@contextmanager
def keep_freed_memory() -> Iterator[None]:
    r"""Makes processes that are started within the block keep the memory that they free."""
    with _default_environment(MALLOC_VARIABLES):
        yield


@contextmanager
def _default_environment(variables: Mapping[str, str]) -> Iterator[None]:
    # Variables that the user has set stay unchanged.
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

    A surrounding :func:`joblib.parallel_config` selects the backend. By default, processes on this
    machine are used, with one thread each unless the function sets another number. With one job,
    this process works on the items in sequence. Workers ignore Ctrl-C, which reaches all processes
    of a terminal: closing the generator stops them.

    Args:
        function (callable): Called with each item; other processes must be able to import it.
        items (iterable): The arguments, one for each call.
        jobs (int, optional): Number of parallel calls. Defaults to the number in
            :func:`joblib.parallel_config`, or to one.

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
    else:  # results arrive in groups, so that an interrupt loses only one group
        calls = (delayed(function)(item) for item in items)
        while group := list(islice(calls, num_jobs)):
            yield from Parallel(num_jobs)(group)
        return
    with ignore_interrupts(), _default_environment(_SAFE_PATH):
        results = parallel(delayed(function)(item) for item in items)
    try:
        yield from results
    finally:
        with warnings.catch_warnings():  # joblib warns about unused results
            warnings.simplefilter("ignore")
            results.close()


def _run_in_worker(
    parent: int, folder: str, function: Callable[[_Item], _Result], item: _Item
) -> _Result:
    # joblib reuses workers, which would stay in the working directory of an earlier run.
    _exit_with_parent(parent)
    os.chdir(folder)
    return function(item)


def _exit_with_parent(parent: int) -> None:
    # Otherwise a worker whose parent was killed would finish its work, or wait for minutes.
    if os.getppid() != parent:
        os._exit(1)
    _watch_parent(parent)


@cache
def _watch_parent(parent: int) -> None:
    def wait() -> None:
        while os.getppid() == parent:
            time.sleep(1.0)
        os._exit(1)

    Thread(target=wait, daemon=True).start()
