"""Recordings of a real pseudo terminal that sends lines of numbers."""

# ruff: noqa: E402
import sys
import threading

import pytest

for module in ("mcap", "google.protobuf", "zstandard"):
    pytest.importorskip(module, reason="needs the extra 'live'")
if sys.platform == "win32":
    pytest.skip("needs pseudo terminals", allow_module_level=True)

from ptys import FakePort

from torch_geometric_tactile.cli import main
from torch_geometric_tactile.io import read_recording


@pytest.mark.slow
@pytest.mark.parametrize("options", ["", "?protocol=lines&num_taxels=3", "?time=ms"])
def test_board_that_prints_lines_is_recorded(tmp_path, capsys, options):
    port = FakePort(tmp_path / "ttyFAKE")
    over = threading.Event()

    def send():
        port.write(b"Ready\r\n")
        number = 0
        while not over.wait(0.01):
            time = f"{10 * number}," if "time" in options else ""
            port.write(f"{time}{number},512,1023\r\n".encode())
            number += 1

    sender = threading.Thread(target=send)
    sender.start()
    file = str(tmp_path / "a.mcap")
    status = main(["record", f"serial:{port.path}{options}", file, "--seconds", "1"])
    over.set()
    sender.join()
    port.close()
    assert status == 0, capsys.readouterr().err
    recording = read_recording(file)
    assert recording.tactile.shape[1:] == (3, 1)
    assert set(recording.tactile[:, 1:, 0].ravel()) == {512, 1023}
    assert recording.meta["unit"] == "count"
    assert 60 < recording.rate < 140
