r"""Many samples on one topology."""

import copy
from collections.abc import Iterable, Sequence
from typing import Any, Self, SupportsIndex, overload

import numpy as np
import torch
from torch import Tensor
from torch_geometric.data import Batch, Data

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.data._block_diagonal import to_batch
from torch_geometric_tactile.data._leveled_data import LeveledData
from torch_geometric_tactile.data._levels import KNOWN_ATTRIBUTES, TOPOLOGY, Schema, flat_index

_Index = Tensor | slice | Sequence[int] | np.ndarray


class StaticData(LeveledData):
    r"""Many samples on one topology: :obj:`x` holds all samples, :obj:`edge_index` is the same for
    all.

    It is a :class:`~torch_geometric.data.Data` object whose attributes have an explicit level:

    * **node** attributes have a row for each taxel, such as :obj:`x` and :obj:`pos`,
    * **edge** attributes have a row for each edge, such as :obj:`edge_attr`,
    * **sample** attributes have a row for each sample, such as :obj:`y` and :obj:`joint`; so do
      all tensors that are neither known nor declared.

    Node and edge attributes have a leading sample dimension :math:`(S, N, \ldots)`, or are shared
    by all samples :math:`(N, \ldots)`. For known attributes (see
    :obj:`torch_geometric_tactile.data._levels.KNOWN_ATTRIBUTES`), the number of dimensions decides
    between the two; for declared attributes, the declaration does. The level is never inferred from
    a part of a name or from a size. Attributes are checked when they are set.

    Numbers, strings and dictionaries are shared, as are declared lists and arrays.

    Args:
        x (torch.Tensor, optional): Readings :math:`(S, N, F)`.
        edge_index (torch.Tensor, optional): The edges of every sample :math:`(2, |\mathcal{E}|)`.
        edge_attr (torch.Tensor, optional): Edge features, shared :math:`(|\mathcal{E}|, D)` or
            :math:`(|\mathcal{E}|,)`, or per sample :math:`(S, |\mathcal{E}|, D)`.
        y (torch.Tensor, optional): Labels :math:`(S,)` or :math:`(S, C)`.
        pos (torch.Tensor, optional): Taxel positions in metres, shared :math:`(N, 3)` or per sample
            :math:`(S, N, 3)`.
        node (iterable of str): Names of attributes with a row for each taxel
            :math:`(S, N, \ldots)`.
        edge (iterable of str): Names of attributes with a row for each edge
            :math:`(S, |\mathcal{E}|, \ldots)`.
        shared (iterable of str): Names of attributes with one value for all samples. The value of
            an attribute that is also in :obj:`node` is a tensor :math:`(N, \ldots)`, in
            :obj:`edge` :math:`(|\mathcal{E}|, \ldots)`; others may have any value. Attributes may
            be declared before they are set.
        num_samples (int, optional): The number of samples :math:`S`, required if no attribute has a
            row for each sample.
        **kwargs: Further attributes.

    Raises:
        ValueError: If the shape of an attribute does not fit its level, or the declarations
            contradict each other.

    Examples:
        >>> import torch
        >>> data = StaticData(
        ...     x=torch.zeros(5, 4, 3),
        ...     edge_index=torch.tensor([[0, 1], [1, 0]]),
        ...     mask=torch.ones(4, dtype=torch.bool),
        ...     node=["mask"],
        ...     shared=["mask"],
        ... )
        >>> data.num_samples, data.num_nodes, data.num_features
        (5, 4, 3)
        >>> data[0]
        Data(x=[4, 3], edge_index=[2, 2], mask=[4])
        >>> data.to_batch()
        DataBatch(x=[20, 3], edge_index=[2, 10], mask=[20], batch=[20], ptr=[6])
    """

    #: The class of a sample.
    sample_type: type[Data] = Data

    def __init__(
        self,
        x: Tensor | None = None,
        edge_index: Tensor | None = None,
        edge_attr: Tensor | None = None,
        y: Tensor | None = None,
        pos: Tensor | None = None,
        *,
        node: Iterable[str] = (),
        edge: Iterable[str] = (),
        shared: Iterable[str] = (),
        num_samples: SupportsIndex | None = None,
        **kwargs: Any,
    ) -> None:
        super().__init__(Schema.from_names(node, edge, shared), num_samples)
        attributes = {"x": x, "edge_index": edge_index, "edge_attr": edge_attr, "y": y, "pos": pos}
        for key, value in (attributes | kwargs).items():
            if value is not None:
                setattr(self, key, value)

    @overload
    def __getitem__(self, key: str) -> Any: ...

    @overload
    def __getitem__(self, key: int | np.integer) -> Data: ...

    @overload
    def __getitem__(self, key: _Index) -> Self: ...

    def __getitem__(self, key: Any) -> Any:
        r"""Returns an attribute by its name, a sample by its index, or several samples."""
        if isinstance(key, str):
            return super().__getitem__(key)
        if isinstance(key, (int, np.integer)) and not isinstance(key, bool):
            return self.sample(int(key))
        if isinstance(key, (Tensor, np.ndarray)) and key.ndim == 0:
            return self.sample(int(key))
        return self.index_select(key)

    def __len__(self) -> int:
        return self.num_samples

    def __bool__(self) -> bool:
        return True  # without this method, an object without samples would be false

    @property
    def num_graphs(self) -> int:
        r"""The number of samples, under PyG's name."""
        return self.num_samples

    def sample(self, i: int) -> Data:
        r"""Returns one sample as PyG's :class:`~torch_geometric.data.Data`.

        Attributes of the sample level keep a first dimension of size one, along which PyG's loader
        joins them.

        Args:
            i (int): Index of the sample.

        Raises:
            IndexError: If there is no such sample.
        """
        num_samples = self.num_samples
        if not -num_samples <= i < num_samples:
            raise IndexError(f"'i' must be below {num_samples} (got {i})")
        i %= num_samples
        schema: Schema = self._schema
        out = self.sample_type()
        # Written to the mapping directly, which takes a third of the time of out[key] = ...
        sample = out._store._mapping
        for key, value in self._store._mapping.items():
            if schema.is_shared(key, value):
                sample[key] = value
            else:
                sample[key] = value[i : i + 1] if schema.level(key) == "sample" else value[i]
        return out

    def get_example(self, idx: int) -> Data:
        r"""Returns one sample, as :meth:`sample`, under PyG's name.

        Args:
            idx (int): Index of the sample.
        """
        return self.sample(idx)

    def index_select(self, index: _Index) -> Self:
        r"""Returns a selection of the samples in the order of the indices.

        Args:
            index (torch.Tensor, slice or list of int): Indices :math:`(B,)`, a mask :math:`(S,)`,
                or a slice, which needs no copy. Tensors of more dimensions are flattened.

        Raises:
            IndexError: If :obj:`index` has another type, or there is no such sample.
        """
        if not isinstance(index, slice):
            index = flat_index(index)
        schema: Schema = self._schema
        out = copy.copy(self)
        # Written to the mapping directly, without new checks: all attributes keep their levels.
        mapping = out._store._mapping
        num_samples: int | None = None
        for key, value in mapping.items():
            if not schema.is_shared(key, value):
                mapping[key] = value[index]
                num_samples = len(mapping[key])
        stated = None
        if num_samples is None:
            num_samples = stated = len(torch.arange(self.num_samples)[index])
        out.__dict__.update(_num_samples=num_samples, _stated_samples=stated)
        return out

    def to_data_list(self) -> list[Data]:
        r"""Returns the samples one by one."""
        return [self.sample(i) for i in range(self.num_samples)]

    def to_batch(self) -> Batch:
        r"""Returns PyG's block-diagonal batch of all samples, for layers that need one.

        It equals :obj:`Batch.from_data_list(data.to_data_list())` attribute by attribute, and
        :obj:`to_data_list` of the batch returns the same samples, but no
        :class:`~torch_geometric.data.Data` object is created for each sample. Attributes of the
        batch are views of the attributes of this object where possible. The :obj:`edge_index` of
        the batch is cached for the next batch of the same size: write only to a clone of it.

        Shapes:
            - **output:** :obj:`x` :math:`(S \cdot N, F)`, :obj:`edge_index`
              :math:`(2, S \cdot |\mathcal{E}|)`, :obj:`batch` :math:`(S \cdot N,)`,
              :obj:`ptr` :math:`(S + 1,)`
        """
        return to_batch(self)

    @classmethod
    def from_data_list(
        cls,
        data_list: Iterable[Data],
        *,
        node: Iterable[str] = (),
        edge: Iterable[str] = (),
        shared: Iterable[str] = (),
    ) -> Self:
        r"""Stacks samples that have the same topology.

        Known node and edge attributes that are equal in all samples are stored once. Declared
        attributes are stored for each sample, or once if they are in :obj:`shared`. Any other
        tensor must have no dimension, or a first dimension of size one. Numbers, strings and
        dictionaries must be equal in all samples, except the numbers of known sample attributes
        such as :obj:`y`, which become a tensor.

        Args:
            data_list (iterable of torch_geometric.data.Data): The samples.
            node (iterable of str): Names of attributes with a row for each taxel.
            edge (iterable of str): Names of attributes with a row for each edge.
            shared (iterable of str): Names of attributes that are the same in all samples.

        Raises:
            ValueError: If there is no sample, or the samples differ in their edges, their
                attributes or their shapes.
        """
        schema = Schema.from_names(node, edge, shared)
        samples = list(data_list)
        return cls(
            node=schema.node,
            edge=schema.edge,
            shared=schema.shared,
            num_samples=len(samples),
            **_stack_samples(samples, schema),
        )


def _stack_samples(data_list: Sequence[Data], schema: Schema) -> dict[str, Any]:
    # The attributes of all samples, stacked or shared according to their levels.
    need(len(data_list) != 0, "'data_list' must hold at least one sample (got none)")
    for i, data in enumerate(data_list):
        if not isinstance(data, Data):
            raise TypeError(
                "'data_list' must hold torch_geometric.data.Data objects, with one kind of nodes "
                f"(got {type(data).__name__} as sample {i})"
            )
    first = set(data_list[0].keys())
    for i, data in enumerate(data_list):
        keys = set(data.keys())
        for a, b, missing in ((i, 0, first - keys), (0, i, keys - first)):
            if missing:
                raise ValueError(
                    f"sample {a} must have '{min(missing)}' as sample {b} has (got none)"
                )
    return {
        key: _stack_attribute(key, [data[key] for data in data_list], schema)
        for key in data_list[0].keys()  # noqa: SIM118
    }


def _stack_attribute(key: str, values: list[Any], schema: Schema) -> Any:
    first = values[0]
    default = KNOWN_ATTRIBUTES.get(key)
    level = schema.level(key)
    is_declared = key in schema.node or key in schema.edge
    is_number = isinstance(first, (bool, int, float))
    if is_number and default is not None and level == "sample" and key not in schema.shared:
        return torch.tensor(values)  # as PyG's loader does
    if key in schema.shared or not isinstance(first, Tensor) or key in TOPOLOGY:
        _require_equal(key, values)
        return first
    shapes = {tuple(value.shape) for value in values}
    need(len(shapes) <= 1, f"all samples must have '{key}' in one shape", sorted(shapes))
    if key == "x" or is_declared:
        return torch.stack(values)
    if level != "sample" and default is not None:
        if first.dim() not in default.ranks:
            ranks = " or ".join(map(str, default.ranks))
            raise ValueError(
                f"'{key}' must have {ranks} dimensions in a sample (got shape "
                f"{tuple(first.shape)}); name it in '{level}' to declare another shape"
            )
        # Equal values are stored once, which changes no sample.
        if all(_is_equal(value, first) for value in values):
            return first
        if first.dim() != default.ranks[-1]:
            raise ValueError(
                f"'{key}' must be named in '{level}' if it differs between samples and has "
                f"shape {tuple(first.shape)} in each"
            )
        return torch.stack(values)
    if first.dim() == 0:
        return torch.stack(values)
    if first.size(0) != 1:
        raise ValueError(
            f"'{key}' must have a first dimension of size 1 in each sample (got shape "
            f"{tuple(first.shape)}); name it in 'node' or 'edge' if it has a row for each taxel "
            "or edge, and in 'shared' if it is the same for all samples"
        )
    return torch.cat(values)


def _require_equal(key: str, values: list[Any]) -> None:
    for i, value in enumerate(values):
        if not _is_equal(value, values[0]):
            raise ValueError(
                f"sample {i} must have the same '{key}' as sample 0, since all samples share it; "
                "use torch_geometric.data.InMemoryDataset where it differs"
            )


def _is_equal(value: Any, first: Any) -> bool:
    if value is first:
        return True
    if not isinstance(value, Tensor) or not isinstance(first, Tensor):
        try:
            return bool(value == first)
        except (RuntimeError, ValueError):  # the comparison of arrays returns several truth values
            return False
    if (value.shape, value.dtype, value.layout) != (first.shape, first.dtype, first.layout):
        return False
    if value.layout == torch.strided:
        return torch.equal(value, first)
    value, first = value.to_sparse_coo().coalesce(), first.to_sparse_coo().coalesce()
    return torch.equal(value.indices(), first.indices()) and torch.equal(
        value.values(), first.values()
    )
