r"""The models of the papers."""

from torch_geometric_tactile.nn.models.grasp_gcn import GraspGCN

__all__ = ["GraspGCN"]
