import os
import signal

import pytest

pytestmark = pytest.mark.full

pytest.importorskip("mujoco", reason="needs the extra 'sim'")
pytest.importorskip("h5py", reason="needs the extra 'sim'")


def test_ctrl_c_keeps_finished_trials_and_nothing_else(start_run, wait_until_gone, tmp_path):
    process = start_run()
    os.killpg(process.pid, signal.SIGINT)  # to the workers too, as from a terminal
    stdout, stderr = process.communicate(timeout=60)
    assert process.returncode == 130
    kept = sorted(path.name for path in tmp_path.iterdir())
    assert 2 <= len(kept) < 8
    assert all(name.endswith("_000.h5") for name in kept)
    assert stderr == f"tactile: stopped; {len(kept)} finished trials are kept\n"
    assert stdout == ""
    wait_until_gone(process.pid, 10)
