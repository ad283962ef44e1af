r"""A convolutional network on the image map of a hand."""

from collections.abc import Mapping, Sequence
from typing import Optional

from torch import Tensor
from torch_geometric.typing import OptTensor

from torch_geometric_tactile.nn.models._inputs import concatenate_inputs
from torch_geometric_tactile.nn.models._taxel_image import checked_map
from torch_geometric_tactile.nn.models._taxels import LayoutLike, load_layout
from torch_geometric_tactile.nn.models._thread_widths import POOLS, WIDTHS
from torch_geometric_tactile.nn.models.cnn_thread import CNNThread
from torch_geometric_tactile.nn.models.tactile_model import TactileModel


class HandCNN(TactileModel):
    r"""The CNN from the "Tactile Object Property Recognition using Geometrical Graph Edge Features
    and Multi-Thread Graph Convolutional Network" paper (:doc:`P1 </papers>`). It applies
    convolutions to the inputs on an image map of the hand, followed by fully connected layers. The
    widths are the same as in the GCN.

    The paper does not show its map. This implementation uses the image map of the layout, in which
    the patches are arranged as on the hand, with empty cells between them. After the last
    convolution, only the cells with a taxel are kept, which gives the paper's :math:`384 \cdot 7`
    features.

    Args:
        layout (TaxelLayout, str or PathLike): The layout, the name of a stock layout or the path of
            a layout file. It must have an :obj:`image_map`.
        out_channels (int): Number of labels or classes :math:`C`.
        inputs (sequence of str): Inputs to use: any of :obj:`"tactile"`, :obj:`"absolute"` and
            :obj:`"position"`.
        num_joints (int): Number of joint angles, 16 for an Allegro hand, or 0 for none.
        channels (dict, optional): Number of features per taxel by input, for inputs that differ
            from the default (3 or 4).
        widths (sequence of int): Width of each convolution.
        pools (sequence of int): Pool size in channels after each convolution.
        head_widths (sequence of int): Width of each fully connected layer.
        head_pools (sequence of int): Pool size in channels after each fully connected layer.

    Shapes:
        - **input:** readings :math:`(N, F)`, :math:`(B, N, F)` or, for a PyG batch,
          :math:`(B \cdot N, F)`; further inputs as in
          :meth:`~torch_geometric_tactile.nn.models.TactileModel.forward`
        - **output:** logits :math:`(B, C)`

    Raises:
        ValueError: If the layout has no image map, or an input is unknown, is missing or has the
            wrong shape.

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
        r"""Returns the features of each taxel before the fully connected layers
        :math:`(B, N, F)`.
        """
        return self.thread(concatenate_inputs(parts))
