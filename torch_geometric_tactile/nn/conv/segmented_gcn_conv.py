r"""A graph convolution with separate weights for each segment."""

from collections.abc import Sequence
from typing import Any, Union

import torch
from torch import Tensor
from torch.nn import Parameter
from torch_geometric.nn import MessagePassing
from torch_geometric.nn.conv.gcn_conv import gcn_norm
from torch_geometric.nn.inits import glorot, zeros
from torch_geometric.typing import Adj, OptTensor

from torch_geometric_tactile.nn._sizes import has_taxels
from torch_geometric_tactile.nn.conv._edge_checks import (
    as_edges,
    check_conv_sizes,
    check_edge_form,
    check_edge_weight,
    check_tensor,
    compute_on_edges,
)
from torch_geometric_tactile.nn.conv._explainable_propagate import ExplainablePropagate
from torch_geometric_tactile.nn.conv._lazy_weight import LazyWeight
from torch_geometric_tactile.nn.conv._plain import is_hooked, sums_messages
from torch_geometric_tactile.nn.conv._static_adjacency import (
    GCN_NORM,
    AdjacencyCache,
    GCNNorm,
    contained_product,
    dense_norm,
    edge_pattern,
    may_cache_edges,
    may_multiply,
    may_multiply_dense,
)


class SegmentedGCNConv(LazyWeight, ExplainablePropagate, MessagePassing):
    r"""A graph convolution within each segment of a hand, with separate weights for each segment,
    as in the "Multifingered Object Recognition with Tactile Sensors and Graph Convolutional
    Networks using Topological Graph Segmentation" paper (eq. 2 and 3), but without the activation.

    .. math::
        \mathbf{X}'_s = \hat{\mathbf{A}}_s \mathbf{X}_s \mathbf{W}_s + \mathbf{b}_s

    The layer is equivalent to one :class:`~torch_geometric.nn.GCNConv` for each segment, applied to
    the induced subgraph of the segment. Edges between segments are ignored.

    Many samples on one topology :math:`(B, N, F)` are multiplied by a matrix, which is sparse on a
    CPU, and dense on a GPU for up to 1024 taxels. The matrix is cached as long as edges and weights
    do not change, as in :class:`~torch_geometric_tactile.nn.conv.StaticGCNConv`. In all other
    cases, messages are passed along edges.

    Args:
        segment (sequence of int or torch.Tensor): Index of each taxel's segment :math:`(N,)`,
            numbered from zero without gaps, as returned by :obj:`layout.segments("patch")`.
        in_channels (int): Size of each input feature, or -1 to infer it from the first input.
        out_channels (int): Size of each output feature.
        bias (bool): Whether to add learnable biases.
        fast (bool): Whether to propagate samples on one topology with a matrix product.
        **kwargs: Further arguments of :class:`torch_geometric.nn.MessagePassing`.

    Shapes:
        - **input:** node features :math:`(N, F_{in})`, :math:`(B, N, F_{in})` or, for a PyG batch,
          :math:`(B \cdot N, F_{in})`, edges :math:`(2, |\mathcal{E}|)` or a sparse matrix
          :math:`(N, N)` of targets and sources, optional edge weights :math:`(|\mathcal{E}|,)`
        - **output:** node features with the same leading shape and width :math:`F_{out}`

    Raises:
        ValueError: If :obj:`segment` has gaps, a size is below one, :obj:`x` has the wrong number
            of taxels or features, :obj:`edge_index` has the wrong shape, does not hold integers or
            has indices out of range, or :obj:`edge_weight` does not hold one real number per edge.

    Examples:
        >>> conv = SegmentedGCNConv([0, 0, 1], 3, 8)
        >>> conv
        SegmentedGCNConv(3, 8, num_segments=2)
        >>> conv(torch.zeros(5, 3, 3), torch.tensor([[0, 1, 1], [1, 0, 2]])).shape
        torch.Size([5, 3, 8])
    """

    segment: Tensor
    _groups: Tensor
    _members: Tensor
    _places: Tensor

    def __init__(
        self,
        segment: Union[Sequence[int], Tensor],
        in_channels: int,
        out_channels: int,
        bias: bool = True,
        *,
        fast: bool = True,
        **kwargs: Any,
    ) -> None:
        super().__init__(**{"aggr": "add", **kwargs})
        self.fast = fast
        self._edge_cache = AdjacencyCache()
        segment = _checked_segment(segment)
        check_conv_sizes(in_channels=in_channels, out_channels=out_channels)
        self.out_channels = out_channels
        # Not saved in the state, so that a checkpoint cannot override the argument.
        self.register_buffer("segment", segment, persistent=False)
        self.num_segments = int(self.segment.max()) + 1
        buffers = zip(("_groups", "_members", "_places"), _taxel_groups(segment), strict=True)
        for name, indices in buffers:
            self.register_buffer(name, indices, persistent=False)
        identity = torch.arange(len(self._members), device=segment.device)
        self._is_grouped = torch.equal(self._members, identity)
        self._add_weight(in_channels)
        if bias:
            self.bias = Parameter(torch.empty(self.num_segments, out_channels))
        else:
            self.register_parameter("bias", None)
        self.reset_parameters()

    def reset_parameters(self) -> None:
        r"""Resets all learnable parameters."""
        super().reset_parameters()
        if not self._is_lazy():
            for weight in self.weight:
                glorot(weight)
        zeros(self.bias)

    def weight_size(self, in_channels: int) -> tuple[int, ...]:
        r"""Returns the shape of the weight.

        Args:
            in_channels (int): Size of each input feature.
        """
        return self.num_segments, self.out_channels, in_channels

    def forward(self, x: Tensor, edge_index: Adj, edge_weight: OptTensor = None) -> Tensor:
        r"""Returns the node features after the convolution.

        Args:
            x (torch.Tensor): Node features.
            edge_index (torch.Tensor): Edges, or a sparse matrix. Edges between segments are
                ignored.
            edge_weight (torch.Tensor, optional): Edge weights. Defaults to ones.
        """
        check_tensor(x)
        self._initialize_weight(x)
        num_taxels = len(self.segment)
        if not has_taxels(x, num_taxels, self.in_channels):
            raise ValueError(
                f"'x' must have {num_taxels} taxels, like 'segment', and {self.in_channels} "
                f"features (got shape {tuple(x.shape)})"
            )
        if self._may_multiply(x):
            out = self._multiply(x, edge_index, edge_weight)
            if out is not None:
                return out
        check_edge_form(edge_index, x.size(-2))
        check_edge_weight(edge_index, edge_weight)
        return compute_on_edges(self._convolve_edges, x.size(-2), x, edge_index, edge_weight)

    def _may_multiply(self, x: Tensor) -> bool:
        return (
            self.fast
            and type(self).message is SegmentedGCNConv.message
            and x.layout == torch.strided
            and (may_multiply(x) or (x.dim() > 2 and may_multiply_dense(x)))
            and sums_messages(self)
        )

    def _multiply(self, x: Tensor, edge_index: Adj, edge_weight: OptTensor) -> OptTensor:
        norm = (*GCN_NORM[:-1], self.flow)
        num_taxels, segment = len(self.segment), self.segment
        adjacency = self._edge_cache.get(
            edge_index, edge_weight, num_taxels, x.dtype, segment, norm
        )
        if may_multiply(x):
            if adjacency is None or not adjacency.may_reorder:
                return None  # weights need a gradient or are infinite
            sums = adjacency.product(x)
        elif adjacency is not None:
            sums = adjacency.dense_product(x)
        else:
            dense = dense_norm(
                edge_index, edge_weight, num_taxels, x.dtype, segment, GCNNorm(*norm)
            )
            sums = contained_product(dense, edge_pattern(dense), x)
        # One batched product multiplies each group of taxels, in all samples, by the weights of its
        # segment.
        h = sums.movedim(-2, 0)
        rows = h.reshape(num_taxels, -1)
        weight: Tensor = self.weight
        bias: OptTensor = self.bias
        if not self._is_grouped:
            rows = rows.index_select(0, self._members)
        if len(self._groups) > self.num_segments:  # each taxel is a group
            weight = weight.index_select(0, segment)
            bias = None if bias is None else bias.index_select(0, segment)
        rows = rows.view(len(self._groups), -1, self.in_channels)
        if bias is None:
            out = torch.bmm(rows, weight.mT)
        else:
            out = torch.baddbmm(bias.unsqueeze(1), rows, weight.mT)
        out = out.view(len(self._members), -1)
        if not self._is_grouped:
            out = out.index_select(0, self._places)
        return out.view(*h.shape[:-1], self.out_channels).movedim(0, -2).contiguous()

    def _convolve_edges(self, x: Tensor, edge_index: Adj, edge_weight: OptTensor) -> Tensor:
        if self.fast and may_cache_edges(x):
            norm, segment = (*GCN_NORM[:-1], self.flow), self.segment
            adjacency = self._edge_cache.get(
                edge_index, edge_weight, x.size(-2), x.dtype, segment, norm
            )
            if adjacency is not None:
                edges, weight = adjacency.edges  # from sources to targets in either flow
                edges = edges.flip(0) if self.flow == "target_to_source" else edges
                return self._pass_messages(x, edges, weight, None)
        edge_index, edge_weight = as_edges(edge_index, edge_weight)
        is_within = self._is_within(edge_index)
        weight = is_within.to(x.dtype)
        if edge_weight is not None:
            weight = (weight * edge_weight.view(-1)).masked_fill(~is_within, 0.0)
        edge_index, norm = gcn_norm(
            edge_index.long(), weight, x.size(-2), flow=self.flow, dtype=x.dtype
        )
        return self._pass_messages(x, edge_index, norm, self._is_within(edge_index))

    def _pass_messages(
        self, x: Tensor, edge_index: Tensor, norm: Tensor, is_within: OptTensor
    ) -> Tensor:
        num_taxels = len(self.segment)
        rows = x.reshape(-1, num_taxels, self.in_channels)
        mapped = torch.einsum("bni,noi->bno", rows, self.weight[self.segment])
        mapped = mapped.reshape(*x.shape[:-1], self.out_channels)
        out: Tensor = self.propagate(edge_index, x=mapped, norm=norm, is_within=is_within)
        if self.bias is None:
            return out
        bias = self.bias[self.segment]
        return out + (bias if x.dim() == 3 else bias.repeat(x.size(0) // num_taxels, 1))

    def is_plain(self) -> bool:
        r"""Returns whether the layer is unmodified. An unmodified layer has no hook, wrapped
        weight, explainer or subclass that changes or observes it.
        """
        return (
            type(self) is SegmentedGCNConv
            and self.flow == "source_to_target"
            and not is_hooked(self)
            and sums_messages(self)
        )

    def _is_within(self, edge_index: Tensor) -> Tensor:
        segment = self.segment[edge_index % len(self.segment)]
        return segment[0] == segment[1]

    def message(self, x_j: Tensor, norm: Tensor, is_within: OptTensor = None) -> Tensor:
        r"""Returns the weighted features of the neighbour. Between segments, they are zero, even if
        the features of the neighbour are infinite.
        """
        out = norm.view(-1, 1) * x_j
        return out if is_within is None else out.masked_fill(~is_within.view(-1, 1), 0.0)

    def __repr__(self) -> str:
        return (
            f"{type(self).__name__}({self.in_channels}, {self.out_channels}, "
            f"num_segments={self.num_segments})"
        )


def _checked_segment(segment: Union[Sequence[int], Tensor]) -> Tensor:
    r"""Returns the segment of each taxel as a tensor :math:`(N,)`.

    Raises:
        ValueError: If the segments are not integers from zero without gaps.
    """
    numbers = torch.as_tensor(segment)
    has_integers = not numbers.is_floating_point() and numbers.dtype != torch.bool
    if numbers.dim() != 1 or len(numbers) == 0 or not has_integers:
        raise ValueError(
            "'segment' must be a whole number for each taxel "
            f"(got shape {tuple(numbers.shape)}, {numbers.dtype})"
        )
    unique_numbers = numbers.unique().tolist()
    if unique_numbers != list(range(len(unique_numbers))):
        raise ValueError(f"'segment' must be numbered from 0 without gaps (got {unique_numbers})")
    return numbers.long()


def _taxel_groups(segment: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    r"""Returns groups with the same number of taxels, so that all taxels can be processed in one
    batched product.

    Returns:
        tuple: Segment of each group :math:`(G,)`; indices of the taxels of all groups, padded with
        the first taxel of each segment :math:`(G \cdot n,)`; and position of each taxel in these
        indices :math:`(N,)`.
    """
    counts, device = segment.bincount(), segment.device
    taxels = torch.arange(len(segment), device=device)
    size = int(counts.max())
    if len(counts) * size > 2 * len(segment):  # padding would more than double the work
        return segment, taxels, taxels
    order = segment.argsort(stable=True)
    starts = counts.cumsum(0) - counts
    offsets = torch.arange(size, device=device).expand(len(counts), size)
    offsets = torch.where(offsets < counts.view(-1, 1), offsets, 0)
    members = order[starts.view(-1, 1) + offsets].view(-1)
    sorted_segment = segment[order]
    positions = torch.empty_like(order)
    positions[order] = sorted_segment * size + taxels - starts[sorted_segment]
    return torch.arange(len(counts), device=device), members, positions
