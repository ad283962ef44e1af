r"""Layouts described by patches: taxels and edges follow from a few rules."""

from collections.abc import Iterator, Mapping
from itertools import pairwise
from typing import Any, NamedTuple

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._texts import short_repr
from torch_geometric_tactile.sensors._content_checks import (
    are_whole,
    is_named,
    is_whole,
    need_key,
    need_list,
    need_mapping,
    only_keys,
)
from torch_geometric_tactile.sensors._patch import Edge, Patch

_MOST_TAXELS = 100_000  # that a description stands for: a few bytes could stand for any number
_MOST_PAIRS = 1_000_000  # of taxels in joins
_DESCRIBING = ("shapes", "patches", "joins", "one_way")
_JOIN_KEYS = {
    "seam": ("kind", "from", "to", "reverse"),
    "fan": ("kind", "from", "to", "reverse", "straight"),
}
_SIDES = ("bottom", "top", "left", "right")
_ADJACENCIES = ("sparse", "slanted", "original", "dense")


def expand_patches(content: Mapping[str, Any]) -> dict[str, Any]:
    r"""Expands the description of a layout by patches to one that lists every taxel.

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
    the first row. The :math:`y` axis of a taxel (of :obj:`"tangent"`) is the direction :obj:`"row"`
    laid onto the skin, its :math:`x` axis :math:`y \times n`, which is :obj:`"column"` where the
    patch is flat.

    Edges within a patch: :obj:`"straight"` ones join neighbours in a row and in a column,
    :obj:`"slanted"` ones diagonal neighbours. :obj:`"sparse"` keeps all those along the columns,
    but across only those listed in the shape's :obj:`"sparse_across"` (row and column of the left
    taxel). A :obj:`"seam"` joins two facing rows, each taxel with the one straight ahead (slanted:
    with its neighbours). A :obj:`"fan"` joins each taxel with all of the facing row but the one
    straight ahead, and one straight pair, :obj:`"straight"`, which :obj:`"slanted"` leaves out. An
    end is :obj:`[patch, side]`, or :obj:`[patch, side, first, last]` for some of its taxels.

    Args:
        content (Mapping): The description.

    Returns:
        dict: What :meth:`TaxelLayout.from_dict` reads, with the adjacencies :obj:`"sparse"`,
        :obj:`"slanted"`, :obj:`"original"` and :obj:`"dense"`.

    Raises:
        ValueError: If a key is missing, a name, a side or a row is unknown, or a shape is none.

    Examples:
        >>> tile = {"kind": "planar", "rows": [2, 2], "pitch": 2, "sparse_across": [[0, 0]]}
        >>> patch = {"name": "low", "digit": "pad", "link": "base", "shape": "tile"}
        >>> patch |= {"origin": [0, 0, 0], "cell": [0, 0]}
        >>> content = {"name": "tile", "unit": "mm", "shapes": {"tile": tile}, "patches": [patch]}
        >>> expanded = expand_patches(content)
        >>> len(expanded["taxels"]), len(expanded["adjacency"]["dense"])  # taxels, directed edges
        (4, 12)
    """
    what = "a layout of patches"
    described, shapes = need_key(content, "patches", what), need_key(content, "shapes", what)
    need("taxels" not in content, f"{what} must have no 'taxels' of its own (got both)")
    need_mapping(shapes, "'shapes'")
    patches: dict[str, Patch] = {}
    num_taxels = 0
    for item in need_list(described, "'patches'"):
        patch = Patch(item, shapes, num_taxels)
        if patch.name in patches:
            raise ValueError(f"'patches' must have different names (got '{patch.name}' twice)")
        patches[patch.name] = patch
        num_taxels += patch.num_taxels
        _check_count("taxels", num_taxels, _MOST_TAXELS)
    joins = [_Join(join, patches) for join in need_list(content.get("joins", ()), "'joins'")]
    _check_count("pairs of taxels in joins", sum(join.most for join in joins), _MOST_PAIRS)
    one_way = _one_way(content.get("one_way", {}), patches)
    taxels = [taxel for patch in patches.values() for taxel in patch.taxels()]
    adjacency = {}
    for name in _ADJACENCIES:
        pairs = [edge for patch in patches.values() for edge in patch.edges(name)]
        pairs += [edge for join in joins for edge in join.edges(name)]
        directed = {*pairs, *((b, a) for a, b in pairs), *one_way.get(name, ())}
        adjacency[name] = [list(edge) for edge in sorted(directed)]
    flat = {key: value for key, value in content.items() if key not in _DESCRIBING}
    own = content.get("adjacency", {})
    need_mapping(own, "'adjacency'")
    return {
        **flat,
        "patch_names": list(patches),
        "taxels": taxels,
        "adjacency": {**adjacency, **own},
    }


def _check_count(what: str, count: int, most: int) -> None:
    need(count <= most, f"a layout of patches must have {most} {what} at most", count)


class _Join:
    # The edges between two sides of patches, which are made when they are needed.
    def __init__(self, join: Mapping[str, Any], patches: Mapping[str, Patch]) -> None:
        self.ends = [_end(need_key(join, end, "a join"), patches) for end in ("from", "to")]
        self.kind: str = need_key(join, "kind", "a join")
        if not is_named(self.kind, _JOIN_KEYS):
            raise ValueError(
                f"the kind of a join must be 'seam' or 'fan' (got {short_repr(self.kind)})"
            )
        only_keys(join, _JOIN_KEYS[self.kind], f"a {self.kind}")
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
            if not is_whole(self.straight) or not 0 <= self.straight < counts[0]:
                raise ValueError(
                    f"'straight' of a fan must be 0 to {counts[0] - 1} (got "
                    f"{short_repr(self.straight)})"
                )
        # The most pairs that it stands for.
        self.most = counts[0] ** 2 if self.kind == "fan" else 3 * counts[0]

    def edges(self, name: str) -> Iterator[Edge]:
        first, second = (end.taxels() for end in self.ends)
        if self.reverse:
            second.reverse()
        if self.kind == "fan":
            for i, a in enumerate(first):
                yield from ((a, b) for k, b in enumerate(second) if k != i)
            if name != "slanted":
                yield first[self.straight], second[self.straight]
            return
        if name != "slanted":
            yield from zip(first, second, strict=True)
        if name in ("slanted", "dense"):
            for (a, next_a), (b, next_b) in zip(pairwise(first), pairwise(second), strict=True):
                yield a, next_b
                yield next_a, b


class _End(NamedTuple):
    # The taxels of a side of a patch, from the first to the last.
    patch: Patch
    side: str
    first: int
    last: int

    def taxels(self) -> list[int]:
        return self.patch.side(self.side)[self.first : self.last + 1]


def _end(place: Any, patches: Mapping[str, Patch]) -> _End:
    if not isinstance(place, list | tuple) or len(place) not in (2, 4):
        raise ValueError(
            f"an end of a join must be [patch, side] or [patch, side, first, last] (got "
            f"{short_repr(place)})"
        )
    name, side, *part = place
    if not is_named(name, patches):
        raise ValueError(f"a join must name patches (got {short_repr(name)})")
    if not is_named(side, _SIDES):
        raise ValueError(f"the side of a join must be one of {_SIDES} (got {short_repr(side)})")
    count = patches[name].side_length(side)
    first, last = part or (0, count - 1)
    if not are_whole([first, last], 2) or not 0 <= first <= last < count:
        raise ValueError(
            f"the first and last taxel of a join's end must be from 0 to {count - 1} (got "
            f"{short_repr(part)})"
        )
    return _End(patches[name], side, first, last)


def _one_way(named: Any, patches: Mapping[str, Patch]) -> dict[str, list[Edge]]:
    need_mapping(named, "'one_way'")
    only_keys(named, _ADJACENCIES, "'one_way'")
    out: dict[str, list[Edge]] = {}
    for name, edges in named.items():
        out[name] = []
        for edge in need_list(edges, f"'{name}' of 'one_way'"):
            ends = [need_key(edge, end, "a one-way edge") for end in ("from", "to")]
            only_keys(edge, ("from", "to"), "a one-way edge")
            out[name].append((_taxel(ends[0], patches), _taxel(ends[1], patches)))
    return out


def _taxel(place: Any, patches: Mapping[str, Patch]) -> int:
    is_place = isinstance(place, list | tuple) and len(place) == 3
    if is_place and is_named(place[0], patches) and are_whole(place[1:], 2):
        patch, (row, column) = patches[place[0]], place[1:]
        if patch.has((row, column)):
            return patch.taxel((row, column))
    raise ValueError(
        f"a one-way edge must join taxels, as [patch, row, column] (got {short_repr(place)})"
    )
