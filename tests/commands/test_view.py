import re
import signal
import subprocess
import sys
import urllib.request

import numpy as np
import pytest

pytest.importorskip("websockets", reason="needs the extra 'live'")

from torch_geometric_tactile.cli import main
from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io._recording_npz import write_npz


@pytest.fixture
def recording(tmp_path):
    path = tmp_path / "cup.npz"
    write_npz(Recording(np.arange(20) / 100, np.zeros((20, 6, 1), np.float32)), path)
    return path


def test_recording_is_served_until_it_is_interrupted(recording):
    command = [sys.executable, "-m", "torch_geometric_tactile", "view", str(recording)]
    process = subprocess.Popen(
        [*command, "--no-browser"],
        stdout=subprocess.PIPE,
        text=True,
        # In a job that a shell put into the background, Ctrl-C would be ignored.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    try:
        line = process.stdout.readline()
        url = re.match(r"(http://127\.0\.0\.1:[0-9]+/)  \(Ctrl-C quits\)", line)[1]
        with urllib.request.urlopen(url, timeout=20) as page:
            assert b"<title>tactile view</title>" in page.read()
        process.send_signal(signal.SIGINT)
        assert process.wait(20) == 0
    finally:
        process.kill()
        process.stdout.close()


def test_source_that_ends(recording, capsys, monkeypatch):
    opened = []
    monkeypatch.setattr("webbrowser.open", opened.append)
    assert main(["view", f"file:{recording}?loop=0", "--layout", "2x3"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[1] == "the source has ended"
    assert lines[0].startswith(opened[0])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["no_such.h5"], "no_such.h5"),
        (["{file}", "--layout", "no_such"], "'layout' must be one of"),
        (["{file}", "--layout", "0x4"], "'rows' and 'cols' must be at least 1"),
        (["usb:1"], "a source must be one of"),
    ],
)
def test_errors_are_explained(recording, capsys, arguments, message):
    arguments = [one.format(file=recording) for one in arguments]
    assert main(["view", *arguments, "--no-browser"]) == 1
    assert message in capsys.readouterr().err


@pytest.mark.parametrize("port", ["-1", "65536", "http", "1_0"])
def test_port_must_be_one(recording, capsys, port):
    with pytest.raises(SystemExit):
        main(["view", str(recording), f"--port={port}"])
    assert "must be a port from 0 to 65535" in capsys.readouterr().err
