r"""A layout as plain data: what its JSON file holds."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import torch

from torch_geometric_tactile.sensors.patches import expand_patches

if TYPE_CHECKING:
    from torch_geometric_tactile.sensors.layout import TaxelLayout

_METRES_PER_UNIT = {"m": 1.0, "mm": 1e-3, "in": 0.0254}
INDEX_KEYS = ("link", "patch", "digit")


def layout_to_content(layout: "TaxelLayout") -> dict[str, Any]:
    r"""Returns a layout as numbers, texts, lists and dictionaries, in metres.

    Args:
        layout (TaxelLayout): The layout.
    """
    taxels: list[dict[str, Any]] = [{"pos": pos} for pos in layout.pos.tolist()]
    columns: dict[str, list[Any]] = {}
    if layout.normal is not None:
        columns["normal"] = layout.normal.tolist()
    for key in INDEX_KEYS:
        names = getattr(layout, f"{key}_names")
        columns[key] = [names[i] for i in getattr(layout, key).tolist()]
    if layout.image_map is not None:
        columns["cell"] = layout.image_map.tolist()
    for key, values in columns.items():
        for taxel, value in zip(taxels, values, strict=True):
            taxel[key] = value
    return {
        "name": layout.name,
        "source": layout.source,
        "unit": "m",
        "link_names": list(layout.link_names),
        "patch_names": list(layout.patch_names),
        "digit_names": list(layout.digit_names),
        "taxels": taxels,
        "adjacency": {name: edges.t().tolist() for name, edges in layout.adjacency.items()},
    }


def layout_arguments(content: Mapping[str, Any]) -> dict[str, Any]:
    r"""Returns the arguments of :class:`TaxelLayout` from plain data.

    Args:
        content (Mapping): As of :meth:`TaxelLayout.from_dict`.

    Raises:
        ValueError: If a key is missing, the unit is unknown, or the taxels are not consistent.
    """
    if "patches" in content:
        content = expand_patches(content)
    for key in ("name", "unit", "taxels"):
        if key not in content:
            raise ValueError(f"a layout must have the key '{key}' (got {sorted(content)})")
    unit = content["unit"]
    if unit not in _METRES_PER_UNIT:
        raise ValueError(f"'unit' must be one of {list(_METRES_PER_UNIT)} (got '{unit}')")
    taxels = _checked_taxels(content["taxels"])
    arguments: dict[str, Any] = {}
    for key in INDEX_KEYS:
        labels = _column(taxels, key)
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
    normal, cells = _column(taxels, "normal"), _column(taxels, "cell")
    pos = torch.tensor([taxel["pos"] for taxel in taxels], dtype=torch.double)
    return {
        "name": content["name"],
        "pos": (pos * _METRES_PER_UNIT[unit]).float(),
        "normal": None if normal is None else torch.tensor(normal, dtype=torch.float),
        "image_map": None if cells is None else torch.tensor(cells),
        "adjacency": {
            name: torch.tensor(pairs, dtype=torch.long).view(-1, 2).t()
            for name, pairs in content.get("adjacency", {}).items()
        },
        "source": content.get("source", ""),
        **arguments,
    }


def _checked_taxels(taxels: Any) -> list[Mapping[str, Any]]:
    taxels = list(taxels)
    if not taxels:
        raise ValueError("'taxels' must hold at least one taxel (got none)")
    dims = set()
    for i, taxel in enumerate(taxels):
        place = taxel.get("pos") if isinstance(taxel, Mapping) else taxel
        if not isinstance(taxel, Mapping) or not _are_numbers(place, 2, 3):
            raise ValueError(f"taxel {i} must have a 'pos' of two or three numbers (got {place})")
        dims.add(len(taxel["pos"]))
    if len(dims) > 1:
        raise ValueError("'pos' must have as many numbers at every taxel (got two and three)")
    return taxels


def _column(taxels: list[Mapping[str, Any]], key: str) -> list[Any] | None:
    missing = [i for i, taxel in enumerate(taxels) if key not in taxel]
    if len(missing) == len(taxels):
        return None
    if missing:
        raise ValueError(
            f"'{key}' must be given for every taxel or for none (not for {missing[0]})"
        )
    return [taxel[key] for taxel in taxels]


def _are_numbers(value: Any, *counts: int) -> bool:
    return (
        isinstance(value, list | tuple)
        and len(value) in counts
        and all(isinstance(number, int | float) for number in value)
    )
