r"""Data sets of small images."""

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from torch_geometric_tactile._typing import Filter, PathLike, Transform
from torch_geometric_tactile.data import Protocol, StaticData
from torch_geometric_tactile.data._image_data import COLUMNS, ROWS, StaticImages, image_of
from torch_geometric_tactile.datasets._raw_files import RawFiles
from torch_geometric_tactile.datasets._splits import checked_split
from torch_geometric_tactile.sensors import TaxelLayout
from torch_geometric_tactile.sensors.letter_array import letter_array

_PARTS = ("train", "test")


class ImageDataset(RawFiles):
    r"""Base class of data sets of 32 x 32 images that are split into folds:
    :class:`~torch_geometric_tactile.datasets.LetterShape` and
    :class:`~torch_geometric_tactile.datasets.DigitImages`. A subclass sets the attributes before it
    calls :meth:`__init__`.
    """

    fold: int | None
    split: Any
    folds: int
    split_seed: int
    adjacency: str | None
    _indices: Any
    _has_parts = False  # whether a split needs no fold
    selection_args: Sequence[str] = ("fold", "split", "folds", "split_seed")

    def __init__(
        self,
        root: PathLike | None,
        transform: Transform | None,
        pre_transform: Transform | None,
        pre_filter: Filter | None,
        force_reload: bool,
    ) -> None:
        self.split = checked_split(self.split, _PARTS)
        if self.split is not None and self.fold is None and not self._has_parts:
            raise ValueError(f"'fold' must be given with split='{self.split}' (got None)")
        self._protocol = Protocol("trial", folds=self.folds, stratify="y")
        if self.fold is not None and not 0 <= self.fold < self.folds:
            raise ValueError(f"'fold' must be between 0 and {self.folds - 1} (got {self.fold})")
        is_filtered = pre_transform is not None or pre_filter is not None
        edge_index = None if self.adjacency is None else self.layout.edge_index(self.adjacency)
        if not is_filtered:  # otherwise, the processed samples depend on the edges
            self.selection_args = (*self.selection_args, "adjacency")
        super().__init__(root, transform, pre_transform, pre_filter, force_reload)
        if not is_filtered:
            self._data.edge_index = edge_index
            self._clone_shared()
        self._data = self._as_images(self._data)
        if self.split is not None:
            protocol = self._protocol if self.fold is not None else Protocol("given")
            parts = protocol.split(self, self.split_seed, self.fold or 0)
            self._indices = getattr(parts, self.split).tolist()

    def _to_data(self, **columns: Tensor) -> StaticData:
        edges = None if self.adjacency is None else self.layout.edge_index(self.adjacency)
        pos, normal = self.layout.pos, self.layout.normal
        return self._as_images(StaticData(edge_index=edges, pos=pos, normal=normal, **columns))

    def _as_images(self, data: StaticData) -> StaticData:
        if not has_image(self.layout) or isinstance(data, StaticImages):
            return data
        attributes: dict[str, Any] = data.to_dict() | data.schema
        return StaticImages(**attributes)

    @property
    def image(self) -> Tensor:
        r"""The images of this selection :math:`(S, 1, 32, 32)`. For the complete data set they are
        a view of :obj:`x`.
        """
        if not has_image(self.layout):
            raise ValueError(
                f"'image' needs the taxels of letter_array(), 32 x 32 (got '{self.layout.name}')"
            )
        x = self.column("x")
        assert x is not None
        return image_of(x)


def has_image(layout: TaxelLayout) -> bool:
    r"""Returns whether the taxels of a layout are 32 x 32 pixels, row by row."""
    if layout.num_taxels != ROWS * COLUMNS or layout.image_map is None:
        return False
    image_map = letter_array().image_map
    return image_map is not None and torch.equal(layout.image_map, image_map)
