import os
import subprocess
import sys
from pathlib import Path

import pytest
from robustness import full_disk

SCRIPT = Path(full_disk.__file__)
pytestmark = [
    pytest.mark.slow,
    pytest.mark.full,
    pytest.mark.skipif(not hasattr(os, "fork"), reason="needs processes that are forked"),
]


def test_full_disk_ends_in_a_clear_error_and_keeps_what_was_there(tmp_path):
    pytest.importorskip("h5py", reason="needs the extra 'io'")
    try:
        with full_disk.small_disk(tmp_path):
            pass
    except PermissionError as error:
        pytest.skip(f"{error}: only root may")
    # In a process of its own: a fork of one in which PyTorch has used threads may wait for ever.
    for module in ("mcap", "google.protobuf"):
        pytest.importorskip(module, reason="needs the extra 'live'")
    chosen = ("MCAP", "write_hdf5", "processed file")
    done = subprocess.run(
        [sys.executable, str(SCRIPT), "--sizes", "3", "--only", *chosen],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    lines = done.stdout.splitlines()
    assert [line[:16].strip() for line in lines[:-1]] == list(chosen), done.stdout + done.stderr
    for line in lines[:-1]:
        assert "'OSError': 2" in line, done.stdout
        assert "'written': 1" in line, done.stdout
        assert line.endswith("} 0 wrong"), done.stdout
    assert lines[-1] == "0 wrong"
