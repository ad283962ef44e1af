r"""Taxels as points in the frame of the palm."""

from collections.abc import Sequence
from typing import Optional, Union

import torch
from torch import Tensor
from torch.nn import Dropout, Linear, ModuleList
from torch_geometric.typing import OptTensor

from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.nn._sizes import check_sizes, checked_layer_widths
from torch_geometric_tactile.nn.models._base_model import BaseModel
from torch_geometric_tactile.nn.models._taxel_levels import ReadingNorm, TaxelNorm
from torch_geometric_tactile.nn.models._taxels import (
    check_taxel_dropout,
    load_layout,
    seen_taxels,
    stacked_readings,
)
from torch_geometric_tactile.sensors import HandKinematics, TaxelLayout

# Width of what places a taxel, by attribute.
_PLACES = {"pos": (3,), "normal": (3,), "tangent": (2, 3)}


class PosedTaxelNet(BaseModel):
    r"""A network that treats the strongest taxels as a set of points, to predict metric values such
    as the width of an object. It is ours, not from a paper.

    Of each sample, the touched taxels (:math:`p_i > 0`) with the largest pressure :math:`p_i` are
    taken, with their position, normal, force :math:`\mathbf{f}_i` and its size in the frame of the
    palm, and pressure. The others do not count: not in maximum and mean, which are zero if nothing
    is touched, and not in the scales of batch normalisation. The numbering of taxels does not
    matter: of equal pressures at the limit, those with the larger :math:`x`, :math:`y`, :math:`z`
    of their position come first. All
    features share one scale for all taxels; a network with shared weights, maximum and mean over
    the taxels, a hidden layer and the outputs follow:

    .. math::
        \mathbf{h}_i = \mathrm{MLP}([\mathbf{p}_i, \mathbf{n}_i, \mathbf{f}_i,
        \lVert \mathbf{f}_i \rVert, p_i]), \qquad
        \mathbf{f}_i = x_i \, \mathbf{t}^x_i + y_i \, \mathbf{t}^y_i - p_i \, \mathbf{n}_i

    Pressure is the last channel. Readings of three channels are :math:`(x, y, p)`, as in
    :class:`~torch_geometric_tactile.transforms.TaxelForce`; of one channel, the force is along the
    normal; of any other number, it is as well, and the readings are further features. Readings
    should be tared and rise with touch: nothing touched is zero, and below zero is not touched. The
    answer is missing (NaN) if any reading is.

    Args:
        layout (TaxelLayout, str or PathLike): The layout, the name of a stock layout, or the path
            of a layout file.
        out_channels (int): Number of classes or targets :math:`C`.
        in_channels (int): Channels of each taxel :math:`F`.
        posed (bool): Whether places follow the joints: :obj:`pos`, :obj:`normal` and, with three
            channels, :obj:`tangent` come with the data, from
            :class:`~torch_geometric_tactile.transforms.TaxelPose`. Otherwise they are those of the
            layout if it has one link, and of the open hand if its links are those of an Allegro
            hand.
        num_strongest (int): Number of touched taxels that are taken, at most.
        widths (sequence of int): Widths of the shared network.
        hidden_channels (int): Width of the hidden layer.
        dropout (float): Part of the features dropped in training before the hidden layer and the
            outputs.
        taxel_dropout (float): Part of the taxels that are not seen in training, drawn anew for each
            sample.

    Shapes:
        - **input:** readings :math:`(N, F)`, :math:`(B, N, F)` or those of a PyG batch
          :math:`(B \cdot N, F)`; :obj:`pos` and :obj:`normal` of the same leading shape, 3 wide, or
          :math:`(N, 3)` for all samples; :obj:`tangent` likewise, :math:`(2, 3)` wide
        - **output:** logits or targets :math:`(B, C)`

    Raises:
        ValueError: If a size is below one, a part is not below one, places are missing or of other
            taxels, or :obj:`x` has other taxels or channels.

    Examples:
        >>> model = PosedTaxelNet("allegro_uskin", 1, posed=False)
        >>> model
        PosedTaxelNet(384, 1, in_channels=3, posed=False, num_strongest=48)
        >>> model(torch.zeros(5, 384, 3)).shape
        torch.Size([5, 1])
    """

    def __init__(
        self,
        layout: Union[TaxelLayout, PathLike],
        out_channels: int,
        *,
        in_channels: int = 3,
        posed: bool = True,
        num_strongest: int = 48,
        widths: Sequence[int] = (48, 48, 96),
        hidden_channels: int = 48,
        dropout: float = 0.2,
        taxel_dropout: float = 0.1,
    ) -> None:
        super().__init__()
        layout = load_layout(layout, "the places of its taxels")
        check_sizes(
            out_channels=out_channels,
            in_channels=in_channels,
            num_strongest=num_strongest,
            hidden_channels=hidden_channels,
        )
        self.num_nodes = layout.num_taxels
        self.out_channels = out_channels
        self.in_channels = in_channels
        self.posed = posed
        self.num_strongest = num_strongest
        self.taxel_dropout = check_taxel_dropout(taxel_dropout)
        self.places = ("pos", "normal", "tangent") if in_channels == 3 else ("pos", "normal")
        if not posed:
            with torch.device("cpu"):  # on the meta device, places would lose their numbers
                for name, value in zip(_PLACES, _open(layout), strict=True):
                    self.register_buffer(f"open_{name}", value, persistent=False)
        # Position, normal, force, size and pressure; and readings whose meaning is not known.
        size = 11 if in_channels in (1, 3) else 11 + in_channels
        self.norm = ReadingNorm(size)
        self.lins = ModuleList()
        self.norms = ModuleList()
        for width in checked_layer_widths(widths):
            self.lins.append(Linear(size, width, bias=False))
            self.norms.append(TaxelNorm(width))
            size = width
        self.dropout = Dropout(dropout)
        self.lin = Linear(2 * size, hidden_channels, bias=False)
        self.norm_hidden = TaxelNorm(hidden_channels)
        self.lin_out = Linear(hidden_channels, out_channels)

    @property
    def modalities(self) -> tuple[str, ...]:
        r"""The attributes of a batch that :meth:`forward` needs by keyword."""
        return self.places if self.posed else ()

    def forward(
        self,
        x: Tensor,
        edge_index: OptTensor = None,
        edge_attr: OptTensor = None,
        joint: OptTensor = None,
        absolute: OptTensor = None,
        pos: OptTensor = None,
        *,
        normal: OptTensor = None,
        tangent: OptTensor = None,
    ) -> Tensor:
        r"""Returns the logits or targets :math:`(B, C)`.

        The order is that of :meth:`~torch_geometric_tactile.nn.models.TactileModel.forward`.

        Args:
            x (torch.Tensor): Readings.
            edge_index, edge_attr, absolute (torch.Tensor, optional): Not used.
            joint (torch.Tensor, optional): Not used: places follow from it.
            pos (torch.Tensor, optional): Positions in metres, if :obj:`posed`.
            normal (torch.Tensor, optional): Unit normals, if :obj:`posed`.
            tangent (torch.Tensor, optional): Unit :math:`x` and :math:`y` axes, if :obj:`posed` and
                there are three channels.
        """
        x = stacked_readings(x, self.num_nodes, self.in_channels, "channels")
        given = {"pos": pos, "normal": normal, "tangent": tangent}
        places = {name: self._place(name, given[name], x) for name in self.places}
        seen = seen_taxels(x, self.taxel_dropout if self.training else 0.0)
        # What misses a reading comes first, so that the answer is missing as well.
        score = x[..., -1].masked_fill(x.isnan().any(dim=-1), torch.inf)
        score = score if seen is None else score.masked_fill(~seen, -torch.inf)
        chosen = _strongest(score, places["pos"], self.num_strongest)
        # The rows of fewer taxels are filled up with others, which are masked from here on.
        number = min(self.num_strongest, self.num_nodes)
        index = score.masked_fill(~chosen, -torch.inf).topk(number, dim=1).indices
        kept = chosen.gather(1, index).unsqueeze(-1)
        x = x.masked_fill(~chosen.unsqueeze(-1), 0.0)
        h = self.norm(self._features(x, places, index), kept)
        for lin, norm in zip(self.lins, self.norms, strict=True):
            h = norm(lin(h), kept).relu()
        h = h * kept  # not negative after ReLU: the maximum is of those kept
        rows = torch.cat([h.amax(dim=1), h.sum(dim=1) / kept.sum(dim=1).clamp(min=1)], dim=1)
        rows = self.norm_hidden(self.lin(self.dropout(rows))).relu()
        return self.lin_out(self.dropout(rows))

    def _features(self, x: Tensor, places: dict[str, Tensor], strongest: Tensor) -> Tensor:
        # Of the strongest taxels of each sample (B, K, F).
        x = _taken(x, strongest)
        near = {name: _taken(value, strongest) for name, value in places.items()}
        pressure = x[..., -1:]
        force = -pressure * near["normal"]
        if "tangent" in near:
            force = force + (x[..., :2].unsqueeze(-1) * near["tangent"]).sum(dim=-2)
        # Not the square root of zero, whose gradient is infinite.
        size = (force.square().sum(dim=-1, keepdim=True) + 1e-12).sqrt()
        parts = [near["pos"], near["normal"], force, size, pressure]
        return torch.cat(parts if self.in_channels in (1, 3) else [*parts, x], dim=-1)

    def _place(self, name: str, value: Optional[Tensor], x: Tensor) -> Tensor:
        # Of each sample (B, N, ...).
        width = _PLACES[name]
        if not self.posed:
            own: Tensor = getattr(self, f"open_{name}")
            return own.to(x.dtype).expand(x.size(0), -1, *[-1] * len(width))
        if value is None:
            raise ValueError(
                f"'{name}' must be given if 'posed' is True, as TaxelPose sets it (got None)"
            )
        num_samples, rank = x.size(0), len(width)
        if tuple(value.shape[-rank:]) == width:
            if value.dim() == rank + 2 and value.shape[:2] == x.shape[:2]:
                return value.to(x.dtype)
            if value.dim() == rank + 1 and value.size(0) == self.num_nodes:
                return value.to(x.dtype).expand(num_samples, *value.shape)
            if value.dim() == rank + 1 and value.size(0) == num_samples * self.num_nodes:
                return value.to(x.dtype).reshape(num_samples, self.num_nodes, *width)
        raise ValueError(
            f"'{name}' must be of {num_samples} samples of {self.num_nodes} taxels, as 'x', and "
            f"{width} wide (got shape {tuple(value.shape)})"
        )

    def extra_repr(self) -> str:
        r"""Returns the sizes for :obj:`repr`."""
        return (
            f"{self.num_nodes}, {self.out_channels}, in_channels={self.in_channels}, "
            f"posed={self.posed}, num_strongest={self.num_strongest}"
        )


def _taken(values: Tensor, index: Tensor) -> Tensor:
    # Some taxels of each sample (B, K, ...) of (B, N, ...).
    more = values.shape[2:]
    index = index.view(*index.shape, *[1] * len(more)).expand(-1, -1, *more)
    return values.gather(1, index)


def _strongest(pressure: Tensor, pos: Tensor, most: int) -> Tensor:
    # Which taxels are touched and among the strongest (B, N). Of equal pressure at the limit, those
    # come first whose place has the larger x, y, z; comparisons alone, for the same choice in any
    # numbering and runtime. Of equals at one place, all that fit or none.
    tied = pressure > 0
    chosen = torch.zeros_like(tied)
    most = min(most, pressure.size(1))
    for key in (pressure, *pos.unbind(-1)):
        left = most - chosen.sum(dim=1, keepdim=True)
        key = key.masked_fill(~tied, -torch.inf)
        least = key.topk(most, dim=1).values.gather(1, left - 1)
        chosen = chosen | (key > least)
        tied = tied & (key == least)
    fits = chosen.sum(dim=1, keepdim=True) + tied.sum(dim=1, keepdim=True) <= most
    return chosen | (tied & fits)


def _open(layout: TaxelLayout) -> tuple[Tensor, Tensor, Tensor]:
    # Positions, normals and axes of the open hand.
    axes = layout.axes()
    assert layout.link is not None
    if len(layout.link.unique()) == 1:
        return layout.pos, axes[:, 2], axes[:, :2]
    hand = HandKinematics.allegro()
    missing = sorted(set(layout.link_names) - set(hand.link_names))
    if missing:
        raise ValueError(
            "'posed' must be True for a layout on several links that are not those of an Allegro "
            f"hand (got the link '{missing[0]}')"
        )
    pose = hand.link_pose(torch.zeros(hand.num_joints))
    number = torch.tensor([hand.link_names.index(name) for name in layout.link_names])
    link = number[layout.link]
    rotation, shift = pose.rotation[link], pose.translation[link]
    pos = (rotation @ layout.pos.unsqueeze(-1)).squeeze(-1) + shift
    turned = axes @ rotation.transpose(1, 2)
    return pos, turned[:, 2], turned[:, :2]
