r"""MessagePassing layers."""

from torch_geometric_tactile.nn.conv.static_gcn_conv import StaticGCNConv

__all__ = ["StaticGCNConv"]
