r"""A network that treats the strongest taxels as points in the frame of the palm."""

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
    stacked_readings,
    taxel_mask,
)
from torch_geometric_tactile.sensors import HandKinematics, TaxelLayout

# Shapes of the attributes that describe the pose of a taxel.
_POSE_SHAPES = {"pos": (3,), "normal": (3,), "tangent": (2, 3)}


class PosedTaxelNet(BaseModel):
    r"""A network that treats the strongest taxels as a set of points. Use it to predict metric
    values, such as the width of an object. It is not from a paper.

    For each sample, the model selects the touched taxels (:math:`p_i > 0`) with the largest
    pressure :math:`p_i`. The features of a taxel are its position :math:`\mathbf{p}_i`, its normal
    :math:`\mathbf{n}_i`, its force :math:`\mathbf{f}_i` in the frame of the palm, the norm of the
    force, and its pressure. All taxels share the same feature scales. The features pass through a
    network with shared weights, which is followed by the maximum and mean over the taxels, a hidden
    layer and the outputs:

    .. math::
        \mathbf{h}_i = \mathrm{MLP}([\mathbf{p}_i, \mathbf{n}_i, \mathbf{f}_i,
        \lVert \mathbf{f}_i \rVert, p_i]), \qquad
        \mathbf{f}_i = x_i \, \mathbf{t}^x_i + y_i \, \mathbf{t}^y_i - p_i \, \mathbf{n}_i

    Taxels that are not selected affect neither the maximum and mean nor the statistics of batch
    normalisation. The maximum and mean are zero if no taxel is touched. The output does not depend
    on the order of the taxels: among taxels with equal pressure, those with the larger :math:`x`,
    then :math:`y`, then :math:`z` are selected first.

    Pressure is the last channel. Three channels are :math:`(x, y, p)`, as in
    :class:`~torch_geometric_tactile.transforms.TaxelForce`. With any other number of channels, the
    force is along the normal. With neither one nor three channels, the readings are appended to the
    features. Readings must be tared and must increase with contact. A taxel whose pressure is zero
    or negative counts as not touched. The output is NaN if any reading is missing (NaN).

    Args:
        layout (TaxelLayout, str or PathLike): The layout, the name of a stock layout, or the path
            of a layout file.
        out_channels (int): Number of classes or targets :math:`C`.
        in_channels (int): Number of channels per taxel :math:`F`.
        posed (bool): If :obj:`True`, the poses of the taxels are read from the attributes
            :obj:`pos`, :obj:`normal` and, for three channels, :obj:`tangent` of the data. Add them
            with :class:`~torch_geometric_tactile.transforms.TaxelPose`. If :obj:`False`, the poses
            are fixed: for a layout on a single link, they are taken from the layout; for a layout
            on the links of an Allegro hand, they are computed for the open hand.
        num_strongest (int): Maximum number of selected taxels.
        widths (sequence of int): Widths of the shared network.
        hidden_channels (int): Width of the hidden layer.
        dropout (float): Probability of dropping a feature before the hidden layer and before the
            outputs during training.
        taxel_dropout (float): Probability of dropping a taxel of a sample during training.

    Shapes:
        - **input:** readings :math:`(N, F)`, :math:`(B, N, F)` or, for a PyG batch,
          :math:`(B \cdot N, F)`; :obj:`pos` and :obj:`normal` with the same leading shape and width
          3, or :math:`(N, 3)` for all samples; :obj:`tangent` likewise with trailing shape
          :math:`(2, 3)`
        - **output:** logits or targets :math:`(B, C)`

    Raises:
        ValueError: If a size is below one, :obj:`taxel_dropout` is negative or not below one, poses
            are missing or have the wrong shape, or :obj:`x` has the wrong number of taxels or
            channels.

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
        layout = load_layout(layout, "the poses of its taxels")
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
            with torch.device("cpu"):  # on the meta device, poses would lose their values
                for name, pose in zip(_POSE_SHAPES, _open_hand_pose(layout), strict=True):
                    self.register_buffer(f"open_{name}", pose, persistent=False)
        # Position, normal, force, norm of the force and pressure (3 + 3 + 3 + 1 + 1). Readings that
        # are neither pressures nor forces are appended.
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
        r"""Names of the attributes of a batch that are passed to :meth:`forward` by keyword."""
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

        The arguments have the same order as in
        :meth:`~torch_geometric_tactile.nn.models.TactileModel.forward`.

        Args:
            x (torch.Tensor): Readings.
            edge_index, edge_attr, absolute (torch.Tensor, optional): Not used.
            joint (torch.Tensor, optional): Not used, since the poses already depend on the joint
                angles.
            pos (torch.Tensor, optional): Positions in metres. Required if :obj:`posed` is
                :obj:`True`.
            normal (torch.Tensor, optional): Unit normals. Required if :obj:`posed` is :obj:`True`.
            tangent (torch.Tensor, optional): Unit :math:`x` and :math:`y` axes. Required if
                :obj:`posed` is :obj:`True` and there are three channels.
        """
        x = stacked_readings(x, self.num_nodes, self.in_channels, "channels")
        inputs = {"pos": pos, "normal": normal, "tangent": tangent}
        poses = {name: self._pose(name, inputs[name], x) for name in self.places}
        mask = taxel_mask(x, self.taxel_dropout if self.training else 0.0)
        # Taxels with a missing reading are selected first, so that the output becomes NaN.
        score = x[..., -1].masked_fill(x.isnan().any(dim=-1), torch.inf)
        score = score if mask is None else score.masked_fill(~mask, -torch.inf)
        is_selected = _select_strongest(score, poses["pos"], self.num_strongest)
        # Samples with fewer touched taxels are padded with taxels that are masked below.
        num_rows = min(self.num_strongest, self.num_nodes)
        index = score.masked_fill(~is_selected, -torch.inf).topk(num_rows, dim=1).indices
        row_mask = is_selected.gather(1, index).unsqueeze(-1)
        x = x.masked_fill(~is_selected.unsqueeze(-1), 0.0)
        h = self.norm(self._features(x, poses, index), row_mask)
        for lin, norm in zip(self.lins, self.norms, strict=True):
            h = norm(lin(h), row_mask).relu()
        h = h * row_mask  # the output of ReLU is never negative, so zeros do not change the maximum
        pooled = torch.cat([h.amax(dim=1), h.sum(dim=1) / row_mask.sum(dim=1).clamp(min=1)], dim=1)
        pooled = self.norm_hidden(self.lin(self.dropout(pooled))).relu()
        return self.lin_out(self.dropout(pooled))

    def _features(self, x: Tensor, poses: dict[str, Tensor], index: Tensor) -> Tensor:
        # Returns the features (B, K, F) of the taxels at `index` (B, K).
        x = _gather_taxels(x, index)
        selected = {name: _gather_taxels(pose, index) for name, pose in poses.items()}
        pressure = x[..., -1:]
        force = -pressure * selected["normal"]
        if "tangent" in selected:
            force = force + (x[..., :2].unsqueeze(-1) * selected["tangent"]).sum(dim=-2)
        # The constant avoids the infinite gradient of the square root at zero.
        force_norm = (force.square().sum(dim=-1, keepdim=True) + 1e-12).sqrt()
        features = [selected["pos"], selected["normal"], force, force_norm, pressure]
        return torch.cat(features if self.in_channels in (1, 3) else [*features, x], dim=-1)

    def _pose(self, name: str, pose: Optional[Tensor], x: Tensor) -> Tensor:
        # Returns an attribute of the pose for each sample and taxel (B, N, ...).
        shape = _POSE_SHAPES[name]
        if not self.posed:
            open_pose: Tensor = getattr(self, f"open_{name}")
            return open_pose.to(x.dtype).expand(x.size(0), -1, *[-1] * len(shape))
        if pose is None:
            raise ValueError(
                f"'{name}' must be given if 'posed' is True (got None): add TaxelPose() to the "
                "transform"
            )
        num_samples, rank = x.size(0), len(shape)
        if tuple(pose.shape[-rank:]) == shape:
            if pose.dim() == rank + 2 and pose.shape[:2] == x.shape[:2]:
                return pose.to(x.dtype)
            if pose.dim() == rank + 1 and pose.size(0) == self.num_nodes:
                return pose.to(x.dtype).expand(num_samples, *pose.shape)
            if pose.dim() == rank + 1 and pose.size(0) == num_samples * self.num_nodes:
                return pose.to(x.dtype).reshape(num_samples, self.num_nodes, *shape)
        raise ValueError(
            f"'{name}' must have {num_samples} samples of {self.num_nodes} taxels, like 'x', with "
            f"shape {shape} for each taxel (got shape {tuple(pose.shape)})"
        )

    def extra_repr(self) -> str:
        r"""Returns the sizes for :obj:`repr`."""
        return (
            f"{self.num_nodes}, {self.out_channels}, in_channels={self.in_channels}, "
            f"posed={self.posed}, num_strongest={self.num_strongest}"
        )


def _gather_taxels(values: Tensor, index: Tensor) -> Tensor:
    # Returns the values (B, K, ...) of the taxels at `index` (B, K).
    shape = values.shape[2:]
    index = index.view(*index.shape, *[1] * len(shape)).expand(-1, -1, *shape)
    return values.gather(1, index)


def _select_strongest(pressure: Tensor, pos: Tensor, max_taxels: int) -> Tensor:
    # Returns whether each taxel is touched and among the strongest (B, N). Ties at the limit are
    # broken by position: larger x first, then y, then z. Only comparisons are used, so that the
    # selection does not depend on the order of the taxels or on the runtime. Taxels with the same
    # pressure and position are selected together if all of them fit.
    is_tied = pressure > 0
    is_selected = torch.zeros_like(is_tied)
    max_taxels = min(max_taxels, pressure.size(1))
    for key in (pressure, *pos.unbind(-1)):
        num_free = max_taxels - is_selected.sum(dim=1, keepdim=True)
        key = key.masked_fill(~is_tied, -torch.inf)
        threshold = key.topk(max_taxels, dim=1).values.gather(1, num_free - 1)
        is_selected = is_selected | (key > threshold)
        is_tied = is_tied & (key == threshold)
    do_ties_fit = (
        is_selected.sum(dim=1, keepdim=True) + is_tied.sum(dim=1, keepdim=True) <= max_taxels
    )
    return is_selected | (is_tied & do_ties_fit)


def _open_hand_pose(layout: TaxelLayout) -> tuple[Tensor, Tensor, Tensor]:
    # Returns positions (N, 3), normals (N, 3) and tangents (N, 2, 3) of the open hand.
    axes = layout.axes()
    assert layout.link is not None
    if len(layout.link.unique()) == 1:
        return layout.pos, axes[:, 2], axes[:, :2]
    hand = HandKinematics.allegro()
    unknown_links = sorted(set(layout.link_names) - set(hand.link_names))
    if unknown_links:
        raise ValueError(
            "'posed' must be True for a layout on several links, unless all are links of an "
            f"Allegro hand (got the link '{unknown_links[0]}')"
        )
    pose = hand.link_pose(torch.zeros(hand.num_joints))
    hand_link = torch.tensor([hand.link_names.index(name) for name in layout.link_names])
    link = hand_link[layout.link]
    rotation, translation = pose.rotation[link], pose.translation[link]
    pos = (rotation @ layout.pos.unsqueeze(-1)).squeeze(-1) + translation
    palm_axes = axes @ rotation.transpose(1, 2)
    return pos, palm_axes[:, 2], palm_axes[:, :2]
