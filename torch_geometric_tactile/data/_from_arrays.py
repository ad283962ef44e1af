r"""Data sets of arrays and lists of your own."""

from collections.abc import Callable, Iterable, Sequence
from typing import Any, ClassVar, Self

from torch_geometric.data import Data

from torch_geometric_tactile._typing import Filter, PathLike, Transform
from torch_geometric_tactile.data._arrays import layout_of, static_data_from_arrays
from torch_geometric_tactile.data.static_data import StaticData
from torch_geometric_tactile.sensors import TaxelLayout, as_layout


class FromArrays:
    r"""The constructors of :class:`~torch_geometric_tactile.data.StaticDataset` for samples that
    are in memory already."""

    _of: ClassVar[Callable[..., Any]]  # of the data set: one of samples, a layout and transforms

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
        r"""Returns a data set of arrays in memory, NumPy's or PyTorch's.

        Numbers in double precision are converted to single precision, except :obj:`time`. Names in
        :obj:`y`, :obj:`group` and :obj:`session` are numbered; names that differ by surrounding
        blanks or case only, or are equal as numbers, are one. If the layout has one link, the
        samples share its positions and normals; those of a hand follow from its joint angles, see
        :class:`~torch_geometric_tactile.transforms.TaxelPose`.

        Args:
            x (array-like): Readings :math:`(S, N, F)`, or :math:`(S, N)` for one channel. Missing
                ones are NaN.
            y (array-like, optional): Labels :math:`(S,)` or :math:`(S, C)`, or names :math:`(S,)`.
            layout (TaxelLayout or str or PathLike): The taxels: a layout, the name of one that
                comes with the package, or a layout file.
            group (array-like, optional): The group (usually, the object) of each sample, as
                numbers or names :math:`(S,)`.
            trial (array-like, optional): Number of the trial of each sample :math:`(S,)`.
            session (array-like, optional): The recording session of each sample, as numbers or
                names :math:`(S,)`.
            joint (array-like, optional): Joint angles in radians :math:`(S, J)`.
            time (array-like, optional): Times in seconds :math:`(S,)`.
            edge_index (array-like, optional): The edges of every sample
                :math:`(2, |\mathcal{E}|)`.
            adjacency (str, optional): Name of the adjacency of the layout that has the edges. If
                both are left out, it is :obj:`"original"`, or the only one of the layout; without
                such there are no edges, which a :obj:`pre_transform` such as
                :class:`~torch_geometric_tactile.transforms.KNNGraph` may add.
            class_names (sequence of str): The names of the classes of :obj:`y`, in their order.
            group_names (sequence of str): The names of the groups (usually, objects).
            session_names (sequence of str): The names of the recording sessions.
            transform (callable, optional): Applied at every access.
            pre_transform (callable, optional): Applied once, to all samples.
            pre_filter (callable, optional): Tells whether a sample is kept.
            node (iterable of str): Further attributes with a row for each taxel
                :math:`(S, N, \ldots)`.
            edge (iterable of str): Further attributes with a row for each edge
                :math:`(S, |\mathcal{E}|, \ldots)`.
            shared (iterable of str): Further attributes that all samples share, without
                :math:`S`.
            **attributes: Further attributes, with a row for each sample if not named above.

        Raises:
            ValueError: If an array has another shape than layout and samples ask for, or there is
                no such layout or adjacency.

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
        dataset: Self = cls._of(source, layout, transform, pre_transform, pre_filter)
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
        r"""Returns a data set of PyG's :class:`~torch_geometric.data.Data` objects in memory.

        Args:
            data_list (iterable of torch_geometric.data.Data): The samples, such as a list or a PyG
                data set. They must have the same edges.
            layout (TaxelLayout or str or PathLike, optional): The taxels: a layout, the name of one
                that comes with the package, or a layout file. If left out, they are at the
                :obj:`pos` that the samples share.
            class_names (sequence of str): The names of the classes of :obj:`y`, in their order.
            group_names (sequence of str): The names of the groups (usually, objects).
            session_names (sequence of str): The names of the recording sessions.
            transform (callable, optional): Applied at every access.
            pre_transform (callable, optional): Applied once, to all samples.
            pre_filter (callable, optional): Tells whether a sample is kept.
            node (iterable of str): Further attributes with a row for each taxel.
            edge (iterable of str): Further attributes with a row for each edge.
            shared (iterable of str): Further attributes that all samples share.

        Raises:
            ValueError: If there is no sample, the samples differ in their edges, their attributes
                or their shapes, or there is neither a layout nor one :obj:`pos`.
        """
        data = StaticData.from_data_list(data_list, node=node, edge=edge, shared=shared)
        names = {"class": class_names, "group": group_names, "session": session_names}
        source = data, {key: list(value) for key, value in names.items() if value}
        layout = layout_of(data) if layout is None else as_layout(layout)
        dataset: Self = cls._of(source, layout, transform, pre_transform, pre_filter)
        return dataset
