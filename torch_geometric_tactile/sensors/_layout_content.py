r"""A layout as plain data: what its JSON file holds."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from torch_geometric_tactile._texts import short_repr
from torch_geometric_tactile.sensors._content_checks import (
    MOST_TAXELS,
    are_numbers,
    are_whole,
    need_mapping,
    need_text,
    need_texts,
    only_keys,
)
from torch_geometric_tactile.sensors.patches import expand_patches

if TYPE_CHECKING:
    from torch_geometric_tactile.sensors.layout import TaxelLayout

_METRES_PER_UNIT = {"m": 1.0, "mm": 1e-3, "in": 0.0254}
INDEX_KEYS = ("link", "patch", "digit")
_TAXEL_KEYS = ("pos", "normal", "tangent", *INDEX_KEYS, "cell")
_KEYS = (
    "name",
    "source",
    "unit",
    *(f"{key}_names" for key in INDEX_KEYS),
    "taxels",
    "adjacency",
)


def layout_to_content(layout: "TaxelLayout") -> dict[str, Any]:
    r"""Returns a layout as numbers, texts, lists and dictionaries, in metres."""
    taxels: list[dict[str, Any]] = [{"pos": pos} for pos in layout.pos.tolist()]
    columns: dict[str, list[Any]] = {}
    if layout.normal is not None:
        columns["normal"] = layout.normal.tolist()
    if layout.tangent is not None:
        columns["tangent"] = layout.tangent.tolist()
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
    r"""Returns the arguments of :class:`TaxelLayout` from plain data."""
    need_mapping(content, "a layout")
    if "patches" in content:
        content = expand_patches(content)
    only_keys(content, _KEYS, "a layout")
    for key in ("name", "unit", "taxels"):
        if key not in content:
            raise ValueError(f"a layout must have the key '{key}' (got {sorted(content)})")
    for key in ("name", "unit", "source"):
        need_text(content.get(key, ""), f"'{key}'")
    unit = content["unit"]
    if unit not in _METRES_PER_UNIT:
        raise ValueError(f"'unit' must be one of {list(_METRES_PER_UNIT)} (got '{unit}')")
    taxels = _checked_taxels(content["taxels"])
    normal, tangent, cells = (_column(taxels, key) for key in ("normal", "tangent", "cell"))
    pos = torch.tensor([taxel["pos"] for taxel in taxels], dtype=torch.double)
    return {
        "name": content["name"],
        "pos": (pos * _METRES_PER_UNIT[unit]).float(),
        "normal": None if normal is None else torch.tensor(normal, dtype=torch.float),
        "tangent": None if tangent is None else torch.tensor(tangent, dtype=torch.double),
        "image_map": None if cells is None else torch.tensor(cells),
        "adjacency": _adjacency(content.get("adjacency", {}), len(taxels)),
        "source": content.get("source", ""),
        **_indices(content, taxels),
    }


def _adjacency(named: Any, num_taxels: int) -> dict[str, Tensor]:
    need_mapping(named, "'adjacency'")
    out = {}
    for name, pairs in named.items():
        what = f"adjacency '{name}'"
        is_list = isinstance(pairs, list | tuple)
        if not is_list or not all(are_whole(pair, 2) for pair in pairs):
            raise ValueError(f"{what} must be a list of pairs of taxels, whole numbers")
        wrong = next((pair for pair in pairs if not 0 <= min(pair) <= max(pair) < num_taxels), None)
        if wrong is not None:
            raise ValueError(
                f"{what} must join taxels 0 to {num_taxels - 1} (got {short_repr(wrong)})"
            )
        out[name] = torch.tensor(pairs, dtype=torch.long).view(-1, 2).t()
    return out


def _indices(content: Mapping[str, Any], taxels: list[Mapping[str, Any]]) -> dict[str, Any]:
    # The index of each taxel's link, patch and digit, and their names.
    out: dict[str, Any] = {}
    for key in INDEX_KEYS:
        labels = _column(taxels, key)
        names = content.get(f"{key}_names")
        if names is not None:
            need_texts(names, f"'{key}_names'")
        if labels is None:
            if names:
                out[f"{key}_names"] = tuple(names)
            continue
        need_texts(labels, f"'{key}' of the taxels", may_repeat=True)
        number = {name: i for i, name in enumerate(names or dict.fromkeys(labels))}
        unnamed = [label for label in labels if label not in number]
        if unnamed:
            raise ValueError(
                f"'{key}_names' must name every {key} (got {list(number)} without '{unnamed[0]}')"
            )
        out[key] = torch.tensor([number[label] for label in labels])
        out[f"{key}_names"] = tuple(number)
    return out


def _checked_taxels(taxels: Any) -> list[Mapping[str, Any]]:
    if not isinstance(taxels, list | tuple):
        raise ValueError(f"'taxels' must be a list (got {type(taxels).__name__})")
    if not taxels:
        raise ValueError("'taxels' must hold at least one taxel (got none)")
    if len(taxels) > MOST_TAXELS:
        raise ValueError(f"'taxels' must be {MOST_TAXELS} at most (got {len(taxels)})")
    dims = set()
    for i, taxel in enumerate(taxels):
        place = taxel.get("pos") if isinstance(taxel, Mapping) else taxel
        if not isinstance(taxel, Mapping) or not are_numbers(place, 2, 3):
            raise ValueError(
                f"taxel {i} must have a 'pos' of two or three numbers (got {short_repr(place)})"
            )
        only_keys(taxel, _TAXEL_KEYS, f"taxel {i}")
        if "normal" in taxel and not are_numbers(taxel["normal"], 3):
            raise ValueError(
                f"'normal' of taxel {i} must be three numbers (got {short_repr(taxel['normal'])})"
            )
        tangent = taxel.get("tangent", ([0.0] * 3,) * 2)
        is_pair = isinstance(tangent, list | tuple) and len(tangent) == 2
        if not is_pair or not all(are_numbers(axis, 3) for axis in tangent):
            raise ValueError(
                f"'tangent' of taxel {i} must be two axes of three numbers (got "
                f"{short_repr(tangent)})"
            )
        if "cell" in taxel and not are_whole(taxel["cell"], 2):
            raise ValueError(
                f"'cell' of taxel {i} must be a row and a column (got {short_repr(taxel['cell'])})"
            )
        dims.add(len(taxel["pos"]))
    if len(dims) > 1:
        raise ValueError("'pos' must have as many numbers at every taxel (got two and three)")
    return list(taxels)


def _column(taxels: list[Mapping[str, Any]], key: str) -> list[Any] | None:
    missing = [i for i, taxel in enumerate(taxels) if key not in taxel]
    if len(missing) == len(taxels):
        return None
    if missing:
        raise ValueError(
            f"'{key}' must be given for every taxel or for none (not for {missing[0]})"
        )
    return [taxel[key] for taxel in taxels]
