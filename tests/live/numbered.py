"""A source whose frames are known by their numbers."""

import time

import numpy as np

from torch_geometric_tactile.data.live_frame import LiveFrame
from torch_geometric_tactile.live.source import Source, SourceEnded

SHAPE = (24, 3)


def contents(sequence):
    """What frame number ``sequence`` holds, and no other."""
    base = np.arange(SHAPE[0] * SHAPE[1], dtype=np.float32).reshape(SHAPE)
    return base * (1 + sequence % 91) + sequence


class NumberedSource(Source):
    """Frames at a rate, ``count`` of them; ``after`` raises an error behind so many."""

    def __init__(self, rate=500.0, count=None, after=None, error=None, change=lambda frame: frame):
        super().__init__("numbered:", {"unit": "count"})
        self.rate, self.count, self.after, self.error = rate, count, after, error
        self.change = change
        self.number = 0
        self.start = None

    def open(self):
        self.start = time.monotonic() if self.start is None else self.start

    def read(self, timeout):
        if self.number == self.count:
            raise SourceEnded("all frames were read")
        if self.number == self.after:
            raise self.error
        due = self.start + self.number / self.rate
        wait = due - time.monotonic()
        if wait > 0:
            time.sleep(min(wait, timeout))
            if wait > timeout:
                return []
        now = time.perf_counter_ns()
        frame = LiveFrame(self.number, now / 1e9, now, None, contents(self.number))
        self.number += 1
        return [self.change(frame)]

    def close(self):
        pass
