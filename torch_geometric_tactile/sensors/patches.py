r"""Expansion of layouts that are described by patches to taxels and edges."""

from collections.abc import Iterator, Mapping
from itertools import pairwise
from typing import Any, NamedTuple

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._texts import short_repr
from torch_geometric_tactile.sensors._content_checks import (
    are_integers,
    is_integer,
    is_one_of,
    need_key,
    need_list,
    need_mapping,
    need_only_keys,
)
from torch_geometric_tactile.sensors._patch import Edge, Patch

# Limits for untrusted files, whose few bytes could describe any number of taxels and edges.
_MAX_TAXELS = 100_000
_MAX_JOINED_PAIRS = 1_000_000
_DESCRIPTION_KEYS = ("shapes", "patches", "joins", "one_way")  # not in an expanded layout
_JOIN_KEYS = {
    "seam": ("kind", "from", "to", "reverse"),
    "fan": ("kind", "from", "to", "reverse", "straight"),
}
_SIDES = ("bottom", "top", "left", "right")
_ADJACENCIES = ("sparse", "slanted", "original", "dense")


def expand_patches(content: Mapping[str, Any]) -> dict[str, Any]:
    r"""Expands a layout that is described by patches to one that lists every taxel.

    The description has the keys :obj:`"shapes"` (name to :obj:`{"kind", "rows", ...}`),
    :obj:`"patches"` (a list of :obj:`{"name", "digit", "link", "shape", "origin", "cell"}` and
    optionally the directions :obj:`"column"` and :obj:`"row"` in the link frame), :obj:`"joins"` (a
    list of :obj:`{"kind", "from", "to"}`) and :obj:`"one_way"` (single directed edges). Lengths are
    in the layout's :obj:`"unit"`.

    The :obj:`"rows"` of a shape are the numbers of taxels of each row, from the base outwards.
    Shorter rows are centred. A :obj:`"planar"` patch has a :obj:`"pitch"`, and its :obj:`"origin"`
    is its centre. A :obj:`"capsule"` (a half cylinder with a dome at its end) has a
    :obj:`"pitch"` along the axis, a :obj:`"radius"`, the :obj:`"straight"` length of its cylinder
    and the :obj:`"column_angle"` in degrees between columns; its :obj:`"origin"` is the point of
    its axis at the first row. The :math:`y` axis of a taxel (in :obj:`"tangent"`) is the direction
    :obj:`"row"` projected onto the skin. Its :math:`x` axis is :math:`y \times n`, which is
    :obj:`"column"` where the patch is flat.

    The adjacency :obj:`"original"` joins neighbours in a row or a column, :obj:`"slanted"` joins
    diagonal neighbours, and :obj:`"dense"` both. :obj:`"sparse"` has all edges along the columns,
    but across the columns only those listed in the shape's :obj:`"sparse_across"` (row and column
    of the left taxel).

    A :obj:`"seam"` joins the taxels of two facing rows, each with the taxel straight ahead, or in
    :obj:`"slanted"` with the neighbours of that taxel. A :obj:`"fan"` joins each taxel with all
    taxels of the facing row except the one straight ahead, and adds one straight pair,
    :obj:`"straight"`, which is not in :obj:`"slanted"`. An end of a join is :obj:`[patch, side]`,
    or :obj:`[patch, side, first, last]` for a range of its taxels.

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
    what = "a layout of patches"
    items, shapes = need_key(content, "patches", what), need_key(content, "shapes", what)
    need("taxels" not in content, f"{what} must not have 'taxels' as well (got both)")
    need_mapping(shapes, "'shapes'")
    patches: dict[str, Patch] = {}
    num_taxels = 0
    for item in need_list(items, "'patches'"):
        patch = Patch(item, shapes, num_taxels)
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
    kept_content = {key: value for key, value in content.items() if key not in _DESCRIPTION_KEYS}
    listed_adjacency = content.get("adjacency", {})
    need_mapping(listed_adjacency, "'adjacency'")
    return {
        **kept_content,
        "patch_names": list(patches),
        "taxels": taxels,
        "adjacency": {**adjacency, **listed_adjacency},
    }


def _check_count(what: str, count: int, maximum: int) -> None:
    need(count <= maximum, f"a layout of patches must have {maximum} {what} at most", count)


class _Join:
    # The edges between two sides of patches. They are computed when they are needed, so that their
    # number can be checked first.
    def __init__(self, join: Mapping[str, Any], patches: Mapping[str, Patch]) -> None:
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

    def edges(self, name: str) -> Iterator[Edge]:
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
    patch: Patch
    side: str
    first: int
    last: int

    def taxels(self) -> list[int]:
        return self.patch.side(self.side)[self.first : self.last + 1]


def _parse_end(content: Any, patches: Mapping[str, Patch]) -> _End:
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
    count = patches[name].side_length(side)
    first, last = limits or (0, count - 1)
    if not are_integers([first, last], 2) or not 0 <= first <= last < count:
        raise ValueError(
            f"the first and last taxel of a join's end must be from 0 to {count - 1} (got "
            f"{short_repr(limits)})"
        )
    return _End(patches[name], side, first, last)


def _one_way(content: Any, patches: Mapping[str, Patch]) -> dict[str, list[Edge]]:
    need_mapping(content, "'one_way'")
    need_only_keys(content, _ADJACENCIES, "'one_way'")
    one_way: dict[str, list[Edge]] = {}
    for name, edges in content.items():
        one_way[name] = []
        for edge in need_list(edges, f"'{name}' of 'one_way'"):
            ends = [need_key(edge, end, "a one-way edge") for end in ("from", "to")]
            need_only_keys(edge, ("from", "to"), "a one-way edge")
            one_way[name].append((_taxel_index(ends[0], patches), _taxel_index(ends[1], patches)))
    return one_way


def _taxel_index(content: Any, patches: Mapping[str, Patch]) -> int:
    is_triple = isinstance(content, list | tuple) and len(content) == 3
    if is_triple and is_one_of(content[0], patches) and are_integers(content[1:], 2):
        patch, (row, column) = patches[content[0]], content[1:]
        if patch.has((row, column)):
            return patch.taxel((row, column))
    raise ValueError(
        f"a one-way edge must join taxels, as [patch, row, column] (got {short_repr(content)})"
    )
