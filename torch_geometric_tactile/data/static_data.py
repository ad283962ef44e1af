r"""One topology, many samples."""

from collections.abc import Collection, Iterable, Sequence
from typing import Any, Self

import torch
from torch import Tensor
from torch_geometric.data import Data

# The number of dimensions that these attributes have when all samples share them.
_SHARED_DIM = {
    "pos": 2,
    "normal": 2,
    "edge_attr": 2,
    "edge_weight": 1,
    "absolute": 2,
    "dropped": 1,
    "missing": 1,
}
# Everyday words, which may name a user's own attribute of the samples: the number of dimensions is
# not enough, there must be a row for each taxel as well.
_NEEDS_ROWS = ("absolute", "dropped", "missing")


def _stands_once(key: str, value: Any) -> bool:
    return not isinstance(value, Tensor) or "index" in key or "face" in key


class StaticData(Data):
    r"""Many samples on one topology: :obj:`x` holds all samples, :obj:`edge_index` stands once.

    It is a :class:`~torch_geometric.data.Data` object whose per-sample attributes carry a leading
    sample dimension, so that it moves between devices, prints and takes attributes as any other.

    An attribute belongs to the samples if its name says so (:obj:`x`; :obj:`pos`, :obj:`normal` and
    :obj:`edge_attr` with three dimensions, :obj:`edge_weight` with two), and otherwise if its first
    dimension is the number of samples. Attributes whose name contains :obj:`index` or
    :obj:`face`, and those named in :obj:`shared`, stand once for all samples. So do
    :obj:`absolute` with two dimensions and :obj:`dropped` and :obj:`missing` with one, if the first
    is the number of taxels.

    Args:
        x (torch.Tensor, optional): Readings :math:`(S, N, F)`.
        edge_index (torch.Tensor, optional): The edges of every sample :math:`(2, |\mathcal{E}|)`.
        edge_attr (torch.Tensor, optional): Edge features, shared :math:`(|\mathcal{E}|, D)` or per
            sample :math:`(S, |\mathcal{E}|, D)`.
        y (torch.Tensor, optional): Labels :math:`(S,)` or :math:`(S, C)`.
        pos (torch.Tensor, optional): Taxel positions in metres, shared :math:`(N, 3)` or per sample
            :math:`(S, N, 3)`.
        shared (iterable of str): Names of further attributes that stand once for all samples.
        **kwargs: Further attributes.

    Raises:
        ValueError: If :obj:`x` has not three dimensions.

    Examples:
        >>> data = StaticData(x=torch.zeros(5, 4, 3), edge_index=torch.tensor([[0, 1], [1, 0]]))
        >>> data.num_samples, data.num_nodes, data.num_features
        (5, 4, 3)
        >>> data.sample(0)
        Data(x=[4, 3], edge_index=[2, 2])
    """

    def __init__(
        self,
        x: Tensor | None = None,
        edge_index: Tensor | None = None,
        edge_attr: Tensor | None = None,
        y: Tensor | None = None,
        pos: Tensor | None = None,
        *,
        shared: Iterable[str] = (),
        **kwargs: Any,
    ) -> None:
        if x is not None and x.dim() != 3:
            raise ValueError(
                f"'x' must have shape (num_samples, num_nodes, num_features) (got {tuple(x.shape)})"
            )
        self.__dict__["_shared"] = frozenset(shared)
        super().__init__(x=x, edge_index=edge_index, edge_attr=edge_attr, y=y, pos=pos, **kwargs)

    def __cat_dim__(self, key: str, value: Any, *args: Any, **kwargs: Any) -> Any:
        if key in ("x", "pos", "normal"):
            return -2  # the taxels, from which PyG reads the number of nodes
        return super().__cat_dim__(key, value, *args, **kwargs)

    @property
    def num_samples(self) -> int:
        r"""The number of samples :math:`S`."""
        return self.x.size(0)

    @property
    def shared(self) -> frozenset[str]:
        r"""The names given as :obj:`shared`, or found to be so before a selection."""
        shared: frozenset[str] = self.__dict__["_shared"]
        return shared

    def shared_names(self, once: Iterable[str] | None = None) -> frozenset[str]:
        r"""Returns :obj:`shared`, and the names that stand once because of their size only.

        They must be given as :obj:`shared` where the number of samples changes.

        Args:
            once (iterable of str, optional): The names for which :meth:`is_shared` holds, where
                they are known.
        """
        once = filter(self.is_shared, self._store.keys()) if once is None else once
        by_size = (
            key
            for key in once
            if not _stands_once(key, self._store[key])
            and not self._is_element_level(key, self._store[key].shape, self.x.size(1))
        )
        return self.shared.union(by_size)

    def is_shared(self, key: str) -> bool:
        r"""Tells whether an attribute stands once for all samples.

        Args:
            key (str): Name of the attribute.
        """
        value = self[key]
        if key == "x":
            return False
        if key in self.shared or _stands_once(key, value):
            return True
        if key in _SHARED_DIM and key not in _NEEDS_ROWS:
            return value.dim() == _SHARED_DIM[key]
        if key in _NEEDS_ROWS and self._is_element_level(key, value.shape, self.x.size(1)):
            return True
        return value.dim() == 0 or value.size(0) != self.num_samples

    def has_elements(self, key: str) -> bool:
        r"""Tells whether each sample has its own row for each taxel or edge in an attribute: the
        elements are then in its second dimension.

        Args:
            key (str): Name of the attribute.
        """
        if self.is_shared(key):
            return False
        return self._is_element_level(key, self[key].shape[1:], self.x.size(1))

    def share(self, *keys: str) -> None:
        r"""Adds to :obj:`shared`.

        Args:
            *keys (str): Names of attributes that stand once for all samples.
        """
        self.__dict__["_shared"] = self.shared.union(keys)

    def sample(self, i: int) -> Data:
        r"""Returns one sample as PyG's :class:`~torch_geometric.data.Data`.

        Args:
            i (int): Its index.

        Raises:
            IndexError: If there is no such sample.
        """
        if not -self.num_samples <= i < self.num_samples:
            raise IndexError(f"'i' must be below {self.num_samples} (got {i})")
        i %= self.num_samples
        out = Data()
        for key, value in self._store.items():
            if self.is_shared(key):
                out[key] = value
            elif self._is_element_level(key, value.shape[1:], self.x.size(1)):
                out[key] = value[i]
            else:
                out[key] = value[i : i + 1]
        return out

    @staticmethod
    def _is_element_level(key: str, size: Sequence[int], num_nodes: int | None) -> bool:
        # `size` is that of one sample's value.
        if key in _NEEDS_ROWS:
            return len(size) == _SHARED_DIM[key] and size[0] == num_nodes
        return key == "x" or key in _SHARED_DIM

    def index_select(self, index: Tensor | slice) -> Self:
        r"""Returns some of the samples, in the given order.

        Args:
            index (torch.Tensor or slice): Indices :math:`(B,)`, a mask :math:`(S,)`, or a slice
                (which copies nothing).
        """
        once = frozenset(filter(self.is_shared, self._store.keys()))
        out = self.__class__(shared=self.shared_names(once))
        for key, value in self._store.items():
            out._store[key] = value if key in once else value[index]
        return out

    def to_data_list(self) -> list[Data]:
        r"""Returns the samples one by one."""
        return [self.sample(i) for i in range(self.num_samples)]

    @classmethod
    def from_data_list(cls, data_list: Sequence[Data], shared: Iterable[str] = ()) -> Self:
        r"""Stacks samples that have one topology.

        An attribute whose first dimension is not of size one, such as one with a row for each
        taxel, must be the same in all samples and then stands once.

        Args:
            data_list (list of torch_geometric.data.Data): The samples.
            shared (iterable of str): Names of attributes that stand once for all samples.

        Raises:
            ValueError: If there is no sample, or the samples differ in their edges, their
                attributes or their shapes.
        """
        if len(data_list) == 0:
            raise ValueError("'data_list' must hold at least one sample (got none)")
        keys = data_list[0].keys()
        for i in range(len(data_list)):
            for a, b in ((i, 0), (0, i)):
                missing = sorted(set(data_list[b].keys()) - set(data_list[a].keys()))
                if missing:
                    raise ValueError(
                        f"sample {a} must have '{missing[0]}' as sample {b} has (got none)"
                    )
        shared = set(shared)
        stacked = {}
        x = data_list[0].x
        num_nodes = None if x is None else x.size(0)
        for key in keys:
            values = [data[key] for data in data_list]
            stacked[key] = cls._stack(key, values, shared, num_nodes)
            if cls._has_rows(key, values[0], num_nodes):
                shared.add(key)
        out = cls(x=stacked.pop("x", None), shared=shared)
        for key, value in stacked.items():
            out[key] = value
        return out

    @classmethod
    def _has_rows(cls, key: str, value: Any, num_nodes: int | None) -> bool:
        if _stands_once(key, value) or cls._is_element_level(key, value.shape, num_nodes):
            return False
        return value.dim() > 0 and value.size(0) != 1

    @classmethod
    def _stack(
        cls, key: str, values: list[Any], shared: Collection[str], num_nodes: int | None
    ) -> Any:
        first = values[0]
        has_rows = cls._has_rows(key, first, num_nodes)
        once = key in shared or _stands_once(key, first) or has_rows
        elements = not once and cls._is_element_level(key, first.shape, num_nodes)
        if once or (elements and key != "x" and all(value is first for value in values)):
            for i, value in enumerate(values):
                same = value is first or (
                    torch.equal(value, first) if isinstance(first, Tensor) else value == first
                )
                if not same and has_rows and key not in shared:
                    raise ValueError(
                        f"'{key}' must have a first dimension of size 1, or be the same in all "
                        f"samples (got {tuple(value.shape)} in sample {i})"
                    )
                if not same:
                    raise ValueError(
                        f"sample {i} must have the same '{key}' as sample 0: one topology, many "
                        "samples; use torch_geometric.data.InMemoryDataset where it differs"
                    )
            return first
        shapes = {tuple(value.shape) for value in values}
        if len(shapes) > 1:
            raise ValueError(f"all samples must have '{key}' in one shape (got {sorted(shapes)})")
        if elements:
            if key != "x" and all(torch.equal(value, first) for value in values):
                return first
            return torch.stack(values)
        if first.dim() == 0:
            return torch.stack(values)
        return torch.cat(values)
