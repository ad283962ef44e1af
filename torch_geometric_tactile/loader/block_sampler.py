r"""A random order for data sets that do not fit into memory."""

from collections.abc import Iterator, Sized

import torch
from torch.utils.data import RandomSampler

from torch_geometric_tactile._checks import need


class BlockSampler(RandomSampler):
    r"""Draws samples in a random order that is fast for data sets that do not fit into memory.
    Blocks of consecutive samples are drawn in random order, and the samples of several blocks are
    shuffled together.

    Each sample is drawn once per epoch. A memory-mapped file is read block by block, whereas a full
    random order would read a page of the file for nearly every sample.

    If several processes train one model, Lightning replaces this sampler with its distributed
    sampler, since this class is a :class:`~torch.utils.data.RandomSampler`. The distributed sampler
    draws samples in a full random order, with the same seed in all processes.

    Args:
        data_source (Sized): The samples.
        block_size (int): Number of consecutive samples in a block.
        num_blocks (int): Number of blocks whose samples are shuffled together.
        generator (torch.Generator, optional): Source of the random numbers. Defaults to the global
            generator.

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
        for name, number in (("block_size", block_size), ("num_blocks", num_blocks)):
            need(number >= 1, f"'{name}' must be at least 1", number)
        super().__init__(data_source, generator=generator)
        self.block_size = block_size
        self.num_blocks = num_blocks

    def __iter__(self) -> Iterator[int]:
        # Draws a single number from the loader's generator as the seed for the order of the epoch.
        seed = torch.empty((), dtype=torch.int64).random_(generator=self.generator)
        generator = torch.Generator().manual_seed(int(seed))
        size = len(self.data_source)
        blocks = torch.randperm(-(-size // self.block_size), generator=generator)
        for mixed_blocks in blocks.split(self.num_blocks):
            index = (self.block_size * mixed_blocks[:, None] + torch.arange(self.block_size)).view(
                -1
            )
            index = index[index < size]  # the last block of the data may be shorter
            yield from index[torch.randperm(len(index), generator=generator)].tolist()
