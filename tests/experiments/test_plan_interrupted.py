import json
import os
import signal
import subprocess
import sys
import time

import pytest

pytest.importorskip("lightning", reason="needs the extra 'train'")
pytest.importorskip("matplotlib", reason="needs the extra 'viz'")

from torch_geometric_tactile.experiments.plan import Settings, make_plan
from torch_geometric_tactile.experiments.run_plan import run_plan
from torch_geometric_tactile.papers import load_table

pytestmark = [
    pytest.mark.slow,
    pytest.mark.full,
    pytest.mark.skipif(os.name != "posix", reason="sends signals to a group of processes"),
]
ONLY = ["x_tac", "i_tac", "ii_tac", "ii_tac_joint"]


def running(group):
    """The processes of a group that have not ended."""
    listed = subprocess.run(
        ["ps", "-eo", "pgid=,stat=,args="], capture_output=True, text=True, check=True
    ).stdout
    rows = [line.split(None, 2) for line in listed.splitlines()]
    return [row for row in rows if int(row[0]) == group and not row[1].startswith("Z")]


def wait_until(condition, seconds, process=None):
    deadline = time.monotonic() + seconds
    while not condition():
        assert process is None or process.poll() is None, process.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.02)


def heed_ctrl_c():
    """In a job that a shell put into the background, Ctrl-C would be ignored."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


@pytest.fixture
def start(grasps, tmp_path):
    """Starts the command on two processes, in a group of its own as a terminal does, and waits for
    two finished runs of eight."""
    started = []

    def run():
        command = [sys.executable, "-m", "torch_geometric_tactile", "table", "p2-table2"]
        command += ["--root", str(grasps), "--out", str(tmp_path), "--seeds", "1", "--epochs", "3"]
        command += ["--jobs", "2", "--only", *ONLY]
        process = subprocess.Popen(
            command,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
            preexec_fn=heed_ctrl_c,
        )
        started.append(process)
        folder = tmp_path / "runs"
        wait_until(lambda: len(list(folder.glob("*.json"))) >= 2, 240, process)
        return process

    yield run
    for process in started:
        if running(process.pid):
            os.killpg(process.pid, signal.SIGKILL)


def test_killed_run_keeps_finished_experiments_and_no_half_one(start, grasps, tmp_path):
    process = start()
    os.kill(process.pid, signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL
    process.stdout.close()
    process.stderr.close()
    wait_until(lambda: not running(process.pid), 60)  # workers and their trainings end as well
    paths = list((tmp_path / "runs").glob("*.json"))
    finished = {path: path.stat().st_mtime_ns for path in paths}
    assert 2 <= len(finished) < 8
    for path in finished:
        assert json.loads(path.read_text())["result"]["metrics"]["accuracy"] >= 0

    settings = Settings(seeds=1, epochs=3)
    plan = make_plan(load_table("p2-table2"), settings, data={"root": str(grasps)})
    run = run_plan(plan, tmp_path, only=ONLY)
    assert (run.kept, len(run.results), run.failed) == (len(finished), 8, {})
    assert {path: path.stat().st_mtime_ns for path in finished} == finished
    assert not list((tmp_path / "runs").glob(".*"))


def test_ctrl_c_ends_with_130_and_says_what_to_do(start, tmp_path):
    process = start()
    os.killpg(process.pid, signal.SIGINT)  # to the workers too, as from a terminal
    stdout, stderr = process.communicate(timeout=120)
    assert process.returncode == 130
    kept = list((tmp_path / "runs").iterdir())
    assert 2 <= len(kept) < 8
    assert all(json.loads(path.read_text())["result"] for path in kept)
    assert stderr == (
        f"tactile: stopped; {len(kept)} of 36 runs are finished and kept: run the same "
        "command again to continue; --no-train writes the table of finished runs\n"
    )
    assert stdout == ""
    wait_until(lambda: not running(process.pid), 60)
