"""Small grasps of three fingers, as files of BiGS, for training."""

import numpy as np

from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io import write_hdf5

OBJECTS = ("cylinder", "box", "ball")


def write_grasps(root, count=24):
    """Fills ``root/raw``: grasps of three objects in four sessions, firmer where they succeed."""
    (root / "raw").mkdir(parents=True)
    for i in range(count):
        rng = np.random.default_rng(i)
        # As in the generator, all objects are in all sessions, successes and failures.
        name, session, success = OBJECTS[i % 3], i // 3 % 4, i // 2 % 2 == 1
        length = 40 + i % 7
        tactile = 2000 + rng.normal(0, 1, (length, 19, 3))
        tactile[12:] += (150 if success else 60) * np.linspace(0.5, 1, length - 12)[:, None, None]
        recording = Recording(
            time=np.arange(length) / 100,
            tactile=tactile.astype(np.float32),
            label="success" if success else "failure",
            meta={
                "unit": "count",
                "object": name,
                "trial": i,
                "session": session,
                "pickup_time": 0.2,
                "synthetic": True,
            },
        )
        write_hdf5(recording, root / "raw" / f"{name}_{i:04d}.h5")
    return root
