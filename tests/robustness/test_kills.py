import os
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).with_name("kills.py")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.full,
    pytest.mark.skipif(not hasattr(os, "fork"), reason="needs processes that are forked"),
]


def kill(kills, *jobs):
    # In a process of its own: a fork of one in which PyTorch has used threads may wait for ever.
    done = subprocess.run(
        [sys.executable, str(SCRIPT), "--kills", kills, "--frames", "60", "--only", *jobs],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_killed_jobs_lose_nothing_and_leave_nothing_after_the_next_run():
    pytest.importorskip("h5py", reason="needs the extra 'io'")
    said = kill("12", "processing", "convert", "grasps", "convert-hdf5")
    assert said.endswith("13 kills, 0 wrong\n"), said


@pytest.mark.parametrize("job", ["simulate-bigs", "simulate-letters"])
def test_killed_simulation_leaves_whole_files_and_goes_on(job):
    for package in ("mujoco", "h5py"):
        pytest.importorskip(package, reason="needs the extra 'sim'")
    said = kill("3", job)
    assert said.endswith("3 kills, 0 wrong\n"), said
