import os
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).with_name("kills.py")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not hasattr(os, "fork"), reason="needs processes that are forked"),
]


def test_killed_jobs_lose_nothing_and_leave_nothing_after_the_next_run():
    pytest.importorskip("h5py", reason="needs the extra 'io'")
    # In a process of its own: a fork of one in which PyTorch has used threads may wait for ever.
    jobs = ("processing", "convert", "grasps", "append")
    done = subprocess.run(
        [sys.executable, str(SCRIPT), "--kills", "12", "--frames", "60", "--only", *jobs],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.stdout.endswith("13 kills, 0 wrong\n"), done.stdout + done.stderr
    assert done.returncode == 0
