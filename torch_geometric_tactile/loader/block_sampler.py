r"""Random orders for data that does not fit into memory."""

from collections.abc import Iterator, Sized

import torch
from torch import Tensor
from torch.utils.data import Dataset, DistributedSampler, RandomSampler

from torch_geometric_tactile.loader._random_states import mixed


class BlockSampler(RandomSampler):
    r"""Draws the samples by blocks: blocks of consecutive samples in random order, and the samples
    of several blocks shuffled together.

    Each sample is drawn once in an epoch. A memory-mapped file is read a block at a time, where a
    full random order reads a page of it for nearly every sample.

    It is a :class:`~torch.utils.data.RandomSampler`, so that Lightning replaces it by its own
    distributed sampler (which draws in a full random order) where a loader is shared by processes;
    :class:`DistributedBlockSampler` stays.

    Args:
        data_source (Sized): The samples.
        block_size (int): Number of consecutive samples of a block.
        num_blocks (int): Number of blocks whose samples are mixed.
        generator (torch.Generator, optional): What is drawn from; the global one if left out.

    Raises:
        ValueError: If a number is below one.

    Examples:
        >>> generator = torch.Generator().manual_seed(0)
        >>> sampler = BlockSampler(range(8), block_size=2, num_blocks=2, generator=generator)
        >>> order = list(sampler)
        >>> sorted(order), {i // 2 for i in order[:4]} & {i // 2 for i in order[4:]}
        ([0, 1, 2, 3, 4, 5, 6, 7], set())
    """

    def __init__(
        self,
        data_source: Sized,
        block_size: int = 256,
        num_blocks: int = 128,
        generator: torch.Generator | None = None,
    ) -> None:
        _check_numbers(block_size, num_blocks)
        super().__init__(data_source, generator=generator)
        self.block_size = block_size
        self.num_blocks = num_blocks

    def __iter__(self) -> Iterator[int]:
        # One number from the source of the loader: the rest of an epoch follows from it.
        seed = torch.empty((), dtype=torch.int64).random_(generator=self.generator)
        generator = torch.Generator().manual_seed(int(seed))
        size = len(self.data_source)
        blocks = torch.randperm(-(-size // self.block_size), generator=generator)
        for chosen in blocks.split(self.num_blocks):
            index = _samples(chosen, self.block_size, size)
            yield from index[torch.randperm(len(index), generator=generator)].tolist()


class DistributedBlockSampler(DistributedSampler):
    r"""Draws the samples by blocks, as :class:`BlockSampler`, and gives each of several processes
    its own part.

    Blocks of consecutive samples come in one random order, of which each process takes a piece, so
    that it reads whole blocks but for the first and the last of its piece. As with
    :class:`~torch.utils.data.DistributedSampler`, all processes get equally many samples: up to
    :math:`R - 1` come twice in an epoch, or are left out with :obj:`drop_last`, and
    :meth:`set_epoch` must be called before each epoch, as Lightning does.

    Args:
        dataset (torch.utils.data.Dataset): The samples.
        num_replicas (int, optional): Number of processes :math:`R`; that of the process group if
            left out.
        rank (int, optional): Which of them this is; by the process group if left out.
        seed (int): What the order follows from, with the epoch; the same in all processes.
        drop_last (bool): Whether to leave out samples instead of drawing some twice.
        block_size (int): Number of consecutive samples of a block.
        num_blocks (int): Number of blocks whose samples are mixed.

    Raises:
        ValueError: If a number is below one, or :obj:`rank` is not one of the processes.

    Examples:
        >>> ranks = [DistributedBlockSampler(range(8), 2, rank, block_size=2) for rank in range(2)]
        >>> first, second = map(sorted, ranks)
        >>> sorted(first + second), {i // 2 for i in first} & {i // 2 for i in second}
        ([0, 1, 2, 3, 4, 5, 6, 7], set())
    """

    def __init__(
        self,
        dataset: Dataset | Sized,
        num_replicas: int | None = None,
        rank: int | None = None,
        seed: int = 0,
        drop_last: bool = False,
        *,
        block_size: int = 256,
        num_blocks: int = 128,
    ) -> None:
        _check_numbers(block_size, num_blocks)
        super().__init__(
            dataset,  # type: ignore[arg-type]
            num_replicas,
            rank,
            seed=seed,
            drop_last=drop_last,
        )
        self.block_size = block_size
        self.num_blocks = num_blocks

    def __iter__(self) -> Iterator[int]:
        generator = torch.Generator().manual_seed(mixed(self.seed, self.epoch))
        size = len(self.dataset)  # type: ignore[arg-type]
        blocks = torch.randperm(-(-size // self.block_size), generator=generator)
        order = _samples(blocks, self.block_size, size)
        place = self.rank * self.num_samples + torch.arange(self.num_samples)
        mine = order[place % max(size, 1)]  # the first ones again, after the last
        for index in mine.split(self.block_size * self.num_blocks):
            yield from index[torch.randperm(len(index), generator=generator)].tolist()


def _check_numbers(block_size: int, num_blocks: int) -> None:
    for name, number in (("block_size", block_size), ("num_blocks", num_blocks)):
        if number < 1:
            raise ValueError(f"'{name}' must be at least 1 (got {number})")


def _samples(blocks: Tensor, block_size: int, size: int) -> Tensor:
    # The samples of some blocks, one block after the other; the last of all may be shorter.
    index = (block_size * blocks[:, None] + torch.arange(block_size)).view(-1)
    return index[index < size]
