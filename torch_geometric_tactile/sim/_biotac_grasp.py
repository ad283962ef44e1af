r"""Generated grasps with BioTac-like fingertips."""

from typing import NamedTuple

import numpy as np

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.sensors import TaxelLayout

_GRAVITY = 9.81
_REST = 3000.0  # counts
_GAIN = 260.0  # counts per newton at the centre of a contact
_SATURATION = 2200.0  # counts; largest decrease of a reading
_NOISE = 12.0  # counts


class SimulatedGrasps(NamedTuple):
    r"""Readings and labels of generated grasps.

    Shapes:
        - **reading:** counts of :math:`N` electrodes on :math:`K` fingers :math:`(S, N, K)`
        - **slipped:** 1 if the grasp slipped, else 0 :math:`(S,)`
        - **group:** index of the object :math:`(S,)`
        - **session:** index of the recording session :math:`(S,)`
        - **force:** normal force of each finger in newtons :math:`(S, K)`

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
    r"""Returns generated static readings of grasps that hold or slip, as from electrodes under a
    fluid-filled skin. The model is for tests and demonstrations; its constants are plausible, not
    measured.

    Each object has a mass, a friction coefficient and a curvature. Each grasp has a normal force
    and a contact position for every finger. A grasp slips if friction cannot carry the weight; the
    labels contain some noise. A contact lowers the readings of nearby electrodes, over a larger
    area for flatter objects. Its centre moves with the shear of the load. The offset and the gain
    of every electrode differ between sessions.

    Args:
        layout (TaxelLayout): The fingertip.
        objects (int): Number of objects.
        grasps_per_object (int): Number of grasps of each object, spread over the sessions.
        sessions (int): Number of recording sessions.
        num_fingers (int): Number of fingers :math:`K`.
        seed (int): Seed of all random numbers.
        pose_seed (int, optional): Seed of the pose of the hand in each session, which determines
            the contact positions (default: :obj:`seed`).

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
    rng = np.random.default_rng(seed)
    pos = layout.pos.double().numpy()
    size = float(np.ptp(pos, axis=0).max()) or 0.01
    num_grasps = objects * grasps_per_object

    mass = rng.uniform(0.15, 0.6, objects)
    friction = rng.uniform(0.3, 0.9, objects)
    width = rng.uniform(0.12, 0.3, objects) * size
    group = np.repeat(np.arange(objects), grasps_per_object)
    session = np.tile(np.arange(sessions), num_grasps // sessions + 1)[:num_grasps]

    # The median grip is the force that just holds the object, so about half of the grasps slip.
    holding_force = mass[group] * _GRAVITY / (friction[group] * num_fingers)
    grasp_factor = rng.lognormal(0.0, 0.5, (num_grasps, 1))
    relative_force = grasp_factor * rng.lognormal(0.0, 0.15, (num_grasps, num_fingers))
    force = holding_force[:, None] * relative_force
    margin = np.log(force.sum(1) / (holding_force * num_fingers))
    slipped = (margin + rng.normal(0.0, 0.1, num_grasps) < 0).astype(np.int64)

    pose_rng = np.random.default_rng(seed if pose_seed is None else pose_seed)
    session_centre = pos[pose_rng.integers(0, len(pos), (sessions, num_fingers))]
    centre = session_centre[session] + rng.normal(0.0, 0.15 * size, (num_grasps, num_fingers, 3))
    load = mass[group] * _GRAVITY / num_fingers
    shear = np.clip(load[:, None] / (friction[group][:, None] * force), 0.0, 1.0)
    centre[..., 0] += 0.15 * size * shear  # shear drags the skin along the finger
    square_distance = ((centre[:, None] - pos[None, :, None]) ** 2).sum(-1)  # (S, N, K)
    contact = force[:, None] * np.exp(-square_distance / (2 * width[group][:, None, None] ** 2))
    bulge = (
        0.08 * force[:, None] * np.ones_like(contact)
    )  # displaced fluid lifts the skin elsewhere
    fall = _SATURATION * np.tanh(_GAIN * (contact - bulge) / _SATURATION)

    offset = _REST + rng.normal(0.0, 150.0, (sessions, len(pos), num_fingers))
    gain = rng.lognormal(0.0, 0.15, (sessions, len(pos), num_fingers))
    reading = offset[session] - gain[session] * fall + rng.normal(0.0, _NOISE, fall.shape)
    return SimulatedGrasps(
        reading=np.clip(reading, 0, 4095).round().astype(np.float32),
        slipped=slipped,
        group=group,
        session=session,
        force=force.astype(np.float32),
    )
