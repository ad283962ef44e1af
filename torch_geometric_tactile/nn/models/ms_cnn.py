r"""Convolutions on maps of patches, fingers and the hand."""

from typing import Literal, Optional

import torch.nn.functional as F
from torch import Tensor
from torch.nn import ModuleList
from torch.nn.init import trunc_normal_, zeros_
from torch_geometric.nn.inits import reset
from torch_geometric.typing import OptTensor

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.nn.models._hand_maps import (
    PATTERNS,
    SD,
    MapStage,
    input_maps,
    joined_maps,
)
from torch_geometric_tactile.nn.models._taxel_image import checked_map
from torch_geometric_tactile.nn.models._taxels import LayoutLike, load_layout
from torch_geometric_tactile.nn.models.pooled_mlp import PooledMLP
from torch_geometric_tactile.nn.models.tactile_model import TactileModel

# Features of a cell after each convolution, and of the fully connected layer.
_WIDTHS = {3: (14, 28, 56), 1: (5, 9, 18)}
_HIDDEN = {3: 1200, 1: 400}
_ALL = 3  # channels of readings, of which the last is along the normal


class MSCNN(TactileModel):
    r"""The MS-CNN of the "Morphology-Specific Convolutional Neural Networks for Tactile Object
    Recognition with a Multi-Fingered Hand" paper (:doc:`P4 </papers>`): three convolutions, each on
    maps of patches, of fingers or of the whole hand, whose outputs are put together as the patches
    are on the hand; then the joint angles join, and two fully connected layers follow.

    What a map is at each convolution is the :obj:`pattern`, a row of
    :obj:`~torch_geometric_tactile.nn.models._hand_maps.PATTERNS`:

    * I: the whole hand, with zeros above the thumb;
    * II: patches, then the hand; III: patches twice, then the hand;
    * IV, the best of the paper: patches, then fingers, then the hand;
    * V: patches, then fingers twice; VI: patches only; VII: fingers only.

    There is neither padding nor pooling, so that an output is smaller than its map. Widths are 3,
    14, 28 and 56 (1, 5, 9 and 18 with one channel), followed by 1200 (400). As in the paper,
    weights begin as a normal distribution of standard deviation 0.1, cut at two of them; that
    biases begin at zero is ours.

    The paper's little finger is the layout's ring finger. Weights are shared between maps of equal
    size with filters of equal size.

    Args:
        layout (TaxelLayout, str or PathLike): The layout, the name of a stock layout or the path of
            a layout file. Its :obj:`image_map` has the patches of a digit one above the other,
            fingertips up, and digits side by side; the digit called :obj:`"thumb"` is the thumb.
        out_channels (int): Number of classes :math:`C`.
        pattern (str): :obj:`"I"` to :obj:`"VII"`.
        share_weights (bool): Whether maps share their filters.
        channels (int): 3 for all forces, 1 for those along the normal: of readings with three
            channels the last one, and readings with one channel as they are.
        num_joints (int): Number of joint angles; 16 for an Allegro hand, 0 for none.
        hidden_channels (int, optional): Width of the fully connected layer, if not 1200 or 400.

    Shapes:
        - **input:** readings :math:`(N, F)`, :math:`(B, N, F)` or those of a PyG batch
          :math:`(B \cdot N, F)`; joint angles :math:`(B, J)`
        - **output:** logits :math:`(B, C)`

    Raises:
        ValueError: If the pattern is unknown or does not fit the layout, the layout has no map, a
            size is below one, or an input is missing or of another shape.

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
        hidden_channels = _HIDDEN[channels] if hidden_channels is None else hidden_channels
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
        table = PATTERNS[pattern]
        maps, width = input_maps(layout, table[0].level), int(channels)
        self.stages = ModuleList()
        for stage, out_width in zip(table, _WIDTHS[channels], strict=True):
            maps = joined_maps(maps, stage.level, layout)
            convs = MapStage(width, out_width, maps, stage, share_weights)
            self.stages.append(convs)
            maps, width = convs.maps, out_width
        num_features = width * sum(one.cell.size for one in maps) + num_joints
        self.head = PooledMLP(num_features, out_channels, (hidden_channels,), (1,))
        self.reset_parameters()

    def reset_parameters(self) -> None:
        r"""Draws all weights anew."""
        reset(self.stages)
        for lin in (*self.head.lins, self.head.lin_out):
            trunc_normal_(lin.weight, std=SD, a=-2 * SD, b=2 * SD)
            zeros_(lin.bias)

    def collect(self, name: str, x: Tensor, *others: OptTensor) -> Tensor:
        r"""Returns the readings of each taxel :math:`(B, N, F)`, whatever the form of the data.

        Args:
            name (str): :obj:`"tactile"`.
            x (torch.Tensor): Readings.
            *others (torch.Tensor, optional): Not used.
        """
        if self.num_channels == 1 and x.size(-1) == _ALL:
            x = x[..., _ALL - 1 :]
        return super().collect(name, x, *others)

    def extract(self, parts: dict[str, Tensor], x: Tensor, edge_index: OptTensor) -> Tensor:
        r"""Returns the features of each cell of the last maps :math:`(B, M, F)`."""
        h = F.pad(parts["tactile"], (0, 0, 0, 1))  # a zero for the cells without a taxel
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
