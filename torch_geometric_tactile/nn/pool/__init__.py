r"""Pooling layers."""

from torch_geometric_tactile.nn.pool.channel_max_pool import ChannelMaxPool
from torch_geometric_tactile.nn.pool.taxel_pool import TaxelPool

__all__ = ["ChannelMaxPool", "TaxelPool"]
