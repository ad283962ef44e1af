r"""The fixed geometry of a tactile sensor."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, Self

import torch
from torch import Tensor

from torch_geometric_tactile.files import atomic_path
from torch_geometric_tactile.sensors.patches import expand_patches
from torch_geometric_tactile.typing import PathLike

_METRES_PER_UNIT = {"m": 1.0, "mm": 1e-3, "in": 0.0254}
_SEGMENTATIONS = ("digit", "patch")


def _are_numbers(value: Any, count: int) -> bool:
    return (
        isinstance(value, list | tuple)
        and len(value) == count
        and all(isinstance(number, int | float) for number in value)
    )


@dataclass(frozen=True, eq=False)
class TaxelLayout:
    r"""Where the taxels of a sensor are and how they are joined. Frozen, and checked at birth.

    Args:
        name (str): Name of the sensor.
        pos (torch.Tensor): Taxel positions in the link frame, in metres :math:`(N, 3)`.
        normal (torch.Tensor, optional): Outward unit normals in the link frame :math:`(N, 3)`.
        link (torch.Tensor, optional): Index of each taxel's link :math:`(N,)`; all on one link
            if left out.
        patch (torch.Tensor, optional): Index of each taxel's patch :math:`(N,)`.
        digit (torch.Tensor, optional): Index of each taxel's digit :math:`(N,)`.
        link_names (tuple of str): Names of the links.
        patch_names (tuple of str): Names of the patches.
        digit_names (tuple of str): Names of the digits.
        adjacency (Mapping of str to torch.Tensor): Named adjacencies, each a directed
            :obj:`edge_index` :math:`(2, |\mathcal{E}|)`.
        image_map (torch.Tensor, optional): Row and column of each taxel on a 2-D map
            :math:`(N, 2)`, for convolutional networks.
        source (str): Where the numbers come from.

    Raises:
        ValueError: If a vector has another length than :obj:`pos`, an index has no name or lies
            outside of the layout, a position is not finite, a normal has no unit length, or two
            taxels share a cell of the image map.

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

    def __post_init__(self) -> None:
        pos = torch.as_tensor(self.pos, dtype=torch.float)
        if pos.dim() != 2 or pos.size(0) == 0 or pos.size(1) != 3:
            raise ValueError(f"'pos' must have shape (num_taxels, 3) (got {tuple(pos.shape)})")
        if not pos.isfinite().all():
            raise ValueError("'pos' must hold finite numbers only (got NaN or infinity)")
        self._set("pos", pos)
        for key in ("link", "patch", "digit"):
            self._set(key, self._checked_index(key))
        if self.normal is not None:
            normal = torch.as_tensor(self.normal, dtype=torch.float)
            if normal.shape != pos.shape:
                raise ValueError(
                    f"'normal' must have shape {tuple(pos.shape)} (got {tuple(normal.shape)})"
                )
            length = normal.norm(dim=1)
            if not torch.allclose(length, torch.ones_like(length), atol=1e-3):
                raise ValueError(
                    "'normal' must hold unit vectors (got a length of "
                    f"{float(length[(length - 1).abs().argmax()]):.4g})"
                )
            self._set("normal", normal)
        if self.image_map is not None:
            self._set("image_map", self._checked_image_map(self.image_map))
        self._set(
            "adjacency",
            {name: self._checked_edges(name, edges) for name, edges in self.adjacency.items()},
        )

    def _set(self, key: str, value: Any) -> None:
        object.__setattr__(self, key, value)

    def _checked_index(self, key: str) -> Tensor:
        value = getattr(self, key)
        names = tuple(getattr(self, f"{key}_names"))
        self._set(f"{key}_names", names)
        if value is None:
            return torch.zeros(self.num_taxels, dtype=torch.long)
        value = torch.as_tensor(value, dtype=torch.long)
        if value.shape != (self.num_taxels,):
            raise ValueError(
                f"'{key}' must have shape ({self.num_taxels},) (got {tuple(value.shape)})"
            )
        if int(value.min()) < 0 or int(value.max()) >= len(names):
            raise ValueError(
                f"'{key}' must hold indices into '{key}_names', 0 to {len(names) - 1} "
                f"(got {int(value.min())} to {int(value.max())})"
            )
        return value

    def _checked_image_map(self, image_map: Tensor) -> Tensor:
        image_map = torch.as_tensor(image_map, dtype=torch.long)
        if image_map.shape != (self.num_taxels, 2):
            raise ValueError(
                f"'image_map' must have shape ({self.num_taxels}, 2) (got {tuple(image_map.shape)})"
            )
        if int(image_map.min()) < 0:
            raise ValueError(
                f"'image_map' must hold rows and columns from 0 (got {int(image_map.min())})"
            )
        if len(image_map.unique(dim=0)) < self.num_taxels:
            raise ValueError("'image_map' must give every taxel a cell of its own (got a shared)")
        return image_map

    def _checked_edges(self, name: str, edge_index: Tensor) -> Tensor:
        edge_index = torch.as_tensor(edge_index, dtype=torch.long)
        if edge_index.dim() != 2 or edge_index.size(0) != 2:
            raise ValueError(
                f"adjacency '{name}' must have shape (2, num_edges) (got {tuple(edge_index.shape)})"
            )
        if edge_index.numel() and not 0 <= int(edge_index.min()) <= int(edge_index.max()) < len(
            self
        ):
            raise ValueError(
                f"adjacency '{name}' must join taxels 0 to {self.num_taxels - 1} "
                f"(got {int(edge_index.min())} to {int(edge_index.max())})"
            )
        return edge_index.contiguous()

    @property
    def num_taxels(self) -> int:
        r"""The number of taxels :math:`N`."""
        return self.pos.size(0)

    def __len__(self) -> int:
        return self.num_taxels

    def edge_index(self, name: str) -> Tensor:
        r"""Returns a named adjacency.

        Args:
            name (str): Name of the adjacency, a key of :obj:`adjacency`.

        Shapes:
            - **output:** directed edges :math:`(2, |\mathcal{E}|)`

        Raises:
            ValueError: If the layout has no such adjacency.
        """
        if name not in self.adjacency:
            known = ", ".join(f"'{key}'" for key in self.adjacency) or "none; see KNNGraph"
            raise ValueError(
                f"'name' must be an adjacency of layout '{self.name}': {known} (got '{name}')"
            )
        return self.adjacency[name]

    def segments(self, by: Literal["digit", "patch"]) -> Tensor:
        r"""Returns the segment of each taxel.

        Args:
            by (str): What a segment is, :obj:`"digit"` or :obj:`"patch"`.

        Shapes:
            - **output:** segment indices :math:`(N,)`

        Raises:
            ValueError: If :obj:`by` is neither.
        """
        if by not in _SEGMENTATIONS:
            raise ValueError(f"'by' must be one of {_SEGMENTATIONS} (got '{by}')")
        segments: Tensor = getattr(self, by)
        return segments

    def matches(self, other: "TaxelLayout") -> bool:
        r"""Tells whether both layouts have the same taxels at the same places (to a nanometre).

        Args:
            other (TaxelLayout): The layout to compare with.
        """
        return self.pos.shape == other.pos.shape and torch.allclose(
            self.pos, other.pos, rtol=0.0, atol=1e-9
        )

    def to_dict(self) -> dict[str, Any]:
        r"""Returns the layout as numbers, strings, lists and dictionaries, in metres."""
        taxels: list[dict[str, Any]] = []
        assert self.link is not None
        assert self.patch is not None
        assert self.digit is not None
        for i in range(self.num_taxels):
            taxel: dict[str, Any] = {"pos": self.pos[i].tolist()}
            if self.normal is not None:
                taxel["normal"] = self.normal[i].tolist()
            taxel["link"] = self.link_names[int(self.link[i])]
            taxel["patch"] = self.patch_names[int(self.patch[i])]
            taxel["digit"] = self.digit_names[int(self.digit[i])]
            if self.image_map is not None:
                taxel["cell"] = self.image_map[i].tolist()
            taxels.append(taxel)
        return {
            "name": self.name,
            "source": self.source,
            "unit": "m",
            "link_names": list(self.link_names),
            "patch_names": list(self.patch_names),
            "digit_names": list(self.digit_names),
            "taxels": taxels,
            "adjacency": {name: edges.t().tolist() for name, edges in self.adjacency.items()},
        }

    @classmethod
    def from_dict(cls, content: Mapping[str, Any]) -> Self:
        r"""Builds a layout from what :meth:`to_dict` returns.

        Args:
            content (Mapping): The keys :obj:`"name"`, :obj:`"unit"` (:obj:`"m"`, :obj:`"mm"` or
                :obj:`"in"`), :obj:`"taxels"` (a list of :obj:`{"pos", "normal", "link", "patch",
                "digit", "cell"}`, of which only :obj:`"pos"` is required) and, if wanted,
                :obj:`"source"`, :obj:`"adjacency"` (name to a list of pairs), and
                :obj:`"link_names"`, :obj:`"patch_names"` and :obj:`"digit_names"` (by order of
                appearance if left out). In place of :obj:`"taxels"` it may have
                :obj:`"patches"`, from which taxels and edges follow (see
                :func:`~torch_geometric_tactile.sensors.expand_patches`).

        Raises:
            ValueError: If a key is missing, the unit is unknown, or the layout is not consistent.
        """
        if "patches" in content:
            content = expand_patches(content)
        for key in ("name", "unit", "taxels"):
            if key not in content:
                raise ValueError(f"a layout must have the key '{key}' (got {sorted(content)})")
        unit = content["unit"]
        if unit not in _METRES_PER_UNIT:
            raise ValueError(f"'unit' must be one of {list(_METRES_PER_UNIT)} (got '{unit}')")
        taxels = list(content["taxels"])
        if not taxels:
            raise ValueError("'taxels' must hold at least one taxel (got none)")
        for i, taxel in enumerate(taxels):
            place = taxel.get("pos") if isinstance(taxel, Mapping) else taxel
            if taxel is place or not _are_numbers(place, 3):
                raise ValueError(f"taxel {i} must have a 'pos' of three numbers (got {place})")

        def column(key: str) -> list[Any] | None:
            given = [i for i, taxel in enumerate(taxels) if key in taxel]
            if not given:
                return None
            if len(given) < len(taxels):
                missing = sorted(set(range(len(taxels))) - set(given))[0]
                raise ValueError(f"'{key}' must stand at every taxel or at none (not at {missing})")
            return [taxel[key] for taxel in taxels]

        arguments: dict[str, Any] = {}
        for key in ("link", "patch", "digit"):
            labels = column(key)
            if labels is not None:
                names = tuple(content.get(f"{key}_names") or dict.fromkeys(labels))
                unnamed = [label for label in labels if label not in names]
                if unnamed:
                    raise ValueError(
                        f"'{key}_names' must name every {key} (got {list(names)} without "
                        f"'{unnamed[0]}')"
                    )
                arguments[key] = torch.tensor([names.index(label) for label in labels])
                arguments[f"{key}_names"] = names
        for name, pairs in content.get("adjacency", {}).items():
            if not all(_are_numbers(pair, 2) for pair in pairs):
                raise ValueError(f"adjacency '{name}' must be a list of pairs of taxels")
        normal, cells = column("normal"), column("cell")
        pos = torch.tensor([taxel["pos"] for taxel in taxels], dtype=torch.double)
        return cls(
            name=content["name"],
            pos=(pos * _METRES_PER_UNIT[unit]).float(),
            normal=None if normal is None else torch.tensor(normal, dtype=torch.float),
            image_map=None if cells is None else torch.tensor(cells),
            adjacency={
                name: torch.tensor(pairs, dtype=torch.long).view(-1, 2).t()
                for name, pairs in content.get("adjacency", {}).items()
            },
            source=content.get("source", ""),
            **arguments,
        )

    def save(self, path: PathLike) -> None:
        r"""Writes the layout as a JSON file that a person can edit.

        Args:
            path (str or PathLike): The file. It is written whole or not at all.
        """
        content = self.to_dict()
        taxels = ",\n  ".join(json.dumps(taxel) for taxel in content.pop("taxels"))
        head = json.dumps(content, indent=1)[:-2]
        with atomic_path(path) as temporary:
            temporary.write_text(f'{head},\n "taxels": [\n  {taxels}\n ]\n}}\n', encoding="utf-8")

    @classmethod
    def load(cls, path: PathLike) -> Self:
        r"""Reads a layout from a JSON file, and converts its unit to metres.

        Args:
            path (str or PathLike): A file as :meth:`save` writes it.

        Raises:
            FileNotFoundError: If there is no such file.
            ValueError: If the file is no JSON or no consistent layout; the message names the file.
        """
        try:
            content = json.loads(Path(path).read_text(encoding="utf-8"))
            if not isinstance(content, dict):
                raise ValueError(f"a layout must be a JSON object (got {type(content).__name__})")
            return cls.from_dict(content)
        except (ValueError, TypeError, RuntimeError) as error:  # JSONDecodeError is a ValueError
            raise ValueError(f"'{path}' is not a taxel layout: {error}") from error

    def __repr__(self) -> str:
        return (
            f"{type(self).__name__}('{self.name}', num_taxels={self.num_taxels}, "
            f"patches={len(self.patch_names)}, digits={len(self.digit_names)})"
        )
