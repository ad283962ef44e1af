r"""The base class of data sets whose samples share one topology."""

import copy
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Self

import numpy as np
import torch
from torch import Tensor
from torch_geometric.data import Data

from torch_geometric_tactile._typing import Filter, PathLike, Transform
from torch_geometric_tactile.data._arrays import layout_from_pos, static_data_from_arrays
from torch_geometric_tactile.data._dataset_info import dataset_info
from torch_geometric_tactile.data._levels import flat_index
from torch_geometric_tactile.data._processed_dataset import ProcessedDataset
from torch_geometric_tactile.data.apply_transform import (
    apply_transform,
    call_transform,
    forbid_writes,
)
from torch_geometric_tactile.data.frame_info import FrameInfo
from torch_geometric_tactile.data.static_data import StaticData
from torch_geometric_tactile.sensors import TaxelLayout, as_layout


class StaticDataset(ProcessedDataset):
    r"""A PyG data set whose samples share one topology and are stored in one tensor.

    :obj:`dataset[i]` is an ordinary :class:`~torch_geometric.data.Data` object, so that PyG's
    :class:`~torch_geometric.loader.DataLoader`, transforms and explainers work.
    :class:`~torch_geometric_tactile.loader.StaticLoader` loads whole batches instead. The
    attributes of all samples are attributes of the data set, such as :obj:`dataset.y`. The
    processed file is memory-mapped, so that a data set may be larger than memory.

    Use :meth:`from_arrays` or :meth:`from_data_list` for data in memory. To read files, write a
    subclass: it defines :meth:`read`, and sets :obj:`layout` unless its samples share their
    :obj:`pos`. With a :obj:`root` it may also define :obj:`raw_file_names` (by default all files in
    :obj:`root/raw`), :obj:`processed_file_names` (by default a file named after the class) and
    :meth:`download`.

    The processed file records the class, the arguments of its constructor, :obj:`layout`,
    :obj:`pre_transform`, :obj:`pre_filter` and :meth:`raw_state`. If one of them has changed, a
    warning names it and the raw files are processed again.

    Args:
        root (str or PathLike, optional): Folder of the raw and the processed files. If left out,
            the data set is in memory.
        transform (callable, optional): Applied at every access.
        pre_transform (callable, optional): Applied once, before the samples are saved.
        pre_filter (callable, optional): Returns whether to keep a sample.
        force_reload (bool): Whether to process the raw files again.

    Raises:
        ValueError: If the processed file is damaged, holds samples of another layout, or was
            written with other settings and the raw files are missing.

    Examples:
        >>> from torch_geometric_tactile.sensors import grid
        >>> x = torch.randn(6, 4, 3)  # samples, taxels, channels
        >>> y = [0, 1, 0, 1, 0, 1]
        >>> dataset = StaticDataset.from_arrays(x, y, layout=grid(2, 2, pitch=0.004))
        >>> len(dataset), dataset[0].x.shape
        (6, torch.Size([4, 3]))
    """

    #: The meaning of :obj:`group` in one word, such as :obj:`"object"` or :obj:`"person"`.
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
            self._clone_shared()
        else:
            self._data, self._names = self._pop_file()
        self.__dict__.pop("_constructor_call", None)
        if not hasattr(self, "layout"):
            self.layout = layout_from_pos(self._data)
        if self._data.num_nodes != self.layout.num_taxels:
            raise ValueError(
                f"the samples of {type(self).__name__} must have {self.layout.num_taxels} taxels, "
                f"as in layout '{self.layout.name}' (got {self._data.num_nodes})"
            )

    @classmethod
    def from_arrays(
        cls,
        x: Any,
        y: Any = None,
        *,
        layout: TaxelLayout | PathLike,
        group: Any = None,
        trial: Any = None,
        session: Any = None,
        joint: Any = None,
        time: Any = None,
        edge_index: Any = None,
        adjacency: str | None = None,
        class_names: Sequence[str] = (),
        group_names: Sequence[str] = (),
        session_names: Sequence[str] = (),
        transform: Transform | None = None,
        pre_transform: Transform | None = None,
        pre_filter: Filter | None = None,
        node: Iterable[str] = (),
        edge: Iterable[str] = (),
        shared: Iterable[str] = (),
        **attributes: Any,
    ) -> Self:
        r"""Builds a data set from NumPy or PyTorch arrays in memory.

        Numbers in half and double precision are converted to single precision, except :obj:`time`.
        Names in :obj:`y`, :obj:`group`, :obj:`trial`, :obj:`session` and further attributes are
        converted to integers. Names that differ only in surrounding blanks or in case, or are equal
        as numbers, get the same integer.

        If the layout has one link, the samples share its positions and normals. The positions and
        normals of a hand depend on its joint angles;
        :class:`~torch_geometric_tactile.transforms.TaxelPose` computes them.

        Args:
            x (array-like): Readings :math:`(S, N, F)`, or :math:`(S, N)` for one channel. Missing
                readings are NaN.
            y (array-like, optional): Labels :math:`(S,)` or :math:`(S, C)`, or names :math:`(S,)`.
            layout (TaxelLayout or str or PathLike): The taxels: a layout, the name of a layout of
                this package, or a layout file.
            group (array-like, optional): The group (usually the object) of each sample, as numbers
                or names :math:`(S,)`.
            trial (array-like, optional): The trial of each sample, as numbers or names
                :math:`(S,)`.
            session (array-like, optional): The recording session of each sample, as numbers or
                names :math:`(S,)`.
            joint (array-like, optional): Joint angles in radians :math:`(S, J)`.
            time (array-like, optional): Times in seconds :math:`(S,)`.
            edge_index (array-like, optional): The edges of every sample
                :math:`(2, |\mathcal{E}|)`.
            adjacency (str, optional): Name of an adjacency of the layout, whose edges are used. If
                both :obj:`edge_index` and :obj:`adjacency` are left out, the default is
                :obj:`"original"`, or the only adjacency of the layout. With a layout without
                adjacencies the samples have no edges; a :obj:`pre_transform` such as
                :class:`~torch_geometric_tactile.transforms.KNNGraph` can add them.
            class_names (sequence of str): The names of the classes, in the order of the numbers in
                :obj:`y`.
            group_names (sequence of str): The names of the groups (usually objects).
            session_names (sequence of str): The names of the recording sessions.
            transform (callable, optional): Applied at every access.
            pre_transform (callable, optional): Applied once to all samples.
            pre_filter (callable, optional): Returns whether to keep a sample.
            node (iterable of str): Names of further attributes with a row for each taxel
                :math:`(S, N, \ldots)`.
            edge (iterable of str): Names of further attributes with a row for each edge
                :math:`(S, |\mathcal{E}|, \ldots)`.
            shared (iterable of str): Names of further attributes that all samples share, without
                the dimension :math:`S`.
            **attributes: Further attributes, with a row for each sample unless named in
                :obj:`node`, :obj:`edge` or :obj:`shared`. Pass the names of people, for example,
                to split by person with :class:`~torch_geometric_tactile.data.Protocol`.

        Raises:
            ValueError: If the shape of an array does not fit the layout or the number of samples,
                a label, group, trial or session is missing, or there is no such layout or
                adjacency.

        Examples:
            >>> import torch
            >>> from torch_geometric_tactile.data import StaticDataset
            >>> from torch_geometric_tactile.sensors import grid
            >>> x, y = torch.rand(20, 6, 3), ["rest", "touch"] * 10
            >>> dataset = StaticDataset.from_arrays(x, y, layout=grid(2, 3, pitch=0.002))
            >>> dataset, dataset.class_names
            (StaticDataset(20), ['rest', 'touch'])
            >>> dataset[0]
            Data(x=[6, 3], edge_index=[2, 14], y=[1], pos=[6, 3], normal=[6, 3])
        """
        layout = as_layout(layout)
        if edge_index is not None and adjacency is not None:
            raise ValueError("only one of 'edge_index' and 'adjacency' may be given (got both)")
        adjacency = layout.default_adjacency if adjacency is None else adjacency
        if edge_index is None and adjacency is not None:
            edge_index = layout.edge_index(adjacency)
        columns = {"group": group, "trial": trial, "session": session, "joint": joint, "time": time}
        source = static_data_from_arrays(
            x,
            layout,
            edge_index,
            {"y": y, **columns, **attributes},
            {"class": class_names, "group": group_names, "session": session_names},
            {"node": tuple(node), "edge": tuple(edge), "shared": tuple(shared)},
        )
        return cls._from_samples(source, layout, transform, pre_transform, pre_filter)

    @classmethod
    def from_data_list(
        cls,
        data_list: Iterable[Data],
        *,
        layout: TaxelLayout | PathLike | None = None,
        class_names: Sequence[str] = (),
        group_names: Sequence[str] = (),
        session_names: Sequence[str] = (),
        transform: Transform | None = None,
        pre_transform: Transform | None = None,
        pre_filter: Filter | None = None,
        node: Iterable[str] = (),
        edge: Iterable[str] = (),
        shared: Iterable[str] = (),
    ) -> Self:
        r"""Builds a data set from PyG's :class:`~torch_geometric.data.Data` objects in memory.

        Args:
            data_list (iterable of torch_geometric.data.Data): The samples, such as a list or a PyG
                data set. They must have the same edges.
            layout (TaxelLayout or str or PathLike, optional): The taxels: a layout, the name of a
                layout of this package, or a layout file. If left out, a layout is built from the
                :obj:`pos` that the samples share.
            class_names (sequence of str): The names of the classes, in the order of the numbers in
                :obj:`y`.
            group_names (sequence of str): The names of the groups (usually objects).
            session_names (sequence of str): The names of the recording sessions.
            transform (callable, optional): Applied at every access.
            pre_transform (callable, optional): Applied once to all samples.
            pre_filter (callable, optional): Returns whether to keep a sample.
            node (iterable of str): Names of further attributes with a row for each taxel.
            edge (iterable of str): Names of further attributes with a row for each edge.
            shared (iterable of str): Names of further attributes that all samples share.

        Raises:
            ValueError: If there is no sample, the samples differ in their edges, their attributes
                or their shapes, or there is neither a layout nor a shared :obj:`pos`.
        """
        data = StaticData.from_data_list(data_list, node=node, edge=edge, shared=shared)
        names = {"class": class_names, "group": group_names, "session": session_names}
        source = data, {key: list(value) for key, value in names.items() if value}
        layout = layout_from_pos(data) if layout is None else as_layout(layout)
        return cls._from_samples(source, layout, transform, pre_transform, pre_filter)

    @classmethod
    def _from_samples(
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

    def _clone_shared(self) -> None:
        # Shared tensors may belong to the layout, which other data sets use as well. A write to the
        # samples must not change them.
        if isinstance(self._data, StaticData):
            for key, value in self._data.to_dict().items():
                if isinstance(value, Tensor) and self._data.is_shared(key):
                    self._data._store._mapping[key] = value.clone()

    def len(self) -> int:
        r"""Returns the number of stored samples, including samples that are not selected."""
        return self._data.num_samples

    def get(self, idx: int) -> Data:
        r"""Returns a stored sample, before :obj:`transform`.

        Args:
            idx (int): Index among all stored samples.
        """
        return self._data.sample(idx)

    def __getitem__(self, idx: Any) -> Any:
        r"""Returns one sample after :obj:`transform`, or a selection of several."""
        if not isinstance(idx, (int, np.integer)) and not (
            isinstance(idx, (Tensor, np.ndarray)) and idx.ndim == 0
        ):
            return self.index_select(idx)
        sample = self.get(self.indices()[idx])
        if self.transform is None:
            return sample
        with forbid_writes(self.transform, self._stored_tensors()):
            return call_transform(self.transform, sample, object)

    def index_select(self, idx: Any) -> Self:
        r"""Returns a selection of the samples.

        Args:
            idx (slice or sequence of int or torch.Tensor or numpy.ndarray): Indices or a mask, of
                any shape.

        Raises:
            IndexError: If :obj:`idx` has the wrong type.
        """
        idx = idx if isinstance(idx, slice) else flat_index(idx).tolist()
        selection: Self = super().index_select(idx)
        return selection

    def _stored_tensors(self) -> Mapping[str, Any]:
        # The attributes that a transform must not change in place.
        return self._data._store._mapping

    @property
    def data(self) -> StaticData:
        r"""All samples of this selection, before :obj:`transform`."""
        stored: StaticData = self._selected()
        return stored

    @property
    def nbytes(self) -> int:
        r"""The size of all stored attributes in bytes. Attributes of a memory-mapped file are in
        memory only while they are used.
        """
        values = [value for value in self._data.to_dict().values() if isinstance(value, Tensor)]
        return sum(value.numel() * value.element_size() for value in values)

    @property
    def transforms(self) -> list[Transform | None]:
        r"""All transforms that run at every access, in the order of their application."""
        return [self.transform]

    @property
    def info(self) -> FrameInfo:
        r"""The properties of the frames of this selection: the rate of their recordings, the
        largest gap and the stride, as far as :obj:`time` and :obj:`trial` determine them.

        Raises:
            ValueError: If the recordings have several rates. The message names two recordings.
        """
        return dataset_info(self, self._known_info())

    def _known_info(self) -> FrameInfo:
        # The properties that are known without the times of the frames.
        return FrameInfo()

    def batch(self, index: Tensor | Sequence[int]) -> StaticData:
        r"""Returns several samples as one object, after :obj:`transform`.

        Args:
            index (torch.Tensor or list of int): Indices into this selection :math:`(B,)`, or a
                mask over it.
        """
        index = flat_index(index)
        if self._indices is not None:
            index = self._index()[index]
        return apply_transform(self.transform, self._data.index_select(index))

    def copy(self, idx: Any = None) -> Self:
        r"""Returns a copy that contains only the samples of this selection and shares no memory
        with this data set.

        Args:
            idx (slice or sequence of int or torch.Tensor or numpy.ndarray, optional): Indices or a
                mask of the samples to copy. If left out, all samples of this selection are copied.
        """
        dataset = copy.copy(self if idx is None else self.index_select(idx))
        dataset._data = dataset._selected().clone()
        dataset._indices = None
        return dataset

    def to(self, device: Any) -> Self:
        r"""Moves the samples of this selection to a device. Other selections stay where they are.

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
            device (torch.device or str or int, optional): The device. If left out, the current GPU
                is used.
        """
        return self.to("cuda" if device is None else torch.device("cuda", device))

    def _selected(self) -> Any:
        # The stored samples of this selection. A view returns windows that are not cut yet, unlike
        # `data`.
        return self._data if self._indices is None else self._data.index_select(self._index())

    def _index(self) -> Tensor:
        # Cached, since PyG stores a selection as a list, whose conversion to a tensor takes longer
        # than selecting a batch.
        indices, tensor = self.__dict__.get("_cached_index", (None, None))
        if tensor is None or indices is not self._indices:
            indices, tensor = self._indices, torch.as_tensor(self._indices, dtype=torch.long)
            self.__dict__["_cached_index"] = (indices, tensor)
        return tensor

    def column(self, key: str) -> Tensor | None:
        r"""Returns one attribute of the samples of this selection, without reading any other
        attribute.

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
        data = self.__dict__.get("_data")  # not yet set while PyG's constructor runs
        if data is not None and key in data:
            return self.column(key)
        message = f"'{type(self).__name__}' object has no attribute '{key}'"
        if key in ("save", "load", "collate"):
            message += (
                ", which belongs to PyG's InMemoryDataset: define 'read' in place of 'process', "
                "and return the samples from it (StaticData.from_data_list builds them from a "
                "list); they are saved and loaded automatically"
            )
        raise AttributeError(message)

    @property
    def num_classes(self) -> int:
        r"""The number of classes over all stored samples, including samples that are not
        selected.
        """
        y = self._data["y"] if "y" in self._data else None  # noqa: SIM401 - Data is no mapping
        if y is None or y.numel() == 0:
            return 0
        if self._data.level("y") != "sample" and not self._data.is_shared("y"):
            y = y.flatten(0, 1)  # the shape of the labels in PyG's batches
        return int(self._infer_num_classes(y))

    @property
    def class_names(self) -> list[str]:
        r"""The names of the classes of :obj:`y`."""
        return list(self._names.get("class", ()))

    @property
    def group_names(self) -> list[str]:
        r"""The names of the groups (usually objects) in :obj:`group`."""
        return list(self._names.get("group", ()))

    @property
    def session_names(self) -> list[str]:
        r"""The names of the recording sessions in :obj:`session`."""
        return list(self._names.get("session", ()))

    @property
    def trial_names(self) -> list[str]:
        r"""The names of the trials in :obj:`trial`. If each file is a trial, they are the names of
        the files without suffix. The list is empty if the trials only have numbers.
        """
        return list(self._names.get("trial", ()))
