"""Recordings of the Allegro hand, as files."""

import numpy as np

from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.datasets import AllegroUSkin
from torch_geometric_tactile.io import write_recording


def recording(frames=2, taxels=384, channels=3, joints=16, value=0.0, phase=None, **meta):
    return Recording(
        time=np.arange(frames) / 100,
        tactile=np.full((frames, taxels, channels), value),
        joint=np.full((frames, joints), 0.5) if joints else None,
        meta=meta,
        privileged={} if phase is None else {"phase": phase},
    )


def write(path, **kwargs):
    path.parent.mkdir(parents=True, exist_ok=True)
    write_recording(recording(**kwargs), path)


def everything(root, **kwargs):
    return AllegroUSkin(root, split=None, **kwargs)
