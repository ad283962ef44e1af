"""Records a numbered source until it is killed: python record_in_child.py FILE RATE

It writes the number and time of each frame to its output after the recorder has taken it.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from live.numbered import NumberedSource

from torch_geometric_tactile.io import McapWriter
from torch_geometric_tactile.live import Recorder, Stream


def main():
    path, rate = sys.argv[1], float(sys.argv[2])
    write = McapWriter.write_frame

    def told(self, frame):
        write(self, frame)
        sys.stdout.write(f"{frame.sequence} {frame.received}\n")
        sys.stdout.flush()

    McapWriter.write_frame = told
    stream = Stream(NumberedSource(rate))
    with Recorder(path, stream, label="mug"), stream:
        for _ in stream.subscribe("newest"):
            pass


if __name__ == "__main__":
    main()
