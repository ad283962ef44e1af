import os
import sys

import pytest

pytest.importorskip("lightning", reason="needs the extra 'train'")

from torch_geometric_tactile._parallel import KEPT_MEMORY, check_backend, kept_memory, run_parallel
from torch_geometric_tactile.experiments.plan import Settings, make_plan
from torch_geometric_tactile.experiments.run_plan import Workers, run_plan
from torch_geometric_tactile.papers import load_table


def process_and_square(number):
    return os.getpid(), number**2


@pytest.mark.parametrize("backend", ["loky", "dask"])
def test_work_is_done_by_other_processes(backend):
    if backend == "dask":
        pytest.importorskip("distributed", reason="needs the extra 'dask'")
    results = list(run_parallel(process_and_square, range(8), 2, backend))
    assert sorted(square for _, square in results) == [i**2 for i in range(8)]
    assert os.getpid() not in {process for process, _ in results}


def folder_of_worker(number):
    return os.getcwd()


def test_workers_that_are_kept_follow_into_another_folder(tmp_path, monkeypatch):
    for name in ("first", "second"):
        (tmp_path / name).mkdir()
        monkeypatch.chdir(tmp_path / name)
        assert set(run_parallel(folder_of_worker, range(4), 2)) == {str(tmp_path / name)}


def test_running_dask_cluster_is_used(monkeypatch):
    distributed = pytest.importorskip("distributed", reason="needs the extra 'dask'")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None
    ) as cluster:
        workers = {worker.pid for worker in cluster.workers.values()}
        address = cluster.scheduler_address
        results = list(run_parallel(process_and_square, range(8), 1, "dask", address))
        assert {process for process, _ in results} <= workers
        assert len(results) == 8


def test_scheduler_that_does_not_answer(monkeypatch):
    distributed = pytest.importorskip("distributed", reason="needs the extra 'dask'")
    import dask

    with (
        dask.config.set({"distributed.comm.timeouts.connect": "0.3s"}),
        pytest.raises(OSError, match=r"127\.0\.0\.1"),
    ):
        list(run_parallel(process_and_square, range(2), 1, "dask", "tcp://127.0.0.1:9"))
    assert not distributed.client._global_clients


def test_table_is_trained_by_dask(grasps, tmp_path):
    pytest.importorskip("distributed", reason="needs the extra 'dask'")
    settings = Settings(seeds=1, epochs=1)
    plan = make_plan(
        load_table("p2-table2"), settings, data={"root": str(grasps)}, selection={"stride": 4}
    )
    run = run_plan(plan, tmp_path, Workers(2, "dask"), only=["ii_tac"])
    assert not run.failed
    assert len(run.results) == len(list((tmp_path / "runs").glob("ii_tac_*.json"))) == 2
    assert run_plan(plan, tmp_path, only=["ii_tac"]).kept == 2


@pytest.mark.parametrize(
    ("backend", "module"), [("dask", "distributed"), ("ray", "ray.util.joblib")]
)
def test_missing_package_names_the_extra(backend, module, monkeypatch):
    monkeypatch.setitem(sys.modules, module, None)
    message = rf'the backend {backend} needs .*pip install "torch-geometric-tactile\[{backend}\]"'
    with pytest.raises(ImportError, match=message):
        check_backend(backend)


def test_closing_stops_the_work():
    results = run_parallel(process_and_square, range(50), 2)
    next(results)
    results.close()
    assert list(results) == []


def test_workers_compute_with_one_thread(monkeypatch):
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    assert set(run_parallel(os.getenv, ["OMP_NUM_THREADS"] * 4, 2)) == {"1"}


def test_one_job_is_done_here():
    assert {process for process, _ in run_parallel(process_and_square, range(3))} == {os.getpid()}


def test_fewer_jobs_than_one():
    with pytest.raises(ValueError, match=r"'jobs' must be at least 1 \(got 0\)"):
        list(run_parallel(process_and_square, range(3), 0))


def test_memory_is_kept_by_processes_started_inside_only(monkeypatch):
    first, second = KEPT_MEMORY
    monkeypatch.setenv(first, "7")
    monkeypatch.delenv(second, raising=False)
    with kept_memory():
        assert (os.environ[first], os.environ[second]) == ("7", KEPT_MEMORY[second])
    assert os.environ[first] == "7"
    assert second not in os.environ
