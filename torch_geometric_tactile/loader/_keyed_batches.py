r"""Batches of indices with a seed each, and a data set of batches."""

from collections.abc import Iterable, Iterator
from contextlib import nullcontext
from typing import Any, NamedTuple

import torch
from torch.utils.data import Dataset

from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.data._batches import static_batch, static_parts
from torch_geometric_tactile.loader._random_states import mix_seeds, seeded_rng


class KeyedIndex(NamedTuple):
    r"""The indices of the samples of a batch, and the seed of its random transforms."""

    index: Any
    seed: int | None


class KeyedBatches:
    r"""The batches of a sampler, each with a seed that depends on its number and on the random
    state at the start of the epoch.

    Args:
        sampler (iterable): The batches of indices.
        generator (torch.Generator, optional): Its state gives the seeds; the global one by default.
        keyed (bool): Whether to give seeds.
    """

    def __init__(
        self, sampler: Iterable[Any], generator: torch.Generator | None, keyed: bool
    ) -> None:
        self.sampler = sampler
        self.generator = generator
        self.keyed = keyed
        self.indices: dict[
            int, Any
        ] = {}  # by number, of batches that are requested but not yielded yet

    def __len__(self) -> int:
        return len(self.sampler)  # type: ignore[arg-type]

    def __iter__(self) -> Iterator[KeyedIndex]:
        self.indices.clear()
        seed = self._epoch_seed() if self.keyed else None
        for number, index in enumerate(self.sampler):
            self.indices[number] = index
            yield KeyedIndex(index, None if seed is None else mix_seeds(seed, number))

    def _epoch_seed(self) -> int:
        # Drawn from a copy, so that the random numbers that follow stay the same.
        source, copied_generator = self.generator, torch.Generator()
        copied_generator.set_state(torch.get_rng_state() if source is None else source.get_state())
        return int(torch.empty((), dtype=torch.int64).random_(generator=copied_generator))


class BatchDataset(Dataset):
    r"""A data set whose items are batches, cut from the tensors of another data set.

    Args:
        dataset (Dataset): The data set of the samples.
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

    def __getitem__(self, key: KeyedIndex) -> StaticData:  # an index or a list of indices
        return self._cut(torch.as_tensor(key.index).view(-1).tolist(), key.seed)

    def __getitems__(self, key: KeyedIndex) -> StaticData:
        return self._cut(key.index, key.seed)

    def _cut(self, index: Any, seed: int | None) -> StaticData:
        is_random = seed is not None and not self._is_plain
        with seeded_rng(seed or 0, self._generators) if is_random else nullcontext():
            return static_batch(self.dataset, index)


def _transform_generators(transform: Any) -> Iterator[torch.Generator]:
    # The random generators that are attributes of a transform, or of the transforms in it.
    for inner in getattr(transform, "transforms", ()):
        yield from _transform_generators(inner)
    for value in getattr(transform, "__dict__", {}).values():
        if isinstance(value, torch.Generator):
            yield value
