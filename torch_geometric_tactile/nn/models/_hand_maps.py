r"""Parts of :class:`~torch_geometric_tactile.nn.models.MSCNN`: patterns, maps of patches, fingers
and the hand, and convolutions on several maps at once."""

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

INIT_STD = 0.1  # standard deviation of the initial weights, from the paper
_THUMB = "thumb"
Level = Literal["patch", "finger", "hand"]
LEVELS: tuple[Level, ...] = ("patch", "finger", "hand")
_NO_EXCEPTIONS: Mapping[str, tuple[int, int]] = MappingProxyType({})


class Stage(NamedTuple):
    r"""One convolution of a pattern. The filters have :obj:`size`, except on the kinds of maps in
    :obj:`exceptions`.
    """

    level: Level
    size: tuple[int, int]
    stride: int = 1
    exceptions: Mapping[str, tuple[int, int]] = _NO_EXCEPTIONS

    def filter_size(self, kinds: tuple[str, ...]) -> tuple[int, int]:
        r"""Returns the height and width of the filters on a map.

        Args:
            kinds (tuple of str): Kinds of the map, with the most specific kind first.
        """
        return next((self.exceptions[kind] for kind in kinds if kind in self.exceptions), self.size)


#: The three convolutions of each pattern. In pattern IV, the thumb has filters of 2 x 2 cells and
#: the fingers have filters of 4 x 2 cells. The paper's text swaps these sizes, but this gives
#: neither equal heights nor the printed size.
PATTERNS: Mapping[str, tuple[Stage, Stage, Stage]] = MappingProxyType(
    {
        "I": (Stage("hand", (3, 3), stride=2), Stage("hand", (3, 3)), Stage("hand", (2, 2))),
        "II": (
            Stage("patch", (3, 3), exceptions={"thumb phalanx": (2, 3)}),
            Stage("hand", (3, 3)),
            Stage("hand", (4, 3)),
        ),
        "III": (
            Stage("patch", (3, 3)),
            Stage("patch", (2, 2), exceptions={"tip": (3, 2), "thumb tip": (2, 2)}),
            Stage("hand", (2, 1)),
        ),
        "IV": (
            Stage("patch", (3, 3)),
            Stage("finger", (4, 2), exceptions={"thumb": (2, 2)}),
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
    r"""A map of a patch, a finger or the hand. Each cell holds the index of its features."""

    name: str
    level: Level
    digit: int
    kinds: tuple[str, ...]
    cell: np.ndarray

    @property
    def size(self) -> tuple[int, int]:
        r"""Number of rows and columns."""
        rows, columns = self.cell.shape
        return rows, columns


def input_maps(layout: TaxelLayout, level: Level) -> list[HandMap]:
    r"""Returns the maps of the readings, sorted by digit from left to right, and within a digit
    from the tip down. Each map is the part of the layout's image map with one patch or one digit,
    or the whole image map. Cells without a taxel hold the index :math:`N`.

    Args:
        layout (TaxelLayout): The layout, with an image map.
        level (str): :obj:`"patch"`, :obj:`"finger"` or :obj:`"hand"`.

    Raises:
        ValueError: If a patch or digit has no taxels, or if maps overlap or are not stacked
            vertically.
    """
    assert layout.image_map is not None
    image_map = layout.image_map.numpy()
    image = np.full(image_map.max(axis=0) + 1, layout.num_taxels)
    image[image_map[:, 0], image_map[:, 1]] = np.arange(layout.num_taxels)
    if level == "hand":
        return [HandMap("hand", "hand", -1, (), image)]
    digit = layout.segments("digit").numpy()
    segment = digit if level == "finger" else layout.segments("patch").numpy()
    names = layout.digit_names if level == "finger" else layout.patch_names
    located_maps = []
    for i, name in enumerate(names):
        taxels = (segment == i).nonzero()[0]
        if len(taxels) == 0:
            raise ValueError(f"'layout' must have taxels in each {level} (got none in '{name}')")
        digits = set(digit[taxels].tolist())
        if len(digits) > 1:
            raise ValueError(
                f"'layout' must have each patch on one digit (got '{name}' on {len(digits)})"
            )
        (top, left), (bottom, right) = image_map[taxels].min(axis=0), image_map[taxels].max(axis=0)
        cells = image[top : bottom + 1, left : right + 1]
        if set(cells[cells < layout.num_taxels].tolist()) != set(taxels.tolist()):
            raise ValueError(
                f"'layout' must have an image_map on which no {level} overlaps another (got "
                f"'{name}' of '{layout.name}')"
            )
        map_digit = digits.pop()
        column = image_map[digit == map_digit, 1].min()
        located_maps.append((column, top, bottom, HandMap(name, level, map_digit, (), cells)))
    located_maps.sort(key=lambda location: (location[0], location[3].digit, location[1]))
    for (_, _, bottom, upper), (_, top, _, lower) in pairwise(located_maps):
        if upper.digit == lower.digit and top <= bottom:
            raise ValueError(
                f"'layout' must have an image_map with the patches of a digit one above the other "
                f"(got '{upper.name}' beside '{lower.name}' in '{layout.name}')"
            )
    return _with_kinds([hand_map for *_, hand_map in located_maps], layout)


def _with_kinds(maps: Sequence[HandMap], layout: TaxelLayout) -> list[HandMap]:
    # Sets the kinds of each map, with the most specific kind first. Maps are sorted by digit, and
    # within a digit from the tip down, so that the first patch of a digit is its tip.
    result, visited_digits = [], set()
    for hand_map in maps:
        kinds: tuple[str, ...] = ()
        is_thumb = layout.digit_names[hand_map.digit] == _THUMB
        if hand_map.level == "patch":
            part = "phalanx" if hand_map.digit in visited_digits else "tip"
            kinds = (f"{_THUMB} {part}", part, _THUMB) if is_thumb else (part,)
        elif is_thumb:
            kinds = (_THUMB,)
        visited_digits.add(hand_map.digit)
        result.append(hand_map._replace(kinds=kinds))
    return result


def join_maps(maps: Sequence[HandMap], level: Level, layout: TaxelLayout) -> list[HandMap]:
    r"""Returns the maps of a coarser level. Patches are stacked vertically to form fingers, and
    fingers are placed side by side to form the hand.

    Args:
        maps (sequence of HandMap): Maps of one level.
        level (str): Level of the returned maps.
        layout (TaxelLayout): The layout.

    Raises:
        ValueError: If the maps to be joined differ in size.
    """
    joined_maps = list(maps)
    if joined_maps[0].level == "patch" and level != "patch":
        joined_maps = [
            _concatenate_maps(list(patches), layout.digit_names[digit], "finger", digit)
            for digit, patches in groupby(joined_maps, key=lambda hand_map: hand_map.digit)
        ]
        joined_maps = _with_kinds(joined_maps, layout)
    if joined_maps[0].level == "finger" and level == "hand":
        joined_maps = [_concatenate_maps(joined_maps, "hand", "hand", -1)]
    assert LEVELS.index(joined_maps[0].level) == LEVELS.index(level)  # maps are never split
    return joined_maps


def _concatenate_maps(maps: Sequence[HandMap], name: str, level: Level, digit: int) -> HandMap:
    axis = 0 if level == "finger" else 1
    widths = {hand_map.size[1 - axis] for hand_map in maps}
    if len(widths) > 1:
        sizes = {hand_map.name: hand_map.size for hand_map in maps}
        dimension = "columns" if axis == 0 else "rows"
        raise ValueError(
            f"'pattern' must give neighbouring maps the same number of {dimension} (got {sizes})"
        )
    return HandMap(
        name, level, digit, (), np.concatenate([hand_map.cell for hand_map in maps], axis)
    )


class MapConv(Module):
    r"""Convolutions with filters of one size on maps of one size, with separate or shared filters.
    There is no padding.

    The cells under each filter position are gathered, and one batched matrix product multiplies the
    cells of all maps. On small maps, this takes half as long as a plain or grouped
    :class:`torch.nn.Conv2d`.

    Args:
        in_channels (int): Size of each input feature.
        out_channels (int): Size of each output feature.
        cell (numpy.ndarray): Index of the features of each cell, for each map :math:`(G, R, C)`.
        size (tuple of int): Height and width of the filters.
        stride (int): Distance between filter positions in cells.
        share_weights (bool): Whether all maps share the filters.

    Shapes:
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
        windows = np.lib.stride_tricks.sliding_window_view(cell, size, axis=(1, 2))
        windows = windows[:, ::stride, ::stride]  # maps, rows, columns, filter rows and columns
        self.out_size: tuple[int, int] = windows.shape[1:3]
        self.register_buffer("cell", torch.from_numpy(windows.flatten()), persistent=False)
        num_filter_sets = 1 if share_weights else self.num_maps
        self.weight = Parameter(torch.empty(num_filter_sets, *size, in_channels, out_channels))
        self.bias = Parameter(torch.empty(num_filter_sets, out_channels))
        self.reset_parameters()

    def reset_parameters(self) -> None:
        r"""Resets all learnable parameters."""
        trunc_normal_(self.weight, std=INIT_STD, a=-2 * INIT_STD, b=2 * INIT_STD)
        zeros_(self.bias)

    def forward(self, x: Tensor) -> Tensor:
        r"""Returns the features of the maps after the convolution.

        Args:
            x (torch.Tensor): Features.
        """
        weight = self.weight.flatten(1, 3)
        num_filter_sets, width = weight.size(0), weight.size(1)
        num_rows = self.out_size[0] * self.out_size[1] * (self.num_maps // num_filter_sets)
        windows = x.index_select(1, self.cell).reshape(x.size(0), num_filter_sets, num_rows, width)
        windows = windows.transpose(0, 1).reshape(num_filter_sets, -1, width)
        out = torch.baddbmm(self.bias.unsqueeze(1), windows, weight)
        out = out.view(num_filter_sets, x.size(0), num_rows, self.out_channels)
        return out.transpose(0, 1).flatten(1, 2)

    def __repr__(self) -> str:
        return (
            f"{type(self).__name__}({self.in_channels}, {self.out_channels}, "
            f"maps={self.num_maps}, size={self.in_size}, filter={self.filter_size}, "
            f"stride={self.stride}, share_weights={self.share_weights})"
        )


class MapStage(Module):
    r"""One convolution of a pattern: one :class:`MapConv` for each map size, followed by ReLU.

    Args:
        in_channels (int): Size of each input feature.
        out_channels (int): Size of each output feature.
        maps (sequence of HandMap): Input maps.
        stage (Stage): Sizes and stride of the filters.
        share_weights (bool): Whether maps of the same size share the filters.

    Raises:
        ValueError: If a filter is larger than its map.
    """

    def __init__(
        self,
        in_channels: int,
        out_channels: int,
        maps: Sequence[HandMap],
        stage: Stage,
        share_weights: bool,
    ) -> None:
        super().__init__()
        maps_by_size: dict[tuple[tuple[int, int], tuple[int, int]], list[HandMap]] = {}
        for hand_map in maps:
            size = stage.filter_size(hand_map.kinds)
            if hand_map.size[0] < size[0] or hand_map.size[1] < size[1]:
                raise ValueError(
                    f"'pattern' must have filters that fit on its maps (got {size} for "
                    f"{hand_map.size} cells of '{hand_map.name}')"
                )
            maps_by_size.setdefault((hand_map.size, size), []).append(hand_map)
        self.convs = ModuleList()
        self.maps: list[HandMap] = []
        num_cells = 0
        for (_, size), group in maps_by_size.items():
            cell = np.stack([hand_map.cell for hand_map in group])
            conv = MapConv(in_channels, out_channels, cell, size, stage.stride, share_weights)
            self.convs.append(conv)
            indices = np.arange(
                num_cells, num_cells + len(group) * conv.out_size[0] * conv.out_size[1]
            )
            num_cells += len(indices)
            for hand_map, out_cell in zip(group, indices.reshape(-1, *conv.out_size), strict=True):
                self.maps.append(hand_map._replace(cell=out_cell))
        # Grouping by size changes the order of the maps, so that the order is restored before
        # joining.
        order = [hand_map.name for hand_map in maps]
        self.maps.sort(key=lambda hand_map: order.index(hand_map.name))
        self.num_cells = num_cells

    def forward(self, x: Tensor) -> Tensor:
        r"""Returns the features of the cells of all maps :math:`(B, M', F')`.

        Shapes:
            - **x:** Features :math:`(B, M, F)`.
        """
        outs = [conv(x) for conv in self.convs]
        return (outs[0] if len(outs) == 1 else torch.cat(outs, dim=1)).relu()
