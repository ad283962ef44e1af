r"""A :obj:`TaxelNet` without edges, to measure the benefit of its graph."""

import torch

from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.nn.models import TaxelNet
from torch_geometric_tactile.sensors import TaxelLayout


class TaxelNetWithoutEdges(TaxelNet):
    r"""A :class:`~torch_geometric_tactile.nn.models.TaxelNet` without edges. Everything else is the
    same, including the initial weights for a given seed, so that any difference in accuracy is due
    to the edges.

    Examples:
        >>> TaxelNetWithoutEdges("biotac_sp", 2, depth=1)
        TaxelNetWithoutEdges(24, 2, in_channels=3, widths=(32,), taxels=(24,), head='all')

    Shapes:
        - **out_channels:** Number of labels or classes :math:`C`.
        - **in_channels:** Number of features per taxel :math:`F`.
        - **input:** readings :math:`(N, F)`, :math:`(B, N, F)` or, for a PyG batch,
          :math:`(B \cdot N, F)`
        - **output:** logits :math:`(B, C)`
    """

    def __init__(
        self,
        layout: TaxelLayout | PathLike,
        out_channels: int,
        *,
        in_channels: int = 3,
        depth: int = 2,
        taxel_dropout: float = 0.2,
    ) -> None:
        super().__init__(
            layout,
            out_channels,
            in_channels=in_channels,
            depth=depth,
            taxel_dropout=taxel_dropout,
        )
        for level in self.levels:  # replaces the buffers of TaxelLevel
            level.register_buffer("edge_index", torch.zeros(2, 0, dtype=torch.long), False)
            level.register_buffer("sector", torch.zeros(0, dtype=torch.long), False)
