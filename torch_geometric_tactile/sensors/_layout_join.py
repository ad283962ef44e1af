r"""Several layouts as one: a hand of its fingers."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from torch_geometric_tactile._checks import need

if TYPE_CHECKING:
    from torch_geometric_tactile.sensors.layout import TaxelLayout


def join_arguments(
    layouts: Sequence["TaxelLayout"],
    names: Sequence[str],
    links: Sequence[str] | None,
    pose: Tensor | None,
) -> dict[str, Any]:
    r"""Returns the arguments of the joined layout, except its name."""
    count = len(layouts)
    for key, values in (("names", names), ("links", links)):
        if values is not None and len(values) != count:
            raise ValueError(f"'{key}' must be {count}, one for each layout (got {len(values)})")
    need(len(set(names)) >= count, "'names' must differ from one another", list(names))
    poses = _checked_pose(pose, count)
    pos = [
        (layout.pos.double() @ turn[:3, :3].t() + turn[:3, 3]).float()
        for layout, turn in zip(layouts, poses, strict=True)
    ]
    arguments: dict[str, Any] = {
        "pos": torch.cat(pos),
        "normal": _turned("normal", layouts, poses),
        "tangent": _turned("tangent", layouts, poses),
        "adjacency": _adjacency(layouts),
        "image_map": _image_map(layouts),
        "source": "; ".join(dict.fromkeys(one.source for one in layouts if one.source)),
    }
    for key in ("patch", "digit"):
        arguments |= _numbered(key, layouts, names)
    return arguments | _links(layouts, names, links)


def _turned(key: str, layouts: Sequence["TaxelLayout"], poses: Tensor) -> Tensor | None:
    # Directions, if all layouts have them.
    turned = []
    for layout, turn in zip(layouts, poses[:, :3, :3], strict=True):
        directions: Tensor | None = getattr(layout, key)
        if directions is None:
            return None
        turned.append((directions.double() @ turn.t()).to(directions))
    return torch.cat(turned)


def _checked_pose(pose: Tensor | None, count: int) -> Tensor:
    eye = torch.eye(3, dtype=torch.double)
    if pose is None:
        return torch.eye(4, dtype=torch.double).expand(count, 4, 4)
    pose = torch.as_tensor(pose, dtype=torch.double)
    need(pose.shape == (count, 4, 4), f"'pose' must have shape ({count}, 4, 4)", tuple(pose.shape))
    turn = pose[:, :3, :3]
    is_rigid = torch.allclose(turn @ turn.mT, eye.expand_as(turn), atol=1e-4)
    last = torch.tensor([0.0, 0.0, 0.0, 1.0], dtype=torch.double)
    if not is_rigid or not pose[:, 3].equal(last.expand(count, 4)) or (turn.det() < 0).any():
        raise ValueError(
            "'pose' must hold rigid transforms: a rotation, a translation in metres and the last "
            "row 0, 0, 0, 1"
        )
    return pose


def _adjacency(layouts: Sequence["TaxelLayout"]) -> dict[str, Tensor]:
    common = [key for key in layouts[0].adjacency if all(key in one.adjacency for one in layouts)]
    sizes = torch.tensor([len(layout) for layout in layouts])
    firsts = (sizes.cumsum(0) - sizes).tolist()
    return {
        key: torch.cat(
            [one.edge_index(key) + first for one, first in zip(layouts, firsts, strict=True)], dim=1
        )
        for key in common
    }


def _numbered(
    key: str, layouts: Sequence["TaxelLayout"], names: Sequence[str]
) -> dict[str, Tensor | tuple[str, ...]]:
    # A part with one digit gives it its name, one with several puts its name before theirs.
    joined: list[str] = []
    numbers = []
    for layout, name in zip(layouts, names, strict=True):
        inner = getattr(layout, f"{key}_names")
        numbers.append(getattr(layout, key) + len(joined))
        joined += [name] if len(inner) == 1 else [f"{name}_{one}" for one in inner]
    return {key: torch.cat(numbers), f"{key}_names": tuple(joined)}


def _links(
    layouts: Sequence["TaxelLayout"], names: Sequence[str], links: Sequence[str] | None
) -> dict[str, Tensor | tuple[str, ...]]:
    if links is None:
        return _numbered("link", layouts, names)
    for layout, name in zip(layouts, names, strict=True):
        if len(layout.link_names) > 1:
            raise ValueError(
                f"'links' must be None where a layout has several links (got '{name}' with "
                f"{', '.join(layout.link_names)})"
            )
    found = tuple(dict.fromkeys(links))
    numbers = [
        torch.full((len(layout),), found.index(link))
        for layout, link in zip(layouts, links, strict=True)
    ]
    return {"link": torch.cat(numbers), "link_names": found}


def _image_map(layouts: Sequence["TaxelLayout"]) -> Tensor | None:
    maps, column = [], 0
    for layout in layouts:
        if layout.image_map is None:
            return None
        maps.append(layout.image_map + torch.tensor([0, column]))
        column += int(layout.image_map[:, 1].max()) + 1
    return torch.cat(maps)
