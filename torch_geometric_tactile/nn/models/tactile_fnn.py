r"""Fully connected layers on all inputs."""

from collections.abc import Sequence
from typing import Optional

from torch import Tensor
from torch_geometric.typing import OptTensor

from torch_geometric_tactile.nn.models.tactile_model import TactileModel, side_by_side


class TactileFNN(TactileModel):
    r"""The FNN of the "Tactile Object Property Recognition using Geometrical Graph Edge Features
    and Multi-Thread Graph Convolutional Network" paper, which knows nothing of the hand's graph:
    fully connected layers "32768(P)16384, 4096(P)2048, 1024(P)512" on the inputs of all taxels.

    Args:
        num_nodes (int): Number of taxels :math:`N`.
        out_channels (int): Number of labels or classes :math:`C`.
        inputs (sequence of str): Some of :obj:`"tactile"`, :obj:`"absolute"` and
            :obj:`"position"`.
        num_joints (int): Number of joint angles; 16 for an Allegro hand, 0 for none.
        widths (sequence of int): Width of each layer.
        pools (sequence of int): How many channels share one maximum, behind each layer.
        channels (dict, optional): Features of a taxel by input, where they are not 3 or 4.

    Shapes:
        - **input:** readings :math:`(N, F)`, :math:`(B, N, F)` or those of a PyG batch
          :math:`(B \cdot N, F)`; further inputs as
          :meth:`~torch_geometric_tactile.nn.models.TactileModel.forward` says
        - **output:** logits :math:`(B, C)`

    Raises:
        ValueError: If an input is unknown or missing, or has another shape.

    Examples:
        >>> TactileFNN(widths=(64, 32, 16)).head.in_channels
        1152
    """

    def __init__(
        self,
        num_nodes: int = 384,
        out_channels: int = 6,
        inputs: Sequence[str] = ("tactile",),
        num_joints: int = 0,
        widths: Sequence[int] = (32768, 4096, 1024),
        pools: Sequence[int] = (2, 2, 2),
        channels: Optional[dict[str, int]] = None,
    ) -> None:
        super().__init__(num_nodes, out_channels, inputs, num_joints, channels)
        if "edge" in self.inputs:
            raise ValueError(f"'inputs' must not have 'edge': there is no graph (got {inputs})")
        self.add_head(sum(self.channels[name] for name in self.inputs), widths, pools)

    def extract(self, parts: dict[str, Tensor], x: Tensor, edge_index: OptTensor) -> Tensor:
        r"""Returns the features of each taxel before the fully connected layers."""
        return side_by_side(parts)
