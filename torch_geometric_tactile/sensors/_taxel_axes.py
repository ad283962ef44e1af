r"""The axes of taxels: given, or found from normals and places."""

import torch
from torch import Tensor
from torch.nn.functional import normalize

_NEIGHBOURS = 8  # of a taxel, through which its plane is laid
_CHUNK = 1 << 22  # distances between taxels at a time
_PARALLEL = 1e-3  # sine of the angle below which directions are one


def taxel_axes(pos: Tensor, link: Tensor, normal: Tensor | None, tangent: Tensor | None) -> Tensor:
    r"""Returns the axes of each taxel of a layout; see :meth:`TaxelLayout.axes`.

    Shapes:
        - **output:** the unit axes :math:`x`, :math:`y` and normal as rows, double
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
    # The link's x axis laid onto the skin; its y axis where x points along the normal.
    unit = normalize(normal, dim=1)
    first, second = (axis - unit * (unit @ axis).unsqueeze(1) for axis in _eye()[:2])
    parallel = first.norm(dim=1, keepdim=True) < _PARALLEL
    x = normalize(torch.where(parallel, second, first), dim=1)
    return torch.stack([x, torch.linalg.cross(unit, x)], dim=1)


def _normals(pos: Tensor, link: Tensor) -> Tensor:
    out = torch.empty_like(pos)
    for number in link.unique():
        taxels = (link == number).nonzero().view(-1)
        out[taxels] = _local_normals(pos[taxels])
    return out


def _local_normals(pos: Tensor) -> Tensor:
    # Those of one link, whose places are in one frame.
    if bool((pos[:, 2] == pos[0, 2]).all()):
        return _eye()[2].expand(len(pos), 3)
    count = min(len(pos), _NEIGHBOURS + 1)
    parts = pos.split(max(1, _CHUNK // len(pos)))
    near = torch.cat([torch.cdist(part, pos).topk(count, largest=False).indices for part in parts])
    around = pos[near] - pos[near].mean(dim=1, keepdim=True)
    squares, directions = torch.linalg.eigh(around.mT @ around)  # the smallest first
    normal, line = directions[:, :, 0], directions[:, :, 2]
    # Taxels in a line lie in many planes: that which is closest to the link's xy plane.
    upright = normalize(_eye()[2] - line * line[:, 2:], dim=1)
    upright = torch.where(line[:, 2:].abs() > 1 - _PARALLEL, _eye()[0], upright)
    in_line = squares[:, 1:2] <= _PARALLEL**2 * squares[:, 2:]
    normal = torch.where(in_line, upright, normal)
    return normal * _outwards(normal, pos - pos.mean(dim=0))


def _outwards(normal: Tensor, place: Tensor) -> Tensor:
    # The sign that makes normals point away from the centre; without a side, upwards; of those that
    # lie flat, along their largest component.
    along = (normal * place).sum(dim=1, keepdim=True)
    largest = normal.gather(1, normal.abs().argmax(dim=1, keepdim=True))
    up = torch.where(normal[:, 2:].abs() > _PARALLEL, normal[:, 2:], largest)
    has_side = along.abs() > _PARALLEL * place.norm(dim=1).max()
    return torch.where(has_side, along, up).sign()


def _eye() -> Tensor:
    return torch.eye(3, dtype=torch.double)
