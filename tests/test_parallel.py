import os
import threading

import joblib
import pytest

pytest.importorskip("lightning", reason="needs the extra 'train'")

from torch_geometric_tactile._parallel import MALLOC_VARIABLES, keep_freed_memory, run_parallel
from torch_geometric_tactile.experiments.plan import Settings, make_plan
from torch_geometric_tactile.experiments.run_plan import run_plan
from torch_geometric_tactile.papers import load_table

pytestmark = pytest.mark.slow


def process_and_square(number):
    return os.getpid(), number**2


def thread_and_process(number):
    return threading.get_ident(), os.getpid()


def folder_of_worker(number):
    return os.getcwd()


@pytest.fixture(scope="module")
def dask_client():
    """A Dask cluster of two processes."""
    distributed = pytest.importorskip("distributed", reason="needs the extra 'dask'")
    quiet = {"dashboard_address": None, "silence_logs": "ERROR"}
    with (
        distributed.LocalCluster(n_workers=2, threads_per_worker=1, **quiet) as cluster,
        distributed.Client(cluster) as client,
    ):
        yield client


def test_work_is_done_by_other_processes():
    results = list(run_parallel(process_and_square, range(8), 2))
    assert sorted(square for _, square in results) == [i**2 for i in range(8)]
    assert os.getpid() not in {process for process, _ in results}


@pytest.mark.full
def test_workers_that_are_kept_follow_into_another_folder(tmp_path, monkeypatch):
    for name in ("first", "second"):
        (tmp_path / name).mkdir()
        monkeypatch.chdir(tmp_path / name)
        assert set(run_parallel(folder_of_worker, range(4), 2)) == {str(tmp_path / name)}


def test_backend_of_the_caller_is_obeyed():
    with joblib.parallel_config(backend="threading", n_jobs=2):
        results = list(run_parallel(thread_and_process, range(20)))
    assert {process for _, process in results} == {os.getpid()}
    assert threading.get_ident() not in {thread for thread, _ in results}


def test_number_of_jobs_of_the_caller_is_obeyed():
    with joblib.parallel_config(n_jobs=2):
        assert os.getpid() not in {process for process, _ in run_parallel(process_and_square, [1])}
        here = list(run_parallel(process_and_square, range(3), 1))
    assert {process for process, _ in here} == {os.getpid()}


@pytest.mark.full
def test_backend_that_returns_results_at_the_end_only():
    # Its results come in groups, so that those of a group that has ended can be stored.
    with joblib.parallel_config(backend="multiprocessing", n_jobs=2):
        results = run_parallel(process_and_square, range(5))
        assert [square for _, square in results] == [i**2 for i in range(5)]


@pytest.mark.full
def test_dask_cluster_is_used(dask_client):
    workers = set(dask_client.run(os.getpid).values())
    with joblib.parallel_config(backend="dask"):
        results = list(run_parallel(process_and_square, range(8)))
    assert sorted(square for _, square in results) == [i**2 for i in range(8)]
    assert {process for process, _ in results} <= workers


@pytest.mark.full
def test_table_is_trained_by_dask(dask_client, grasps, tmp_path):
    plan = make_plan(
        load_table("p2-table2"),
        Settings(seeds=1, epochs=1),
        data={"root": str(grasps)},
        selection={"stride": 4},
    )
    with joblib.parallel_config(backend="dask"):
        run = run_plan(plan, tmp_path, only=["ii_tac"])
    assert not run.failed
    assert len(run.results) == len(list((tmp_path / "runs").glob("ii_tac_*.json"))) == 2
    assert run_plan(plan, tmp_path, only=["ii_tac"]).kept == 2


@pytest.mark.full
def test_closing_stops_the_work():
    results = run_parallel(process_and_square, range(50), 2)
    next(results)
    results.close()
    assert list(results) == []


@pytest.mark.full
def test_workers_compute_with_one_thread(monkeypatch):
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    assert set(run_parallel(os.getenv, ["OMP_NUM_THREADS"] * 4, 2)) == {"1"}
    with joblib.parallel_config(backend="loky", n_jobs=2, inner_max_num_threads=3):
        assert set(run_parallel(os.getenv, ["OMP_NUM_THREADS"] * 4)) == {"3"}


def test_one_job_is_done_here():
    assert {process for process, _ in run_parallel(process_and_square, range(3))} == {os.getpid()}


def test_fewer_jobs_than_one():
    with pytest.raises(ValueError, match=r"'jobs' must be at least 1 \(got 0\)"):
        list(run_parallel(process_and_square, range(3), 0))


def test_memory_is_kept_by_processes_started_inside_only(monkeypatch):
    first, second = MALLOC_VARIABLES
    monkeypatch.setenv(first, "7")
    monkeypatch.delenv(second, raising=False)
    with keep_freed_memory():
        assert (os.environ[first], os.environ[second]) == ("7", MALLOC_VARIABLES[second])
    assert os.environ[first] == "7"
    assert second not in os.environ
