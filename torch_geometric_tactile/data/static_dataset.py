r"""The base class of data sets with one topology."""

import copy
from collections.abc import Mapping, Sequence
from typing import Any, Self

import numpy as np
import torch
from torch import Tensor
from torch_geometric.data import Data

from torch_geometric_tactile._typing import Filter, PathLike, Transform
from torch_geometric_tactile.data._arrays import layout_of
from torch_geometric_tactile.data._dataset_info import dataset_info
from torch_geometric_tactile.data._from_arrays import FromArrays
from torch_geometric_tactile.data._levels import flat_index
from torch_geometric_tactile.data._processed_dataset import ProcessedDataset
from torch_geometric_tactile.data.apply_transform import apply_transform, returned, unwritten
from torch_geometric_tactile.data.frame_info import FrameInfo
from torch_geometric_tactile.data.static_data import StaticData
from torch_geometric_tactile.sensors import TaxelLayout


class StaticDataset(FromArrays, ProcessedDataset):
    r"""A PyG data set whose samples share one topology and are held in one tensor.

    :obj:`dataset[i]` is an ordinary :class:`~torch_geometric.data.Data` object, so that PyG's
    :class:`~torch_geometric.loader.DataLoader`, transforms and explainers work;
    :class:`~torch_geometric_tactile.loader.StaticLoader` cuts whole batches instead. The attributes
    of all samples are attributes of the data set: :obj:`dataset.y`. The processed file is
    memory-mapped, so that a data set may be larger than memory.

    For data of your own see :meth:`from_arrays` and :meth:`from_data_list`. A subclass defines
    :meth:`read`, and sets :obj:`layout`, unless its samples share their :obj:`pos`. With a
    :obj:`root` it may also define :obj:`raw_file_names` (all files in :obj:`root/raw` if left out),
    :obj:`processed_file_names` (one named after the class) and :meth:`download`.

    The processed file records the class, the arguments of its constructor, :obj:`layout`,
    :obj:`pre_transform`, :obj:`pre_filter` and :meth:`raw_state`. If one of them differs, the raw
    files are processed again and a warning is logged that names it.

    Args:
        root (str or PathLike, optional): Folder of the raw and the processed files. Without one,
            the data set lives in memory.
        transform (callable, optional): Applied at every access.
        pre_transform (callable, optional): Applied once, before the samples are saved.
        pre_filter (callable, optional): Tells whether a sample is kept.
        force_reload (bool): Whether to process the raw files anew.

    Raises:
        ValueError: If the processed file is damaged, holds samples of another layout, or was made
            with other settings and the raw files are missing.

    Examples:
        >>> from torch_geometric_tactile.sensors import grid
        >>> x = torch.randn(6, 4, 3)  # samples, taxels, channels
        >>> y = [0, 1, 0, 1, 0, 1]
        >>> dataset = StaticDataset.from_arrays(x, y, layout=grid(2, 2, pitch=0.004))
        >>> len(dataset), dataset[0].x.shape
        (6, torch.Size([4, 3]))
    """

    #: What one :obj:`group` is, in one word, such as :obj:`"object"` or :obj:`"person"`.
    group_kind: str = "group"
    _indices: Sequence[int] | None

    def __init__(
        self,
        root: PathLike | None = None,
        transform: Transform | None = None,
        pre_transform: Transform | None = None,
        pre_filter: Filter | None = None,
        force_reload: bool = False,
    ) -> None:
        super().__init__(
            None if root is None else str(root),
            transform,
            pre_transform,
            pre_filter,
            force_reload=force_reload,
        )
        if root is None:
            self._data, self._names = self._build()
            self._own_shared()
        else:
            self._data, self._names = self._take_file()
        self.__dict__.pop("_given", None)
        if not hasattr(self, "layout"):
            self.layout = layout_of(self._data)
        if self._data.num_nodes != self.layout.num_taxels:
            raise ValueError(
                f"the samples of {type(self).__name__} must have {self.layout.num_taxels} taxels, "
                f"as layout '{self.layout.name}' (got {self._data.num_nodes})"
            )

    @classmethod
    def _of(
        cls,
        source: tuple[StaticData, dict[str, list[str]]],
        layout: TaxelLayout,
        transform: Transform | None,
        pre_transform: Transform | None,
        pre_filter: Filter | None,
    ) -> Self:
        dataset = cls.__new__(cls)
        dataset.layout = layout
        dataset.__dict__["_source"] = source
        StaticDataset.__init__(dataset, None, transform, pre_transform, pre_filter)
        return dataset

    def _own_shared(self) -> None:
        # Not the tensors of the layout, which a write would change for others.
        if isinstance(self._data, StaticData):
            for key, value in self._data.to_dict().items():
                if isinstance(value, Tensor) and self._data.is_shared(key):
                    self._data._store._mapping[key] = value.clone()

    def len(self) -> int:
        r"""Returns the number of samples stored."""
        return self._data.num_samples

    def get(self, idx: int) -> Data:
        r"""Returns the sample at an index of the storage.

        Args:
            idx (int): The index.
        """
        return self._data.sample(idx)

    def __getitem__(self, idx: Any) -> Any:
        r"""Returns one sample after :obj:`transform`, or a selection of several, as PyG does."""
        if not isinstance(idx, (int, np.integer)) and not (
            isinstance(idx, (Tensor, np.ndarray)) and idx.ndim == 0
        ):
            return self.index_select(idx)
        sample = self.get(self.indices()[idx])
        if self.transform is None:
            return sample
        with unwritten(self.transform, self._watched()):
            return returned(self.transform, sample, object)

    def index_select(self, idx: Any) -> Self:
        r"""Returns a selection of the samples.

        Args:
            idx (slice or sequence of int or torch.Tensor or numpy.ndarray): Their indices, or a
                mask, of any shape.

        Raises:
            IndexError: If it is something else.
        """
        idx = idx if isinstance(idx, slice) else flat_index(idx).tolist()
        selection: Self = super().index_select(idx)
        return selection

    def _watched(self) -> Mapping[str, Any]:
        return self._data._store._mapping

    @property
    def data(self) -> StaticData:
        r"""All samples of this selection at once, before :obj:`transform`."""
        stored: StaticData = self._selected()
        return stored

    @property
    def nbytes(self) -> int:
        r"""The bytes of the attributes that are stored, of all samples. Those of a memory-mapped
        file are in memory only while they are used.
        """
        values = [value for value in self._data.to_dict().values() if isinstance(value, Tensor)]
        return sum(value.numel() * value.element_size() for value in values)

    @property
    def transforms(self) -> list[Transform | None]:
        r"""All transforms that run at every access, in their order."""
        return [self.transform]

    @property
    def info(self) -> FrameInfo:
        r"""How the frames of this selection were made: the rate of their recordings, the largest
        gap, and how they were thinned, as far as :obj:`time` and :obj:`trial` tell it.

        Raises:
            ValueError: If the recordings have several rates; the message names two of them.
        """
        return dataset_info(self, self._known_info())

    def _known_info(self) -> FrameInfo:
        # What is known beside the times of the frames.
        return FrameInfo()

    def batch(self, index: Tensor | Sequence[int]) -> StaticData:
        r"""Returns some samples at once, after :obj:`transform`: what :obj:`dataset[i]` is for one.

        Args:
            index (torch.Tensor or list of int): Indices into this selection :math:`(B,)`, or a
                mask of it.
        """
        index = flat_index(index)
        if self._indices is not None:
            index = self._index()[index]
        return apply_transform(self.transform, self._data.index_select(index))

    def copy(self, idx: Any = None) -> Self:
        r"""Returns a copy with the samples of this selection only, which shares no memory with this
        data set.

        Args:
            idx (optional): Which of them: a slice, a list, or a tensor or array of integers or
                booleans. All if left out.
        """
        dataset = copy.copy(self if idx is None else self.index_select(idx))
        dataset._data = dataset._selected().clone()
        dataset._indices = None
        return dataset

    def to(self, device: Any) -> Self:
        r"""Moves the samples of this selection to a device; other selections keep theirs.

        Args:
            device (torch.device or str): The device.
        """
        self._data = copy.copy(self._selected()).to(device)
        self._indices = None
        return self

    def cpu(self) -> Self:
        r"""Moves the samples of this selection to the CPU."""
        return self.to("cpu")

    def cuda(self, device: Any = None) -> Self:
        r"""Moves the samples of this selection to a GPU.

        Args:
            device (torch.device or str or int, optional): The device; the current one if left out.
        """
        return self.to("cuda" if device is None else torch.device("cuda", device))

    def _selected(self) -> Any:
        # What is stored of this selection: other than `data`, views do not cut it.
        return self._data if self._indices is None else self._data.index_select(self._index())

    def _index(self) -> Tensor:
        # PyG keeps a selection as a list, and converting it costs more than cutting a batch.
        indices, tensor = self.__dict__.get("_cached_index", (None, None))
        if tensor is None or indices is not self._indices:
            indices, tensor = self._indices, torch.as_tensor(self._indices, dtype=torch.long)
            self.__dict__["_cached_index"] = (indices, tensor)
        return tensor

    def column(self, key: str) -> Tensor | None:
        r"""Returns one attribute of the samples of this selection, without reading the others.

        Args:
            key (str): Name of the attribute, such as :obj:`y`, :obj:`trial` or :obj:`group`.

        Returns:
            torch.Tensor: The values :math:`(S, ...)`, or :obj:`None` if there is no such attribute.
        """
        value: Tensor | None = None
        if key in self._data:
            value = self._data[key]
        if value is None or self._indices is None or self._data.is_shared(key):
            return value
        return value[self._index()]

    def __getattr__(self, key: str) -> Any:
        data = self.__dict__.get("_data")  # not there while PyG's constructor runs
        if data is not None and key in data:
            return self.column(key)
        what = f"'{type(self).__name__}' object has no attribute '{key}'"
        if key in ("save", "load", "collate"):
            what += (
                ", which is of PyG's InMemoryDataset: define 'read' in place of 'process', and "
                "return the samples from it (StaticData.from_data_list makes them of a list); they "
                "are saved and loaded for you"
            )
        raise AttributeError(what)

    @property
    def num_classes(self) -> int:
        r"""The number of classes, over all samples that are stored, also of a selection."""
        y = self._data["y"] if "y" in self._data else None  # noqa: SIM401 - Data is no mapping
        if y is None or y.numel() == 0:
            return 0
        if self._data.level("y") != "sample" and not self._data.is_shared("y"):
            y = y.flatten(0, 1)  # as PyG joins the samples
        return int(self._infer_num_classes(y))

    @property
    def class_names(self) -> list[str]:
        r"""The names of the classes of :obj:`y`."""
        return list(self._names.get("class", ()))

    @property
    def group_names(self) -> list[str]:
        r"""The names of the groups (of the objects, usually) in :obj:`group`."""
        return list(self._names.get("group", ()))

    @property
    def session_names(self) -> list[str]:
        r"""The names of the recording sessions in :obj:`session`."""
        return list(self._names.get("session", ()))
