r"""Loaders and samplers for data sets whose samples share one topology."""

from typing import TYPE_CHECKING

from torch_geometric_tactile._removed import removed_names
from torch_geometric_tactile.loader.block_sampler import BlockSampler
from torch_geometric_tactile.loader.static_loader import StaticLoader

__all__ = ["BlockSampler", "StaticLoader"]

if not TYPE_CHECKING:
    __getattr__ = removed_names(__name__)
