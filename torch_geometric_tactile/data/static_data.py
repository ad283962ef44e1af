r"""Many samples on one topology."""

import copy
import operator
import warnings
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple, Self, SupportsIndex, overload

import numpy as np
import torch
from torch import Tensor
from torch_geometric.data import Batch, Data
from torch_geometric.data.storage import GlobalStorage

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.data._levels import (
    KNOWN_ATTRIBUTES,
    TOPOLOGY,
    Level,
    Schema,
    flat_index,
)

_Index = Tensor | slice | Sequence[int] | np.ndarray
_MAX_SAMPLES = 2**40
_MAX_CACHED_EDGES = 4
_MAX_CACHED_BYTES = 2**26  # of all cached edges together


# Empty batches by the class of their samples. They are copied, since PyG creates a new class for
# each batch that it constructs, which is slow.
_EMPTY_BATCHES: dict[type[Data], Batch] = {Data: Batch(_base_cls=Data)}


class _CheckedStorage(GlobalStorage):
    r"""PyG's storage of attributes, which checks each attribute when it is set.

    All ways to set an attribute end here: :obj:`data.mask = ...`, :obj:`data["mask"] = ...` and
    the :obj:`store["mask"] = ...` of PyG's transforms.
    """

    def __setitem__(self, key: str, value: Any) -> None:
        if value is not None and not self._has_same_shape(key, value):
            data = self._parent()
            data._schema.check(key, value, self._mapping, data.__dict__.get("_stated_samples"))
            if not data._schema.is_shared(key, value):
                data.__dict__.update(_num_samples=int(value.size(0)), _stated_samples=None)
        super().__setitem__(key, value)

    def _has_same_shape(self, key: str, value: Any) -> bool:
        # A tensor that replaces one of the same shape, as in '.to()', needs no new check.
        old = self._mapping.get(key)
        return isinstance(old, Tensor) and isinstance(value, Tensor) and old.shape == value.shape

    def is_node_attr(self, key: str) -> bool:
        r"""Returns whether an attribute is a tensor with a row for each taxel."""
        return isinstance(self[key], Tensor) and self._parent().level(key) == "node"

    def is_edge_attr(self, key: str) -> bool:
        r"""Returns whether an attribute is a tensor with a row for each edge."""
        return isinstance(self[key], Tensor) and self._parent().level(key) == "edge"


class StaticData(Data):
    r"""A batch of samples on one topology: :obj:`x` holds the readings of all samples, which share
    one :obj:`edge_index`.

    This class is a :class:`~torch_geometric.data.Data` whose attributes have an explicit level:

    * **node** attributes, such as :obj:`x` and :obj:`pos`, have a row for each taxel,
    * **edge** attributes, such as :obj:`edge_attr`, have a row for each edge,
    * **sample** attributes, such as :obj:`y` and :obj:`joint`, have a row for each sample. Tensors
      that are neither known nor declared have this level.

    Node and edge attributes have a leading sample dimension :math:`(S, N, \ldots)`, or are shared
    by all samples :math:`(N, \ldots)`. For known attributes (see
    :obj:`torch_geometric_tactile.data._levels.KNOWN_ATTRIBUTES`), the number of dimensions decides
    between the two; for declared attributes, the declaration does. The level is never inferred from
    a part of a name or from a size. Each attribute is checked when it is set.

    Numbers, strings and dictionaries are shared. Lists and arrays are also shared and must be
    declared.

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
        shared (iterable of str): Names of attributes with one value for all samples. An attribute
            that is also in :obj:`node` must be a tensor :math:`(N, \ldots)`; one that is also in
            :obj:`edge`, a tensor :math:`(|\mathcal{E}|, \ldots)`. Other attributes may have any
            value. Attributes may be declared before they are set.
        num_samples (int, optional): The number of samples :math:`S`. Required if no attribute has a
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
        super().__init__()
        schema = Schema.from_names(node, edge, shared)
        count = None
        if num_samples is not None:
            is_integer = hasattr(num_samples, "__index__") and not isinstance(num_samples, bool)
            count = operator.index(num_samples) if is_integer else -1
            need(
                0 <= count < _MAX_SAMPLES,
                "'num_samples' must be a non-negative integer",
                repr(num_samples),
            )
        self.__dict__["_schema"] = schema
        # `_num_samples` is the last known number. `_stated_samples` is the number that the first
        # attribute with a row for each sample must have.
        self.__dict__.update(_num_samples=count, _stated_samples=count)
        self.__dict__["_store"] = _CheckedStorage(_parent=self)
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

    def __getattr__(self, key: str) -> Any:
        if key in ("batch", "ptr"):
            # An AttributeError, since PyG's transforms call `hasattr` to look for a batch vector.
            raise AttributeError(
                f"StaticData has no '{key}': its samples are stacked, not joined; call "
                "'to_batch()' for a PyG batch"
            )
        return super().__getattr__(key)

    @property
    def batch(self) -> Tensor | None:
        r"""Always raises an :class:`AttributeError`: only the output of :meth:`to_batch` has a
        batch vector.
        """
        raise AttributeError  # continues in __getattr__

    def __cat_dim__(self, key: str, value: Any, *args: Any, **kwargs: Any) -> Any:
        # PyG reads the number of taxels or edges from this dimension.
        if (
            isinstance(value, Tensor)
            and value.layout == torch.strided
            and key != "edge_index"
            and self.level(key) != "sample"
        ):
            return 0 if self._schema.is_shared(key, value) else 1
        return super().__cat_dim__(key, value, *args, **kwargs)

    @property
    def num_samples(self) -> int:
        r"""The number of samples :math:`S`, read from an attribute with a row for each sample.
        Without such an attribute, it is the number passed to the constructor or counted by
        :meth:`from_data_list`, or zero.
        """
        num_rows = self._schema.num_samples(self._store._mapping)
        return (self.__dict__.get("_num_samples") or 0) if num_rows is None else num_rows

    @property
    def schema(self) -> dict[str, Any]:
        r"""The declarations, as keyword arguments of the constructor and :meth:`from_data_list`."""
        schema: Schema = self._schema
        return schema.to_dict()

    def level(self, key: str) -> Level:
        r"""Returns the level of an attribute: :obj:`"node"` (a row for each taxel), :obj:`"edge"`
        (a row for each edge) or :obj:`"sample"` (a row for each sample).

        Args:
            key (str): Name of the attribute, which need not be set.
        """
        schema: Schema = self._schema
        return schema.level(key)

    def is_shared(self, key: str) -> bool:
        r"""Returns whether all samples share one value of an attribute.

        Args:
            key (str): Name of the attribute.
        """
        schema: Schema = self._schema
        return schema.is_shared(key, self._store[key])

    def declare(
        self, *, node: Iterable[str] = (), edge: Iterable[str] = (), shared: Iterable[str] = ()
    ) -> Self:
        r"""Declares attributes in place, like the arguments of the constructor.

        Earlier declarations of the same names are replaced. Existing copies of this object keep
        their declarations.

        Args:
            node (iterable of str): Names of attributes with a row for each taxel.
            edge (iterable of str): Names of attributes with a row for each edge.
            shared (iterable of str): Names of attributes with one value for all samples.

        Raises:
            ValueError: If the shape of an attribute does not fit its new level, or the declarations
                contradict each other.
        """
        declared = Schema.from_names(node, edge, shared)
        schema = self._schema.update(declared)
        for key in sorted(declared.node | declared.edge | declared.shared):
            if key in self._store:
                schema.check(key, self._store[key], self._store._mapping)
        self.__dict__["_schema"] = schema
        return self

    def validate(self, raise_on_error: bool = True) -> bool:
        r"""Checks all attributes and the edges, and returns whether they are valid.

        Attributes are checked one by one as they are set. After :obj:`x` or :obj:`edge_index` is
        replaced by a tensor with a different number of taxels or edges, the attributes that depend
        on this number must be replaced as well; this method checks whether all of them were.

        Args:
            raise_on_error (bool): If :obj:`True`, raises a :class:`ValueError` for an invalid
                attribute; otherwise a warning is issued.
        """
        for key, value in self._store.items():
            try:
                self._schema.check(key, value, self._store._mapping)
            except ValueError as error:
                if raise_on_error:
                    raise
                warnings.warn(str(error), stacklevel=2)
                return False
        return super().validate(raise_on_error)

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
        r"""Returns one sample, like :meth:`sample`, under PyG's name.

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
            IndexError: If :obj:`index` has the wrong type, or there is no such sample.
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

        The batch equals :obj:`Batch.from_data_list(data.to_data_list())` attribute by attribute,
        and its :obj:`to_data_list` returns the same samples, but no
        :class:`~torch_geometric.data.Data` object is created for each sample. Attributes of the
        batch are views of the attributes of this object where possible. The :obj:`edge_index` of
        the batch is cached for the next batch of the same size: only write to a clone of it.

        Shapes:
            - **output:** :obj:`x` :math:`(S \cdot N, F)`, :obj:`edge_index`
              :math:`(2, S \cdot |\mathcal{E}|)`, :obj:`batch` :math:`(S \cdot N,)`,
              :obj:`ptr` :math:`(S + 1,)`
        """
        return _to_batch(self)

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
                    f"sample {a} must have '{min(missing)}', like sample {b} (got none)"
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
    need(len(shapes) <= 1, f"'{key}' must have the same shape in all samples", sorted(shapes))
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
                "use torch_geometric.data.InMemoryDataset for samples that differ in it"
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


def _to_batch(data: StaticData) -> Batch:
    r"""Returns the batch that :meth:`~torch_geometric.data.Batch.from_data_list` builds from the
    samples, without creating a :class:`~torch_geometric.data.Data` object for each.
    """
    num_samples = data.num_samples
    numbers = torch.arange(num_samples + 1)
    sample = data.sample(0) if num_samples else _empty_sample(data)
    sample_type = data.sample_type
    if sample_type not in _EMPTY_BATCHES:
        _EMPTY_BATCHES[sample_type] = Batch(_base_cls=sample_type)
    out = copy.copy(_EMPTY_BATCHES[sample_type])
    mapping = out._store._mapping  # a dictionary, without the checks of PyG's attributes
    # PyG uses these to separate the samples of a batch again: the first row of each sample, and the
    # number that was added to its indices.
    slices: dict[str, Any] = {}
    increments: dict[str, Any] = {}
    pyg_keys = []
    for key, value in data._store._mapping.items():
        if key == "num_nodes":
            mapping[key] = value * num_samples
            out._num_nodes = [value] * num_samples
        elif type(value) is Tensor and value.layout == torch.strided:
            mapping[key], slices[key], increments[key] = _join_tensor(
                data, sample, key, value, numbers
            )
        elif isinstance(value, str):
            mapping[key] = [value] * num_samples
            slices[key], increments[key] = numbers, None
        else:
            pyg_keys.append(key)
    if pyg_keys and num_samples:
        _join_with_pyg(out, data, pyg_keys, slices, increments)
    # As in PyG, a batch has no 'batch' vector if no attribute determines the number of nodes.
    if sample._store.can_infer_num_nodes:
        num_nodes = sample.num_nodes or 0
        values = data._store._mapping.values()
        device = next((v.device for v in values if isinstance(v, Tensor)), None)
        numbers = numbers.to(device)
        mapping["batch"] = numbers[:-1].repeat_interleave(num_nodes)
        mapping["ptr"] = num_nodes * numbers
    out._num_graphs = num_samples
    out._slice_dict = slices
    out._inc_dict = increments
    return out


def _empty_sample(data: StaticData) -> Data:
    # A sample of zeros with the types and shapes of the attributes of an empty data set.
    out = data.sample_type()
    for key, value in data._store.items():
        if data.is_shared(key):
            out[key] = value
        else:
            sample_level = data.level(key) == "sample"
            out[key] = value.new_zeros((1, *value.shape[1:]) if sample_level else value.shape[1:])
    return out


def _join_tensor(
    data: StaticData, sample: Data, key: str, value: Tensor, numbers: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    # Returns the attribute in the batch, the first row of each sample in it, and the increment of
    # each sample. `sample` is the first sample; all samples have its types and shapes.
    sample_value: Tensor = sample[key]
    num_samples = len(numbers) - 1
    shared = data.is_shared(key)
    dim, size = 0, 1
    if sample_value.dim():
        dim = sample.__cat_dim__(key, sample_value) % sample_value.dim()
        size = sample_value.size(dim)
    if "batch" in key and not shared:
        rows = value.flatten(1) if value.dim() > 1 else value.view(-1, 1)
        counts = rows.amax(1).long().cpu() + 1
        starts = counts.cumsum(0) - counts
        has_increments = num_samples > 1 and int(starts[-1]) != 0
    else:
        step = sample.__inc__(key, sample_value)
        if step is None:  # PyG 2.6 returns None without an error
            raise RuntimeError(f"Unable to infer 'num_nodes', which '{key}' needs; please set it")
        starts = step * numbers[:-1]
        has_increments = num_samples > 1 and step != 0
        if has_increments and key == "edge_index":
            return _edges.get(value, step, num_samples), size * numbers, starts
    if shared:
        value = sample_value.expand(num_samples, *sample_value.shape)
    elif data.level(key) == "sample":
        value = value.unsqueeze(1)  # a sample of PyG has a first dimension of size one
    if has_increments:
        # A zero-dimensional tensor does not promote the type of another tensor of the same kind.
        dtype = torch.result_type(sample_value, starts[0])
        start = starts.to(dtype=dtype, device=value.device)
        value = value.to(dtype) + start.view(-1, *[1] * (value.dim() - 1))
    if sample_value.dim() == 0:
        return value.clone(), numbers, starts
    if dim > 0:
        value = value.movedim(0, dim)
    return value.flatten(dim, dim + 1), size * numbers, starts


def _join_with_pyg(
    out: Batch,
    data: StaticData,
    keys: list[str],
    slices: dict[str, Any],
    increments: dict[str, Any],
) -> None:
    # Sparse tensors, numbers, lists and dictionaries are rare and left to PyG.
    samples = data.to_data_list() if any(not data.is_shared(key) for key in keys) else None
    parts = [data.sample(0)] * data.num_samples if samples is None else samples
    excluded = [key for key in data.keys() if key not in keys]  # noqa: SIM118
    if "num_nodes" in data or any("index" in key for key in keys):
        # PyG adds the number of nodes to indices, and reads this number from 'x'.
        excluded = [key for key in excluded if key != "x"]
    pyg_batch = Batch.from_data_list(parts, exclude_keys=excluded)
    for key in keys:
        out[key] = pyg_batch[key]
        slices[key] = pyg_batch._slice_dict[key]
        increments[key] = pyg_batch._inc_dict[key]


class _CachedEdges(NamedTuple):
    edge_index: Tensor  # a private copy, which no caller can write to
    num_nodes: int
    num_samples: int
    edges: Tensor
    version: int

    def matches(self, edge_index: Tensor, num_nodes: int, num_samples: int) -> bool:
        return (
            (self.num_nodes, self.num_samples) == (num_nodes, num_samples)
            and self.edge_index.dtype == edge_index.dtype
            and self.edge_index.device == edge_index.device
            and self.edges._version == self.version  # a caller may have written to it
            and torch.equal(self.edge_index, edge_index)
        )


class _EdgeCache:
    r"""A cache of the most recent block-diagonal edges, whose construction takes longer than all
    other steps of building a batch.

    Edges are compared by value, so that changes in place are noticed as well.
    """

    def __init__(self) -> None:
        # A tuple that is replaced, never edited, since other threads may be reading it.
        self.entries: tuple[_CachedEdges, ...] = ()

    def get(self, edge_index: Tensor, num_nodes: int, num_samples: int) -> Tensor:
        for entry in self.entries:
            if entry.matches(edge_index, num_nodes, num_samples):
                return entry.edges
        start = num_nodes * torch.arange(
            num_samples, dtype=edge_index.dtype, device=edge_index.device
        )
        edges = (edge_index.unsqueeze(1) + start.view(1, -1, 1)).flatten(1)
        if edges.is_inference():  # without a version counter, a later write would go unnoticed
            return edges
        entry = _CachedEdges(edge_index.clone(), num_nodes, num_samples, edges, edges._version)
        entries: list[_CachedEdges] = []
        size = 0
        for candidate in (entry, *self.entries):
            size += candidate.edges.numel() * candidate.edges.element_size()
            if size <= _MAX_CACHED_BYTES and len(entries) < _MAX_CACHED_EDGES:
                entries.append(candidate)
        self.entries = tuple(entries)
        return edges


_edges = _EdgeCache()
