r"""The base class of data sets with one topology."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torch_geometric.data import Data, Dataset

from torch_geometric_tactile.data.static_data import StaticData, apply_transform
from torch_geometric_tactile.files import atomic_path
from torch_geometric_tactile.sensors import TaxelLayout
from torch_geometric_tactile.typing import Filter, PathLike, Transform

_FORMAT = 2


class StaticDataset(Dataset):
    r"""A PyG data set whose samples share one topology and stand in one tensor.

    :obj:`dataset[i]` is an ordinary :class:`~torch_geometric.data.Data` object, so that PyG's
    :class:`~torch_geometric.loader.DataLoader`, transforms and explainers work;
    :class:`~torch_geometric_tactile.loader.StaticLoader` cuts whole batches instead. The processed
    file is memory-mapped, so that a data set may be larger than memory.

    A subclass sets :obj:`layout` and defines :meth:`read`; with a :obj:`root` also
    :obj:`raw_file_names`, :obj:`processed_file_names` and, if it can, :meth:`download`.

    Args:
        root (str or PathLike, optional): Folder of the raw and the processed files. Without one,
            the data set lives in memory.
        transform (callable, optional): Applied at every access.
        pre_transform (callable, optional): Applied once, before the samples are saved.
        pre_filter (callable, optional): Tells whether a sample is kept.
        force_reload (bool): Whether to process the raw files anew.

    Raises:
        ValueError: If the processed file is damaged, or holds samples of another layout.
    """

    layout: TaxelLayout

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
        else:
            self._data, self._names = load_static(self.processed_paths[0])
        if self._data.num_nodes != self.layout.num_taxels:
            raise ValueError(
                f"the samples of {type(self).__name__} must have {self.layout.num_taxels} taxels, "
                f"as layout '{self.layout.name}' (got {self._data.num_nodes})"
            )

    def read(self) -> tuple[StaticData, dict[str, list[str]]]:
        r"""Returns all samples, and the names behind their integer attributes.

        The names are those of :obj:`y` (:obj:`"class"`), :obj:`group` (:obj:`"group"`) and
        :obj:`session` (:obj:`"session"`).
        """
        raise NotImplementedError

    @property
    def has_process(self) -> bool:
        r"""Whether there are files to process: not so in memory."""
        return self.root != "???"  # PyG's mark of a missing root

    def _build(self) -> tuple[StaticData, dict[str, list[str]]]:
        data, names = self.read()
        if self.pre_filter is not None:
            kept = [i for i in range(data.num_samples) if self.pre_filter(data.sample(i))]
            if not kept:
                raise ValueError("'pre_filter' must keep at least one sample (kept none)")
            data = data.index_select(torch.tensor(kept))
        return apply_transform(self.pre_transform, data), names

    def process(self) -> None:
        r"""Reads, filters and transforms the samples, and saves them whole or not at all."""
        data, names = self._build()
        save_static(data, names, self.processed_paths[0])

    def len(self) -> int:
        r"""Returns the number of samples stored."""
        return self._data.num_samples

    def get(self, idx: int) -> Data:
        r"""Returns the sample at an index of the storage.

        Args:
            idx (int): The index.
        """
        return self._data.sample(idx)

    @property
    def data(self) -> StaticData:
        r"""All samples of this selection at once, before :obj:`transform`."""
        if self._indices is None:
            return self._data
        return self._data.index_select(self._index())

    def batch(self, index: Tensor | Sequence[int]) -> StaticData:
        r"""Returns some samples at once, after :obj:`transform`: what :obj:`dataset[i]` is for one.

        Args:
            index (torch.Tensor or list of int): Indices into this selection :math:`(B,)`, or a
                mask of it.
        """
        index = torch.as_tensor(index)
        index = index.nonzero().view(-1) if index.dtype == torch.bool else index.long()
        if self._indices is not None:
            index = self._index()[index]
        return apply_transform(self.transform, self._data.index_select(index))

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
        if value is None or self._indices is None:
            return value
        return value[self._index()]

    @property
    def num_classes(self) -> int:
        r"""The number of classes, over all samples of this selection."""
        y = self.column("y")
        if y is not None and len(y) == 0:
            return 0
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


def save_static(data: StaticData, names: dict[str, list[str]], path: PathLike) -> None:
    r"""Writes samples to a file, whole or not at all.

    Args:
        data (StaticData): The samples.
        names (dict): The names behind their integer attributes.
        path (str or PathLike): The file.
    """
    attributes: dict[str, Any] = {}
    for key, value in data.to_dict().items():
        attributes[key] = value.clone() if _is_view(value) else value
    schema = data.schema
    content = {"format": _FORMAT, "attributes": attributes, "schema": schema, "names": names}
    with atomic_path(path) as temporary:
        torch.save(content, temporary)


def _is_view(value: Any) -> bool:
    # It would drag its whole storage into the file. Others need no copy, which may not fit.
    if not isinstance(value, Tensor):
        return False
    if type(value) is not Tensor or value.layout != torch.strided:
        return True
    return value.untyped_storage().nbytes() != value.numel() * value.element_size()


def load_static(path: PathLike) -> tuple[StaticData, dict[str, list[str]]]:
    r"""Reads samples from a file, memory-mapped.

    Args:
        path (str or PathLike): A file of :func:`save_static`.

    Raises:
        ValueError: If the file is damaged or of another format.
    """
    mend = "delete it or pass 'force_reload=True' to process the raw files again"
    if Path(path).stat().st_size == 0:
        raise ValueError(f"processed file '{path}' is empty; {mend}")
    try:
        content = torch.load(path, mmap=True, weights_only=True)
    except Exception as error:  # torch raises five kinds for a cut file
        raise ValueError(f"processed file '{path}' cannot be read; {mend} ({error})") from error
    if not isinstance(content, dict) or content.get("format") != _FORMAT:
        raise ValueError(f"processed file '{path}' is not in format {_FORMAT}; {mend}")
    data = StaticData(**content["schema"])
    for key, value in content["attributes"].items():
        data[key] = value
    return data, content["names"]
