r"""Conversion of plain data (the content of a JSON file) to the arguments of a layout."""

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._texts import short_repr
from torch_geometric_tactile.sensors._content_checks import (
    MAX_TAXELS,
    are_integers,
    are_numbers,
    need_mapping,
    need_only_keys,
    need_text,
    need_texts,
)
from torch_geometric_tactile.sensors.patches import expand_patches

_METRES_PER_UNIT = {"m": 1.0, "mm": 1e-3, "in": 0.0254}
INDEX_KEYS = ("link", "patch", "digit")
_TAXEL_KEYS = ("pos", "normal", "tangent", *INDEX_KEYS, "cell")
# Checks of optional values of a taxel, and the requirement in the error message.
_CHECKS = {
    "normal": (lambda value: are_numbers(value, 3), "three numbers"),
    "tangent": (lambda value: _are_axes(value), "two axes of three numbers"),
    "cell": (lambda value: are_integers(value, 2), "a row and a column"),
}
_KEYS = (
    "name",
    "source",
    "unit",
    *(f"{key}_names" for key in INDEX_KEYS),
    "taxels",
    "adjacency",
)


def layout_arguments(content: Mapping[str, Any]) -> dict[str, Any]:
    r"""Returns the arguments of :class:`TaxelLayout` from plain data."""
    need_mapping(content, "a layout")
    if "patches" in content:
        content = expand_patches(content)
    need_only_keys(content, _KEYS, "a layout")
    for key in ("name", "unit", "taxels"):
        if key not in content:
            raise ValueError(f"a layout must have the key '{key}' (got {sorted(content)})")
    for key in ("name", "unit", "source"):
        need_text(content.get(key, ""), f"'{key}'")
    unit = content["unit"]
    need(unit in _METRES_PER_UNIT, f"'unit' must be one of {list(_METRES_PER_UNIT)} (got '{unit}')")
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


def _adjacency(pairs_by_name: Any, num_taxels: int) -> dict[str, Tensor]:
    need_mapping(pairs_by_name, "'adjacency'")
    adjacency = {}
    for name, pairs in pairs_by_name.items():
        subject = f"adjacency '{name}'"
        is_list = isinstance(pairs, list | tuple)
        if not is_list or not all(are_integers(pair, 2) for pair in pairs):
            raise ValueError(f"{subject} must be a list of pairs of taxel indices")
        outside = next(
            (pair for pair in pairs if not 0 <= min(pair) <= max(pair) < num_taxels), None
        )
        if outside is not None:
            raise ValueError(
                f"{subject} must join taxels 0 to {num_taxels - 1} (got {short_repr(outside)})"
            )
        adjacency[name] = torch.tensor(pairs, dtype=torch.long).view(-1, 2).t()
    return adjacency


def _indices(content: Mapping[str, Any], taxels: list[Mapping[str, Any]]) -> dict[str, Any]:
    # The index of each taxel's link, patch and digit, and their names.
    arguments: dict[str, Any] = {}
    for key in INDEX_KEYS:
        labels = _column(taxels, key)
        names = content.get(f"{key}_names")
        if names is not None:
            need_texts(names, f"'{key}_names'")
        if labels is None:
            if names:
                arguments[f"{key}_names"] = tuple(names)
            continue
        need_texts(labels, f"'{key}' of the taxels", may_repeat=True)
        index = {name: i for i, name in enumerate(names or dict.fromkeys(labels))}
        unnamed = [label for label in labels if label not in index]
        if unnamed:
            raise ValueError(
                f"'{key}_names' must name every {key} (got {list(index)} without '{unnamed[0]}')"
            )
        arguments[key] = torch.tensor([index[label] for label in labels])
        arguments[f"{key}_names"] = tuple(index)
    return arguments


def _checked_taxels(taxels: Any) -> list[Mapping[str, Any]]:
    if not isinstance(taxels, list | tuple):
        raise ValueError(f"'taxels' must be a list (got {type(taxels).__name__})")
    need(taxels, "'taxels' must hold at least one taxel (got none)")
    need(len(taxels) <= MAX_TAXELS, f"'taxels' must hold at most {MAX_TAXELS} taxels", len(taxels))
    dims = set()
    for i, taxel in enumerate(taxels):
        pos = taxel.get("pos") if isinstance(taxel, Mapping) else taxel
        if not isinstance(taxel, Mapping) or not are_numbers(pos, 2, 3):
            raise ValueError(
                f"taxel {i} must have a 'pos' of two or three numbers (got {short_repr(pos)})"
            )
        need_only_keys(taxel, _TAXEL_KEYS, f"taxel {i}")
        for key, (is_valid, requirement) in _CHECKS.items():
            if key in taxel and not is_valid(taxel[key]):
                raise ValueError(
                    f"'{key}' of taxel {i} must be {requirement} (got {short_repr(taxel[key])})"
                )
        dims.add(len(taxel["pos"]))
    need(len(dims) <= 1, "'pos' must have the same length for all taxels (got 2 and 3)")
    return list(taxels)


def _are_axes(value: Any) -> bool:
    is_pair = isinstance(value, list | tuple) and len(value) == 2
    return is_pair and all(are_numbers(axis, 3) for axis in value)


def _column(taxels: list[Mapping[str, Any]], key: str) -> list[Any] | None:
    # The values of a key for all taxels, or None if no taxel has the key.
    missing = [i for i, taxel in enumerate(taxels) if key not in taxel]
    if len(missing) == len(taxels):
        return None
    if missing:
        raise ValueError(
            f"'{key}' must be given for every taxel or for none (missing for taxel {missing[0]})"
        )
    return [taxel[key] for taxel in taxels]
