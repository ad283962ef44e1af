r"""Viewing directions of layouts and hands, for figures and the viewer."""

import torch
from torch import Tensor

from torch_geometric_tactile.sensors.kinematics import HandKinematics
from torch_geometric_tactile.sensors.layout import TaxelLayout

_RELATIVE_TOLERANCE = 1e-6  # of extents that count as equal
PAD_GAP = 0.5  # between pads, as a fraction of the largest pad
# With zero angles, the thumb of an Allegro hand shows its edge; these angles turn its pads to view.
_OPEN_ANGLES = {"joint_12.0": 0.263, "joint_13.0": 1.1}


def open_angles(kinematics: HandKinematics) -> Tensor:
    r"""Returns the joint angles of an open hand in radians :math:`(J,)`."""
    angle = torch.tensor([_OPEN_ANGLES.get(name, 0.0) for name in kinematics.joint_names])
    return torch.minimum(torch.maximum(angle, kinematics.lower), kinematics.upper)


def pads_side_by_side(layout: TaxelLayout) -> list[tuple[Tensor, Tensor, Tensor]]:
    r"""Returns, for each link, its taxels :math:`(M,)`, the axes of :func:`facing_axes`
    :math:`(3, 3)`, and the translation along them in metres :math:`(3,)` that arranges the pads
    side by side.
    """
    assert layout.link is not None
    pads = []
    for link in layout.link.unique():
        taxels = (layout.link == link).nonzero().view(-1)
        axes = facing_axes(
            layout.pos[taxels], None if layout.normal is None else layout.normal[taxels]
        )
        pos = layout.pos[taxels].double() @ axes.T
        pads.append((taxels, axes, pos.amin(dim=0), pos.amax(dim=0)))
    gap = PAD_GAP * max(float((high - low).max()) for *_, low, high in pads)
    arranged_pads, edge = [], 0.0
    for taxels, axes, low, high in pads:
        translation = -(low + high) / 2
        translation[0] = edge - low[0]
        arranged_pads.append((taxels, axes, translation))
        edge += float(high[0] - low[0]) + gap
    return arranged_pads


def facing_axes(pos: Tensor, normal: Tensor | None) -> Tensor:
    r"""Returns the axes of a view of a pad: to the right, up and towards the viewer.

    The mean normal points at the viewer. Without normals, or if they cancel out, the view is along
    the direction of the smallest extent. The two axes of the link's frame farthest from the
    viewing direction point to the right and up, so the view is never mirrored: it shows :math:`x`
    and :math:`y` from :math:`+z`, and :math:`x` and :math:`z` from :math:`-y`.

    Shapes:
        - **pos:** Positions of the taxels in metres :math:`(N, 3)`.
        - **normal:** Outward normals of the taxels :math:`(N, 3)`.
        - **output:** unit axes as rows of a rotation :math:`(3, 3)`, in double precision
    """
    toward = pos.new_zeros(3).double() if normal is None else normal.double().mean(dim=0)
    if float(toward.norm()) <= 1e-3:
        toward = _thinnest_axis(pos.double() - pos.double().mean(dim=0))
    toward = toward / toward.norm()
    right = toward.new_zeros(3)
    right[facing_sides(toward)[0]] = 1.0
    right = right - (right @ toward) * toward
    right = right / right.norm()
    return torch.stack([right, torch.linalg.cross(toward, right), toward])


def facing_sides(toward: Tensor) -> tuple[int, int]:
    r"""Returns the indices of the frame's axes that point to the right and up."""
    facing = 2 - _argmax(toward.flip(0))  # z if components are equal
    first, second = (facing + 1) % 3, (facing + 2) % 3
    return (first, second) if float(toward[facing]) > 0 else (second, first)


def _argmax(vector: Tensor) -> int:
    # Rounded, so that rounding errors do not decide between equal components.
    return int(vector.abs().div(_RELATIVE_TOLERANCE).round().argmax())


def _thinnest_axis(points: Tensor) -> Tensor:
    # The direction of the smallest extent. Several directions may have the same extent, and the
    # sign of an eigenvector is arbitrary: take the longest of the frame's axes projected onto them.
    value, vector = torch.linalg.eigh(points.T @ points)
    directions = vector[:, value <= value[0] + _RELATIVE_TOLERANCE * value[-1]]
    candidates = (directions @ directions.T).flip(1)
    return candidates[:, _argmax(candidates.norm(dim=0))]
