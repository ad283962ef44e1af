r"""Generated grasps on BioTac-like fingertips."""

from typing import NamedTuple

import numpy as np

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.sensors import TaxelLayout

_GRAVITY = 9.81
_REST = 3000.0  # counts
_GAIN = 260.0  # counts per newton at the centre of a contact
_SATURATION = 2200.0  # counts by which a reading can fall
_NOISE = 12.0  # counts


class SimulatedGrasps(NamedTuple):
    r"""Readings and labels of generated grasps.

    :obj:`reading` in counts :math:`(S, N, K)`, :obj:`slipped`, :obj:`group` (the object) and
    :obj:`session` :math:`(S,)`, and the normal force of each finger in newtons, :obj:`force`
    :math:`(S, K)`.

    Examples:
        >>> from torch_geometric_tactile.sensors import biotac_sp
        >>> grasps = simulate_grasps(biotac_sp(), objects=2, grasps_per_object=5)
        >>> grasps.reading.shape, grasps.force.shape
        ((10, 24, 3), (10, 3))
    """

    reading: np.ndarray
    slipped: np.ndarray
    group: np.ndarray
    session: np.ndarray
    force: np.ndarray


def simulate_grasps(
    layout: TaxelLayout,
    objects: int,
    grasps_per_object: int,
    sessions: int = 3,
    num_fingers: int = 3,
    seed: int = 0,
    pose_seed: int | None = None,
) -> SimulatedGrasps:
    r"""Generates static readings of grasps that hold or slip, like those of electrodes under a
    fluid-filled skin. A model for tests and demonstrations; its numbers are plausible, not
    measured.

    Each object has a mass, a friction coefficient and a curvature; each grasp a normal force and a
    contact place for every finger. The grasp slips where friction cannot carry the weight, which
    the labels know with some noise. A contact lowers the reading of near electrodes, wider for
    flatter objects, and its centre moves with the shear of the load. Each session has an offset and
    a gain of its own on every electrode.

    Args:
        layout (TaxelLayout): The fingertip.
        objects (int): Number of objects.
        grasps_per_object (int): Number of grasps of each object, spread over the sessions.
        sessions (int): Number of recording sessions.
        num_fingers (int): Number of fingers :math:`K`.
        seed (int): Seed of all draws.
        pose_seed (int, optional): Seed of how the hand is held in each session, which decides where
            the fingers touch; :obj:`seed` if left out.

    Raises:
        ValueError: If a number is below one.

    Examples:
        >>> from torch_geometric_tactile.sensors import biotac_sp
        >>> simulate_grasps(biotac_sp(), objects=2, grasps_per_object=5).reading.shape
        (10, 24, 3)
    """
    counts = {
        "objects": objects,
        "grasps_per_object": grasps_per_object,
        "sessions": sessions,
        "num_fingers": num_fingers,
    }
    for name, number in counts.items():
        need(number >= 1, f"'{name}' must be at least 1", number)
    draw = np.random.default_rng(seed)
    pos = layout.pos.double().numpy()
    size = float(np.ptp(pos, axis=0).max()) or 0.01
    num = objects * grasps_per_object

    mass = draw.uniform(0.15, 0.6, objects)
    friction = draw.uniform(0.3, 0.9, objects)
    width = draw.uniform(0.12, 0.3, objects) * size
    group = np.repeat(np.arange(objects), grasps_per_object)
    session = np.tile(np.arange(sessions), num // sessions + 1)[:num]

    # A hand that grips about as hard as the object needs makes half of the grasps slip.
    needed = mass[group] * _GRAVITY / (friction[group] * num_fingers)
    effort = draw.lognormal(0.0, 0.5, (num, 1)) * draw.lognormal(0.0, 0.15, (num, num_fingers))
    force = needed[:, None] * effort
    margin = np.log(force.sum(1) / (needed * num_fingers)) + draw.normal(0.0, 0.1, num)
    slipped = (margin < 0).astype(np.int64)

    pose = np.random.default_rng(seed if pose_seed is None else pose_seed)
    place = pos[pose.integers(0, len(pos), (sessions, num_fingers))]
    centre = place[session] + draw.normal(0.0, 0.15 * size, (num, num_fingers, 3))
    load = mass[group] * _GRAVITY / num_fingers
    shear = np.clip(load[:, None] / (friction[group][:, None] * force), 0.0, 1.0)
    centre[..., 0] += 0.15 * size * shear  # the skin is dragged along the finger
    square = ((centre[:, None] - pos[None, :, None]) ** 2).sum(-1)  # (S, N, K)
    contact = force[:, None] * np.exp(-square / (2 * width[group][:, None, None] ** 2))
    bulge = 0.08 * force[:, None] * np.ones_like(contact)  # displaced fluid lifts the others
    fall = _SATURATION * np.tanh(_GAIN * (contact - bulge) / _SATURATION)

    offset = _REST + draw.normal(0.0, 150.0, (sessions, len(pos), num_fingers))
    gain = draw.lognormal(0.0, 0.15, (sessions, len(pos), num_fingers))
    reading = offset[session] - gain[session] * fall + draw.normal(0.0, _NOISE, fall.shape)
    return SimulatedGrasps(
        reading=np.clip(reading, 0, 4095).round().astype(np.float32),
        slipped=slipped,
        group=group,
        session=session,
        force=force.astype(np.float32),
    )
