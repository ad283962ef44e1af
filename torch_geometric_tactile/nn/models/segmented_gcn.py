r"""Graph convolutions on a hand in segments."""

from collections.abc import Sequence
from typing import Literal, Optional, Union

from torch import Tensor
from torch.nn import Module
from torch_geometric.typing import OptTensor

from torch_geometric_tactile.nn.models.gcn_thread import POOLS, WIDTHS, GCNThread
from torch_geometric_tactile.nn.models.segmented_thread import SegmentedThread
from torch_geometric_tactile.nn.models.tactile_model import TactileModel, as_layout, side_by_side
from torch_geometric_tactile.sensors import TaxelLayout


class SegmentedGCN(TactileModel):
    r"""The GCNs of the "Multifingered Object Recognition with Tactile Sensors and Graph
    Convolutional Networks using Topological Graph Segmentation" paper: small graph convolutional
    networks for the segments of a hand, or one for the whole, and fully connected layers.

    * :obj:`segments=None` (the paper's X): the whole hand, "14, 28, 56(P)28, 112(P)28, 112(P)7".
    * :obj:`segments="digit"` (I): five networks, of the fingers, the thumb and the palm.
    * :obj:`segments="patch"` (II): 22 networks, of the patches. Each of I and II is "14, 56(P)7".

    The inputs of the paper are :obj:`("tactile",)` (Tac), :obj:`("position",)` (Pos) and both, each
    with and without joint angles.

    Args:
        layout (TaxelLayout or str): The taxels and their segments, or the name of a layout that
            comes with the package.
        segments (str, optional): :obj:`"digit"`, :obj:`"patch"` or :obj:`None`.
        out_channels (int): Number of labels or classes :math:`C`.
        inputs (sequence of str): Some of :obj:`"tactile"`, :obj:`"edge"`, :obj:`"absolute"` and
            :obj:`"position"`.
        num_edges (int, optional): Number of edges, for the dense encoder of :obj:`"edge"`.
        num_joints (int): Number of joint angles; 16 for an Allegro hand, 0 for none.
        widths (sequence of int, optional): Width of each convolution; the paper's if left out.
        pools (sequence of int, optional): How many channels share one maximum, behind each.
        head_widths (sequence of int): Width of each fully connected layer.
        head_pools (sequence of int): How many channels share one maximum, behind each of them.
        encoder (str or torch.nn.Module): The encoder of edge features, as in
            :class:`~torch_geometric_tactile.nn.models.TactileGCN`.
        channels (dict, optional): Features of a taxel by input, where they are not 3 or 4.

    Shapes:
        - **input:** readings :math:`(N, F)`, :math:`(B, N, F)` or those of a PyG batch
          :math:`(B \cdot N, F)`, edges :math:`(2, |\mathcal{E}|)`, of which those between segments
          do not count; further inputs as
          :meth:`~torch_geometric_tactile.nn.models.TactileModel.forward` says
        - **output:** logits :math:`(B, C)`

    Raises:
        ValueError: If :obj:`segments` is unknown, or an input is unknown, missing or of another
            shape.

    Examples:
        >>> model = SegmentedGCN(segments="patch", num_joints=16)
        >>> model
        SegmentedGCN(384, 8, segments='patch', inputs=('tactile',), num_joints=16)
        >>> model.thread, model.head.in_channels
        (SegmentedThread(3, num_segments=22, widths=(14, 56), pools=(1, 8)), 2704)
    """

    thread: Module

    def __init__(
        self,
        layout: Union[TaxelLayout, str] = "allegro_uskin",
        segments: Optional[Literal["digit", "patch"]] = None,
        out_channels: int = 8,
        inputs: Sequence[str] = ("tactile",),
        num_edges: Optional[int] = None,
        num_joints: int = 0,
        widths: Optional[Sequence[int]] = None,
        pools: Optional[Sequence[int]] = None,
        head_widths: Sequence[int] = (1536, 384, 96),
        head_pools: Sequence[int] = (2, 2, 2),
        encoder: Union[str, Module] = "dense",
        channels: Optional[dict[str, int]] = None,
    ) -> None:
        if segments not in (None, "digit", "patch"):
            raise ValueError(f"'segments' must be 'digit', 'patch' or None (got '{segments}')")
        layout = as_layout(layout)
        super().__init__(layout.num_taxels, out_channels, inputs, num_joints, channels)
        self.segments = segments
        self.add_encoder(encoder, num_edges)
        width = sum(self.channels[name] for name in self.inputs)
        if segments is None:
            self.thread = GCNThread(width, widths or WIDTHS, pools or POOLS)
        else:
            numbers = layout.segments(segments)
            self.thread = SegmentedThread(width, numbers, widths or (14, 56), pools or (1, 8))
        self.add_head(self.thread.out_channels, head_widths, head_pools)

    def extract(self, parts: dict[str, Tensor], x: Tensor, edge_index: OptTensor) -> Tensor:
        r"""Returns the features of each taxel before the fully connected layers."""
        return self.convolve(self.thread, side_by_side(parts), x, edge_index)

    def extra_text(self) -> str:
        r"""Returns what :obj:`repr` tells beside the sizes."""
        return f"segments={self.segments!r}, {super().extra_text()}"
