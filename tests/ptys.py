"""A serial port made of a pair of pseudo terminals, that can go and come back."""

import os
import tty
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
