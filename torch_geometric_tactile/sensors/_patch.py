r"""Patches of taxels, described by their shapes."""

from collections.abc import Callable, Iterator, Mapping
from functools import cached_property
from typing import Any

import numpy as np

from torch_geometric_tactile._texts import short_repr
from torch_geometric_tactile.sensors._content_checks import (
    are_integers,
    are_numbers,
    is_integer,
    is_number,
    is_one_of,
    need_key,
    need_list,
    need_only_keys,
    need_text,
)

_PATCH_KEYS = ("name", "digit", "link", "shape", "origin", "cell", "column", "row")
# Sizes that may be zero: a dome without a cylinder, and a capsule of a single column.
_MAY_BE_ZERO = ("straight", "column_angle")
_POLE_SINE = 1e-3  # sine of the angle between normal and rows below which a taxel is at the pole

Cell = tuple[int, int]  # row from the base, column of the widest row
Edge = tuple[int, int]


class Patch:
    r"""A patch of taxels. Its cells and taxels are computed when they are needed, so that a caller
    can check their number first.
    """

    def __init__(self, patch: Mapping[str, Any], shapes: Mapping[str, Any], start: int) -> None:
        self.name: str = need_key(patch, "name", "a patch")
        need_text(self.name, "the name of a patch")
        what = f"patch '{self.name}'"
        need_only_keys(patch, _PATCH_KEYS, what)
        shape = need_key(patch, "shape", what)
        if not is_one_of(shape, shapes):
            raise ValueError(
                f"the shape of {what} must be one of {sorted(shapes)} (got {short_repr(shape)})"
            )
        self.shape: Mapping[str, Any] = shapes[shape]
        for key in ("link", "digit"):
            need_text(need_key(patch, key, what), f"the {key} of {what}")
        self.patch = patch
        self.origin = _vector(need_key(patch, "origin", what), f"'origin' of {what}")
        self.cell = patch.get("cell")
        if self.cell is not None and not are_integers(self.cell, 2):
            raise ValueError(
                f"'cell' of {what} must be a row and a column (got {short_repr(self.cell)})"
            )
        self.start = start
        self.rows = _checked_rows(self.shape, shape)
        self.num_taxels = sum(self.rows)
        self.width = max(self.rows)
        self.across = _checked_across(self.shape, shape, self)
        self.surface = _checked_surface(self.shape, shape)

    def first(self, row: int) -> int:
        r"""Returns the first column of a row."""
        return (self.width - self.rows[row]) // 2

    def has(self, cell: Cell) -> bool:
        r"""Returns whether a cell has a taxel."""
        row, column = cell
        if not 0 <= row < len(self.rows):
            return False
        return self.first(row) <= column < self.first(row) + self.rows[row]

    @cached_property
    def cells(self) -> list[Cell]:
        r"""Row and column of each taxel."""
        return [
            (row, self.first(row) + column)
            for row, count in enumerate(self.rows)
            for column in range(count)
        ]

    @cached_property
    def number(self) -> dict[Cell, int]:
        r"""The index of the taxel in each cell, from zero."""
        return {cell: i for i, cell in enumerate(self.cells)}

    def taxels(self) -> Iterator[dict[str, Any]]:
        r"""Yields the taxels in the form of a layout file."""
        what = f"patch '{self.name}'"
        column = _unit(self.patch.get("column", (0, 1, 0)), f"'column' of {what}")
        row = _unit(self.patch.get("row", (0, 0, 1)), f"'row' of {what}")
        if abs(column @ row) > 1e-6:
            raise ValueError(f"'column' and 'row' of {what} must be at right angles")
        frame = np.stack([column, row, np.cross(column, row)], axis=1)
        top, left = self.cell or (0, 0)
        last = self.cells[-1][0]
        for row_index, column_index in self.cells:
            pos, normal = self.surface(self.shape, row_index, column_index - (self.width - 1) / 2)
            normal = (frame @ normal).round(9)
            taxel = {
                "pos": (self.origin + frame @ pos).round(9).tolist(),
                "normal": normal.tolist(),
                "tangent": _tangent(normal, frame).tolist(),
                "link": self.patch["link"],
                "patch": self.name,
                "digit": self.patch["digit"],
            }
            if self.cell is not None:
                taxel["cell"] = [top + last - row_index, left + column_index]
            yield taxel

    def edges(self, name: str) -> Iterator[Edge]:
        r"""Yields the edges of an adjacency within the patch, each in one direction."""
        for row, column in self.cells:
            steps = []
            if name != "slanted":
                steps.append((row + 1, column))
                if name != "sparse" or (row, column) in self.across:
                    steps.append((row, column + 1))
            if name in ("slanted", "dense"):
                steps += [(row + 1, column - 1), (row + 1, column + 1)]
            for cell in steps:
                if cell in self.number:
                    yield self.taxel((row, column)), self.taxel(cell)

    def taxel(self, cell: Cell) -> int:
        r"""Returns the index of a taxel in the layout."""
        return self.start + self.number[cell]

    def side(self, side: str) -> list[int]:
        r"""Returns the indices of the taxels of a side in the layout."""
        if side in ("bottom", "top"):
            row = 0 if side == "bottom" else len(self.rows) - 1
            return [self.taxel((row, self.first(row) + i)) for i in range(self.rows[row])]
        return [
            self.taxel((row, self.first(row) + (0 if side == "left" else count - 1)))
            for row, count in enumerate(self.rows)
        ]

    def side_length(self, side: str) -> int:
        r"""Returns the number of taxels of a side."""
        if side in ("bottom", "top"):
            return self.rows[0 if side == "bottom" else -1]
        return len(self.rows)


def _checked_rows(shape: Mapping[str, Any], name: str) -> list[int]:
    rows = need_key(shape, "rows", f"shape '{name}'")
    if (
        not isinstance(rows, list | tuple)
        or not rows
        or not all(is_integer(r) and r > 0 for r in rows)
    ):
        raise ValueError(
            f"the rows of shape '{name}' must have at least one taxel each (got {short_repr(rows)})"
        )
    if any((max(rows) - row) % 2 for row in rows):
        raise ValueError(
            f"the rows of shape '{name}' must be all even or all odd, so that shorter ones "
            f"are in the middle (got {short_repr(rows)})"
        )
    return list(rows)


def _checked_across(shape: Mapping[str, Any], name: str, patch: Patch) -> set[Cell]:
    across = need_list(shape.get("sparse_across", ()), f"'sparse_across' of shape '{name}'")
    for cell in across:
        is_cell = are_integers(cell, 2)
        if not is_cell or not patch.has(tuple(cell)) or not patch.has((cell[0], cell[1] + 1)):
            raise ValueError(
                f"'sparse_across' of shape '{name}' must list taxels with a neighbour to "
                f"their right (got {short_repr(cell)})"
            )
    return {(row, column) for row, column in across}


def _checked_surface(shape: Mapping[str, Any], name: str) -> "_Surface":
    what = f"shape '{name}'"
    kind = need_key(shape, "kind", what)
    if not is_one_of(kind, _SURFACES):
        raise ValueError(
            f"the kind of {what} must be one of {sorted(_SURFACES)} (got {short_repr(kind)})"
        )
    surface, sizes = _SURFACES[kind]
    need_only_keys(shape, ("kind", "rows", "sparse_across", *sizes), what)
    for size in sizes:
        value = need_key(shape, size, what)
        if not is_number(value):
            raise ValueError(f"'{size}' of {what} must be a number (got {short_repr(value)})")
        if value < 0:
            raise ValueError(f"'{size}' of {what} must not be negative (got {short_repr(value)})")
        if value == 0 and size not in _MAY_BE_ZERO:
            raise ValueError(f"'{size}' of {what} must not be zero")
    return surface


def _vector(value: Any, what: str) -> np.ndarray:
    if not are_numbers(value, 3):
        raise ValueError(f"{what} must be three numbers (got {short_repr(value)})")
    return np.array(value, dtype=float)


def _unit(value: Any, what: str) -> np.ndarray:
    vector = _vector(value, what)
    length = np.linalg.norm(vector)
    if length == 0:
        raise ValueError(f"{what} must have a direction (got {short_repr(value)})")
    return vector / length


def _tangent(normal: np.ndarray, frame: np.ndarray) -> np.ndarray:
    # The x and y axes of a taxel (2, 3). The y axis is the direction of the patch's rows, projected
    # onto the skin. At the pole of a dome, where that direction is normal to the skin, it continues
    # the path over the dome.
    normal = normal.astype(np.float32).astype(float)  # the precision of a layout
    _, row, up = frame.T
    projection = row - (normal @ row) * normal
    if np.linalg.norm(projection) < _POLE_SINE:
        projection = (normal @ up) * normal - up
    y = projection / np.sqrt((projection**2).sum())
    return np.stack([np.cross(y, normal), y])


def _planar(shape: Mapping[str, Any], row: int, column: float) -> tuple[np.ndarray, np.ndarray]:
    centre_row = (len(shape["rows"]) - 1) / 2
    pos = np.array([column, row - centre_row, 0.0]) * shape["pitch"]
    return pos, np.array([0.0, 0.0, 1.0])


def _capsule(shape: Mapping[str, Any], row: int, column: float) -> tuple[np.ndarray, np.ndarray]:
    radius, straight = shape["radius"], shape["straight"]
    angle = np.deg2rad(column * shape["column_angle"])
    distance = row * shape["pitch"]  # along the axis, and then over the dome
    # The normal is that of the cylinder, bent over the dome beyond its straight length.
    bend = max(0.0, distance - straight) / radius
    cosine = np.cos(angle)
    normal = np.array([np.sin(angle), cosine * np.sin(bend), cosine * np.cos(bend)])
    return np.array([0.0, min(distance, straight), 0.0]) + radius * normal, normal


_Surface = Callable[[Mapping[str, Any], int, float], tuple[np.ndarray, np.ndarray]]
_SURFACES: dict[str, tuple[_Surface, tuple[str, ...]]] = {
    "planar": (_planar, ("pitch",)),
    "capsule": (_capsule, ("pitch", "radius", "straight", "column_angle")),
}
