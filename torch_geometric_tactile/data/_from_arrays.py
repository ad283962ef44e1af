r"""Constructors of data sets from arrays and lists."""

from collections.abc import Callable, Iterable, Sequence
from typing import Any, ClassVar, Self

from torch_geometric.data import Data

from torch_geometric_tactile._typing import Filter, PathLike, Transform
from torch_geometric_tactile.data._arrays import layout_from_pos, static_data_from_arrays
from torch_geometric_tactile.data.static_data import StaticData
from torch_geometric_tactile.sensors import TaxelLayout, as_layout


class FromArrays:
    r"""The constructors of :class:`~torch_geometric_tactile.data.StaticDataset` for samples in
    memory.
    """

    # Defined by the data set: builds it from samples, a layout and transforms.
    _from_samples: ClassVar[Callable[..., Any]]

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

        Numbers in double precision are converted to single precision, except :obj:`time`. Names in
        :obj:`y`, :obj:`group` and :obj:`session` are numbered; names that differ only in
        surrounding blanks or in case, or are equal as numbers, get the same number. If the layout
        has one link, the samples share its positions and normals. Those of a hand depend on its
        joint angles and are computed by :class:`~torch_geometric_tactile.transforms.TaxelPose`.

        Args:
            x (array-like): Readings :math:`(S, N, F)`, or :math:`(S, N)` for one channel. Missing
                ones are NaN.
            y (array-like, optional): Labels :math:`(S,)` or :math:`(S, C)`, or names :math:`(S,)`.
            layout (TaxelLayout or str or PathLike): The taxels: a layout, the name of a layout of
                this package, or a layout file.
            group (array-like, optional): The group (usually the object) of each sample, as numbers
                or names :math:`(S,)`.
            trial (array-like, optional): Number of the trial of each sample :math:`(S,)`.
            session (array-like, optional): The recording session of each sample, as numbers or
                names :math:`(S,)`.
            joint (array-like, optional): Joint angles in radians :math:`(S, J)`.
            time (array-like, optional): Times in seconds :math:`(S,)`.
            edge_index (array-like, optional): The edges of every sample
                :math:`(2, |\mathcal{E}|)`.
            adjacency (str, optional): Name of the adjacency of the layout that has the edges. If
                both :obj:`edge_index` and :obj:`adjacency` are left out, it is :obj:`"original"`,
                or the only adjacency of the layout. A layout without adjacency gives no edges; a
                :obj:`pre_transform` such as
                :class:`~torch_geometric_tactile.transforms.KNNGraph` may add them.
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
                :obj:`node`, :obj:`edge` or :obj:`shared`.

        Raises:
            ValueError: If the shape of an array does not fit the layout or the number of samples,
                or there is no such layout or adjacency.

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
        dataset: Self = cls._from_samples(source, layout, transform, pre_transform, pre_filter)
        return dataset

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
                layout of this package, or a layout file. If left out, the taxels are at the
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
        dataset: Self = cls._from_samples(source, layout, transform, pre_transform, pre_filter)
        return dataset
