r"""What :class:`~torch_geometric_tactile.nn.models.MSCNN` is made of: patterns, maps of patches,
fingers and the hand, and convolutions on several maps at once."""

from collections.abc import Mapping, Sequence
from itertools import groupby, pairwise
from types import MappingProxyType
from typing import Literal, NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.nn import Module, ModuleList, Parameter
from torch.nn.init import trunc_normal_, zeros_

from torch_geometric_tactile.sensors import TaxelLayout

SD = 0.1  # of the weights at the beginning
_THUMB = "thumb"
Level = Literal["patch", "finger", "hand"]
LEVELS: tuple[Level, ...] = ("patch", "finger", "hand")
NO_OTHERS: Mapping[str, tuple[int, int]] = MappingProxyType({})


class Stage(NamedTuple):
    r"""One convolution of a pattern."""

    level: Level
    size: tuple[int, int]
    stride: int = 1
    others: Mapping[str, tuple[int, int]] = NO_OTHERS

    def filter_of(self, kinds: tuple[str, ...]) -> tuple[int, int]:
        r"""Returns height and width of the filters of a map."""
        return next((self.others[kind] for kind in kinds if kind in self.others), self.size)


#: Three convolutions each. Pattern IV gives 2 x 2 to the thumb and 4 x 2 to the fingers: the text
#: has it the other way round, which gives neither equal heights nor the printed size.
PATTERNS: Mapping[str, tuple[Stage, Stage, Stage]] = MappingProxyType(
    {
        "I": (Stage("hand", (3, 3), stride=2), Stage("hand", (3, 3)), Stage("hand", (2, 2))),
        "II": (
            Stage("patch", (3, 3), others={"thumb phalanx": (2, 3)}),
            Stage("hand", (3, 3)),
            Stage("hand", (4, 3)),
        ),
        "III": (
            Stage("patch", (3, 3)),
            Stage("patch", (2, 2), others={"tip": (3, 2), "thumb tip": (2, 2)}),
            Stage("hand", (2, 1)),
        ),
        "IV": (
            Stage("patch", (3, 3)),
            Stage("finger", (4, 2), others={"thumb": (2, 2)}),
            Stage("hand", (2, 2)),
        ),
        "V": (Stage("patch", (2, 2)), Stage("finger", (5, 2)), Stage("finger", (5, 2))),
        "VI": (Stage("patch", (2, 2)), Stage("patch", (2, 2)), Stage("patch", (2, 2))),
        "VII": (
            Stage("finger", (4, 2), stride=2),
            Stage("finger", (3, 2)),
            Stage("finger", (2, 1)),
        ),
    }
)


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


class MapConv(Module):
    r"""Convolutions with filters of one size on maps of one size, each with filters of its own or
    all with the same. There is no padding.

    The cells under a filter are gathered and multiplied with it, for all maps in one matrix
    product: on maps of a few cells that takes half the time of :class:`torch.nn.Conv2d`, also of a
    grouped one.

    Shapes:
        - **cell:** Which of the features is where, on each map :math:`(G, R, C)`.
        - **input:** features :math:`(B, M, F)`
        - **output:** features of the cells of all maps, map by map and row by row
          :math:`(B, G \cdot R' \cdot C', F')`
    """

    cell: Tensor

    def __init__(
        self,
        in_channels: int,
        out_channels: int,
        cell: np.ndarray,
        size: tuple[int, int],
        stride: int = 1,
        share_weights: bool = False,
    ) -> None:
        super().__init__()
        self.in_channels = in_channels
        self.out_channels = out_channels
        self.filter_size = size
        self.stride = stride
        self.share_weights = share_weights
        self.num_maps = len(cell)
        self.in_size: tuple[int, int] = cell.shape[1:]
        under = np.lib.stride_tricks.sliding_window_view(cell, size, axis=(1, 2))
        under = under[:, ::stride, ::stride]  # maps, rows, columns, and the filter's
        self.out_size: tuple[int, int] = under.shape[1:3]
        self.register_buffer("cell", torch.from_numpy(under.flatten()), persistent=False)
        sets = 1 if share_weights else self.num_maps
        self.weight = Parameter(torch.empty(sets, *size, in_channels, out_channels))
        self.bias = Parameter(torch.empty(sets, out_channels))
        self.reset_parameters()

    def reset_parameters(self) -> None:
        r"""Draws the weights anew."""
        trunc_normal_(self.weight, std=SD, a=-2 * SD, b=2 * SD)
        zeros_(self.bias)

    def forward(self, x: Tensor) -> Tensor:
        r"""Returns the features of the maps."""
        weight = self.weight.flatten(1, 3)
        sets, width = weight.size(0), weight.size(1)
        rows = self.out_size[0] * self.out_size[1] * (self.num_maps // sets)
        under = x.index_select(1, self.cell).reshape(x.size(0), sets, rows, width)
        under = under.transpose(0, 1).reshape(sets, -1, width)
        out = torch.baddbmm(self.bias.unsqueeze(1), under, weight)
        out = out.view(sets, x.size(0), rows, self.out_channels)
        return out.transpose(0, 1).flatten(1, 2)

    def __repr__(self) -> str:
        return (
            f"{type(self).__name__}({self.in_channels}, {self.out_channels}, "
            f"maps={self.num_maps}, size={self.in_size}, filter={self.filter_size}, "
            f"stride={self.stride}, share_weights={self.share_weights})"
        )


class MapStage(Module):
    r"""One convolution of a pattern: a :class:`MapConv` for the maps of each size, and ReLU."""

    def __init__(
        self,
        in_channels: int,
        out_channels: int,
        maps: Sequence[HandMap],
        stage: Stage,
        share_weights: bool,
    ) -> None:
        super().__init__()
        alike: dict[tuple[tuple[int, int], tuple[int, int]], list[HandMap]] = {}
        for one in maps:
            size = stage.filter_of(one.kinds)
            if one.size[0] < size[0] or one.size[1] < size[1]:
                raise ValueError(
                    f"'pattern' must have filters that fit on its maps (got {size} for {one.size} "
                    f"cells of '{one.name}')"
                )
            alike.setdefault((one.size, size), []).append(one)
        self.convs = ModuleList()
        self.maps: list[HandMap] = []
        first = 0
        for (_, size), group in alike.items():
            cell = np.stack([one.cell for one in group])
            conv = MapConv(in_channels, out_channels, cell, size, stage.stride, share_weights)
            self.convs.append(conv)
            numbers = np.arange(first, first + len(group) * conv.out_size[0] * conv.out_size[1])
            first += len(numbers)
            for one, found in zip(group, numbers.reshape(-1, *conv.out_size), strict=True):
                self.maps.append(one._replace(cell=found))
        order = [one.name for one in maps]
        self.maps.sort(key=lambda one: order.index(one.name))
        self.num_cells = first

    def forward(self, x: Tensor) -> Tensor:
        r"""Returns the features of the cells of all maps :math:`(B, M', F')`.

        Shapes:
            - **x:** Features :math:`(B, M, F)`.
        """
        parts = [conv(x) for conv in self.convs]
        return (parts[0] if len(parts) == 1 else torch.cat(parts, dim=1)).relu()
