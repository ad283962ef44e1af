r"""The smallest squeeze with which friction holds an object."""

import numpy as np

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.sensors import TaxelLayout
from torch_geometric_tactile.sim._gripper_scene import (
    GRAVITY,
    TIP_RADIUS,
    default_pad,
    normal_forces,
    pad_positions,
)
from torch_geometric_tactile.sim.lift_object import LiftObject

_MAX_NEED = 1000.0  # N
_NUM_BISECTIONS = 50
_NUM_CENTRES, _CENTRE_SCALE = 361, 0.01  # m
_LAST_ANGLE = np.pi / 2 - 1e-4  # a distance of 100 m


def needed_squeeze(item: LiftObject, pad: TaxelLayout | None = None) -> float:
    r"""Returns the smallest squeeze, in newtons, with which friction holds an object at rest
    against sliding and turning. The squeeze is the normal force on each of the two pads.

    Each pad carries half of the weight, :math:`F = m g / 2`. At the limit, the object turns about a
    point at :math:`c` on the horizontal line through the middle of the pads, and friction opposes
    the motion on each taxel. The motion that needs the largest squeeze determines the result. A
    slide without turning is the limit of a distant :math:`c`:

    .. math::
        P = \frac{F}{\mu} \max_c \frac{|d - c|}{\sum_i p_i |\mathbf{r}_i - c|}

    where :math:`d` is the lever of the weight, :math:`\mathbf{r}_i` the position of a taxel and
    :math:`p_i` its part of the normal force. The parts depend on :math:`P`, because the outer
    taxels of a crowned pad touch later. The equation is therefore solved by bisection. It is the
    limit surface of `"Planar sliding with dry friction. Part 1. Limit surface and moment function"
    <https://doi.org/10.1016/0043-1648(91)90104-3>`_ (Goyal, Ruina and Papadopoulos, 1991).

    Args:
        item (LiftObject): The object.
        pad (TaxelLayout, optional): The taxels of each pad (default: 4 x 4, 5 mm apart).

    Raises:
        ValueError: If fewer than two taxels of a pad touch the object.

    Examples:
        >>> round(needed_squeeze(LiftObject(mass=0.2, friction=0.5)), 2)
        1.96
        >>> round(needed_squeeze(LiftObject(mass=0.2, friction=0.5, offset=0.012)), 2)
        4.28
    """
    position = pad_positions(default_pad() if pad is None else pad)
    # A taxel at the very edge of the object slips off.
    position = position[np.abs(position[:, 0] - item.place) < item.breadth / 2 - TIP_RADIUS]
    need(len(position) > 1, "'item' must be touched by two taxels of each pad", item)
    # Centres of rotation from minus to plus infinity, most of them near the pad.
    middle = position[:, 0].mean()
    centre = middle + _CENTRE_SCALE * np.tan(np.linspace(-1, 1, _NUM_CENTRES) * _LAST_ANGLE)
    distance = np.hypot(position[:, :1] - centre, position[:, 1:])
    lever = item.mass * GRAVITY / 2 * np.abs(item.offset - centre)
    low, high = 0.0, _MAX_NEED
    for _ in range(_NUM_BISECTIONS):
        squeeze = (low + high) / 2
        moment = item.friction * (normal_forces(position, squeeze)[:, None] * distance).sum(axis=0)
        if (moment < lever).any():
            low = squeeze
        else:
            high = squeeze
    return high
