r"""The order of a loader's batches, and what is drawn while one is cut."""

from collections.abc import Iterable, Iterator, Mapping
from contextlib import nullcontext
from itertools import islice
from typing import Any, NamedTuple

import torch
from torch.utils.data import Dataset

from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.data._batches import static_batch, static_parts
from torch_geometric_tactile.loader._random_states import RandomStates, kept_rng, mixed, seeded_rng


class KeyedIndex(NamedTuple):
    r"""What a batch is cut by."""

    index: Any
    seed: int | None


class EpochOrder:
    r"""The batches of a sampler, numbered, from any batch on.

    The random states at the start of an epoch tell its order; they are what :meth:`state_dict`
    keeps.
    """

    def __init__(
        self, sampler: Iterable[Any], generator: torch.Generator | None, keyed: bool
    ) -> None:
        self.sampler = sampler
        self.generator = generator
        self.keyed = keyed
        self.skipped = 0  # batches of this epoch that are left out
        self.ended = False  # whether the epoch that was loaded has none left
        self.indices: dict[int, Any] = {}  # of batches that were asked for and not yielded yet
        self._start: tuple[RandomStates, torch.Tensor | None] | None = None
        self._resumed: tuple[RandomStates, torch.Tensor | None] | None = None

    @property
    def resumes(self) -> bool:
        r"""Whether the next epoch is one that was begun before."""
        return self._resumed is not None

    def __len__(self) -> int:
        return len(self.sampler)  # type: ignore[arg-type]

    def __iter__(self) -> Iterator[KeyedIndex]:
        # From here on only with the first batch: a loader with workers makes an iterator more.
        resumed, self._resumed = self._resumed, None
        self.indices.clear()
        if resumed is None:
            self.skipped = 0
            self._start = RandomStates.now(), self._own_state()
            batches = iter(self.sampler)
        else:
            self._start = resumed
            with kept_rng():
                resumed[0].restore()
                if self.generator is not None and resumed[1] is not None:
                    self.generator.set_state(resumed[1])
                batches = iter(self.sampler)
                for _ in islice(batches, self.skipped):  # the first makes a sampler draw its order
                    pass
        seed = self._seed() if self.keyed else None
        for number, index in enumerate(batches, self.skipped):
            self.indices[number] = index
            yield KeyedIndex(index, None if seed is None else mixed(seed, number))

    def _own_state(self) -> torch.Tensor | None:
        return None if self.generator is None else self.generator.get_state()

    def _seed(self) -> int:
        # Looked at, not drawn: the numbers that follow stay as they were.
        assert self._start is not None
        states, own = self._start
        generator = torch.Generator()
        generator.set_state(states.torch if own is None else own)
        return int(torch.empty((), dtype=torch.int64).random_(generator=generator))

    def state_dict(self, num_batches: int) -> dict[str, Any]:
        r"""Returns where the epoch is, as plain values and tensors."""
        if self._start is None:
            return {"num_batches": 0}
        states, own = self._start
        return {"num_batches": num_batches, "start": states.to_dict(), "generator": own}

    def load_state_dict(self, state_dict: Mapping[str, Any]) -> None:
        r"""Lets the next epoch be one that was begun before, without the batches that it had."""
        num_batches = state_dict.get("num_batches")
        if not isinstance(num_batches, int) or num_batches < 0:
            raise ValueError(
                "'num_batches' of the state of a loader must be a number from 0 (got "
                f"{num_batches})"
            )
        ended = hasattr(self.sampler, "__len__") and num_batches >= len(self)
        self.ended = ended or bool(state_dict.get("ended"))
        self.skipped = num_batches
        if num_batches and not self.ended:
            start = RandomStates.from_dict(state_dict.get("start", {}))
            self._resumed = start, state_dict.get("generator")


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
