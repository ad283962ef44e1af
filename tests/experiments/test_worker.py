import pytest

pytest.importorskip("lightning", reason="needs the extra 'train'")

from torch_geometric_tactile.experiments import _worker as worker
from torch_geometric_tactile.experiments._worker import close_process, run_in_process, run_safely

pytestmark = pytest.mark.full


def test_process_measures_is_used_again_and_says_what_failed(of_grasps):
    experiment = of_grasps(measure_memory=True)
    first = run_safely(experiment)
    assert first["num_test"] == 24
    assert first["peak_memory_mb"] > 0
    assert run_in_process(experiment)["predictions"] == first["predictions"]
    wrong = of_grasps(selection={"phases": ["fly"]}, measure_memory=True)
    error = run_safely(wrong)["error"]
    assert "'phases' must be some of ['hover', 'hold']" in error
    assert run_in_process(experiment)["metrics"] == first["metrics"]
    close_process()
    close_process()


def test_nothing_is_started_where_no_memory_is_measured(of_grasps, monkeypatch):
    monkeypatch.setattr(worker, "run_in_process", None)
    assert run_safely(of_grasps())["num_test"] == 24
    error = run_safely(of_grasps(selection={"phases": ["fly"]}))["error"]
    assert error.startswith("ValueError: 'phases' must be some of ['hover', 'hold']")


def test_killed_process_is_explained(of_grasps, monkeypatch):
    start = worker._Process

    def killed(threads):
        process = start(threads)
        process._popen.kill()
        return process

    monkeypatch.setattr(worker, "_Process", killed)
    assert run_in_process(of_grasps()) == {
        "error": "its process was killed, possibly for lack of memory"
    }
    close_process()
