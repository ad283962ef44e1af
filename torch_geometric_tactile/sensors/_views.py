r"""From where layouts and hands are seen, in figures and in the viewer."""

import torch
from torch import Tensor

from torch_geometric_tactile.sensors.kinematics import HandKinematics
from torch_geometric_tactile.sensors.layout import TaxelLayout

_TIE = 1e-6  # relative difference below which two extents count as equal
PAD_GAP = 0.3  # between pads, of the largest extent of one
# The thumb of an Allegro hand at rest shows its edge; so turned, it shows its pads.
_OPEN_ANGLES = {"joint_12.0": 0.263, "joint_13.0": 1.1}


def open_angles(kinematics: HandKinematics) -> Tensor:
    r"""Returns the joint angles of an open hand in radians :math:`(J,)`."""
    angle = torch.tensor([_OPEN_ANGLES.get(name, 0.0) for name in kinematics.joint_names])
    return torch.minimum(torch.maximum(angle, kinematics.lower), kinematics.upper)


def pads_side_by_side(layout: TaxelLayout) -> list[tuple[Tensor, Tensor, Tensor]]:
    r"""Returns the taxels of each link :math:`(M)`, the axes of :func:`facing_axes`
    :math:`(3, 3)`, and the shift in metres :math:`(3)` along them that sets the pads side by side.
    """
    assert layout.link is not None
    pads = []
    for link in layout.link.unique():
        mine = (layout.link == link).nonzero().view(-1)
        axes = facing_axes(layout.pos[mine], None if layout.normal is None else layout.normal[mine])
        places = layout.pos[mine].double() @ axes.T
        pads.append((mine, axes, places.amin(dim=0), places.amax(dim=0)))
    gap = PAD_GAP * max(float((high - low).max()) for *_, low, high in pads)
    found, edge = [], 0.0
    for mine, axes, low, high in pads:
        shift = -(low + high) / 2
        shift[0] = edge - low[0]
        found.append((mine, axes, shift))
        edge += float(high[0] - low[0]) + gap
    return found


def facing_axes(pos: Tensor, normal: Tensor | None) -> Tensor:
    r"""Returns the axes from which a pad is seen: to the right, up and towards the viewer.

    The mean normal points at the viewer; without normals (or where they cancel) it is the direction
    of least extent. Of the frame of the link, the axis closest to it is left out, and the others
    are to the right and up, such that the view is never mirrored: :math:`x` and :math:`y` seen from
    :math:`+z`, :math:`x` and :math:`z` from :math:`-y`.

    Shapes:
        - **pos:** Places of the taxels in metres :math:`(N, 3)`.
        - **normal:** Their outward normals :math:`(N, 3)`.
        - **output:** unit axes as rows of a rotation :math:`(3, 3)`, in double
    """
    toward = pos.new_zeros(3).double() if normal is None else normal.double().mean(dim=0)
    if float(toward.norm()) <= 1e-3:
        toward = _least_axis(pos.double() - pos.double().mean(dim=0))
    toward = toward / toward.norm()
    right = toward.new_zeros(3)
    right[facing_sides(toward)[0]] = 1.0
    right = right - (right @ toward) * toward
    right = right / right.norm()
    return torch.stack([right, torch.linalg.cross(toward, right), toward])


def facing_sides(toward: Tensor) -> tuple[int, int]:
    r"""Returns the numbers of the frame's axes to the right and up."""
    out = 2 - _largest(toward.flip(0))  # z where components are equal
    first, second = (out + 1) % 3, (out + 2) % 3
    return (first, second) if float(toward[out]) > 0 else (second, first)


def _largest(vector: Tensor) -> int:
    return int(vector.abs().div(_TIE).round().argmax())


def _least_axis(points: Tensor) -> Tensor:
    value, vector = torch.linalg.eigh(points.T @ points)
    least = vector[:, value <= value[0] + _TIE * value[-1]]
    # Of the frame's axes projected onto the directions of least extent, the longest: unlike an
    # eigenvector it has a sign, and stays the same where extents are equal.
    candidates = (least @ least.T).flip(1)
    return candidates[:, _largest(candidates.norm(dim=0))]
