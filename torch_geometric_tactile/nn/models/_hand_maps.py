r"""Maps of patches, fingers and the hand, and how they are put together."""

from collections.abc import Sequence
from itertools import groupby, pairwise
from typing import NamedTuple

import numpy as np

from torch_geometric_tactile.nn.models._ms_cnn_patterns import LEVELS, Level
from torch_geometric_tactile.sensors import TaxelLayout

_THUMB = "thumb"


class HandMap(NamedTuple):
    r"""A map of a patch, a finger or the hand."""

    name: str
    level: Level
    digit: int
    kinds: tuple[str, ...]
    cell: np.ndarray

    @property
    def size(self) -> tuple[int, int]:
        r"""Its rows and columns."""
        rows, columns = self.cell.shape
        return rows, columns


def input_maps(layout: TaxelLayout, level: Level) -> list[HandMap]:
    r"""Returns the maps of the readings: those parts of the layout's image map that hold its
    patches, its digits or all of it. Cells without a taxel have the number :math:`N`.
    """
    assert layout.image_map is not None
    place = layout.image_map.numpy()
    image = np.full(place.max(axis=0) + 1, layout.num_taxels)
    image[place[:, 0], place[:, 1]] = np.arange(layout.num_taxels)
    if level == "hand":
        return [HandMap("hand", "hand", -1, (), image)]
    digit = layout.segments("digit").numpy()
    of = digit if level == "finger" else layout.segments("patch").numpy()
    names = layout.digit_names if level == "finger" else layout.patch_names
    found = []
    for i, name in enumerate(names):
        taxels = (of == i).nonzero()[0]
        if len(taxels) == 0:
            raise ValueError(f"'layout' must have taxels in each {level} (got none in '{name}')")
        owners = set(digit[taxels].tolist())
        if len(owners) > 1:
            raise ValueError(f"'layout' must have each patch on one digit (got '{name}' on more)")
        (top, left), (bottom, right) = place[taxels].min(axis=0), place[taxels].max(axis=0)
        part = image[top : bottom + 1, left : right + 1]
        if set(part[part < layout.num_taxels].tolist()) != set(taxels.tolist()):
            raise ValueError(
                f"'layout' must have an image_map on which no {level} overlaps another (got "
                f"'{name}' of '{layout.name}')"
            )
        owner = owners.pop()
        column = place[digit == owner, 1].min()
        found.append((column, top, bottom, HandMap(name, level, owner, (), part)))
    found.sort(key=lambda place: (place[0], place[3].digit, place[1]))
    for (_, _, bottom, upper), (_, top, _, lower) in pairwise(found):
        if upper.digit == lower.digit and top <= bottom:
            raise ValueError(
                f"'layout' must have an image_map with the patches of a digit one above the other "
                f"(got '{upper.name}' beside '{lower.name}' in '{layout.name}')"
            )
    return _with_kinds([one for *_, one in found], layout)


def _with_kinds(maps: Sequence[HandMap], layout: TaxelLayout) -> list[HandMap]:
    out, seen = [], set()
    for one in maps:  # from left to right, and in a digit from its tip on
        kinds: tuple[str, ...] = ()
        is_thumb = layout.digit_names[one.digit] == _THUMB
        if one.level == "patch":
            part = "phalanx" if one.digit in seen else "tip"
            kinds = (f"{_THUMB} {part}", part, _THUMB) if is_thumb else (part,)
        elif is_thumb:
            kinds = (_THUMB,)
        seen.add(one.digit)
        out.append(one._replace(kinds=kinds))
    return out


def joined_maps(maps: Sequence[HandMap], level: Level, layout: TaxelLayout) -> list[HandMap]:
    r"""Returns maps put together: patches one above the other to fingers, and fingers side by side
    to the hand.
    """
    out = list(maps)
    if out[0].level == "patch" and level != "patch":
        out = [
            _joined(list(parts), layout.digit_names[digit], "finger", digit)
            for digit, parts in groupby(out, key=lambda one: one.digit)
        ]
        out = _with_kinds(out, layout)
    if out[0].level == "finger" and level == "hand":
        out = [_joined(out, "hand", "hand", -1)]
    assert LEVELS.index(out[0].level) == LEVELS.index(level)  # maps are not taken apart
    return out


def _joined(parts: Sequence[HandMap], name: str, level: Level, digit: int) -> HandMap:
    axis = 0 if level == "finger" else 1
    across = {one.size[1 - axis] for one in parts}
    if len(across) > 1:
        sizes = {one.name: one.size for one in parts}
        what = "columns" if axis == 0 else "rows"
        raise ValueError(
            f"'pattern' must give maps with as many {what} as those beside them (got {sizes})"
        )
    return HandMap(name, level, digit, (), np.concatenate([one.cell for one in parts], axis))
