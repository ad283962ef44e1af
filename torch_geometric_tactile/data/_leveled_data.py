r"""PyG data whose attributes have levels."""

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
    r"""PyG's storage of attributes, each checked as it is set.

    All ways to set one end here: :obj:`data.mask = ...`, :obj:`data["mask"] = ...` and the
    :obj:`store["mask"] = ...` of PyG's transforms.
    """

    def __setitem__(self, key: str, value: Any) -> None:
        if value is not None and not self._is_like(key, value):
            data = self._parent()
            data._schema.check(key, value, self._mapping, data.__dict__.get("_stated_samples"))
            if not data._schema.is_shared(key, value):
                data.__dict__.update(_num_samples=int(value.size(0)), _stated_samples=None)
        super().__setitem__(key, value)

    def _is_like(self, key: str, value: Any) -> bool:
        # A tensor of the shape of the one that it replaces was checked with that, as in '.to()'.
        old = self._mapping.get(key)
        return isinstance(old, Tensor) and isinstance(value, Tensor) and old.shape == value.shape

    def is_node_attr(self, key: str) -> bool:
        r"""Tells whether an attribute has a row for each taxel, by its level."""
        return isinstance(self[key], Tensor) and self._parent().level(key) == "node"

    def is_edge_attr(self, key: str) -> bool:
        r"""Tells whether an attribute has a row for each edge, by its level."""
        return isinstance(self[key], Tensor) and self._parent().level(key) == "edge"


class LeveledData(Data):
    r"""A :class:`~torch_geometric.data.Data` object whose attributes have levels, and belong to one
    sample each or to all of them: the base class of
    :class:`~torch_geometric_tactile.data.StaticData`. A schema has the levels of attributes that
    are not known.

    The number of samples is kept beside the attributes, of which none may have a row for each.
    """

    def __init__(self, schema: Schema, num_samples: SupportsIndex | None = None) -> None:
        super().__init__()
        number = None
        if num_samples is not None:
            is_number = hasattr(num_samples, "__index__") and not isinstance(num_samples, bool)
            number = operator.index(num_samples) if is_number else -1
            need(
                0 <= number < _MAX_SAMPLES,
                "'num_samples' must be a number of samples",
                repr(num_samples),
            )
        self.__dict__["_schema"] = schema
        # The number as it was last known, and as the attributes to come must have it.
        self.__dict__.update(_num_samples=number, _stated_samples=number)
        self.__dict__["_store"] = CheckedStorage(_parent=self)

    def __getattr__(self, key: str) -> Any:
        if key in ("batch", "ptr"):
            # An AttributeError, so that PyG's transforms see that there is none.
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
        # The dimension of the taxels or edges, from which PyG reads their number.
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
        r"""The number of samples :math:`S`: that of the attributes with a row for each, or the one
        that :meth:`from_data_list` or the constructor got; zero if nothing has told it.
        """
        number = self._schema.num_samples(self._store._mapping)
        return (self.__dict__.get("_num_samples") or 0) if number is None else number

    @property
    def schema(self) -> dict[str, Any]:
        r"""The declarations, as arguments of the constructor and of :meth:`from_data_list`."""
        schema: Schema = self._schema
        return schema.to_dict()

    def level(self, key: str) -> Level:
        r"""Returns what an attribute has rows for: :obj:`"node"`, :obj:`"edge"` or
        :obj:`"sample"`.

        Args:
            key (str): Name of the attribute, which need not be set.
        """
        schema: Schema = self._schema
        return schema.level(key)

    def is_shared(self, key: str) -> bool:
        r"""Tells whether all samples share one value of an attribute.

        Args:
            key (str): Name of the attribute.
        """
        schema: Schema = self._schema
        return schema.is_shared(key, self._store[key])

    def declare(
        self, *, node: Iterable[str] = (), edge: Iterable[str] = (), shared: Iterable[str] = ()
    ) -> Self:
        r"""Declares attributes, in place, as the constructor does. Earlier declarations of the
        same names are replaced; copies made before keep theirs.

        Args:
            node (iterable of str): Names of attributes with a row for each taxel.
            edge (iterable of str): Names of attributes with a row for each edge.
            shared (iterable of str): Names of attributes with one value for all samples.

        Raises:
            ValueError: If an attribute has not the shape of its new level, or the declaration is
                contradictory.
        """
        declared = Schema.of(node, edge, shared)
        schema = self._schema.update(declared)
        for key in sorted(declared.node | declared.edge | declared.shared):
            if key in self._store:
                schema.check(key, self._store[key], self._store._mapping)
        self.__dict__["_schema"] = schema
        return self

    def validate(self, raise_on_error: bool = True) -> bool:
        r"""Checks all attributes again, and the edges.

        Attributes are checked one by one as they are set. When :obj:`x` or :obj:`edge_index` is
        replaced by one with another number of taxels or edges, the attributes that go with it may
        follow; this method tells whether they did.

        Args:
            raise_on_error (bool): Whether to raise a :class:`ValueError`, not only to warn.
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
