r"""Samples whose taxels and edges may differ: PyG's data sets, selections from them, concatenated
data sets and lists.
"""

import copy
from collections.abc import Sequence
from typing import Any, overload

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import ConcatDataset, Dataset, Subset
from torch_geometric.data import Batch, Data
from torch_geometric.data import Dataset as PyGDataset
from torch_geometric.transforms import BaseTransform

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.data._batches import check_same_names, static_parts
from torch_geometric_tactile.data._levels import NAMED, flat_index
from torch_geometric_tactile.data.static_data import StaticData
from torch_geometric_tactile.data.static_dataset import StaticDataset

_CATEGORIES = ("y", "trial", "group", "session", "placement", "size")
_NUM_TAXELS = ""  # key of the numbers of taxels; no attribute has an empty name
#: Samples on one topology, or a sequence of PyG's samples.
AnySamples = StaticDataset | StaticData | Dataset | Sequence[Data]


class GraphSamples(Dataset):
    r"""PyG samples whose taxels may differ, with the interface of
    :class:`~torch_geometric_tactile.data.StaticDataset`: attributes as columns, selections, and the
    names of classes, groups and sessions. Texts in :obj:`y` and in the attributes by which samples
    are split become numbers, in the order of the sorted texts.

    Args:
        samples (Dataset or sequence of Data): The samples.

    Raises:
        TypeError: If the samples are not PyG samples with one kind of nodes.
        ValueError: If there is no sample.
    """

    #: There is no common layout, since the samples may come from several sensors.
    layout = None
    group_kind = "group"

    def __init__(self, samples: Any) -> None:
        is_listed = isinstance(samples, Dataset) or (
            isinstance(samples, Sequence) and not isinstance(samples, str)
        )
        if not is_listed or not hasattr(samples, "__len__"):
            raise TypeError(
                "'dataset' must be a data set of PyG, a Subset or ConcatDataset, or a list of Data "
                f"(got {type(samples).__name__})"
            )
        need(len(samples) != 0, "'dataset' must hold at least one sample (got none)")
        if not isinstance(samples[0], Data):
            raise TypeError(
                "'dataset' must hold torch_geometric.data.Data objects, with one kind of nodes "
                f"(got {type(samples[0]).__name__})"
            )
        self._samples = samples
        self._indices: Tensor = torch.arange(len(samples))
        self.transform: BaseTransform | None = None
        # The columns and names of all stored samples; selections share these dictionaries.
        self._columns: dict[str, list[Any]] = {}
        self._names: dict[str, list[str]] = {}

    def __len__(self) -> int:
        return len(self._indices)

    def len(self) -> int:
        r"""Returns the number of stored samples, including samples that are not selected."""
        return len(self._samples)

    def indices(self) -> list[int]:
        r"""Returns the indices of the selected samples among all stored samples."""
        indices: list[int] = self._indices.tolist()
        return indices

    @overload
    def __getitem__(self, index: int) -> Data: ...

    @overload
    def __getitem__(self, index: Tensor | slice | Sequence[int]) -> "GraphSamples": ...

    def __getitem__(self, index: Any) -> Any:
        r"""Returns one sample after :obj:`transform`, or a selection of several."""
        if isinstance(index, int | np.integer):
            sample: Data = self._samples[int(self._indices[index])]
            text_keys = [key for key in _CATEGORIES if isinstance(getattr(sample, key, None), str)]
            if text_keys:
                self._read_columns()
                sample = copy.copy(sample)
                for key in text_keys:
                    sample[key] = self._names[NAMED.get(key, key)].index(sample[key])
            return sample if self.transform is None else self.transform(sample)
        out = copy.copy(self)
        rows = index if isinstance(index, slice) else flat_index(index)
        out._indices = self._indices[rows]
        return out

    def first(self) -> Data:
        r"""Returns the first stored sample, after :obj:`transform`, even if the selection is
        empty.
        """
        out = copy.copy(self)
        out._indices = torch.arange(1)
        return out[0]

    def batch(self, index: Tensor | Sequence[int]) -> Batch:
        r"""Returns samples as PyG's batch, after :obj:`transform`.

        Args:
            index (torch.Tensor or list of int): Indices into this selection :math:`(B,)`.
        """
        indices = torch.as_tensor(index, dtype=torch.long).tolist()
        return Batch.from_data_list([self[i] for i in indices])

    def column(self, key: str) -> Tensor | None:
        r"""Returns an attribute with one value for each sample :math:`(S, \ldots)`; :obj:`None` if
        no sample has it.

        Args:
            key (str): Name of the attribute.

        Raises:
            ValueError: If only some samples have the attribute, or it does not have one value for
                each sample.
        """
        self._read_columns()
        values = self._columns.get(key)
        if values is None:
            value = self._samples[0].to_dict().get(key)
            if value is not None:
                shape = tuple(value.shape) if isinstance(value, Tensor) else type(value).__name__
                raise ValueError(
                    f"'{key}' must be a number in each sample, or numbers of shape (1, C) (got "
                    f"{shape} in sample 0)"
                )
            return None
        missing = [i for i, value in enumerate(values) if value is None]
        if missing:
            raise ValueError(
                f"sample {missing[0]} must have '{key}', like the other samples, with one value "
                "(got none)"
            )
        if key in NAMED:
            self._check_names(key)
        kinds = {(value.dtype, value.shape) for value in values}
        if len({shape for _, shape in kinds}) > 1:
            raise ValueError(f"'{key}' must have the same shape in all samples (got several)")
        return torch.stack(values)[self._indices]

    def complete_columns(self) -> list[str]:
        r"""Returns the names of the attributes that each sample has."""
        self._read_columns()
        return [key for key, values in self._columns.items() if key and None not in values]

    def _check_names(self, key: str) -> None:
        # In concatenated data sets with different names, the same number means different things.
        try:
            first, *further_parts = static_parts(self._samples)
        except TypeError:
            return
        for i, part in enumerate(further_parts):
            check_same_names(first, part, [key], f"part {i + 1} of 'dataset'")

    def _read_columns(self) -> None:
        # Reads all attributes with one value for each sample in one pass, since a data set may load
        # each sample from a file.
        if self._columns:
            return
        stored = without_transform(self._samples)
        columns: dict[str, list[Any]] = {_NUM_TAXELS: [None] * len(stored)}
        for i in range(len(stored)):
            sample = stored[i]
            columns[_NUM_TAXELS][i] = torch.tensor(_num_taxels(sample))
            for key, value in sample.to_dict().items():
                row = _sample_value(value)
                if row is not None and key != "x":
                    columns.setdefault(key, [None] * len(stored))[i] = row
        for key, values in columns.items():
            if any(isinstance(value, str) for value in values):
                names = sorted({value for value in values if isinstance(value, str)})
                codes = {name: torch.tensor(code) for code, name in enumerate(names)}
                columns[key] = [codes.get(value) for value in values]
                self._names[NAMED.get(key, key)] = names
        self._columns.update(columns)

    @property
    def num_taxels(self) -> tuple[int, int]:
        r"""The smallest and the largest number of taxels of a sample."""
        counts = self.column(_NUM_TAXELS)
        if counts is None or not len(counts):
            return 0, 0
        return int(counts.min()), int(counts.max())

    @property
    def is_mixed(self) -> bool:
        r"""Whether the samples differ in their number of taxels."""
        min_taxels, max_taxels = self.num_taxels
        return min_taxels != max_taxels

    @property
    def num_classes(self) -> int:
        r"""The number of classes over all stored samples, including samples that are not
        selected.
        """
        y = self.stored().column("y")
        if y is None or y.numel() == 0:
            return 0
        return y.size(1) if y.dim() == 2 else int(y.max()) + 1

    def stored(self) -> "GraphSamples":
        r"""Returns all stored samples, without the transform of their data set."""
        out = copy.copy(self)
        out._samples = without_transform(self._samples)
        out._indices = torch.arange(len(self._samples))
        out.transform = None
        return out

    def names(self, kind: str) -> list[str]:
        r"""Returns the names of the numbers of an attribute: the texts that were numbered, or else
        the names in the data set. The list is empty if there are neither.

        Args:
            kind (str): :obj:`"class"`, :obj:`"group"`, :obj:`"session"` or :obj:`"trial"`.
        """
        self._read_columns()
        if kind in self._names:
            return self._names[kind]
        source = self._samples
        while isinstance(source, Subset | ConcatDataset):
            source = source.dataset if isinstance(source, Subset) else source.datasets[0]
        return list(getattr(source, f"{kind}_names", None) or ())

    @property
    def class_names(self) -> list[str]:
        r"""The names of the classes of :obj:`y`."""
        return self.names("class")

    @property
    def group_names(self) -> list[str]:
        r"""The names of the groups."""
        return self.names("group")

    @property
    def session_names(self) -> list[str]:
        r"""The names of the recording sessions."""
        return self.names("session")

    @property
    def trial_names(self) -> list[str]:
        r"""The names of the trials."""
        return self.names("trial")

    def describe_taxels(self) -> str:
        r"""Returns the number of taxels in words, such as :obj:`"30 to 60 taxels"`."""
        min_taxels, max_taxels = self.num_taxels
        return (
            f"{max_taxels} taxels"
            if min_taxels == max_taxels
            else f"{min_taxels} to {max_taxels} taxels"
        )


#: Samples on which models are trained, with their attributes as columns.
SampleSet = StaticDataset | GraphSamples


def _num_taxels(sample: Data) -> int:
    return len(sample.x) if isinstance(sample.x, Tensor) else int(sample.num_nodes or 0)


def _sample_value(value: Any) -> Any:
    # Returns a number, a row of numbers or a text; None for an attribute with a row for each taxel
    # or edge.
    if isinstance(value, str):
        return value
    if isinstance(value, bool | int | float | np.generic):
        return torch.tensor(value)
    if not isinstance(value, Tensor) or value.layout != torch.strided:
        return None
    if value.dim() == 0:
        return value.cpu()
    if value.dim() <= 2 and value.size(0) == 1:
        return value[0].cpu()
    return None


def without_transform(data: Any) -> Any:
    r"""Returns samples without the :obj:`transform` of their data set.

    Raises:
        TypeError: If :obj:`data` holds no samples.
    """
    if isinstance(data, StaticData):
        return data
    if isinstance(data, Batch):
        return data.to_data_list()
    if isinstance(data, Subset):
        return Subset(without_transform(data.dataset), data.indices)
    if isinstance(data, ConcatDataset):
        return ConcatDataset([without_transform(part) for part in data.datasets])
    if isinstance(data, PyGDataset | GraphSamples):
        data = copy.copy(data)
        data.transform = None
        return data
    if isinstance(data, Dataset) or (isinstance(data, Sequence) and not isinstance(data, str)):
        return data
    raise TypeError(
        f"'data' must be a PyG data set, StaticData or a list of Data (got {type(data).__name__})"
    )


def as_samples(dataset: Any) -> StaticDataset | StaticData | GraphSamples:
    r"""Returns samples with their attributes as columns. Samples on one topology, including a
    :class:`~torch.utils.data.Subset` of them, keep their class; all other samples become
    :class:`GraphSamples`.
    """
    if isinstance(dataset, StaticDataset | StaticData | GraphSamples):
        return dataset
    if isinstance(dataset, Subset):
        samples = as_samples(dataset.dataset)
        if isinstance(samples, StaticDataset):
            selection: StaticDataset = samples[torch.as_tensor(list(dataset.indices)).long()]
            return selection
    return GraphSamples(dataset)


def sample_column(dataset: AnySamples, key: str) -> Tensor | None:
    r"""Returns an attribute of the samples :math:`(S, \ldots)`, or :obj:`None` if they lack it."""
    samples = as_samples(dataset)
    if isinstance(samples, StaticData):
        value = samples[key] if key in samples else None  # noqa: SIM401 - Data is no mapping
        return value if isinstance(value, Tensor) else None
    return samples.column(key)
