r"""The earlier place of a network that checkpoints of version 0.2 name."""

from torch_geometric_tactile.papers._taxel_net_without_edges import TaxelNetWithoutEdges

__all__ = ["TaxelNetWithoutEdges"]
