"""A small file of touches that move, whose classes only time tells apart."""

import numpy as np


def motions(path, num_trials=12, frames=40, channels=2, seed=0, **changes):
    """Writes a bump that runs over a grid of 3 x 4, to the left (class 0) or to the right (1)."""
    draw = np.random.default_rng(seed)
    y, time = np.arange(num_trials) % 2, np.arange(frames)
    place = (time / 3 + draw.uniform(0, 4, size=(num_trials, 1))) % 4  # of the bump, in columns
    place = np.where(y[:, None] == 1, place, (4 - place) % 4)
    away = np.abs(np.arange(4) - place[..., None])
    bump = 3 * np.exp(-np.square(np.minimum(away, 4 - away)))
    x = bump[:, :, None, :, None] + 0.3 * draw.normal(size=(num_trials, frames, 3, 4, channels))
    content = {
        "x": x.reshape(-1, 3, 4, channels).astype(np.float32),
        "y": y.repeat(frames),
        "trial": np.arange(num_trials).repeat(frames),
        "time": np.tile(0.01 * time, num_trials),
    }
    content |= {key: value for key, value in changes.items() if value is not None}
    for key in [key for key, value in changes.items() if value is None]:
        del content[key]
    np.savez(path, **content)
    return content
