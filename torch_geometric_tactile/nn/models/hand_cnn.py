r"""Convolutions on a map of the hand."""

from collections.abc import Mapping, Sequence
from typing import Optional

from torch import Tensor
from torch_geometric.typing import OptTensor

from torch_geometric_tactile.nn.models._inputs import side_by_side
from torch_geometric_tactile.nn.models._taxel_image import checked_map
from torch_geometric_tactile.nn.models._taxels import LayoutLike, load_layout
from torch_geometric_tactile.nn.models._thread_widths import POOLS, WIDTHS
from torch_geometric_tactile.nn.models.cnn_thread import CNNThread
from torch_geometric_tactile.nn.models.tactile_model import TactileModel


class HandCNN(TactileModel):
    r"""The CNN of the "Tactile Object Property Recognition using Geometrical Graph Edge Features
    and Multi-Thread Graph Convolutional Network" paper (:doc:`P1 </papers>`): the inputs of the
    taxels on a map of the hand, convolutions with the widths of the GCN, and fully connected
    layers.

    The paper does not give its map. Ours is that of the layout, where patches lie as on the hand,
    with empty cells between them. The taxels' cells are read back after the last convolution, which
    gives the paper's :math:`384 \cdot 7` features.

    Args:
        layout (TaxelLayout, str or PathLike): The layout, the name of a stock layout or the path of
            a layout file; it must have an :obj:`image_map`.
        out_channels (int): Number of labels or classes :math:`C`.
        inputs (sequence of str): Some of :obj:`"tactile"`, :obj:`"absolute"` and
            :obj:`"position"`.
        num_joints (int): Number of joint angles; 16 for an Allegro hand, 0 for none.
        channels (dict, optional): Features of a taxel by input, if not 3 or 4.
        widths (sequence of int): Width of each convolution.
        pools (sequence of int): How many channels share one maximum, after each convolution.
        head_widths (sequence of int): Width of each fully connected layer.
        head_pools (sequence of int): How many channels share one maximum, after each of them.

    Shapes:
        - **input:** readings :math:`(N, F)`, :math:`(B, N, F)` or those of a PyG batch
          :math:`(B \cdot N, F)`; further inputs as in
          :meth:`~torch_geometric_tactile.nn.models.TactileModel.forward`
        - **output:** logits :math:`(B, C)`

    Raises:
        ValueError: If the layout has no map, or an input is unknown, missing or of another shape.

    Examples:
        >>> model = HandCNN(inputs=("tactile", "absolute"))
        >>> model.thread
        CNNThread(7, widths=(14, 28, 56, 112, 112), pools=(1, 1, 2, 4, 16), size=(32, 16))
        >>> model.head.in_channels
        2688
    """

    needs_edges = False

    def __init__(
        self,
        layout: LayoutLike = "allegro_uskin",
        out_channels: int = 6,
        *,
        inputs: Sequence[str] = ("tactile",),
        num_joints: int = 0,
        channels: Optional[Mapping[str, int]] = None,
        widths: Sequence[int] = WIDTHS,
        pools: Sequence[int] = POOLS,
        head_widths: Sequence[int] = (1536, 384, 96),
        head_pools: Sequence[int] = (2, 2, 2),
    ) -> None:
        layout = load_layout(layout, "its image map")
        super().__init__(
            layout, out_channels, inputs=inputs, num_joints=num_joints, channels=channels
        )
        width = sum(self.channels[name] for name in self.inputs)
        self.thread = CNNThread(width, checked_map(layout, self.inputs), widths, pools)
        self.add_head(self.thread.out_channels, head_widths, head_pools)

    def extract(self, parts: dict[str, Tensor], x: Tensor, edge_index: OptTensor) -> Tensor:
        r"""Returns the features of each taxel before the fully connected layers."""
        return self.thread(side_by_side(parts))
