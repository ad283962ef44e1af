r"""Loaders and samplers for data sets whose samples share one topology."""

from torch_geometric_tactile.loader.block_sampler import BlockSampler, DistributedBlockSampler
from torch_geometric_tactile.loader.static_loader import StaticLoader

__all__ = ["BlockSampler", "DistributedBlockSampler", "StaticLoader"]
