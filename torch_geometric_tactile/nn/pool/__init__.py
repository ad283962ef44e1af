r"""Pooling layers."""

from torch_geometric_tactile.nn.pool.channel_max_pool import ChannelMaxPool

__all__ = ["ChannelMaxPool"]
