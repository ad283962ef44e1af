r"""A small convolutional network on the image map of a layout."""

from collections.abc import Sequence

import torch
from torch import Tensor
from torch.nn import BatchNorm1d, BatchNorm2d, Conv2d, Dropout, Linear, ModuleList
from torch.nn import functional as F
from torch_geometric.typing import OptTensor

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.nn._sizes import check_sizes, has_taxels
from torch_geometric_tactile.nn.models._base_model import BaseModel
from torch_geometric_tactile.nn.models._taxel_image import TaxelImage
from torch_geometric_tactile.nn.models._taxels import LayoutLike, load_layout

_MAX_LAYERS = 8  # each layer halves the map, so 8 layers suffice for maps of 256 x 256 cells


class SmallCNN(BaseModel):
    r"""A plain convolutional network. Use it as a baseline for layouts with an :obj:`image_map`. It
    is not from a paper, but a common first choice for pressure images.

    The model has 3 x 3 convolutions with zero padding, each followed by batch normalisation, ReLU
    and max pooling over 2 x 2 cells. One fully connected layer with batch normalisation, ReLU and
    dropout follows. Cells of the image map without a taxel are zero.

    Args:
        layout (TaxelLayout, str or PathLike): The layout, the name of a stock layout or the path of
            a layout file. It must have an :obj:`image_map`.
        out_channels (int): Number of labels or classes :math:`C`.
        in_channels (int): Number of input features per taxel.
        widths (sequence of int): Width of each convolution.
        hidden_channels (int): Width of the fully connected layer.
        dropout (float): Probability of dropping an input or output of the fully connected layer
            during training.

    Shapes:
        - **input:** readings :math:`(N, F)`, :math:`(B, N, F)` or, for a PyG batch,
          :math:`(B \cdot N, F)`
        - **output:** logits :math:`(B, C)`

    Raises:
        ValueError: If the layout has no image map, a size is below one, or the readings have the
            wrong shape.

    Examples:
        >>> import torch
        >>> from torch_geometric_tactile.sensors import grid
        >>> model = SmallCNN(grid(8, 8, pitch=0.01), 10, in_channels=1)
        >>> model
        SmallCNN(64, 10, in_channels=1, widths=(32, 64), size=(8, 8))
        >>> model(torch.zeros(2, 64, 1)).shape
        torch.Size([2, 10])
    """

    def __init__(
        self,
        layout: LayoutLike,
        out_channels: int,
        *,
        in_channels: int = 3,
        widths: Sequence[int] = (32, 64),
        hidden_channels: int = 64,
        dropout: float = 0.3,
    ) -> None:
        super().__init__()
        layout = load_layout(layout, "its image map")
        widths = tuple(widths)
        check_sizes(
            out_channels=out_channels, in_channels=in_channels, hidden_channels=hidden_channels
        )
        need(
            1 <= len(widths) <= _MAX_LAYERS and min(widths) >= 1,
            f"'widths' must be 1 to {_MAX_LAYERS} positive numbers",
            widths,
        )
        self.image = TaxelImage(layout)
        self.num_nodes = layout.num_taxels
        self.in_channels = in_channels
        self.out_channels = out_channels
        self.widths = widths
        self.size = self.image.size
        input_widths = (in_channels, *widths[:-1])
        self.convs = ModuleList(
            Conv2d(in_width, out_width, 3, padding=1, bias=False)
            for in_width, out_width in zip(input_widths, widths, strict=True)
        )
        # Images with one channel take the memory format of the weights. On a CPU, training on
        # images of 28 x 50 cells takes 0.7 times as long with channels last.
        self.convs.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.norms = ModuleList(BatchNorm2d(width) for width in widths)
        rows, cols = self.size
        for _ in widths:
            rows, cols = -(-rows // 2), -(-cols // 2)
        self.lin1 = Linear(rows * cols * widths[-1], hidden_channels, bias=False)
        self.norm1 = BatchNorm1d(hidden_channels)
        self.dropout = Dropout(dropout)
        self.lin2 = Linear(hidden_channels, out_channels)

    def _logits(self, x: Tensor, **unused: OptTensor) -> Tensor:
        if not has_taxels(x, self.num_nodes, self.in_channels):
            raise ValueError(
                f"'x' must have {self.num_nodes} taxels and {self.in_channels} channels (got shape "
                f"{tuple(x.shape)})"
            )
        x = x.reshape(-1, self.num_nodes, self.in_channels)
        h = self.image(x)
        for conv, norm in zip(self.convs, self.norms, strict=True):
            h = F.max_pool2d(norm(conv(h)).relu(), 2, ceil_mode=True)
        h = self.dropout(h.flatten(1))
        return self.lin2(self.dropout(self.norm1(self.lin1(h)).relu()))

    def extra_repr(self) -> str:
        r"""Returns the sizes for :obj:`repr`."""
        return (
            f"{self.num_nodes}, {self.out_channels}, in_channels={self.in_channels}, "
            f"widths={self.widths}, size={self.size}"
        )
