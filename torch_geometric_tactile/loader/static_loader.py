r"""A loader that slices batches from one tensor."""

import copy
import logging
from collections.abc import Iterable, Iterator, Mapping
from contextlib import nullcontext
from functools import cache
from pickle import PicklingError
from typing import Any, Literal, NamedTuple

import torch
from torch.utils.data import DataLoader, Dataset
from torch_geometric.data import Data

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.data import StaticData, StaticDataset
from torch_geometric_tactile.data._batches import check_joinable, static_batch, static_parts
from torch_geometric_tactile.data.apply_transform import stack_like
from torch_geometric_tactile.loader._memory_limit import exceeds_memory
from torch_geometric_tactile.loader._random_states import mix_seeds, seeded_rng
from torch_geometric_tactile.loader.block_sampler import BlockSampler

_logger = logging.getLogger(__name__)


class _StaticCollater:
    r"""Collates the samples that a loader has fetched into one :class:`StaticData`."""

    def __init__(self, dataset: Dataset) -> None:
        self.dataset = dataset

    def __call__(self, samples: Any) -> StaticData:
        r"""Returns one :class:`StaticData` with all samples."""
        if isinstance(samples, StaticData):
            return samples
        if isinstance(samples, StaticDataset):  # from a sampler that yields lists
            return samples.batch(range(len(samples)))
        samples = [samples] if isinstance(samples, Data) else list(samples)
        if not samples:
            return static_batch(self.dataset, [])
        return stack_like(samples, static_batch(self.dataset, []))


class _KeyedIndex(NamedTuple):
    r"""The indices of the samples in a batch, and the seed for its random transforms."""

    index: Any
    seed: int | None


class _KeyedBatches:
    r"""The batches of a sampler, each with a seed. The seed depends on the number of the batch and
    on the random state at the start of the epoch.

    Args:
        sampler (iterable): Batches of indices.
        generator (torch.Generator, optional): Generator whose state determines the seeds. Defaults
            to the global generator.
        keyed (bool): Whether to add seeds.
    """

    def __init__(
        self, sampler: Iterable[Any], generator: torch.Generator | None, keyed: bool
    ) -> None:
        self.sampler = sampler
        self.generator = generator
        self.keyed = keyed
        # Indices of batches that were requested but not yet yielded, by number.
        self.indices: dict[int, Any] = {}

    def __len__(self) -> int:
        return len(self.sampler)  # type: ignore[arg-type]

    def __iter__(self) -> Iterator[_KeyedIndex]:
        self.indices.clear()
        seed = self._epoch_seed() if self.keyed else None
        for number, index in enumerate(self.sampler):
            self.indices[number] = index
            yield _KeyedIndex(index, None if seed is None else mix_seeds(seed, number))

    def _epoch_seed(self) -> int:
        # The seed is drawn from a copy, so that later random numbers do not change.
        source, copied_generator = self.generator, torch.Generator()
        copied_generator.set_state(torch.get_rng_state() if source is None else source.get_state())
        return int(torch.empty((), dtype=torch.int64).random_(generator=copied_generator))


class _BatchDataset(Dataset):
    r"""A data set whose items are batches, which are sliced from the tensors of another data set.

    Args:
        dataset (Dataset): Data set that holds the samples.
    """

    def __init__(self, dataset: Dataset) -> None:
        self.dataset = dataset
        transforms = [transform for part in static_parts(dataset) for transform in part.transforms]
        self._is_plain = all(transform is None for transform in transforms)
        self._generators = [
            generator for transform in transforms for generator in _transform_generators(transform)
        ]

    def __len__(self) -> int:
        return len(self.dataset)  # type: ignore[arg-type]

    def __getitem__(self, key: _KeyedIndex) -> StaticData:  # an index or a list of indices
        return self._cut(torch.as_tensor(key.index).view(-1).tolist(), key.seed)

    def __getitems__(self, key: _KeyedIndex) -> StaticData:
        return self._cut(key.index, key.seed)

    def _cut(self, index: Any, seed: int | None) -> StaticData:
        is_random = seed is not None and not self._is_plain
        with seeded_rng(seed or 0, self._generators) if is_random else nullcontext():
            return static_batch(self.dataset, index)


def _transform_generators(transform: Any) -> Iterator[torch.Generator]:
    # Yields the random generators that are attributes of a transform or of the transforms in it.
    for inner in getattr(transform, "transforms", ()):
        yield from _transform_generators(inner)
    for value in getattr(transform, "__dict__", {}).values():
        if isinstance(value, torch.Generator):
            yield value


class StaticLoader(DataLoader):
    r"""Loads batches from a :class:`~torch_geometric_tactile.data.StaticDataset` as
    :class:`~torch_geometric_tactile.data.StaticData`. A batch holds readings :math:`(B, N, F)` and
    one :obj:`edge_index`, which all samples share.

    Batches hold the same numbers as batches from :class:`torch_geometric.loader.DataLoader`, but
    loading is faster, since no :class:`~torch_geometric.data.Data` object is created for each
    sample. Shuffling, workers, pinned memory, samplers and distributed sampling work as in
    :class:`torch.utils.data.DataLoader`.

    Args:
        dataset (StaticDataset): The data set. A :class:`~torch.utils.data.Subset` is also accepted,
            such as a part from :func:`~torch.utils.data.random_split`. A
            :class:`~torch.utils.data.ConcatDataset` is accepted if all its data sets have the same
            layout, edges, attributes and names of classes, groups and sessions.
        batch_size (int, optional): Number of samples in a batch. If :obj:`None`, each index (or
            list of indices) from the sampler is a batch.
        shuffle (bool or str, optional): Whether to draw the samples in a new order in every epoch.
            If :obj:`"blocks"`, a :class:`~torch_geometric_tactile.loader.BlockSampler` draws the
            samples (it can also be passed as :obj:`sampler`). If :obj:`True`, samples are drawn in
            a full random order. The exception is a memory-mapped data set that is larger than the
            memory: it is shuffled by blocks, and a warning is logged once.
        keyed (bool): Whether the random numbers in transforms depend only on the epoch and the
            number of the batch. If :obj:`True`, they are the same for any number of workers, and
            the global random states do not change.
        **kwargs: Further arguments of :class:`torch.utils.data.DataLoader`, except
            :obj:`collate_fn`.

    Raises:
        TypeError: If :obj:`dataset` is not one of these data sets, or if :obj:`collate_fn`,
            :obj:`follow_batch` or :obj:`exclude_keys` is given.
        ValueError: If the parts of a :class:`~torch.utils.data.ConcatDataset` differ in their
            layouts, edges, attributes or names, if :obj:`shuffle` has an unknown value, or if
            :obj:`"blocks"` is combined with a sampler.

    Examples:
        >>> from torch_geometric_tactile.datasets import FakeTactileDataset
        >>> loader = StaticLoader(FakeTactileDataset(num_samples=5), batch_size=4)
        >>> [batch.x.shape for batch in loader]
        [torch.Size([4, 24, 3]), torch.Size([1, 24, 3])]
    """

    def __init__(
        self,
        dataset: Dataset,
        batch_size: int | None = 1,
        shuffle: bool | Literal["blocks"] | None = None,
        *,
        keyed: bool = False,
        **kwargs: Any,
    ) -> None:
        _check_arguments(kwargs)
        parts = list(static_parts(dataset))
        if len(parts) > 1:
            check_joinable(parts)
        if isinstance(shuffle, str) or (shuffle and not _has_sampler(kwargs)):
            shuffle = _shuffle_by_blocks(dataset, shuffle, kwargs)
        super().__init__(
            dataset, batch_size, shuffle, collate_fn=_StaticCollater(dataset), **kwargs
        )
        self.keyed = keyed
        self._sampler_name = "sampler" if self.batch_sampler is None else "batch_sampler"
        self._batches = _KeyedBatches(getattr(self, self._sampler_name), self.generator, keyed)
        self._last_index: Any = None

    @property
    def last_index(self) -> list[int]:
        r"""Indices of the samples in the last batch that was yielded."""
        index = [] if self._last_index is None else self._last_index
        return torch.as_tensor(index, dtype=torch.long).view(-1).tolist()

    def __iter__(self) -> Any:
        # Random numbers are drawn with the first batch and not earlier. When Lightning resumes at
        # the end of an epoch, it may create an iterator that it does not use.
        if self._iterator is not None:
            # Persistent workers draw no new seed. This draw makes the order independent of them.
            torch.empty((), dtype=torch.int64).random_(generator=self.generator)
        for number, batch in enumerate(super().__iter__()):
            self._last_index = self._batches.indices.pop(number, None)
            yield batch

    def _get_iterator(self) -> Any:
        # Uses private parts of PyTorch. PyTorch forbids setting `dataset` and the sampler, so they
        # are replaced in the `__dict__` of a copy. The copy slices each batch in one piece.
        loader = copy.copy(self)
        loader.__dict__["dataset"] = _BatchDataset(self.dataset)
        loader.__dict__[self._sampler_name] = self._batches
        try:
            return DataLoader._get_iterator(loader)
        except (AttributeError, TypeError, PicklingError) as error:
            if "pickle" not in str(error).lower():
                raise
            raise TypeError(
                "'dataset' must be picklable for workers that are not forked, the default from "
                f"Python 3.14 on (got: {error}): define transforms and filters as functions or "
                "classes of a module, not as a lambda, or use num_workers=0"
            ) from error


def _has_sampler(kwargs: Mapping[str, Any]) -> bool:
    return any(kwargs.get(key) is not None for key in ("sampler", "batch_sampler"))


def _shuffle_by_blocks(dataset: Any, shuffle: Any, kwargs: dict[str, Any]) -> bool:
    # Adds a sampler to `kwargs` for shuffling by blocks, and returns the `shuffle` argument for
    # PyTorch.
    if isinstance(shuffle, str):
        need(shuffle == "blocks", f"'shuffle' must be True, False or 'blocks' (got '{shuffle}')")
        need(not _has_sampler(kwargs), "'shuffle' must be left out with a sampler (got 'blocks')")
    elif not exceeds_memory(dataset):
        return True
    else:
        _warn_of_blocks()
    kwargs["sampler"] = BlockSampler(dataset, generator=kwargs.get("generator"))
    return False


@cache
def _warn_of_blocks() -> None:
    _logger.warning(
        "the data set is larger than memory: its samples are shuffled by blocks, so that the file "
        "is read block by block; pass a RandomSampler as 'sampler' for a full random order"
    )


def _check_arguments(kwargs: dict[str, Any]) -> None:
    # Lightning rebuilds a loader from its attributes and passes the collater from this module.
    collate_fn = kwargs.pop("collate_fn", None)
    if collate_fn is not None and not isinstance(collate_fn, _StaticCollater):
        raise TypeError(
            "StaticLoader takes no 'collate_fn', since it slices each batch in one piece: "
            "use the 'transform' of the data set, or torch_geometric.loader.DataLoader"
        )
    alternatives = {
        "follow_batch": "in (B, N, F), each sample has a separate row: use "
        "torch_geometric.loader.DataLoader for assignment vectors",
        "exclude_keys": "drop attributes in the 'transform' of the data set, or use "
        "torch_geometric.loader.DataLoader",
    }
    for key, alternative in alternatives.items():
        value = kwargs.pop(key, None)
        if value:
            raise TypeError(f"StaticLoader takes no '{key}' (got {value}): {alternative}")
