"""Grasps of the BiGS data set as somebody may keep them, and what they say."""

import numpy as np

from torch_geometric_tactile.data import Recording

FRAMES = 60


def readings(num_frames=FRAMES, seed=0):
    """Arrays of one grasp by our names, in our order."""
    draw = np.random.default_rng(seed)
    angle = draw.uniform(-1, 1, num_frames)
    zero = np.zeros(num_frames)
    return {
        "electrodes": draw.integers(0, 4096, (num_frames, 19, 3)).astype(np.int16),
        "time": 5.0 + np.arange(num_frames) / 100,
        "pressure": draw.uniform(1500, 2500, (num_frames, 3)).astype(np.float32),
        "pac": draw.integers(0, 4096, (num_frames, 3, 22)).astype(np.int16),
        "robot_joint": draw.uniform(-3, 3, (num_frames, 3, 7)).astype(np.float32),
        "finger_joint": draw.uniform(0, 1, (num_frames, 3, 4)).astype(np.float32),
        "wrench": draw.normal(0, 2, (num_frames, 6)).astype(np.float32),
        "object_pose": np.stack(
            [zero, zero + 0.1, angle, np.cos(angle), np.sin(angle), zero, zero], axis=1
        ).astype(np.float32),
        "phase": np.array(["closing", "lift", "shake"])[np.arange(num_frames) * 3 // num_frames],
        "slip": (np.arange(num_frames) > num_frames // 2).astype(np.uint8),
    }


def values(**more):
    return {
        "success": 1,
        "object": "cylinder é",
        "trial": 7,
        "session": "may",
        "pickup_time": 5.2,
        **more,
    }


def grasp(num_frames=FRAMES, seed=0, label="success", without=(), **meta):
    """A recording in the neutral form, as a file in it has one."""
    arrays = readings(num_frames, seed)
    names = ("pressure", "pac", "robot_joint", "finger_joint", "wrench")
    phases, phase = np.unique(arrays["phase"], return_inverse=True)
    privileged = {
        "phase": phase,
        "slip": arrays["slip"],
        "object_pose": arrays["object_pose"],
    }
    meta = {
        "unit": "count",
        "object": "cylinder",
        "pickup_time": 5.2,
        "phase_names": phases.tolist(),
        **meta,
    }
    return Recording(
        time=arrays["time"],
        tactile=arrays["electrodes"],
        label=label,
        meta={key: value for key, value in meta.items() if value is not None},
        privileged={k: v for k, v in privileged.items() if k not in without},
        extra={name: arrays[name] for name in names if name not in without},
    )


def write_npz(path, content):
    np.savez(path, **{key: np.asarray(value) for key, value in content.items()})
    return path


def write_h5(path, content):
    """Arrays by their paths; those with an "@" are attributes."""
    import h5py

    with h5py.File(path, "w") as file:
        for name, value in content.items():
            place, is_attribute, attribute = name.partition("@")
            array = np.asarray(value)
            if is_attribute:
                owner = file[place] if place in file else file.require_group(place or "/")
                owner.attrs[attribute] = value
            elif array.dtype.kind == "U":
                file.create_dataset(name, data=array.astype(object), dtype=h5py.string_dtype())
            else:
                file.create_dataset(name, data=array, compression="gzip" if array.ndim else None)
    return path
