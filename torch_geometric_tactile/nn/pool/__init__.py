r"""Pooling layers."""

from torch_geometric_tactile.nn.pool.bilinear_feature import BilinearFeature
from torch_geometric_tactile.nn.pool.channel_max_pool import ChannelMaxPool
from torch_geometric_tactile.nn.pool.taxel_pool import TaxelPool

__all__ = ["BilinearFeature", "ChannelMaxPool", "TaxelPool"]
