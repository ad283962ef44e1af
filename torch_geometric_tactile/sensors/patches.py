r"""Layouts described by patches: taxels and edges follow from a few rules."""

from collections.abc import Callable, Iterator, Mapping
from itertools import pairwise
from typing import Any

import numpy as np

_SIDES = ("bottom", "top", "left", "right")
# A dome without a cylinder below it, and a capsule of a single column.
_MAY_BE_ZERO = ("straight", "column_angle")
_ADJACENCIES = ("sparse", "slanted", "original", "dense")

_Cell = tuple[int, int]  # row from the base, column of the widest row
_Edge = tuple[int, int]


def expand_patches(content: Mapping[str, Any]) -> dict[str, Any]:
    r"""Turns a layout that is described by patches into one that lists its taxels.

    The description has the keys :obj:`"shapes"` (name to :obj:`{"kind", "rows", ...}`),
    :obj:`"patches"` (a list of :obj:`{"name", "digit", "link", "shape", "origin", "cell"}` and, if
    wanted, the directions :obj:`"column"` and :obj:`"row"` in the link frame), :obj:`"joins"` (a
    list of :obj:`{"kind", "from", "to"}`) and :obj:`"one_way"` (single directed edges). Lengths are
    in the layout's :obj:`"unit"`.

    A shape's :obj:`"rows"` counts the taxels of each row from the base outwards; shorter rows are
    in the middle. A :obj:`"planar"` patch has a :obj:`"pitch"`, and :obj:`"origin"` is its centre.
    A :obj:`"capsule"` (a half cylinder with a dome at its end) has a :obj:`"pitch"` along the axis,
    a :obj:`"radius"`, the :obj:`"straight"` length of its cylinder and the
    :obj:`"column_angle"` in degrees between columns; :obj:`"origin"` is the point of its axis at
    the first row.

    Edges within a patch: :obj:`"straight"` ones join neighbours in a row and in a column,
    :obj:`"slanted"` ones diagonal neighbours. :obj:`"sparse"` keeps all those along the columns,
    but across only those listed in the shape's :obj:`"sparse_across"` (row and column of the left
    taxel). A :obj:`"seam"` joins two facing rows, each taxel with the one straight ahead (slanted:
    with its neighbours). A :obj:`"fan"` joins each taxel with all of the facing row but the one
    straight ahead, and one straight pair, :obj:`"straight"`, which :obj:`"slanted"` leaves out.

    Args:
        content (Mapping): The description.

    Returns:
        dict: What :meth:`TaxelLayout.from_dict` reads, with the adjacencies :obj:`"sparse"`,
        :obj:`"slanted"`, :obj:`"original"` and :obj:`"dense"`.

    Raises:
        ValueError: If a key is missing, a name, a side or a row is unknown, or a shape is none.
    """
    what = "a layout of patches"
    described, shapes = _need(content, "patches", what), _need(content, "shapes", what)
    patches = {_need(patch, "name", "a patch"): _Patch(patch, shapes) for patch in described}
    if len(patches) < len(described):
        raise ValueError("'patches' must have different names (got one twice)")
    taxels: list[dict[str, Any]] = []
    for patch in patches.values():
        patch.start = len(taxels)
        taxels.extend(patch.taxels())
    adjacency = {}
    for name in _ADJACENCIES:
        pairs = [edge for patch in patches.values() for edge in patch.edges(name)]
        for join in content.get("joins", ()):
            pairs.extend(_join_edges(join, patches, name))
        directed = {*pairs, *((b, a) for a, b in pairs)}
        for edge in content.get("one_way", {}).get(name, ()):
            ends = [_need(edge, end, "a one-way edge") for end in ("from", "to")]
            directed.add((_taxel(ends[0], patches), _taxel(ends[1], patches)))
        adjacency[name] = [list(edge) for edge in sorted(directed)]
    flat = {
        key: value
        for key, value in content.items()
        if key not in ("shapes", "patches", "joins", "one_way")
    }
    return {
        **flat,
        "patch_names": list(patches),
        "taxels": taxels,
        "adjacency": {**adjacency, **content.get("adjacency", {})},
    }


def _need(item: Mapping[str, Any], key: str, what: str) -> Any:
    if not isinstance(item, Mapping):
        raise ValueError(f"{what} must be a JSON object (got {item!r})")
    if key not in item:
        raise ValueError(f"{what} must have the key '{key}' (got {sorted(item)})")
    return item[key]


class _Patch:
    def __init__(self, patch: Mapping[str, Any], shapes: Mapping[str, Any]) -> None:
        self.name = str(patch["name"])
        what = f"patch '{self.name}'"
        shape = _need(patch, "shape", what)
        if shape not in shapes:
            raise ValueError(f"the shape of {what} must be one of {sorted(shapes)} (got '{shape}')")
        self.shape: Mapping[str, Any] = shapes[shape]
        self.patch = patch
        self.start = 0
        rows = _need(self.shape, "rows", f"shape '{shape}'")
        if not rows or not all(isinstance(row, int) and row > 0 for row in rows):
            raise ValueError(
                f"the rows of shape '{shape}' must count at least one taxel each (got {rows})"
            )
        self.width = max(rows)
        if any((self.width - row) % 2 for row in rows):
            raise ValueError(
                f"the rows of shape '{shape}' must be all even or all odd, so that shorter ones "
                f"are in the middle (got {rows})"
            )
        self.cells: list[_Cell] = [
            (row, (self.width - count) // 2 + column)
            for row, count in enumerate(rows)
            for column in range(count)
        ]
        self.number = {cell: i for i, cell in enumerate(self.cells)}
        self.across: set[_Cell] = {(row, col) for row, col in self.shape.get("sparse_across", ())}
        for row, col in sorted(self.across):
            if not {(row, col), (row, col + 1)} <= self.number.keys():
                raise ValueError(
                    f"'sparse_across' of shape '{shape}' must list taxels with a neighbour to "
                    f"their right (got {[row, col]})"
                )
        kind = _need(self.shape, "kind", f"shape '{shape}'")
        if kind not in _SURFACES:
            raise ValueError(
                f"the kind of shape '{shape}' must be one of {sorted(_SURFACES)} (got '{kind}')"
            )
        self.surface, sizes = _SURFACES[kind]
        for size in sizes:
            value = _need(self.shape, size, f"shape '{shape}'")
            if not value >= 0:
                raise ValueError(f"'{size}' of shape '{shape}' must not be negative (got {value})")
            if value == 0 and size not in _MAY_BE_ZERO:
                raise ValueError(f"'{size}' of shape '{shape}' must not be zero")

    def taxels(self) -> Iterator[dict[str, Any]]:
        what = f"patch '{self.name}'"
        origin = np.array(_need(self.patch, "origin", what), dtype=float)
        column = _unit(self.patch.get("column", (0, 1, 0)))
        row = _unit(self.patch.get("row", (0, 0, 1)))
        if abs(column @ row) > 1e-6:
            raise ValueError(f"'column' and 'row' of {what} must be at right angles")
        frame = np.stack([column, row, np.cross(column, row)], axis=1)
        top, left = self.patch.get("cell", (0, 0))
        last = self.cells[-1][0]
        for number, side in self.cells:
            pos, normal = self.surface(self.shape, number, side - (self.width - 1) / 2)
            taxel = {
                "pos": (origin + frame @ pos).round(9).tolist(),
                "normal": (frame @ normal).round(9).tolist(),
                "link": _need(self.patch, "link", what),
                "patch": self.name,
                "digit": _need(self.patch, "digit", what),
            }
            if "cell" in self.patch:
                taxel["cell"] = [top + last - number, left + side]
            yield taxel

    def edges(self, name: str) -> Iterator[_Edge]:
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

    def taxel(self, cell: _Cell) -> int:
        return self.start + self.number[cell]

    def side(self, side: str) -> list[int]:
        if side in ("bottom", "top"):
            row = 0 if side == "bottom" else self.cells[-1][0]
            return [self.taxel(cell) for cell in self.cells if cell[0] == row]
        rows = range(self.cells[-1][0] + 1)
        best = min if side == "left" else max
        return [self.taxel(best(cell for cell in self.cells if cell[0] == row)) for row in rows]


def _unit(vector: Any) -> np.ndarray:
    vector = np.array(vector, dtype=float)
    return vector / np.linalg.norm(vector)


def _planar(shape: Mapping[str, Any], row: int, column: float) -> tuple[np.ndarray, np.ndarray]:
    middle = (len(shape["rows"]) - 1) / 2
    pos = np.array([column, row - middle, 0.0]) * shape["pitch"]
    return pos, np.array([0.0, 0.0, 1.0])


def _capsule(shape: Mapping[str, Any], row: int, column: float) -> tuple[np.ndarray, np.ndarray]:
    radius, straight = shape["radius"], shape["straight"]
    angle = np.deg2rad(column * shape["column_angle"])
    along = row * shape["pitch"]
    # A normal of the cylinder, bent over the dome where the row lies beyond the straight part.
    bend = max(0.0, along - straight) / radius
    out = np.cos(angle)
    normal = np.array([np.sin(angle), out * np.sin(bend), out * np.cos(bend)])
    return np.array([0.0, min(along, straight), 0.0]) + radius * normal, normal


_Surface = Callable[[Mapping[str, Any], int, float], tuple[np.ndarray, np.ndarray]]
_SURFACES: dict[str, tuple[_Surface, tuple[str, ...]]] = {
    "planar": (_planar, ("pitch",)),
    "capsule": (_capsule, ("pitch", "radius", "straight", "column_angle")),
}


def _facing(join: Mapping[str, Any], patches: Mapping[str, _Patch]) -> tuple[list[int], list[int]]:
    rows = []
    for end in ("from", "to"):
        place = _need(join, end, "a join")
        if not isinstance(place, list | tuple) or len(place) != 2:
            raise ValueError(f"an end of a join must be [patch, side] (got {place!r})")
        name, side = place
        if name not in patches:
            raise ValueError(f"a join must name patches (got '{name}')")
        if side not in _SIDES:
            raise ValueError(f"the side of a join must be one of {_SIDES} (got '{side}')")
        rows.append(patches[name].side(side))
    if len(rows[0]) != len(rows[1]):
        raise ValueError(
            f"the facing rows of the join from {join['from']} to {join['to']} must be equally long "
            f"(got {len(rows[0])} and {len(rows[1])})"
        )
    if join.get("reverse", False):
        rows[1].reverse()
    return rows[0], rows[1]


def _join_edges(
    join: Mapping[str, Any], patches: Mapping[str, _Patch], name: str
) -> Iterator[_Edge]:
    first, second = _facing(join, patches)
    kind = _need(join, "kind", "a join")
    if kind == "seam":
        if name != "slanted":
            yield from zip(first, second, strict=True)
        if name in ("slanted", "dense"):
            for (a, next_a), (b, next_b) in zip(pairwise(first), pairwise(second), strict=True):
                yield a, next_b
                yield next_a, b
    elif kind == "fan":
        for i, a in enumerate(first):
            yield from ((a, b) for k, b in enumerate(second) if k != i)
        if name != "slanted":
            straight = _need(join, "straight", "a fan")
            if straight not in range(len(first)):
                raise ValueError(
                    f"'straight' of a fan must be 0 to {len(first) - 1} (got {straight})"
                )
            yield first[straight], second[straight]
    else:
        raise ValueError(f"the kind of a join must be 'seam' or 'fan' (got '{kind}')")


def _taxel(place: Any, patches: Mapping[str, _Patch]) -> int:
    name, *cell = place
    if name not in patches or tuple(cell) not in patches[name].number:
        raise ValueError(
            f"a one-way edge must join taxels, as [patch, row, column] (got {list(place)})"
        )
    row, column = cell
    return patches[name].taxel((row, column))
