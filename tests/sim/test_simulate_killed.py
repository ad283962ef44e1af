import os
import signal

import pytest

pytest.importorskip("mujoco", reason="needs the extra 'sim'")
pytest.importorskip("h5py", reason="needs the extra 'sim'")

from torch_geometric_tactile.sim import paper8, simulate

pytestmark = pytest.mark.full


def test_killed_run_leaves_whole_files_and_goes_on(
    start_run, wait_until_gone, undisturbed, tmp_path, same_arrays
):
    out, _ = undisturbed
    process = start_run()
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
