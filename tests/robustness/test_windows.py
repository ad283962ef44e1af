"""What Windows lacks is imitated; nobody has run the package there."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.full

SCRIPT = Path(__file__).with_name("imitated_windows.py")
TESTS, ROOT = SCRIPT.parents[1], SCRIPT.parents[2]


@pytest.mark.slow
def test_every_writer_runs_where_windows_is_imitated(tmp_path):
    if not Path("/proc/self/fdinfo").is_dir():
        pytest.skip("the imitation asks Linux how a file is open")
    for extra in ("h5py", "lightning", "mcap", "pyarrow", "filelock"):
        pytest.importorskip(extra, reason="needs all extras")
    path = os.pathsep.join([str(ROOT), str(TESTS)])
    environment = {**os.environ, "PYTHONPATH": path, "OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, str(SCRIPT)],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
    )
    assert "16 writers, failed: []" in done.stdout, done.stderr[-3000:]
    assert done.returncode == 0
