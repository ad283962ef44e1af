r"""One thread of graph convolutions over all inputs."""

from collections.abc import Sequence
from typing import Optional, Union

from torch import Tensor
from torch.nn import Module
from torch_geometric.typing import OptTensor

from torch_geometric_tactile.nn.models.gcn_thread import POOLS, WIDTHS, GCNThread
from torch_geometric_tactile.nn.models.tactile_model import TactileModel, side_by_side


class TactileGCN(TactileModel):
    r"""The GCN of the "Tactile Object Property Recognition using Geometrical Graph Edge Features
    and Multi-Thread Graph Convolutional Network" paper: the inputs of each taxel side by side, one
    :class:`~torch_geometric_tactile.nn.models.GCNThread`, and fully connected layers.

    Its variants in the paper are :obj:`inputs` of :obj:`("tactile",)` (T), :obj:`("edge",)` (E),
    :obj:`("absolute",)` (A) and all their combinations, each with and without joint angles.

    Args:
        num_nodes (int): Number of taxels :math:`N`.
        out_channels (int): Number of labels or classes :math:`C`.
        inputs (sequence of str): Some of :obj:`"tactile"`, :obj:`"edge"`, :obj:`"absolute"` and
            :obj:`"position"`.
        num_edges (int, optional): Number of edges, for the dense encoder of :obj:`"edge"`.
        num_joints (int): Number of joint angles; 16 for an Allegro hand, 0 for none.
        widths (sequence of int): Width of each convolution.
        pools (sequence of int): How many channels share one maximum, behind each convolution.
        head_widths (sequence of int): Width of each fully connected layer.
        head_pools (sequence of int): How many channels share one maximum, behind each of them.
        encoder (str or torch.nn.Module): The encoder of edge features: :obj:`"dense"` is the
            paper's; :obj:`"message"` and :obj:`"attention"` are ours.
        channels (dict, optional): Features of a taxel by input, where they are not 3 or 4.

    Shapes:
        - **input:** readings :math:`(N, F)`, :math:`(B, N, F)` or those of a PyG batch
          :math:`(B \cdot N, F)`, edges :math:`(2, |\mathcal{E}|)`; further inputs as
          :meth:`~torch_geometric_tactile.nn.models.TactileModel.forward` says
        - **output:** logits :math:`(B, C)`

    Raises:
        ValueError: If an input is unknown or missing, or has another shape.

    Examples:
        >>> model = TactileGCN(inputs=("tactile", "edge"), num_edges=1401, num_joints=16)
        >>> model
        TactileGCN(384, 6, inputs=('tactile', 'edge'), num_joints=16)
        >>> model.head.in_channels
        2704
    """

    def __init__(
        self,
        num_nodes: int = 384,
        out_channels: int = 6,
        inputs: Sequence[str] = ("tactile",),
        num_edges: Optional[int] = None,
        num_joints: int = 0,
        widths: Sequence[int] = WIDTHS,
        pools: Sequence[int] = POOLS,
        head_widths: Sequence[int] = (1536, 384, 96),
        head_pools: Sequence[int] = (2, 2, 2),
        encoder: Union[str, Module] = "dense",
        channels: Optional[dict[str, int]] = None,
    ) -> None:
        super().__init__(num_nodes, out_channels, inputs, num_joints, channels)
        self.add_encoder(encoder, num_edges)
        self.thread = GCNThread(sum(self.channels[name] for name in self.inputs), widths, pools)
        self.add_head(self.thread.out_channels, head_widths, head_pools)

    def extract(self, parts: dict[str, Tensor], x: Tensor, edge_index: OptTensor) -> Tensor:
        r"""Returns the features of each taxel before the fully connected layers."""
        return self.convolve(self.thread, side_by_side(parts), x, edge_index)
