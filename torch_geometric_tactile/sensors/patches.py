r"""Expansion of layouts that are described by patches into taxels and edges."""

from collections.abc import Callable, Iterator, Mapping
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._texts import short_repr
from torch_geometric_tactile.sensors._content_checks import (
    are_integers,
    are_numbers,
    is_integer,
    is_number,
    is_one_of,
    need_key,
    need_list,
    need_mapping,
    need_only_keys,
    need_text,
)

# Limits for untrusted files: a few bytes could describe any number of taxels and edges.
_MAX_TAXELS = 100_000
_MAX_JOINED_PAIRS = 1_000_000
_DESCRIPTION_KEYS = ("shapes", "patches", "joins", "one_way")  # not in an expanded layout
_JOIN_KEYS = {
    "seam": ("kind", "from", "to", "reverse"),
    "fan": ("kind", "from", "to", "reverse", "straight"),
}
_SIDES = ("bottom", "top", "left", "right")
_ADJACENCIES = ("sparse", "slanted", "original", "dense")
_PATCH_KEYS = ("name", "digit", "link", "shape", "origin", "cell", "column", "row")
# Sizes that may be zero: a dome without a cylinder, and a capsule of a single column.
_MAY_BE_ZERO = ("straight", "column_angle")
_POLE_SINE = 1e-3  # sine of the angle between normal and rows below which a taxel is at the pole

_Cell = tuple[int, int]  # row from the base, column of the widest row
_Edge = tuple[int, int]


def expand_patches(content: Mapping[str, Any]) -> dict[str, Any]:
    r"""Expands a layout that is described by patches into a layout that lists every taxel.

    The description has the keys :obj:`"shapes"` (name to :obj:`{"kind", "rows", ...}`),
    :obj:`"patches"` (a list of :obj:`{"name", "digit", "link", "shape", "origin", "cell"}` and
    optionally the directions :obj:`"column"` and :obj:`"row"` in the link frame), :obj:`"joins"` (a
    list of :obj:`{"kind", "from", "to"}`) and :obj:`"one_way"` (single directed edges). Lengths are
    in the layout's :obj:`"unit"`.

    The :obj:`"rows"` of a shape list the number of taxels in each row, from the base outwards.
    Shorter rows are centred. A :obj:`"planar"` patch has a :obj:`"pitch"`, and its :obj:`"origin"`
    is its centre. A :obj:`"capsule"` (a half cylinder with a dome at its end) has a
    :obj:`"pitch"` along the axis, a :obj:`"radius"`, the :obj:`"straight"` length of its cylinder
    and the :obj:`"column_angle"` in degrees between columns. Its :obj:`"origin"` is the point on
    its axis at the first row. The :math:`y` axis of a taxel (in :obj:`"tangent"`) is the direction
    :obj:`"row"` projected onto the skin. Its :math:`x` axis is :math:`y \times n`, which equals
    :obj:`"column"` where the patch is flat.

    The adjacency :obj:`"original"` joins neighbours in a row or a column, :obj:`"slanted"` joins
    diagonal neighbours, and :obj:`"dense"` joins both. :obj:`"sparse"` has all edges along the
    columns. Across the columns it has only the edges listed in the shape's :obj:`"sparse_across"`
    (row and column of the left taxel).

    A :obj:`"seam"` joins each taxel of a row with the taxel straight ahead in the facing row. In
    :obj:`"slanted"` it joins each taxel with the neighbours of that taxel instead, and in
    :obj:`"dense"` with both. A :obj:`"fan"` joins each taxel with all taxels of the facing row
    except the taxel straight ahead. It also adds one straight pair, :obj:`"straight"`, which is not
    in :obj:`"slanted"`. An end of a join is :obj:`[patch, side]`, or :obj:`[patch, side, first,
    last]` for a range of its taxels.

    Args:
        content (Mapping): The description.

    Returns:
        dict: The argument of :meth:`TaxelLayout.from_dict`, with the adjacencies :obj:`"sparse"`,
        :obj:`"slanted"`, :obj:`"original"` and :obj:`"dense"`.

    Raises:
        ValueError: If a key is missing, a name, side, row or shape is unknown, or the description
            has too many taxels or edges.

    Examples:
        >>> tile = {"kind": "planar", "rows": [2, 2], "pitch": 2, "sparse_across": [[0, 0]]}
        >>> patch = {"name": "low", "digit": "pad", "link": "base", "shape": "tile"}
        >>> patch |= {"origin": [0, 0, 0], "cell": [0, 0]}
        >>> content = {"name": "tile", "unit": "mm", "shapes": {"tile": tile}, "patches": [patch]}
        >>> expanded = expand_patches(content)
        >>> len(expanded["taxels"]), len(expanded["adjacency"]["dense"])  # taxels, directed edges
        (4, 12)
    """
    subject = "a layout of patches"
    items, shapes = need_key(content, "patches", subject), need_key(content, "shapes", subject)
    need("taxels" not in content, f"{subject} must not have 'taxels' as well (got both)")
    need_mapping(shapes, "'shapes'")
    patches: dict[str, _Patch] = {}
    num_taxels = 0
    for item in need_list(items, "'patches'"):
        patch = _Patch(item, shapes, num_taxels)
        if patch.name in patches:
            raise ValueError(f"'patches' must have different names (got '{patch.name}' twice)")
        patches[patch.name] = patch
        num_taxels += patch.num_taxels
        _check_count("taxels", num_taxels, _MAX_TAXELS)
    joins = [_Join(join, patches) for join in need_list(content.get("joins", ()), "'joins'")]
    _check_count(
        "pairs of taxels in joins", sum(join.max_pairs for join in joins), _MAX_JOINED_PAIRS
    )
    one_way = _one_way(content.get("one_way", {}), patches)
    taxels = [taxel for patch in patches.values() for taxel in patch.taxels()]
    adjacency = {}
    for name in _ADJACENCIES:
        pairs = [edge for patch in patches.values() for edge in patch.edges(name)]
        pairs += [edge for join in joins for edge in join.edges(name)]
        directed = {*pairs, *((b, a) for a, b in pairs), *one_way.get(name, ())}
        adjacency[name] = [list(edge) for edge in sorted(directed)]
    layout_content = {key: value for key, value in content.items() if key not in _DESCRIPTION_KEYS}
    listed_adjacency = content.get("adjacency", {})
    need_mapping(listed_adjacency, "'adjacency'")
    return {
        **layout_content,
        "patch_names": list(patches),
        "taxels": taxels,
        "adjacency": {**adjacency, **listed_adjacency},
    }


def _check_count(items: str, count: int, maximum: int) -> None:
    need(count <= maximum, f"a layout of patches must have at most {maximum} {items}", count)


class _Patch:
    r"""A patch of taxels. Its cells and taxels are computed on first use, so that a caller can
    check their number first.
    """

    def __init__(self, patch: Mapping[str, Any], shapes: Mapping[str, Any], start: int) -> None:
        self.name: str = need_key(patch, "name", "a patch")
        need_text(self.name, "the name of a patch")
        subject = f"patch '{self.name}'"
        need_only_keys(patch, _PATCH_KEYS, subject)
        shape = need_key(patch, "shape", subject)
        if not is_one_of(shape, shapes):
            raise ValueError(
                f"the shape of {subject} must be one of {sorted(shapes)} (got {short_repr(shape)})"
            )
        self.shape: Mapping[str, Any] = shapes[shape]
        for key in ("link", "digit"):
            need_text(need_key(patch, key, subject), f"the {key} of {subject}")
        self.patch = patch
        self.origin = _vector(need_key(patch, "origin", subject), f"'origin' of {subject}")
        self.cell = patch.get("cell")
        if self.cell is not None and not are_integers(self.cell, 2):
            raise ValueError(
                f"'cell' of {subject} must be a row and a column (got {short_repr(self.cell)})"
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

    def has(self, cell: _Cell) -> bool:
        r"""Returns whether a cell has a taxel."""
        row, column = cell
        if not 0 <= row < len(self.rows):
            return False
        return self.first(row) <= column < self.first(row) + self.rows[row]

    @cached_property
    def cells(self) -> list[_Cell]:
        r"""Row and column of each taxel."""
        return [
            (row, self.first(row) + column)
            for row, count in enumerate(self.rows)
            for column in range(count)
        ]

    @cached_property
    def number(self) -> dict[_Cell, int]:
        r"""The index of the taxel in each cell, from zero."""
        return {cell: i for i, cell in enumerate(self.cells)}

    def taxels(self) -> Iterator[dict[str, Any]]:
        r"""Yields the taxels in the form of a layout file."""
        subject = f"patch '{self.name}'"
        column = _unit(self.patch.get("column", (0, 1, 0)), f"'column' of {subject}")
        row = _unit(self.patch.get("row", (0, 0, 1)), f"'row' of {subject}")
        if abs(column @ row) > 1e-6:
            raise ValueError(f"'column' and 'row' of {subject} must be at right angles")
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

    def edges(self, name: str) -> Iterator[_Edge]:
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

    def taxel(self, cell: _Cell) -> int:
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


def _checked_across(shape: Mapping[str, Any], name: str, patch: _Patch) -> set[_Cell]:
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
    subject = f"shape '{name}'"
    kind = need_key(shape, "kind", subject)
    if not is_one_of(kind, _SURFACES):
        raise ValueError(
            f"the kind of {subject} must be one of {sorted(_SURFACES)} (got {short_repr(kind)})"
        )
    surface, sizes = _SURFACES[kind]
    need_only_keys(shape, ("kind", "rows", "sparse_across", *sizes), subject)
    for size in sizes:
        value = need_key(shape, size, subject)
        if not is_number(value):
            raise ValueError(f"'{size}' of {subject} must be a number (got {short_repr(value)})")
        if value < 0:
            raise ValueError(
                f"'{size}' of {subject} must not be negative (got {short_repr(value)})"
            )
        if value == 0 and size not in _MAY_BE_ZERO:
            raise ValueError(f"'{size}' of {subject} must not be zero")
    return surface


def _vector(value: Any, subject: str) -> np.ndarray:
    if not are_numbers(value, 3):
        raise ValueError(f"{subject} must be three numbers (got {short_repr(value)})")
    return np.array(value, dtype=float)


def _unit(value: Any, subject: str) -> np.ndarray:
    vector = _vector(value, subject)
    length = np.linalg.norm(vector)
    if length == 0:
        raise ValueError(f"{subject} must have a direction (got {short_repr(value)})")
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
    # The normal of the cylinder, bent over the dome beyond its straight length.
    bend = max(0.0, distance - straight) / radius
    cosine = np.cos(angle)
    normal = np.array([np.sin(angle), cosine * np.sin(bend), cosine * np.cos(bend)])
    return np.array([0.0, min(distance, straight), 0.0]) + radius * normal, normal


_Surface = Callable[[Mapping[str, Any], int, float], tuple[np.ndarray, np.ndarray]]
_SURFACES: dict[str, tuple[_Surface, tuple[str, ...]]] = {
    "planar": (_planar, ("pitch",)),
    "capsule": (_capsule, ("pitch", "radius", "straight", "column_angle")),
}


class _Join:
    # The edges between two sides of patches. They are computed on first use, so that their number
    # can be checked first.
    def __init__(self, join: Mapping[str, Any], patches: Mapping[str, _Patch]) -> None:
        self.ends = [_parse_end(need_key(join, end, "a join"), patches) for end in ("from", "to")]
        self.kind: str = need_key(join, "kind", "a join")
        if not is_one_of(self.kind, _JOIN_KEYS):
            raise ValueError(
                f"the kind of a join must be 'seam' or 'fan' (got {short_repr(self.kind)})"
            )
        need_only_keys(join, _JOIN_KEYS[self.kind], f"a {self.kind}")
        counts = [end.last + 1 - end.first for end in self.ends]
        if counts[0] != counts[1]:
            raise ValueError(
                f"the facing rows of the join from {join['from']} to {join['to']} must be equally "
                f"long (got {counts[0]} and {counts[1]})"
            )
        self.reverse = join.get("reverse", False)
        if not isinstance(self.reverse, bool):
            raise ValueError(
                f"'reverse' of a join must be true or false (got {short_repr(self.reverse)})"
            )
        self.straight = -1
        if self.kind == "fan":
            self.straight = need_key(join, "straight", "a fan")
            if not is_integer(self.straight) or not 0 <= self.straight < counts[0]:
                raise ValueError(
                    f"'straight' of a fan must be 0 to {counts[0] - 1} (got "
                    f"{short_repr(self.straight)})"
                )
        # An upper bound of the number of edges in an adjacency.
        self.max_pairs = counts[0] ** 2 if self.kind == "fan" else 3 * counts[0]

    def edges(self, name: str) -> Iterator[_Edge]:
        # The edges of an adjacency, each in one direction.
        source, target = (end.taxels() for end in self.ends)
        if self.reverse:
            target.reverse()
        if self.kind == "fan":
            for i, a in enumerate(source):
                yield from ((a, b) for k, b in enumerate(target) if k != i)
            if name != "slanted":
                yield source[self.straight], target[self.straight]
            return
        if name != "slanted":
            yield from zip(source, target, strict=True)
        if name in ("slanted", "dense"):
            for (a, next_a), (b, next_b) in zip(pairwise(source), pairwise(target), strict=True):
                yield a, next_b
                yield next_a, b


class _End(NamedTuple):
    # The taxels of a side of a patch, from the first to the last.
    patch: _Patch
    side: str
    first: int
    last: int

    def taxels(self) -> list[int]:
        return self.patch.side(self.side)[self.first : self.last + 1]


def _parse_end(content: Any, patches: Mapping[str, _Patch]) -> _End:
    if not isinstance(content, list | tuple) or len(content) not in (2, 4):
        raise ValueError(
            f"an end of a join must be [patch, side] or [patch, side, first, last] (got "
            f"{short_repr(content)})"
        )
    name, side, *limits = content
    if not is_one_of(name, patches):
        raise ValueError(f"a join must name patches (got {short_repr(name)})")
    if not is_one_of(side, _SIDES):
        raise ValueError(f"the side of a join must be one of {_SIDES} (got {short_repr(side)})")
    num_taxels = patches[name].side_length(side)
    first, last = limits or (0, num_taxels - 1)
    if not are_integers([first, last], 2) or not 0 <= first <= last < num_taxels:
        raise ValueError(
            f"the first and last taxel of a join's end must be from 0 to {num_taxels - 1} (got "
            f"{short_repr(limits)})"
        )
    return _End(patches[name], side, first, last)


def _one_way(content: Any, patches: Mapping[str, _Patch]) -> dict[str, list[_Edge]]:
    need_mapping(content, "'one_way'")
    need_only_keys(content, _ADJACENCIES, "'one_way'")
    one_way: dict[str, list[_Edge]] = {}
    for name, edges in content.items():
        one_way[name] = []
        for edge in need_list(edges, f"'{name}' of 'one_way'"):
            ends = [need_key(edge, end, "a one-way edge") for end in ("from", "to")]
            need_only_keys(edge, ("from", "to"), "a one-way edge")
            one_way[name].append((_taxel_index(ends[0], patches), _taxel_index(ends[1], patches)))
    return one_way


def _taxel_index(content: Any, patches: Mapping[str, _Patch]) -> int:
    is_triple = isinstance(content, list | tuple) and len(content) == 3
    if is_triple and is_one_of(content[0], patches) and are_integers(content[1:], 2):
        patch, (row, column) = patches[content[0]], content[1:]
        if patch.has((row, column)):
            return patch.taxel((row, column))
    raise ValueError(
        f"a one-way edge must join taxels, as [patch, row, column] (got {short_repr(content)})"
    )
