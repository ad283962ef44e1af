r"""A PyG data object whose attributes belong to taxels, edges or samples."""

import operator
import warnings
from collections.abc import Iterable
from typing import Any, Self, SupportsIndex

import torch
from torch import Tensor
from torch_geometric.data import Data
from torch_geometric.data.storage import GlobalStorage

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.data._levels import Level, Schema

_MAX_SAMPLES = 2**40


class CheckedStorage(GlobalStorage):
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


class LeveledData(Data):
    r"""The base class of :class:`~torch_geometric_tactile.data.StaticData`: a
    :class:`~torch_geometric.data.Data` object whose attributes have a level (node, edge or sample),
    and a value for each sample or one for all samples. The schema declares the levels of attributes
    that the package does not know.

    The number of samples is stored apart from the attributes, since all of them may be shared.
    """

    def __init__(self, schema: Schema, num_samples: SupportsIndex | None = None) -> None:
        super().__init__()
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
        self.__dict__["_store"] = CheckedStorage(_parent=self)

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
        r"""Raises an :class:`AttributeError`: only :meth:`to_batch` has it."""
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
        r"""The number of samples :math:`S`: the rows of the attributes with a row for each sample;
        without such attributes, the number passed to the constructor or counted by
        :meth:`from_data_list`, or zero.
        """
        num_rows = self._schema.num_samples(self._store._mapping)
        return (self.__dict__.get("_num_samples") or 0) if num_rows is None else num_rows

    @property
    def schema(self) -> dict[str, Any]:
        r"""The declarations as arguments of the constructor and of :meth:`from_data_list`."""
        schema: Schema = self._schema
        return schema.to_dict()

    def level(self, key: str) -> Level:
        r"""Returns the level of an attribute: :obj:`"node"` if it has a row for each taxel,
        :obj:`"edge"` for each edge, or :obj:`"sample"` for each sample.

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
        r"""Declares attributes in place, as the arguments of the constructor do. Earlier
        declarations of the same names are replaced; existing copies keep their declarations.

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

        Attributes are checked one by one as they are set. If :obj:`x` or :obj:`edge_index` is
        replaced by a tensor with another number of taxels or edges, the attributes that belong to
        them can be replaced afterwards; this method checks whether all of them were.

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
