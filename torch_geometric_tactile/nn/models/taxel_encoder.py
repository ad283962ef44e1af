r"""An encoder of touch that is trained without labels."""

import copy
from typing import Any, Self, Union

import torch
from torch import Tensor
from torch.nn import GELU, Dropout, LayerNorm, Linear, ModuleList, Sequential
from torch_geometric.typing import OptTensor

from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.nn._sizes import check_sizes
from torch_geometric_tactile.nn.models._base_model import BaseModel
from torch_geometric_tactile.nn.models._taxel_kernels import (
    PLACE,
    KernelBlock,
    KernelConv,
    Neighbourhood,
    coarse_layout,
    places,
)
from torch_geometric_tactile.nn.models._taxels import load_layout, stacked_readings
from torch_geometric_tactile.sensors import TaxelLayout

_QUERIES = 8
_HALF = 0.5  # pitches of the coarser layout, of four taxels each, about one of the finer


class TaxelEncoder(BaseModel):
    r"""Encodes what a sensor feels in a fixed number of features: an encoder that is pretrained
    without labels (:func:`~torch_geometric_tactile.training.pretrain`), with a linear layer on top
    for labels. It is ours, not from a paper.

    The weight of a neighbour is a function of its place in the frame of a taxel, in units of the
    local pitch, so that the same weights run on other layouts (:meth:`on_layout`). A missing
    reading (NaN) is left out, and its share goes to its neighbours: thinned and damaged sensors are
    read as they are. If the layout is large, the first convolution leads to a coarser layout of at
    most :obj:`max_taxels`. Means and maxima over its taxels, behind the first and the last layer,
    and eight means with learned shares, which know the places of the taxels, make the features.

    It takes raw readings: :meth:`fit_scale` measures a centre of each taxel and a scale of each
    channel, which are part of its state. Large readings are compressed by the inverse hyperbolic
    sine.

    Args:
        layout (TaxelLayout, str or PathLike): The layout, the name of a stock layout, or the path
            of a layout file.
        out_channels (int): Number of labels or classes :math:`C`.
        in_channels (int): Channels of each taxel :math:`F`.
        hidden_channels (int): Features of each taxel.
        num_layers (int): Blocks behind the first convolution.
        embedding_channels (int): Number of features :math:`D`.
        max_taxels (int): Number of taxels above which they are joined to coarser ones.
        dropout (float): Part of the features dropped in training before the last layer.

    Shapes:
        - **input:** readings :math:`(N, F)`, :math:`(B, N, F)` or those of a PyG batch
          :math:`(B \cdot N, F)`
        - **output:** logits :math:`(B, C)`

    Raises:
        ValueError: If :obj:`layout` is a number, a size is below one, or :obj:`x` has other taxels
            or channels.

    Examples:
        >>> model = TaxelEncoder("biotac_sp", 2, in_channels=1)
        >>> model
        TaxelEncoder(24, 2, in_channels=1, taxels=(24, 24), embedding_channels=128)
        >>> model(torch.zeros(5, 24, 1)).shape, model.embed(torch.zeros(5, 24, 1)).shape
        (torch.Size([5, 2]), torch.Size([5, 128]))
    """

    center: Tensor
    scale: Tensor
    place: Tensor
    place_coarse: Tensor

    def __init__(
        self,
        layout: Union[TaxelLayout, PathLike] = "allegro_uskin",
        out_channels: int = 6,
        *,
        in_channels: int = 3,
        hidden_channels: int = 64,
        num_layers: int = 2,
        embedding_channels: int = 128,
        max_taxels: int = 104,
        dropout: float = 0.3,
    ) -> None:
        super().__init__()
        layout = load_layout(layout, "the places of its taxels")
        check_sizes(
            out_channels=out_channels,
            in_channels=in_channels,
            hidden_channels=hidden_channels,
            num_layers=num_layers,
            embedding_channels=embedding_channels,
            max_taxels=max_taxels,
        )
        self.num_nodes = layout.num_taxels
        self.out_channels = out_channels
        self.in_channels = in_channels
        self.hidden_channels = hidden_channels
        self.embedding_channels = embedding_channels
        self.max_taxels = max_taxels
        coarse = coarse_layout(layout, max_taxels)
        self.taxels = (self.num_nodes, coarse.num_taxels)
        width = hidden_channels
        self.register_buffer("center", torch.zeros(self.num_nodes, in_channels))
        self.register_buffer("scale", torch.ones(in_channels))
        with torch.device("cpu"):  # on the meta device, places would lose their numbers
            place, place_coarse = places(layout, layout), places(coarse, layout)
        self.register_buffer("place", place, persistent=False)
        self.register_buffer("place_coarse", place_coarse, persistent=False)
        self.lift = Sequential(Linear(in_channels + PLACE, width), GELU())
        zoom = 1.0 if coarse is layout else _HALF
        self.near = Neighbourhood(coarse, layout, zoom)
        self.near_coarse = Neighbourhood(coarse, coarse)
        self.conv = KernelConv(width)
        self.norm_conv = LayerNorm(width)
        self.lin_conv = Sequential(Linear(width, width), GELU())
        self.blocks = ModuleList(KernelBlock(width) for _ in range(num_layers))
        self.attention = Linear(width + PLACE, _QUERIES)
        self.lin = Linear((4 + _QUERIES) * width, embedding_channels)
        self.norm = LayerNorm(embedding_channels)
        self.dropout = Dropout(dropout)
        self.lin_out = Linear(embedding_channels, out_channels)

    def fit_scale(self, x: Tensor) -> Self:
        r"""Measures the centre of each taxel, its median, and the scale of each channel, the root
        mean square of the deviations without their outermost hundredths.

        Args:
            x (torch.Tensor): Readings :math:`(B, N, F)`; missing ones are NaN.
        """
        x = stacked_readings(x, self.num_nodes, self.in_channels, "channels").double()
        center = x.nanmedian(dim=0).values.nan_to_num()
        off = (x - center).flatten(0, 1)
        low, high = _middle(off)
        spread = off.clamp(low, high).square().nanmean(dim=0).sqrt()
        whole = off.square().nanmean(dim=0).sqrt()
        scale = torch.where(spread > 0, spread, whole).nan_to_num()
        self.center = center.to(self.center)
        self.scale = torch.where(scale > 0, scale, 1.0).to(self.scale)
        return self

    def scaled(self, x: Tensor) -> Tensor:
        r"""Returns readings less their centre, in units of the scale.

        Args:
            x (torch.Tensor): Readings :math:`(B, N, F)`.
        """
        return (x - self.center) / self.scale

    def nodes(self, x: Tensor) -> tuple[Tensor, Tensor]:
        r"""Returns the features of the taxels behind the first convolution and behind the last.

        Args:
            x (torch.Tensor): Readings :math:`(B, N, F)` as :meth:`scaled` returns them.
        """
        seen = ~x.isnan().any(dim=-1)
        # Not in place of each NaN alone: a taxel without one of its channels is not seen.
        x = torch.where(seen.unsqueeze(-1), x, 0.0).asinh()
        place = self.place.expand(x.size(0), -1, -1)
        h = self.lift(torch.cat([x, place], dim=-1)) * seen.unsqueeze(-1)
        # What is not seen has features of its neighbours behind the first convolution.
        first = self.lin_conv(self.norm_conv(self.conv(h, self.near, seen)))
        last = first
        for block in self.blocks:
            last = block(last, self.near_coarse)
        return first, last

    def embed(self, x: Tensor) -> Tensor:
        r"""Returns the features of samples :math:`(B, D)`.

        Args:
            x (torch.Tensor): Readings as of :meth:`forward`.
        """
        x = stacked_readings(x, self.num_nodes, self.in_channels, "channels")
        return self.pooled(*self.nodes(self.scaled(x)))

    def pooled(self, first: Tensor, last: Tensor) -> Tensor:
        r"""Returns the features of samples from those of their taxels.

        Args:
            first (torch.Tensor): Behind the first convolution :math:`(B, M, H)`.
            last (torch.Tensor): Behind the last :math:`(B, M, H)`.
        """
        parts = [part for h in (first, last) for part in (h.mean(dim=1), h.amax(dim=1))]
        place = self.place_coarse.expand(last.size(0), -1, -1)
        share = self.attention(torch.cat([last, place], dim=-1)).softmax(dim=1)
        parts.append((share.transpose(1, 2) @ last).flatten(1))
        found: Tensor = self.norm(self.lin(torch.cat(parts, dim=1)))
        return found

    def on_layout(self, layout: Union[TaxelLayout, PathLike]) -> Self:
        r"""Returns the same encoder on another layout. The centre of its taxels is the mean of
        those that it was measured on.

        Args:
            layout (TaxelLayout, str or PathLike): The layout, its name or its file.
        """
        arguments: dict[str, Any] = {**self._hub_arguments, "layout": layout}
        other = type(self)(**arguments).to(self.scale)
        state = copy.deepcopy(self.state_dict())
        state["center"] = self.center.mean(dim=0).expand_as(other.center).clone()
        other.load_state_dict(state)
        return other.train(self.training)

    def _logits(self, x: Tensor, **unused: OptTensor) -> Tensor:
        return self.lin_out(self.dropout(self.embed(x)))

    def extra_repr(self) -> str:
        r"""Returns the sizes for :obj:`repr`."""
        return (
            f"{self.num_nodes}, {self.out_channels}, in_channels={self.in_channels}, "
            f"taxels={self.taxels}, embedding_channels={self.embedding_channels}"
        )


def _middle(off: Tensor) -> tuple[Tensor, Tensor]:
    # The first and the last hundredth of each column, of a part of many rows.
    rows = off[:: max(1, len(off) // 100_000)]
    low, high = rows.nanquantile(off.new_tensor([0.01, 0.99]), dim=0)
    return low.nan_to_num(), high.nan_to_num()
