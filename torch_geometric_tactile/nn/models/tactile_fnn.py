r"""A fully connected network on the inputs of all taxels."""

from collections.abc import Mapping, Sequence
from typing import Optional

from torch import Tensor
from torch_geometric.typing import OptTensor

from torch_geometric_tactile.nn.models._inputs import check_no_edges, concatenate_inputs
from torch_geometric_tactile.nn.models._taxels import LayoutLike
from torch_geometric_tactile.nn.models.tactile_model import TactileModel


class TactileFNN(TactileModel):
    r"""The FNN from the "Tactile Object Property Recognition using Geometrical Graph Edge Features
    and Multi-Thread Graph Convolutional Network" paper (:doc:`P1 </papers>`). It applies the fully
    connected layers "32768(P)16384, 4096(P)2048, 1024(P)512" to the inputs of all taxels. It does
    not use the graph of the hand.

    Args:
        layout (TaxelLayout, int, str or PathLike): The layout, the name of a stock layout, the path
            of a layout file, or the number of taxels.
        out_channels (int): Number of labels or classes :math:`C`.
        inputs (sequence of str): Inputs to use: any of :obj:`"tactile"`, :obj:`"absolute"` and
            :obj:`"position"`.
        num_joints (int): Number of joint angles, 16 for an Allegro hand, or 0 for none.
        channels (dict, optional): Number of features per taxel by input, for inputs that differ
            from the default (3 or 4).
        widths (sequence of int): Width of each layer.
        pools (sequence of int): Pool size in channels after each layer.

    Shapes:
        - **input:** readings :math:`(N, F)`, :math:`(B, N, F)` or, for a PyG batch,
          :math:`(B \cdot N, F)`; further inputs as in
          :meth:`~torch_geometric_tactile.nn.models.TactileModel.forward`
        - **output:** logits :math:`(B, C)`

    Raises:
        ValueError: If an input is unknown, is missing or has the wrong shape.

    Examples:
        >>> TactileFNN(widths=(64, 32, 16)).head.in_channels
        1152
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
        widths: Sequence[int] = (32768, 4096, 1024),
        pools: Sequence[int] = (2, 2, 2),
    ) -> None:
        super().__init__(
            layout, out_channels, inputs=inputs, num_joints=num_joints, channels=channels
        )
        check_no_edges(self.inputs)
        self.add_head(sum(self.channels[name] for name in self.inputs), widths, pools)

    def extract(self, parts: dict[str, Tensor], x: Tensor, edge_index: OptTensor) -> Tensor:
        r"""Returns the concatenated inputs of each taxel :math:`(B, N, F)`."""
        return concatenate_inputs(parts)
