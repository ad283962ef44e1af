r"""The axes of taxels, from tangents, normals or positions."""

import torch
from torch import Tensor
from torch.nn.functional import normalize

_NUM_NEIGHBOURS = 8  # for the plane through a taxel
_CHUNK = 1 << 22  # distances between taxels at a time, to limit memory
_PARALLEL_SINE = 1e-3  # sine of the angle below which directions are parallel


def taxel_axes(pos: Tensor, link: Tensor, normal: Tensor | None, tangent: Tensor | None) -> Tensor:
    r"""Returns the axes of each taxel of a layout (see :meth:`TaxelLayout.axes`).

    Shapes:
        - **output:** the unit axes :math:`x`, :math:`y` and normal as rows, in double precision
          :math:`(N, 3, 3)`
    """
    if normal is not None:
        normal = normal.double()
    elif tangent is not None:
        normal = torch.linalg.cross(tangent[:, 0], tangent[:, 1])
    else:
        normal = _normals(pos.double(), link)
    if tangent is None:
        tangent = _tangents(normal)
    return torch.cat([tangent, normal.unsqueeze(1)], dim=1)


def _tangents(normal: Tensor) -> Tensor:
    # The x and y axes for each normal (N, 2, 3). The x axis is the link's x axis, projected onto
    # the skin, or its y axis if x is parallel to the normal.
    unit = normalize(normal, dim=1)
    link_x, link_y = (axis - unit * (unit @ axis).unsqueeze(1) for axis in _eye()[:2])
    is_parallel = link_x.norm(dim=1, keepdim=True) < _PARALLEL_SINE
    x = normalize(torch.where(is_parallel, link_y, link_x), dim=1)
    return torch.stack([x, torch.linalg.cross(unit, x)], dim=1)


def _normals(pos: Tensor, link: Tensor) -> Tensor:
    # Each link has a separate frame.
    normal = torch.empty_like(pos)
    for index in link.unique():
        taxels = (link == index).nonzero().view(-1)
        normal[taxels] = _link_normals(pos[taxels])
    return normal


def _link_normals(pos: Tensor) -> Tensor:
    # The normals of the planes through each taxel of one link and its neighbours.
    if bool((pos[:, 2] == pos[0, 2]).all()):
        return _eye()[2].expand(len(pos), 3)
    num_nearest = min(len(pos), _NUM_NEIGHBOURS + 1)
    parts = pos.split(max(1, _CHUNK // len(pos)))
    nearest = torch.cat(
        [torch.cdist(part, pos).topk(num_nearest, largest=False).indices for part in parts]
    )
    centred = pos[nearest] - pos[nearest].mean(dim=1, keepdim=True)
    squares, directions = torch.linalg.eigh(centred.mT @ centred)  # in ascending order
    normal, line = directions[:, :, 0], directions[:, :, 2]
    # Taxels on a line lie in many planes: use the plane closest to the link's xy plane.
    upright = normalize(_eye()[2] - line * line[:, 2:], dim=1)
    upright = torch.where(line[:, 2:].abs() > 1 - _PARALLEL_SINE, _eye()[0], upright)
    is_on_line = squares[:, 1:2] <= _PARALLEL_SINE**2 * squares[:, 2:]
    normal = torch.where(is_on_line, upright, normal)
    return normal * _outward_sign(normal, pos - pos.mean(dim=0))


def _outward_sign(normal: Tensor, offset: Tensor) -> Tensor:
    # The sign that makes normals point away from the centre. A normal at right angles to the offset
    # from the centre points upwards instead. If it is horizontal as well, its largest component
    # becomes positive.
    projection = (normal * offset).sum(dim=1, keepdim=True)
    largest = normal.gather(1, normal.abs().argmax(dim=1, keepdim=True))
    up = torch.where(normal[:, 2:].abs() > _PARALLEL_SINE, normal[:, 2:], largest)
    has_side = projection.abs() > _PARALLEL_SINE * offset.norm(dim=1).max()
    return torch.where(has_side, projection, up).sign()


def _eye() -> Tensor:
    return torch.eye(3, dtype=torch.double)
