"""Recordings of generated readings that tests share."""

import numpy as np

from torch_geometric_tactile.data import Recording


def counting_recording(
    num_frames=40,
    num_taxels=4,
    num_channels=1,
    *,
    rate=100.0,
    start=0.0,
    offset=0.0,
    joints=0,
    phase=None,
    meta=None,
    **fields,
):
    """The readings of a frame are its number, plus an offset."""
    reading = offset + np.arange(num_frames, dtype=np.float32)[:, None, None]
    return Recording(
        time=start + np.arange(num_frames) / rate,
        tactile=np.broadcast_to(reading, (num_frames, num_taxels, num_channels)),
        joint=np.full((num_frames, joints), 0.5) if joints else None,
        meta=meta or {},
        privileged={} if phase is None else {"phase": np.asarray(phase)},
        **fields,
    )


def noisy_recording(
    num_frames=40, num_taxels=6, num_channels=3, *, rate=100.0, start=0.0, offset=0.0, **fields
):
    """The readings are normally distributed around an offset, always the same."""
    draw = np.random.default_rng(0)
    tactile = draw.normal(size=(num_frames, num_taxels, num_channels)).astype(np.float32)
    return Recording(start + np.arange(num_frames) / rate, tactile + np.float32(offset), **fields)
