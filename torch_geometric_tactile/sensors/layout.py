r"""The fixed geometry of a tactile sensor."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any, Literal, Self

import torch
from torch import Tensor

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._files import atomic_path
from torch_geometric_tactile._texts import read_json
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.sensors._checks import check_edges, check_segment, is_integer_tensor
from torch_geometric_tactile.sensors._content_checks import need_text, need_texts
from torch_geometric_tactile.sensors._layout_content import INDEX_KEYS, layout_arguments
from torch_geometric_tactile.sensors._taxel_axes import taxel_axes

_SEGMENTATIONS = ("digit", "patch")
_MAX_MAP_SIZE = 1 << 14  # rows or columns of an image map


@dataclass(frozen=True, eq=False)
class TaxelLayout:
    r"""The positions of a sensor's taxels and the edges between them. A layout is frozen and is
    checked at construction.

    Args:
        name (str): Name of the sensor.
        pos (torch.Tensor): Taxel positions in the link frame, in metres :math:`(N, 3)`. For a
            flat pad, :math:`(N, 2)` is accepted, with :math:`z = 0`.
        normal (torch.Tensor, optional): Outward unit normals in the link frame :math:`(N, 3)`.
        tangent (torch.Tensor, optional): Unit :math:`x` and :math:`y` axes of each taxel, along
            which it measures shear, in the link frame :math:`(N, 2, 3)`. They are stored in double
            precision.
        link (torch.Tensor, optional): Index of each taxel's link :math:`(N,)`. By default all
            taxels are on one link.
        patch (torch.Tensor, optional): Index of each taxel's patch :math:`(N,)`.
        digit (torch.Tensor, optional): Index of each taxel's digit :math:`(N,)`.
        link_names (tuple of str): Names of the links.
        patch_names (tuple of str): Names of the patches.
        digit_names (tuple of str): Names of the digits.
        adjacency (Mapping of str to torch.Tensor): Named adjacencies, each a directed
            :obj:`edge_index` :math:`(2, |\mathcal{E}|)`.
        image_map (torch.Tensor, optional): Row and column of each taxel on a 2-D map
            :math:`(N, 2)`, for convolutional networks.
        source (str): Source of the positions.

    Raises:
        ValueError: If the arguments differ in their number of taxels, an index has no name, an edge
            joins taxels outside of the layout, a position is not finite, a normal is not a unit
            vector, axes are not at right angles, or two taxels share a cell of the image map.

    Examples:
        >>> from torch_geometric_tactile.sensors import biotac_sp
        >>> layout = biotac_sp()
        >>> layout
        TaxelLayout('biotac_sp', num_taxels=24, patches=1, digits=1)
    """

    name: str
    pos: Tensor
    normal: Tensor | None = None
    link: Tensor | None = None
    patch: Tensor | None = None
    digit: Tensor | None = None
    link_names: tuple[str, ...] = ("base",)
    patch_names: tuple[str, ...] = ("patch",)
    digit_names: tuple[str, ...] = ("digit",)
    adjacency: Mapping[str, Tensor] = field(default_factory=dict)
    image_map: Tensor | None = None
    source: str = ""
    tangent: Tensor | None = None

    def __post_init__(self) -> None:
        self._set("pos", _checked_pos(self.pos))
        need_text(self.name, "'name'")
        for key in INDEX_KEYS:
            names = getattr(self, f"{key}_names")
            need_texts(names, f"'{key}_names'")
            self._set(f"{key}_names", tuple(names))
            self._set(key, _checked_index(self, key))
        for key, check in _OPTIONAL_CHECKS.items():
            if getattr(self, key) is not None:
                self._set(key, check(self, getattr(self, key)))
        adjacency = {
            name: check_edges(edges, self.num_taxels, f"adjacency '{name}'")
            for name, edges in self.adjacency.items()
        }
        self._set("adjacency", MappingProxyType(adjacency))

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "adjacency": dict(self.adjacency)}  # Proxies cannot be pickled.

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update({**state, "adjacency": MappingProxyType(state["adjacency"])})

    def _set(self, key: str, value: Any) -> None:
        object.__setattr__(self, key, value)  # The class is frozen.

    @property
    def num_taxels(self) -> int:
        r"""The number of taxels :math:`N`."""
        return self.pos.size(0)

    def __len__(self) -> int:
        return self.num_taxels

    @property
    def default_adjacency(self) -> str | None:
        r"""The name of the adjacency that data sets use by default: :obj:`"original"` if it exists,
        else the only adjacency. :obj:`None` if the layout has no or several other adjacencies.
        """
        names = list(self.adjacency)
        if "original" in names:
            return "original"
        return names[0] if len(names) == 1 else None

    def edge_index(self, name: str | None = None) -> Tensor:
        r"""Returns a named adjacency.

        Args:
            name (str, optional): Name of the adjacency, a key of :obj:`adjacency`. By default the
                :attr:`default_adjacency`.

        Shapes:
            - **output:** directed edges :math:`(2, |\mathcal{E}|)`

        Raises:
            ValueError: If the layout has no such adjacency, or no default adjacency.
        """
        name = self.default_adjacency if name is None else name
        names = ", ".join(f"'{key}'" for key in self.adjacency) or "none; see KNNGraph"
        if name is None:
            raise ValueError(
                f"'name' must be an adjacency of layout '{self.name}': {names} (got None)"
            )
        if name not in self.adjacency:
            raise ValueError(
                f"'name' must be an adjacency of layout '{self.name}': {names} (got '{name}')"
            )
        return self.adjacency[name]

    def with_adjacency(self, name: str, edge_index: Tensor) -> Self:
        r"""Returns a copy of the layout with an adjacency added or replaced.

        Args:
            name (str): Name of the adjacency. :obj:`"original"` becomes the
                :attr:`default_adjacency`.
            edge_index (torch.Tensor): Directed edges :math:`(2, |\mathcal{E}|)`.

        Raises:
            ValueError: If the edges have the wrong shape or join taxels outside of the layout.

        Examples:
            >>> from torch_geometric_tactile.sensors import biotac_sp
            >>> layout = biotac_sp()
            >>> ring = torch.stack([torch.arange(24), torch.arange(24).roll(1)])
            >>> layout.with_adjacency("ring", ring).edge_index().shape
            torch.Size([2, 24])
        """
        need_text(name, "'name'")
        return replace(self, adjacency={**self.adjacency, name: edge_index})

    def segments(self, by: Literal["digit", "patch"]) -> Tensor:
        r"""Returns the segment of each taxel.

        Args:
            by (str): Kind of segments, :obj:`"digit"` or :obj:`"patch"`.

        Shapes:
            - **output:** segment indices :math:`(N,)`

        Raises:
            ValueError: If :obj:`by` is unknown.
        """
        need(by in _SEGMENTATIONS, f"'by' must be one of {_SEGMENTATIONS} (got '{by}')")
        segments: Tensor = getattr(self, by)
        return segments

    def axes(self, dtype: torch.dtype = torch.float) -> Tensor:
        r"""Returns the unit axes :math:`x, y` of each taxel and its outward normal :math:`n`, in
        the frame of its link. Shear is measured along :math:`x` and :math:`y`. Pressure is measured
        *against* the normal, since it points into the skin.

        Without :obj:`tangent`, :math:`x` is the link's :math:`x` axis projected onto the skin (or
        its :math:`y` axis, if :math:`x` is normal to the skin), and :math:`y = n \times x`. Without
        :obj:`normal`, :math:`n = x \times y`. Without both, :math:`n` is :math:`z` on a link whose
        taxels all have the same :math:`z`. On other links, :math:`n` is the normal of the plane
        through a taxel and its eight nearest neighbours, pointing away from the centre of the
        link's taxels.

        Args:
            dtype (torch.dtype): Type of the output.

        Shapes:
            - **output:** :math:`x`, :math:`y` and :math:`n` as rows :math:`(N, 3, 3)`
        """
        assert self.link is not None
        return taxel_axes(self.pos, self.link, self.normal, self.tangent).to(dtype)

    def matches(self, other: "TaxelLayout") -> bool:
        r"""Returns whether both layouts have the same taxel positions (to a nanometre).

        Args:
            other (TaxelLayout): The layout to compare with.
        """
        return self.pos.shape == other.pos.shape and torch.allclose(
            self.pos, other.pos, rtol=0.0, atol=1e-9
        )

    def to_dict(self) -> dict[str, Any]:
        r"""Returns the layout as JSON values, in metres."""
        return _layout_to_dict(self)

    @classmethod
    def from_dict(cls, content: Mapping[str, Any]) -> Self:
        r"""Builds a layout from the output of :meth:`to_dict`.

        Args:
            content (Mapping): The keys :obj:`"name"`, :obj:`"unit"` (:obj:`"m"`, :obj:`"mm"` or
                :obj:`"in"`) and :obj:`"taxels"`, a list of :obj:`{"pos", "normal", "tangent",
                "link", "patch", "digit", "cell"}`, where only :obj:`"pos"` is required, with two or
                three numbers. Optional keys are :obj:`"source"`, :obj:`"adjacency"` (name to a list
                of pairs), and :obj:`"link_names"`, :obj:`"patch_names"` and :obj:`"digit_names"`
                (by default in order of appearance). In place of :obj:`"taxels"` it may have
                :obj:`"patches"`, which define taxels and edges (see
                :func:`~torch_geometric_tactile.sensors.expand_patches`).

        Raises:
            ValueError: If a key is missing or unknown, the unit is unknown, or the layout is
                inconsistent.
        """
        return cls(**layout_arguments(content))

    @classmethod
    def join(
        cls,
        layouts: Sequence["TaxelLayout"],
        names: Sequence[str] | None = None,
        *,
        name: str = "hand",
        links: Sequence[str] | None = None,
        pose: Tensor | None = None,
    ) -> Self:
        r"""Joins layouts into one layout, for example fingertips into a hand. Taxels are numbered
        layout by layout.

        The joined layout has the adjacencies that all layouts have, without edges between the
        layouts. It has normals, tangents and an image map only if all layouts have them. The image
        maps are placed side by side.

        Args:
            layouts (sequence of TaxelLayout): The layouts.
            names (sequence of str, optional): Name of each layout, such as its finger. By default
                the names of the layouts. If a layout has one digit, patch or link, this becomes its
                name. If it has several, the name is prefixed to theirs, as in :obj:`"left_index"`.
            name (str): Name of the joined layout.
            links (sequence of str, optional): Name of the hand's link that carries each layout,
                such as a link in a URDF. Layouts may share a link. By default they have separate
                links.
            pose (torch.Tensor, optional): Pose of each layout's frame in the frame of its link, in
                metres, as homogeneous matrices :math:`T_{link,layout}` :math:`(K, 4, 4)`. By
                default the identity.

        Raises:
            ValueError: If there is no layout, names are missing or repeated, :obj:`links` are set
                for a layout with several links, or :obj:`pose` is not a rigid transform.

        Examples:
            >>> from torch_geometric_tactile.sensors import biotac_sp
            >>> hand = TaxelLayout.join([biotac_sp()] * 3, ["index", "middle", "thumb"])
            >>> hand
            TaxelLayout('hand', num_taxels=72, patches=3, digits=3)
            >>> hand.link_names
            ('index', 'middle', 'thumb')
        """
        layouts = list(layouts)
        need(layouts, "'layouts' must hold at least one layout (got none)")
        names = [layout.name for layout in layouts] if names is None else names
        return cls(name, **_join_arguments(layouts, names, links, pose))

    def save(self, path: PathLike) -> None:
        r"""Writes the layout to a JSON file that can be edited by hand, with one taxel per line.

        Args:
            path (str or PathLike): The file. It is replaced only after all content is written.
        """
        content = self.to_dict()
        taxels = ",\n  ".join(json.dumps(taxel) for taxel in content.pop("taxels"))
        head = json.dumps(content, indent=1)[:-2]
        with atomic_path(path) as temporary:
            temporary.write_text(f'{head},\n "taxels": [\n  {taxels}\n ]\n}}\n', encoding="utf-8")

    @classmethod
    def load(cls, path: PathLike) -> Self:
        r"""Reads a layout from a JSON file and converts its unit to metres.

        Args:
            path (str or PathLike): A file in the format of :meth:`save`.

        Raises:
            FileNotFoundError: If the file does not exist.
            ValueError: If the file is not JSON or not a consistent layout. The message names the
                file.
        """
        try:
            content = read_json(path)
            if not isinstance(content, dict):
                raise ValueError(f"a layout must be a JSON object (got {type(content).__name__})")
            return cls.from_dict(content)
        except ValueError as error:  # including JSONDecodeError
            raise ValueError(f"'{path}' is not a taxel layout: {error}") from error

    def __repr__(self) -> str:
        return (
            f"{type(self).__name__}('{self.name}', num_taxels={self.num_taxels}, "
            f"patches={len(self.patch_names)}, digits={len(self.digit_names)})"
        )


def _layout_to_dict(layout: TaxelLayout) -> dict[str, Any]:
    vectors = {"pos": layout.pos, "normal": layout.normal, "tangent": layout.tangent}
    columns = {key: tensor.tolist() for key, tensor in vectors.items() if tensor is not None}
    names = {f"{key}_names": list(getattr(layout, f"{key}_names")) for key in INDEX_KEYS}
    for key in INDEX_KEYS:
        columns[key] = [names[f"{key}_names"][i] for i in getattr(layout, key).tolist()]
    if layout.image_map is not None:
        columns["cell"] = layout.image_map.tolist()
    return {
        "name": layout.name,
        "source": layout.source,
        "unit": "m",
        **names,
        "taxels": [
            dict(zip(columns, taxel, strict=True)) for taxel in zip(*columns.values(), strict=True)
        ],
        "adjacency": {name: edges.t().tolist() for name, edges in layout.adjacency.items()},
    }


def _join_arguments(
    layouts: Sequence[TaxelLayout],
    names: Sequence[str],
    links: Sequence[str] | None,
    pose: Tensor | None,
) -> dict[str, Any]:
    r"""Returns the arguments of the joined layout, except its name."""
    num_layouts = len(layouts)
    for key, values in (("names", names), ("links", links)):
        if values is not None and len(values) != num_layouts:
            raise ValueError(
                f"'{key}' must have {num_layouts} entries, one for each layout (got {len(values)})"
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


def _rotate(key: str, layouts: Sequence[TaxelLayout], poses: Tensor) -> Tensor | None:
    # The normals or tangents in the frames of the links, or None if any layout lacks them.
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


def _adjacency(layouts: Sequence[TaxelLayout]) -> dict[str, Tensor]:
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
    key: str, layouts: Sequence[TaxelLayout], names: Sequence[str]
) -> dict[str, Tensor | tuple[str, ...]]:
    # A layout with one digit names it; otherwise the name of the layout is prefixed to its digits.
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
    layouts: Sequence[TaxelLayout], names: Sequence[str], links: Sequence[str] | None
) -> dict[str, Tensor | tuple[str, ...]]:
    if links is None:
        return _join_indices("link", layouts, names)
    for layout, name in zip(layouts, names, strict=True):
        if len(layout.link_names) > 1:
            raise ValueError(
                f"'links' must be None if a layout has several links (got '{name}' with "
                f"{', '.join(layout.link_names)})"
            )
    link_names = tuple(dict.fromkeys(links))  # Layouts may share a link.
    indices = [
        torch.full((len(layout),), link_names.index(link))
        for layout, link in zip(layouts, links, strict=True)
    ]
    return {"link": torch.cat(indices), "link_names": link_names}


def _image_map(layouts: Sequence[TaxelLayout]) -> Tensor | None:
    # The image maps side by side, or None if any layout lacks one.
    maps, column = [], 0
    for layout in layouts:
        if layout.image_map is None:
            return None
        maps.append(layout.image_map + torch.tensor([0, column]))
        column += int(layout.image_map[:, 1].max()) + 1
    return torch.cat(maps)


def _checked_pos(pos: Tensor) -> Tensor:
    pos = torch.as_tensor(pos, dtype=torch.float)
    if pos.dim() != 2 or pos.size(0) == 0 or pos.size(1) not in (2, 3):
        raise ValueError(
            "'pos' must have shape (num_taxels, 3), or (num_taxels, 2) for a flat pad "
            f"(got {tuple(pos.shape)})"
        )
    if pos.size(1) == 2:
        pos = torch.nn.functional.pad(pos, (0, 1))
    need(pos.isfinite().all(), "'pos' must hold finite numbers only (got NaN or infinity)")
    return pos


def _checked_normal(layout: TaxelLayout, normal: Tensor) -> Tensor:
    normal = torch.as_tensor(normal, dtype=torch.float)
    if normal.shape != layout.pos.shape:
        raise ValueError(
            f"'normal' must have shape {tuple(layout.pos.shape)} (got {tuple(normal.shape)})"
        )
    _check_unit_vectors("normal", normal)
    return normal


def _check_unit_vectors(key: str, vectors: Tensor) -> None:
    length = vectors.norm(dim=-1).view(-1)
    if not torch.allclose(length, torch.ones_like(length), atol=1e-3):
        raise ValueError(
            f"'{key}' must hold unit vectors (got a length of "
            f"{float(length[(length - 1).abs().argmax()]):.4g})"
        )


def _checked_tangent(layout: TaxelLayout, tangent: Tensor) -> Tensor:
    tangent = torch.as_tensor(tangent, dtype=torch.double)
    if tangent.shape != (layout.num_taxels, 2, 3):
        raise ValueError(
            f"'tangent' must have shape ({layout.num_taxels}, 2, 3) (got {tuple(tangent.shape)})"
        )
    _check_unit_vectors("tangent", tangent)
    axes = tangent if layout.normal is None else torch.cat([tangent, layout.normal[:, None]], dim=1)
    cosine = (axes @ axes.mT).triu(diagonal=1).abs().amax()
    if cosine > 1e-3:
        raise ValueError(
            "'tangent' must hold axes at right angles to each other and to the normals (got a "
            f"cosine of {float(cosine):.4g})"
        )
    return tangent


def _checked_index(layout: TaxelLayout, key: str) -> Tensor:
    index, names = getattr(layout, key), getattr(layout, f"{key}_names")
    if index is None:
        return torch.zeros(layout.num_taxels, dtype=torch.long)
    index = check_segment(index, layout.num_taxels, f"'{key}'", gaps=True)
    if int(index.min()) < 0 or int(index.max()) >= len(names):
        raise ValueError(
            f"'{key}' must hold indices into '{key}_names', 0 to {len(names) - 1} "
            f"(got {int(index.min())} to {int(index.max())})"
        )
    return index


def _checked_image_map(layout: TaxelLayout, image_map: Tensor) -> Tensor:
    image_map = torch.as_tensor(image_map)
    if image_map.shape != (layout.num_taxels, 2):
        raise ValueError(
            f"'image_map' must have shape ({layout.num_taxels}, 2) (got {tuple(image_map.shape)})"
        )
    need(is_integer_tensor(image_map), "'image_map' must hold whole numbers", image_map.dtype)
    image_map = image_map.long()
    first, last = int(image_map.min()), int(image_map.max())
    # A large map would need memory for all of its cells.
    if first < 0 or last >= _MAX_MAP_SIZE:
        raise ValueError(
            f"'image_map' must hold rows and columns from 0 to {_MAX_MAP_SIZE - 1} "
            f"(got {first if first < 0 else last})"
        )
    if len(image_map.unique(dim=0)) < layout.num_taxels:
        raise ValueError("'image_map' must give each taxel a separate cell (got a shared cell)")
    return image_map


_OPTIONAL_CHECKS = {
    "normal": _checked_normal,
    "tangent": _checked_tangent,
    "image_map": _checked_image_map,
}
