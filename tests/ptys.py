"""A serial port made of a pair of pseudo terminals, that can go and come back; and a terminal."""

import os
import pty
import subprocess
import sys
import time
import tty
from contextlib import suppress
from pathlib import Path


class FakePort:
    def __init__(self, path):
        self.path = Path(path)
        self.master = None
        self.plug()

    def plug(self):
        self.master, device = os.openpty()
        tty.setraw(device)
        self._device = device
        new = self.path.with_suffix(".new")
        new.symlink_to(os.ttyname(device))
        new.rename(self.path)

    def unplug(self):
        self.path.unlink()
        os.close(self._device)
        os.close(self.master)
        self.master = None

    def write(self, data):
        while data:
            data = data[os.write(self.master, data) :]

    def read(self, size=1024):
        return os.read(self.master, size)

    def close(self):
        if self.master is not None:
            self.unplug()


class Terminal:
    """A verb on a pseudo terminal."""

    def __init__(self, folder, *arguments):
        self._line, screen = pty.openpty()
        os.set_blocking(self._line, False)
        self.said = self.passed = ""
        command = [sys.executable, "-m", "torch_geometric_tactile", *map(str, arguments)]
        streams = {"stdin": screen, "stdout": screen, "stderr": screen}
        wide = {**os.environ, "COLUMNS": "300"}
        self.child = subprocess.Popen(command, **streams, env=wide, cwd=folder)
        os.close(screen)

    def until(self, text):
        """Waits for a text, and keeps what was said before it in `passed`."""
        deadline = time.monotonic() + 40
        while text not in self.said:
            assert time.monotonic() < deadline, (text, self.said[-500:])
            with suppress(OSError):
                self.said += os.read(self._line, 65536).decode()
            time.sleep(0.01)
        self.passed, _, self.said = self.said.partition(text)

    def press(self, key):
        os.write(self._line, key.encode())

    def end(self):
        try:
            assert self.child.wait(30) == 0
        finally:
            self.child.kill()
            os.close(self._line)
