r"""Joining of several layouts to one, such as fingers to a hand."""

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
    num_layouts = len(layouts)
    for key, values in (("names", names), ("links", links)):
        if values is not None and len(values) != num_layouts:
            raise ValueError(
                f"'{key}' must be {num_layouts}, one for each layout (got {len(values)})"
            )
    need(len(set(names)) >= num_layouts, "'names' must differ from one another", list(names))
    poses = _checked_pose(pose, num_layouts)
    pos = [
        (layout.pos.double() @ T_link_layout[:3, :3].t() + T_link_layout[:3, 3]).float()
        for layout, T_link_layout in zip(layouts, poses, strict=True)
    ]
    arguments: dict[str, Any] = {
        "pos": torch.cat(pos),
        "normal": _rotate("normal", layouts, poses),
        "tangent": _rotate("tangent", layouts, poses),
        "adjacency": _adjacency(layouts),
        "image_map": _image_map(layouts),
        "source": "; ".join(dict.fromkeys(layout.source for layout in layouts if layout.source)),
    }
    for key in ("patch", "digit"):
        arguments |= _join_indices(key, layouts, names)
    return arguments | _links(layouts, names, links)


def _rotate(key: str, layouts: Sequence["TaxelLayout"], poses: Tensor) -> Tensor | None:
    # The normals or tangents in the frames of the links, or None unless all layouts have them.
    rotated = []
    for layout, rotation in zip(layouts, poses[:, :3, :3], strict=True):
        directions: Tensor | None = getattr(layout, key)
        if directions is None:
            return None
        rotated.append((directions.double() @ rotation.t()).to(directions))
    return torch.cat(rotated)


def _checked_pose(pose: Tensor | None, num_layouts: int) -> Tensor:
    eye = torch.eye(3, dtype=torch.double)
    if pose is None:
        return torch.eye(4, dtype=torch.double).expand(num_layouts, 4, 4)
    pose = torch.as_tensor(pose, dtype=torch.double)
    need(
        pose.shape == (num_layouts, 4, 4),
        f"'pose' must have shape ({num_layouts}, 4, 4)",
        tuple(pose.shape),
    )
    rotation = pose[:, :3, :3]
    is_orthogonal = torch.allclose(rotation @ rotation.mT, eye.expand_as(rotation), atol=1e-4)
    last_row = torch.tensor([0.0, 0.0, 0.0, 1.0], dtype=torch.double)
    if (
        not is_orthogonal
        or not pose[:, 3].equal(last_row.expand(num_layouts, 4))
        or (rotation.det() < 0).any()  # a mirror
    ):
        raise ValueError(
            "'pose' must hold rigid transforms: a rotation, a translation in metres and the last "
            "row 0, 0, 0, 1"
        )
    return pose


def _adjacency(layouts: Sequence["TaxelLayout"]) -> dict[str, Tensor]:
    common = [key for key in layouts[0].adjacency if all(key in each.adjacency for each in layouts)]
    sizes = torch.tensor([len(layout) for layout in layouts])
    offsets = (sizes.cumsum(0) - sizes).tolist()
    return {
        key: torch.cat(
            [
                layout.edge_index(key) + offset
                for layout, offset in zip(layouts, offsets, strict=True)
            ],
            dim=1,
        )
        for key in common
    }


def _join_indices(
    key: str, layouts: Sequence["TaxelLayout"], names: Sequence[str]
) -> dict[str, Tensor | tuple[str, ...]]:
    # The name of a layout names its only digit, or is put before the names of its digits.
    joined_names: list[str] = []
    indices = []
    for layout, name in zip(layouts, names, strict=True):
        inner_names = getattr(layout, f"{key}_names")
        indices.append(getattr(layout, key) + len(joined_names))
        joined_names += (
            [name] if len(inner_names) == 1 else [f"{name}_{inner}" for inner in inner_names]
        )
    return {key: torch.cat(indices), f"{key}_names": tuple(joined_names)}


def _links(
    layouts: Sequence["TaxelLayout"], names: Sequence[str], links: Sequence[str] | None
) -> dict[str, Tensor | tuple[str, ...]]:
    if links is None:
        return _join_indices("link", layouts, names)
    for layout, name in zip(layouts, names, strict=True):
        if len(layout.link_names) > 1:
            raise ValueError(
                f"'links' must be None where a layout has several links (got '{name}' with "
                f"{', '.join(layout.link_names)})"
            )
    link_names = tuple(dict.fromkeys(links))  # Layouts may share a link.
    indices = [
        torch.full((len(layout),), link_names.index(link))
        for layout, link in zip(layouts, links, strict=True)
    ]
    return {"link": torch.cat(indices), "link_names": link_names}


def _image_map(layouts: Sequence["TaxelLayout"]) -> Tensor | None:
    # The image maps side by side, or None unless all layouts have them.
    maps, column = [], 0
    for layout in layouts:
        if layout.image_map is None:
            return None
        maps.append(layout.image_map + torch.tensor([0, column]))
        column += int(layout.image_map[:, 1].max()) + 1
    return torch.cat(maps)
