import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytest.importorskip("mujoco", reason="needs the extra 'sim'")
pytest.importorskip("h5py", reason="needs the extra 'sim'")
pytest.importorskip("joblib", reason="needs the extra 'sim'")

from torch_geometric_tactile.sim import paper8, simulate

ROOT = Path(__file__).parents[2]
pytestmark = pytest.mark.skipif(os.name != "posix", reason="sends signals to a group of processes")


@pytest.fixture
def start(tmp_path):
    """Starts a run on two processes, in a group of its own as a terminal does, and waits for two
    finished trials."""
    started = []

    def run():
        command = [sys.executable, "-m", "torch_geometric_tactile", "simulate"]
        command += ["--out", str(tmp_path), "--preset", "ci", "--trials", "1", "--jobs", "2"]
        process = subprocess.Popen(
            command,
            cwd=ROOT,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        started.append(process)
        deadline = time.monotonic() + 120
        while len(list(tmp_path.glob("*.h5"))) < 2:
            assert process.poll() is None, process.communicate()
            assert time.monotonic() < deadline
            time.sleep(0.005)
        return process

    yield run
    for process in started:
        if running(process.pid):
            os.killpg(process.pid, signal.SIGKILL)


def running(group):
    """The processes of a group that have not ended."""
    listed = subprocess.run(
        ["ps", "-eo", "pgid=,stat=,args="], capture_output=True, text=True, check=True
    ).stdout
    rows = [line.split(None, 2) for line in listed.splitlines()]
    return [row for row in rows if int(row[0]) == group and not row[1].startswith("Z")]


def wait_until_gone(group, seconds):
    deadline = time.monotonic() + seconds
    while running(group):
        assert time.monotonic() < deadline, running(group)
        time.sleep(0.1)


def test_killed_run_leaves_whole_files_and_goes_on(start, undisturbed, tmp_path, same_arrays):
    out, _ = undisturbed
    process = start()
    os.kill(process.pid, signal.SIGKILL)  # as the kernel does when memory is short
    assert process.wait() == -signal.SIGKILL
    process.stdout.close()
    process.stderr.close()
    wait_until_gone(process.pid, 30)  # workers do not go on alone
    finished = {path: path.stat().st_mtime_ns for path in tmp_path.glob("*.h5")}
    assert 2 <= len(finished) < 8
    for path in finished:  # made by two processes, and those to compare with by one
        assert same_arrays(path, out / path.name), path.name

    reports = list(simulate(tmp_path, trials=1, preset="ci"))
    assert {report.path for report in reports if report.kept} == set(finished)
    assert {path: path.stat().st_mtime_ns for path in finished} == finished
    for item in paper8():
        name = f"{item.name}_000.h5"
        assert same_arrays(tmp_path / name, out / name), name
    assert not list(tmp_path.glob(".*"))


def test_ctrl_c_keeps_finished_trials_and_nothing_else(start, tmp_path):
    process = start()
    os.killpg(process.pid, signal.SIGINT)  # to the workers too, as from a terminal
    stdout, stderr = process.communicate(timeout=60)
    assert process.returncode == 130
    kept = sorted(path.name for path in tmp_path.iterdir())
    assert 2 <= len(kept) < 8
    assert all(name.endswith("_000.h5") for name in kept)
    assert stderr == f"tactile: stopped; {len(kept)} finished trials are kept\n"
    assert stdout == ""
    wait_until_gone(process.pid, 10)
