r"""A convolutional network on maps of patches, fingers and the hand."""

from typing import Literal, Optional

import torch.nn.functional as F
from torch import Tensor
from torch.nn import ModuleList
from torch.nn.init import trunc_normal_, zeros_
from torch_geometric.nn.inits import reset
from torch_geometric.typing import OptTensor

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.nn.models._hand_maps import (
    INIT_STD,
    PATTERNS,
    MapStage,
    input_maps,
    join_maps,
)
from torch_geometric_tactile.nn.models._taxel_image import checked_map
from torch_geometric_tactile.nn.models._taxels import LayoutLike, load_layout
from torch_geometric_tactile.nn.models.pooled_mlp import PooledMLP
from torch_geometric_tactile.nn.models.tactile_model import TactileModel

# The paper's widths of the convolutions and of the fully connected layer, by number of channels.
_WIDTHS = {3: (14, 28, 56), 1: (5, 9, 18)}
_HIDDEN_WIDTHS = {3: 1200, 1: 400}
_NUM_FORCE_CHANNELS = 3  # the last channel is along the normal


class MSCNN(TactileModel):
    r"""The MS-CNN from the "Morphology-Specific Convolutional Neural Networks for Tactile Object
    Recognition with a Multi-Fingered Hand" paper (:doc:`P4 </papers>`). It has three convolutions,
    each on maps of the patches, the fingers or the whole hand. The output maps are joined according
    to the arrangement of the patches on the hand. Two fully connected layers take the resulting
    features and the joint angles.

    The :obj:`pattern` determines which maps each convolution uses
    (:obj:`~torch_geometric_tactile.nn.models._hand_maps.PATTERNS`):

    * I: the hand only, with zeros above the thumb;
    * II: patches, then the hand;
    * III: patches twice, then the hand;
    * IV (the best pattern in the paper): patches, then fingers, then the hand;
    * V: patches, then fingers twice;
    * VI: patches only;
    * VII: fingers only.

    The convolutions have neither padding nor pooling, so that each output is smaller than its map.
    The widths are 3, 14, 28 and 56, followed by 1200. With one channel, they are 1, 5, 9 and 18,
    followed by 400. As in the paper, the initial weights are drawn from a normal distribution with
    standard deviation 0.1, truncated at two standard deviations. The paper does not state the
    initial biases; they are zero here.

    The ring finger of the layout is called the little finger in the paper.

    Args:
        layout (TaxelLayout, str or PathLike): The layout, the name of a stock layout or the path of
            a layout file. On its :obj:`image_map`, the patches of each digit must be stacked
            vertically with the fingertip at the top, and the digits must be side by side. The thumb
            must be named :obj:`"thumb"`.
        out_channels (int): Number of classes :math:`C`.
        pattern (str): :obj:`"I"` to :obj:`"VII"`.
        share_weights (bool): Whether maps of the same size that have filters of the same size share
            these filters.
        channels (int): 3 for all force components, or 1 for the component along the normal. The
            component along the normal is the last of three channels, or the only channel.
        num_joints (int): Number of joint angles, 16 for an Allegro hand, or 0 for none.
        hidden_channels (int, optional): Width of the fully connected layer. Defaults to 1200, or to
            400 with one channel.

    Shapes:
        - **input:** readings :math:`(N, F)`, :math:`(B, N, F)` or, for a PyG batch,
          :math:`(B \cdot N, F)`; joint angles :math:`(B, J)`
        - **output:** logits :math:`(B, C)`

    Raises:
        ValueError: If the pattern is unknown or does not fit the layout, the layout has no image
            map, a size is below one, or an input is missing or has the wrong shape.

    Examples:
        >>> model = MSCNN(pattern="IV", share_weights=True)
        >>> model.stages[1].convs
        ModuleList(
          (0): MapConv(14, 28, maps=3, size=(10, 2), filter=(4, 2), stride=1, share_weights=True)
          (1): MapConv(14, 28, maps=1, size=(8, 2), filter=(2, 2), stride=1, share_weights=True)
        )
        >>> model.head.in_channels
        1024
    """

    needs_edges = False

    def __init__(
        self,
        layout: LayoutLike = "allegro_uskin_240",
        out_channels: int = 20,
        *,
        pattern: str = "IV",
        share_weights: bool = False,
        channels: Literal[3, 1] = 3,
        num_joints: int = 16,
        hidden_channels: Optional[int] = None,
    ) -> None:
        layout = load_layout(layout, "its image map")
        need(pattern in PATTERNS, f"'pattern' must be one of {list(PATTERNS)} (got {pattern!r})")
        need(channels in _WIDTHS, f"'channels' must be 3 or 1 (got {channels!r})")
        hidden_channels = _HIDDEN_WIDTHS[channels] if hidden_channels is None else hidden_channels
        need(hidden_channels >= 1, "'hidden_channels' must be at least 1", hidden_channels)
        super().__init__(
            layout,
            out_channels,
            inputs=("tactile",),
            num_joints=num_joints,
            channels={"tactile": channels},
        )
        checked_map(layout, self.inputs)
        self.pattern = pattern
        self.share_weights = share_weights
        self.num_channels = channels
        stages = PATTERNS[pattern]
        maps, width = input_maps(layout, stages[0].level), int(channels)
        self.stages = ModuleList()
        for stage, out_width in zip(stages, _WIDTHS[channels], strict=True):
            maps = join_maps(maps, stage.level, layout)
            convs = MapStage(width, out_width, maps, stage, share_weights)
            self.stages.append(convs)
            maps, width = convs.maps, out_width
        num_features = width * sum(hand_map.cell.size for hand_map in maps) + num_joints
        self.head = PooledMLP(num_features, out_channels, (hidden_channels,), (1,))
        self.reset_parameters()

    def reset_parameters(self) -> None:
        r"""Resets all learnable parameters."""
        reset(self.stages)
        for lin in (*self.head.lins, self.head.lin_out):
            trunc_normal_(lin.weight, std=INIT_STD, a=-2 * INIT_STD, b=2 * INIT_STD)
            zeros_(lin.bias)

    def collect(self, name: str, x: Tensor, *unused: OptTensor) -> Tensor:
        r"""Returns the readings of each taxel as :math:`(B, N, F)`.

        Args:
            name (str): :obj:`"tactile"`.
            x (torch.Tensor): Readings.
            *unused (torch.Tensor, optional): Not used.
        """
        if self.num_channels == 1 and x.size(-1) == _NUM_FORCE_CHANNELS:
            x = x[..., _NUM_FORCE_CHANNELS - 1 :]
        return super().collect(name, x, *unused)

    def extract(self, parts: dict[str, Tensor], x: Tensor, edge_index: OptTensor) -> Tensor:
        r"""Returns the features of each cell in the last maps :math:`(B, M, F)`."""
        h = F.pad(parts["tactile"], (0, 0, 0, 1))  # appends zeros for cells without a taxel
        for stage in self.stages:
            h = stage(h)
        return h

    def extra_repr(self) -> str:
        r"""Returns the sizes and the pattern for :obj:`repr`."""
        shared = ", share_weights=True" if self.share_weights else ""
        return (
            f"{self.num_nodes}, {self.out_channels}, pattern='{self.pattern}'{shared}, "
            f"channels={self.num_channels}, num_joints={self.num_joints}"
        )
