import threading
import time
from collections import deque

import numpy as np

from torch_geometric_tactile.data import LiveFrame
from torch_geometric_tactile.live import Source, SourceEnded


def frame(number=0, received=None, device_time=None, tactile=None, num_taxels=2):
    received = time.perf_counter_ns() if received is None else received
    if tactile is None:
        tactile = np.full((num_taxels, 3), number, dtype=np.float32)
    return LiveFrame(number, received * 1e-9, received, device_time, tactile)


class FakeSource(Source):
    """Gives what the test sends: frames, or errors that `read` raises."""

    def __init__(self, *script, **meta):
        super().__init__("fake:", meta)
        self._script = deque(script)
        self._sent = threading.Condition()
        self.opened = self.closed = 0
        self.open_errors = deque()
        self.there = False
        self.asked = 0

    def send(self, *script):
        with self._sent:
            self._script.extend(script)
            self._sent.notify_all()

    def open(self):
        if self.open_errors:
            raise self.open_errors.popleft()
        self.opened += 1

    def read(self, timeout):
        with self._sent:
            self._sent.wait_for(lambda: self._script, timeout)
            if not self._script:
                return []
            entry = self._script.popleft()
        if isinstance(entry, BaseException):
            raise entry
        return entry if isinstance(entry, list) else [entry]

    def is_there(self):
        self.asked += 1
        return self.there

    def close(self):
        self.closed += 1


def ended(*script, **meta):
    return FakeSource(*script, SourceEnded("no more"), **meta)


def frames(count, first=0):
    return [frame(number) for number in range(first, first + count)]


def wait_until(condition, seconds=20.0):
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "it did not come in time"
        time.sleep(0.005)
