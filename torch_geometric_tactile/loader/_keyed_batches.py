r"""The batches of a sampler with a seed for each, and the samples of a batch in one piece."""

from collections.abc import Iterable, Iterator
from contextlib import nullcontext
from typing import Any, NamedTuple

import torch
from torch.utils.data import Dataset

from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.data._batches import static_batch, static_parts
from torch_geometric_tactile.loader._random_states import mixed, seeded_rng


class KeyedIndex(NamedTuple):
    r"""What a batch is cut by."""

    index: Any
    seed: int | None


class KeyedBatches:
    r"""The batches of a sampler, each with a seed that follows from its number and from the random
    state at the start of the epoch.
    """

    def __init__(
        self, sampler: Iterable[Any], generator: torch.Generator | None, keyed: bool
    ) -> None:
        self.sampler = sampler
        self.generator = generator
        self.keyed = keyed
        self.indices: dict[int, Any] = {}  # of batches that were asked for and not yielded yet

    def __len__(self) -> int:
        return len(self.sampler)  # type: ignore[arg-type]

    def __iter__(self) -> Iterator[KeyedIndex]:
        self.indices.clear()
        seed = self._seed() if self.keyed else None
        for number, index in enumerate(self.sampler):
            self.indices[number] = index
            yield KeyedIndex(index, None if seed is None else mixed(seed, number))

    def _seed(self) -> int:
        # Looked at, not drawn: the numbers that follow stay as they were.
        own, generator = self.generator, torch.Generator()
        generator.set_state(torch.get_rng_state() if own is None else own.get_state())
        return int(torch.empty((), dtype=torch.int64).random_(generator=generator))


class CutBatches(Dataset):
    r"""Whole batches, where a data set has samples."""

    def __init__(self, dataset: Dataset) -> None:
        self.dataset = dataset
        transforms = [one for part in static_parts(dataset) for one in part.transforms]
        self._is_plain = all(transform is None for transform in transforms)
        self._generators = [own for one in transforms for own in _generators(one)]

    def __len__(self) -> int:
        return len(self.dataset)  # type: ignore[arg-type]

    def __getitem__(self, key: KeyedIndex) -> StaticData:  # one, or what a sampler of lists yields
        return self._cut(torch.as_tensor(key.index).view(-1).tolist(), key.seed)

    def __getitems__(self, key: KeyedIndex) -> StaticData:
        return self._cut(key.index, key.seed)

    def _cut(self, index: Any, seed: int | None) -> StaticData:
        draws = seed is not None and not self._is_plain
        with seeded_rng(seed or 0, self._generators) if draws else nullcontext():
            return static_batch(self.dataset, index)


def _generators(transform: Any) -> Iterator[torch.Generator]:
    # The sources that transforms have of their own.
    for inner in getattr(transform, "transforms", ()):
        yield from _generators(inner)
    for value in getattr(transform, "__dict__", {}).values():
        if isinstance(value, torch.Generator):
            yield value
