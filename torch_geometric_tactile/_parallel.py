r"""Many jobs on many processes, of this machine or of a cluster.

joblib is imported when something runs: it comes with scikit-learn, and takes a while.
"""

import logging
import os
import time
import warnings
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from functools import cache
from threading import Thread
from typing import Any, Literal, TypeVar

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._interrupts import interrupts_ignored

Backend = Literal["loky", "dask", "ray"]
BACKENDS: tuple[Backend, ...] = ("loky", "dask", "ray")

# By default glibc gives every activation back to the system and asks for it again in the next
# step. Processes started with these variables keep theirs, which makes small networks faster.
KEPT_MEMORY = dict.fromkeys(("MALLOC_MMAP_THRESHOLD_", "MALLOC_TRIM_THRESHOLD_"), str(2**29))

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


@contextmanager
def kept_memory() -> Iterator[None]:
    r"""Lets processes that are started inside keep the memory that they free."""
    added = [name for name in KEPT_MEMORY if name not in os.environ]
    os.environ.update({name: KEPT_MEMORY[name] for name in added})
    try:
        yield
    finally:
        for name in added:
            del os.environ[name]


def end_with(parent: int | None) -> None:
    r"""Ends this process with the one that its work is for, or else it would go on with what was
    dispatched, or wait for minutes. Does nothing in that process itself, and without one.
    """
    if parent in (None, os.getpid()):
        return
    if os.getppid() != parent:
        os._exit(1)
    _watch(parent)


@cache
def _watch(parent: int | None) -> None:
    def wait() -> None:
        while os.getppid() == parent:
            time.sleep(1.0)
        os._exit(1)

    Thread(target=wait, daemon=True).start()


def check_backend(backend: str, scheduler: str | None = None) -> None:
    r"""Checks before anything runs that the jobs can be run."""
    need(backend in BACKENDS, f"'backend' must be one of {list(BACKENDS)} (got '{backend}')")
    if scheduler is not None and backend == "loky":
        raise ValueError(
            f"'scheduler' must come with the backend dask or ray (got '{scheduler}' with loky)"
        )
    try:
        if backend == "dask":
            import distributed  # noqa: F401
        elif backend == "ray":
            import ray.util.joblib  # noqa: F401
    except ImportError as error:
        raise ImportError(
            f"the backend {backend} needs '{error.name}': "
            f'pip install "torch-geometric-tactile[{backend}]"'
        ) from error


def run_parallel(
    function: Callable[[_Item], _Result],
    items: Iterable[_Item],
    jobs: int = 1,
    backend: Backend = "loky",
    scheduler: str | None = None,
) -> Generator[_Result, None, None]:
    r"""Yields the result of each item as soon as it is ready, in any order.

    With one job of this machine the items are worked on here, one after the other. Workers ignore
    Ctrl-C, which reaches all processes of a terminal: they are stopped from here, when the
    generator is closed. Those of this machine compute with one thread each, unless the function
    sets another number.
    """
    need(jobs >= 1, "'jobs' must be at least 1", jobs)
    check_backend(backend, scheduler)
    from joblib import Parallel, delayed, parallel_config

    with ExitStack() as stack:
        with interrupts_ignored():
            if backend == "dask":
                stack.enter_context(_dask_cluster(jobs, scheduler))
            elif backend == "ray":
                stack.enter_context(_ray_cluster(jobs, scheduler))
            threads = {"inner_max_num_threads": 1} if backend == "loky" else {}
            stack.enter_context(parallel_config(backend=backend, **threads))
            parallel = Parallel(
                n_jobs=jobs if scheduler is None else -1,
                return_as="generator_unordered",
                batch_size=1,
                pre_dispatch="2*n_jobs" if backend == "loky" else "all",
            )
            if backend == "loky" and jobs > 1:
                # Workers outlive a run, and stay in the folder in which they were started.
                folder = os.getcwd()
                results = parallel(delayed(_in_folder)(folder, function, i) for i in items)
            else:
                results = parallel(delayed(function)(item) for item in items)
        try:
            yield from results
        finally:
            with warnings.catch_warnings():  # joblib warns of results that nobody waits for
                warnings.simplefilter("ignore")
                results.close()


def _in_folder(folder: str, function: Callable[[_Item], _Result], item: _Item) -> _Result:
    os.chdir(folder)
    return function(item)


@contextmanager
def _dask_cluster(jobs: int, scheduler: str | None) -> Iterator[Any]:
    from distributed import Client, LocalCluster

    with ExitStack() as stack:
        cluster: Any = scheduler
        if scheduler is None:
            # Not to tell at the end that workers which had torch loaded took long to end.
            quiet = {"dashboard_address": None, "silence_logs": logging.ERROR}
            cluster = stack.enter_context(
                LocalCluster(n_workers=jobs, threads_per_worker=1, **quiet)
            )
        yield stack.enter_context(Client(cluster))


@contextmanager
def _ray_cluster(jobs: int, scheduler: str | None) -> Iterator[Any]:
    import ray
    from joblib import register_parallel_backend
    from ray.util.joblib import ray_backend, register_ray

    register_ray()

    class Streaming(ray_backend.RayBackend):
        # Inherited from multiprocessing's, whose pools cannot be stopped halfway; Ray's can.
        supports_return_generator = True

    register_parallel_backend("ray", Streaming)
    started = not ray.is_initialized()
    if started and scheduler is None:
        ray.init(num_cpus=jobs, include_dashboard=False, log_to_driver=False)
    elif started:
        ray.init(address=scheduler, log_to_driver=False)
    try:
        yield ray
    finally:
        if started:
            ray.shutdown()
