r"""A graph convolution with a separate weight for each direction."""

from typing import Any, NamedTuple, Optional

import torch
import torch.nn.functional as F
from torch import Tensor
from torch.amp import custom_bwd, custom_fwd
from torch.autograd import Function
from torch.autograd.function import once_differentiable
from torch.nn import Parameter
from torch_geometric.nn import MessagePassing
from torch_geometric.nn.inits import glorot, zeros
from torch_geometric.typing import Adj, OptTensor

from torch_geometric_tactile.nn.conv._edge_cache import EdgeCache, is_cacheable
from torch_geometric_tactile.nn.conv._edge_checks import (
    TensorCheck,
    check_conv_sizes,
    check_edge_form,
    check_edge_index,
    check_tensor,
    compute_on_edges,
    is_traced,
)
from torch_geometric_tactile.nn.conv._explainable_propagate import ExplainablePropagate
from torch_geometric_tactile.nn.conv._lazy_weight import LazyWeight
from torch_geometric_tactile.nn.conv._plain import is_static_batch, sums_messages
from torch_geometric_tactile.nn.conv._static_adjacency import all_finite

# Size of a block of copied neighbours, which fits in a CPU's second-level cache.
_BLOCK_BYTES = 2**19
# Up to this size, all neighbours are copied at once, so that there are fewer and larger products.
# With few channels, the products of blocks are so small that one large copy is faster up to a
# higher limit.
_COPY_BYTES = 2**22
_NARROW_COPY_BYTES = 2**25
_MAX_NARROW_CHANNELS = 4
# Smallest batch for which the memory layout of this module is faster than messages.
_MIN_SAMPLES = 8
# Cached block sizes per topology, for several batch sizes and widths.
_MAX_BLOCK_SIZES = 16


class SectorConv(LazyWeight, ExplainablePropagate, MessagePassing):
    r"""A graph convolution with separate weights for the taxel itself and for the neighbour in each
    direction. It is the counterpart of a :math:`3 \times 3` image convolution for any layout.

    .. math::
        \mathbf{x}'_i = \mathbf{W}_{\mathrm{self}} \mathbf{x}_i + \mathbf{b} +
        \sum_{s=0}^{S-1} \mathbf{W}_s \mathbf{x}_{n(i,s)}

    where :math:`n(i, s)` is the neighbour of taxel :math:`i` in sector :math:`s` of its tangent
    plane, as computed by :func:`~torch_geometric_tactile.sensors.sector_edges`. An empty sector
    contributes zero, and multiple neighbours in one sector are summed. On a grid whose pitches
    differ by at most a factor of two, the layer with eight sectors returns the same results as
    :class:`torch.nn.Conv2d` with a :math:`3 \times 3` kernel and zero padding.

    For samples on one topology :math:`(B, N, F)` on a CPU, the features of neighbours are
    multiplied sector by sector. The sorted edges are cached as long as they do not change. On a
    grid, an image convolution is used, which is twice as fast again.

    Messages are passed along edges in all other cases: for a single sample or a PyG batch
    :math:`(N, F)`, for fewer than eight samples with many taxels, on other devices, with
    :obj:`fast=False`, and if an explainer, a hook or a subclass needs the messages.

    Args:
        in_channels (int): Size of each input feature, or -1 to infer it from the first input.
        out_channels (int): Size of each output feature.
        num_sectors (int): Number of sectors :math:`S`.
        bias (bool): Whether to add a learnable bias.
        fast (bool): Whether to multiply sector by sector if this is faster. Second derivatives are
            then not supported.
        **kwargs: Further arguments of :class:`torch_geometric.nn.MessagePassing`, except
            :obj:`flow`.

    Shapes:
        - **input:** node features :math:`(N, F_{in})`, :math:`(B, N, F_{in})` or, for a PyG batch,
          :math:`(B \cdot N, F_{in})`, edges :math:`(2, |\mathcal{E}|)`, sectors
          :math:`(|\mathcal{E}|,)`
        - **output:** node features with the same leading shape and width :math:`F_{out}`

    Raises:
        ValueError: If a size is below one, :obj:`x` has the wrong number of features,
            :obj:`edge_index` has the wrong shape, does not hold integers or has indices out of
            range, or :obj:`edge_sector` does not hold a sector for each edge.

    Examples:
        >>> conv = SectorConv(3, 8, num_sectors=4)
        >>> conv
        SectorConv(3, 8, num_sectors=4)
        >>> conv(torch.zeros(5, 2, 3), torch.tensor([[0, 1], [1, 0]]), torch.tensor([0, 2])).shape
        torch.Size([5, 2, 8])
    """

    def __init__(
        self,
        in_channels: int,
        out_channels: int,
        num_sectors: int = 8,
        bias: bool = True,
        *,
        fast: bool = True,
        **kwargs: Any,
    ) -> None:
        if "flow" in kwargs:
            raise ValueError(
                "'flow' must be left out: edges always point from the neighbour to the taxel (got "
                f"{kwargs['flow']!r})"
            )
        if kwargs.get("decomposed_layers", 1) != 1:
            raise ValueError(
                "'decomposed_layers' must be 1, since the features of a sector cannot be split "
                f"(got {kwargs['decomposed_layers']})"
            )
        super().__init__(**{"aggr": "add", **kwargs})
        check_conv_sizes(
            in_channels=in_channels, out_channels=out_channels, num_sectors=num_sectors
        )
        self.out_channels = out_channels
        self.num_sectors = num_sectors
        self.fast = fast
        # The first weight is for the taxel itself.
        self._add_weight(in_channels)
        if bias:
            self.bias = Parameter(torch.empty(out_channels))
        else:
            self.register_parameter("bias", None)
        self._edge_cache = _SectorCache()
        self.reset_parameters()

    def reset_parameters(self) -> None:
        r"""Resets all learnable parameters."""
        super().reset_parameters()
        if not self._is_lazy():
            glorot(self.weight.flatten(0, 1))
        zeros(self.bias)

    def weight_size(self, in_channels: int) -> tuple[int, ...]:
        r"""Returns the shape of the weight.

        Args:
            in_channels (int): Size of each input feature.
        """
        return 1 + self.num_sectors, in_channels, self.out_channels

    def forward(self, x: Tensor, edge_index: Adj, edge_sector: Tensor) -> Tensor:
        r"""Returns the node features after the convolution.

        Args:
            x (torch.Tensor): Node features.
            edge_index (torch.Tensor): Edges from the neighbour to the taxel.
            edge_sector (torch.Tensor): Index of the taxel's sector that contains the neighbour, for
                each edge.
        """
        check_tensor(x)
        self._initialize_weight(x)
        if x.dim() not in (2, 3) or x.size(-1) != self.in_channels:
            raise ValueError(
                f"'x' must have shape (num_nodes, {self.in_channels}) or (batch_size, num_nodes, "
                f"{self.in_channels}) (got {tuple(x.shape)})"
            )
        check_edge_form(edge_index, x.size(-2))
        if self._is_fast(x):
            table = self._edge_cache.get(edge_index, edge_sector, x.size(1), self.num_sectors)
            if table is not None and _is_product_faster(x, table):
                return _sector_product(x, table, self.weight, self.bias)
        self._edge_cache.check(edge_index, edge_sector, self.num_sectors)
        return compute_on_edges(self._convolve_edges, x.size(-2), x, edge_index, edge_sector)

    def _is_fast(self, x: Tensor) -> bool:
        return self.fast and is_static_batch(x) and type(self) is SectorConv and sums_messages(self)

    def _convolve_edges(self, x: Tensor, edge_index: Adj, edge_sector: Tensor) -> Tensor:
        # Passes messages on a bipartite graph. Its targets are the sectors of all taxels.
        num_nodes, num_targets = x.size(-2), x.size(-2) * self.num_sectors
        source, target = edge_index.long()
        sector_edges = torch.stack([source, target * self.num_sectors + edge_sector.long()])
        sums = self.propagate(sector_edges, x=(x, None), size=(num_nodes, num_targets))
        sums = sums.reshape(*x.shape[:-1], self.num_sectors * self.in_channels)
        out = x @ self.weight[0] + sums @ self.weight[1:].flatten(0, 1)
        return out if self.bias is None else out + self.bias

    def message(self, x_j: Tensor) -> Tensor:
        r"""Returns the neighbour's features."""
        return x_j

    def __repr__(self) -> str:
        return (
            f"{type(self).__name__}({self.in_channels}, {self.out_channels}, "
            f"num_sectors={self.num_sectors})"
        )


class _SectorImage(NamedTuple):
    r"""An image whose pixels, row by row, are the nodes, and whose directions are the sectors. The
    sum over sectors is then an image convolution, for which PyTorch has fast kernels.
    """

    rows: int
    cols: int
    sectors: tuple[int, ...]
    kernel_indices: tuple[int, ...]  # position of each sector in a flattened 3 x 3 kernel

    @classmethod
    def from_edges(
        cls, source: Tensor, target: Tensor, sector: Tensor, num_nodes: int
    ) -> Optional["_SectorImage"]:
        r"""Returns the image that is equivalent to edges, or :obj:`None` if there is none. In an
        image, edges join exactly the pairs of direct neighbours, and each sector is one direction.

        Shapes:
            - **source, target, sector:** Ends and sectors of the edges :math:`(|\mathcal{E}|,)`.
            - **num_nodes:** Number of nodes :math:`N`.
        """
        steps, sectors = {}, sector.unique().tolist()
        for sector_index in sectors:
            step = (source - target)[sector == sector_index]
            steps[sector_index] = int(step[0])
            if bool((step != step[0]).any()):
                return None
        if not steps:
            return None
        # A step to the next row changes the index by the width of the image, plus or minus one for
        # diagonal steps. Steps within a single row do not determine the width, so the number of
        # nodes is tried as well.
        widths = {abs(step) + diagonal for step in steps.values() for diagonal in (-1, 0, 1)}
        for cols in sorted({*widths, num_nodes}):
            if cols > 2 and num_nodes % cols == 0:
                image = cls._with_width(steps, target, sector, num_nodes // cols, cols)
                if image is not None:
                    return image
        return None

    @classmethod
    def _with_width(
        cls, steps: dict[int, int], target: Tensor, sector: Tensor, rows: int, cols: int
    ) -> Optional["_SectorImage"]:
        # Returns the image of this size, or None if the edges do not match its pixels.
        kernel_indices = []
        for sector_index, step in steps.items():
            row_step = round(step / cols)
            col_step = step - row_step * cols
            if abs(row_step) > 1 or abs(col_step) > 1:
                return None
            targets = target[sector == sector_index]
            source_cols = targets % cols + col_step
            is_inside = (source_cols >= 0) & (source_cols < cols)  # the row is then inside as well
            num_pairs = (rows - abs(row_step)) * (cols - abs(col_step))
            if (
                not bool(is_inside.all())
                or len(targets) != num_pairs
                or len(targets.unique()) != num_pairs
            ):
                return None
            kernel_indices.append(3 * (row_step + 1) + col_step + 1)
        return cls(rows, cols, tuple(steps), tuple(kernel_indices))

    def product(self, x: Tensor, weight: Tensor, bias: OptTensor) -> Tensor:
        r"""Returns the sum of the features of each node and its neighbours, each multiplied by the
        matrix of its sector :math:`(B, N, O)`.

        Shapes:
            - **x:** Node features :math:`(B, N, F)`.
            - **weight:** Matrices :math:`(1 + S, F, O)`. The first matrix is for the node itself.
            - **bias:** Biases :math:`(O,)`.
        """
        kernel = weight.new_zeros(9, *weight.shape[1:])
        used_weights = torch.tensor([0, *(1 + sector for sector in self.sectors)])
        # The centre of the kernel is at index 4.
        kernel = kernel.index_add(0, torch.tensor([4, *self.kernel_indices]), weight[used_weights])
        kernel = kernel.view(3, 3, *weight.shape[1:]).permute(3, 2, 0, 1)
        # Nodes are stored pixel by pixel, so that channels-last images are views that need no copy.
        image = x.contiguous().view(len(x), self.rows, self.cols, -1).permute(0, 3, 1, 2)
        out = F.conv2d(image, kernel, bias, padding=1)
        return out.permute(0, 2, 3, 1).reshape(len(x), self.rows * self.cols, -1)


class _SectorBlock(NamedTuple):
    r"""The edges of a block of taxels in one sector."""

    sector: int
    source: Tensor  # taxel indices
    target: Tensor  # indices within the block


class _SectorTable:
    r"""The edges of one topology, grouped by blocks of taxels and by sector.

    Args:
        edge_index (torch.Tensor): Edges :math:`(2, |\mathcal{E}|)`.
        edge_sector (torch.Tensor): Sectors of the edges :math:`(|\mathcal{E}|,)`.
        num_nodes (int): Number of taxels :math:`N`.
        num_sectors (int): Number of sectors :math:`S`.
    """

    def __init__(
        self, edge_index: Tensor, edge_sector: Tensor, num_nodes: int, num_sectors: int
    ) -> None:
        order = (edge_index[1].long() * num_sectors + edge_sector.long()).argsort(stable=True)
        self.source, self.target = edge_index.long()[:, order]
        self.sector = edge_sector.long()[order]
        self.num_nodes = num_nodes
        self.image = _SectorImage.from_edges(self.source, self.target, self.sector, num_nodes)
        self.neighbors = self._neighbors(num_sectors)
        self._blocks: dict[int, list[tuple[int, int, list[_SectorBlock]]]] = {}

    def blocks(self, size: int) -> list[tuple[int, int, list[_SectorBlock]]]:
        r"""Returns the start, end and edges of each block, and caches them.

        Args:
            size (int): Number of taxels in a block.
        """
        blocks = self._blocks.get(size)
        if blocks is None:
            if len(self._blocks) >= _MAX_BLOCK_SIZES:
                self._blocks = {}  # replaced, not cleared: another thread may be reading it
            with torch.inference_mode(False):
                starts = range(0, self.num_nodes, size)
                blocks = [self._block(start, min(start + size, self.num_nodes)) for start in starts]
            self._blocks[size] = blocks
        return blocks

    def _neighbors(self, num_sectors: int) -> Optional[Tensor]:
        # Returns the indices (N * (1 + S),) of each taxel and of its neighbour in each sector. The
        # index N means that there is no neighbour. Returns None if a sector of a taxel has multiple
        # neighbours.
        index = self.target * (1 + num_sectors) + 1 + self.sector
        if len(index.unique()) < len(index):
            return None
        neighbors = torch.full((self.num_nodes, 1 + num_sectors), self.num_nodes)
        neighbors[:, 0] = torch.arange(self.num_nodes)
        neighbors.view(-1)[index] = self.source
        return neighbors.view(-1)

    def _block(self, start: int, stop: int) -> tuple[int, int, list[_SectorBlock]]:
        first, last = torch.searchsorted(self.target, torch.tensor([start, stop])).tolist()
        sector = self.sector[first:last]
        sector_blocks = []
        for sector_index in sector.unique().tolist():
            edges = first + (sector == sector_index).nonzero().view(-1)
            sector_blocks.append(
                _SectorBlock(sector_index, self.source[edges], self.target[edges] - start)
            )
        return start, stop, sector_blocks


class _SectorCache(EdgeCache[_SectorTable]):
    r"""A cache that holds the table of the last topology."""

    def __init__(self) -> None:
        super().__init__()
        self.check = _SectorCheck()

    def get(
        self, edge_index: Tensor, edge_sector: Tensor, num_nodes: int, num_sectors: int
    ) -> Optional[_SectorTable]:
        r"""Returns the table of a topology, or :obj:`None` if the table may not be cached.

        Args:
            edge_index (torch.Tensor): Edges :math:`(2, |\mathcal{E}|)`.
            edge_sector (torch.Tensor): Sectors of the edges :math:`(|\mathcal{E}|,)`.
            num_nodes (int): Number of taxels :math:`N`.
            num_sectors (int): Number of sectors :math:`S`.

        Raises:
            ValueError: If an edge or a sector is invalid.
        """
        key, tensors = (num_nodes,), (edge_index, edge_sector)
        cached_table = self._lookup(key, tensors)
        if cached_table is not None:
            return cached_table
        check_edge_index(edge_index, num_nodes)
        self.check(edge_index, edge_sector, num_sectors)
        if not is_cacheable(edge_index, edge_sector):
            return None

        def group_edges() -> _SectorTable:
            return _SectorTable(edge_index, edge_sector, num_nodes, num_sectors)

        return self._store(key, tensors, group_edges)


class _SectorCheck(TensorCheck):
    r"""A check of the sectors of edges. Shape and type are checked at each call. On a GPU, values
    are checked only if the tensor has changed.
    """

    def __call__(self, edge_index: Tensor, edge_sector: Tensor, num_sectors: int) -> None:
        r"""Checks sectors.

        Args:
            edge_index (torch.Tensor): Edges :math:`(2, |\mathcal{E}|)`.
            edge_sector (torch.Tensor): Sectors of the edges :math:`(|\mathcal{E}|,)`.
            num_sectors (int): Number of sectors :math:`S`.
        """
        num_edges = edge_index.size(1)
        dtype = edge_sector.dtype
        if edge_sector.dim() != 1 or edge_sector.size(0) != num_edges:
            raise ValueError(
                f"'edge_sector' must have shape ({num_edges},), one sector per edge "
                f"(got {tuple(edge_sector.shape)})"
            )
        if dtype.is_floating_point or dtype.is_complex or dtype == torch.bool:
            raise ValueError(f"'edge_sector' must hold integers (got {dtype})")
        # On a CPU, the check is cheap, and the memory may be changed unnoticed through a NumPy
        # array.
        if edge_sector.is_cpu:
            _check_sector_values(edge_sector, num_sectors)
        else:
            self._check(edge_sector, num_sectors, _check_sector_values)


def _check_sector_values(edge_sector: Tensor, num_sectors: int) -> None:
    if is_traced() or edge_sector.is_meta or edge_sector.numel() == 0:
        return
    low, high = torch.stack(torch.aminmax(edge_sector)).tolist()
    if low < 0 or high >= num_sectors:
        raise ValueError(
            f"'edge_sector' must hold sectors from 0 to {num_sectors - 1} (got {low} to {high})"
        )


def _is_product_faster(x: Tensor, table: _SectorTable) -> bool:
    r"""Returns whether :func:`_sector_product` is faster than messages. This is the case for many
    samples, for images, and if all neighbours may be copied at once.

    Shapes:
        - **x:** Node features :math:`(B, N, F)`.
    """
    return x.size(0) >= _MIN_SAMPLES or table.image is not None or _is_copy_small(x, table)


def _sector_product(x: Tensor, table: _SectorTable, weight: Tensor, bias: OptTensor) -> Tensor:
    r"""Returns the sum of the features of each taxel and its neighbours, each multiplied by the
    matrix of its sector.

    If the taxels are the pixels of an image, the sum is computed by an image convolution. If a copy
    of all neighbours is small, the sum is computed by a single product. Otherwise, neighbours are
    copied block by block, so that the copies stay in the cache. The backward pass then copies them
    again, and second derivatives are not supported.

    Shapes:
        - **input:** features :math:`(B, N, F)`, weights :math:`(1 + S, F, O)`, biases :math:`(O,)`
        - **output:** :math:`(B, N, O)`, or a view of :math:`(N, B, O)`
    """
    with torch.autocast(x.device.type, enabled=False):  # in full precision
        # The kernel of an image has zeros for missing sectors, and zero times infinity is NaN.
        # Therefore, images with infinite or missing readings are not convolved.
        if table.image is not None and all_finite(x):
            return table.image.product(x, weight, bias)
        if _is_copy_small(x, table):
            assert table.neighbors is not None
            # The appended row of zeros is used for missing neighbours.
            rows = F.pad(x, (0, 0, 0, 1)).index_select(1, table.neighbors)
            rows = rows.view(*x.shape[:2], weight.size(0) * x.size(2))
            return F.linear(rows, weight.flatten(0, 1).t(), bias)
    if bias is None:
        bias = weight.new_zeros(weight.size(-1))
    out: Tensor = _SectorProduct.apply(x.transpose(0, 1).contiguous(), weight, bias, table)
    return out.transpose(0, 1)


def _is_copy_small(x: Tensor, table: _SectorTable) -> bool:
    max_bytes = _NARROW_COPY_BYTES if x.size(2) <= _MAX_NARROW_CHANNELS else _COPY_BYTES
    return table.neighbors is not None and len(table.neighbors) * x[:, 0].nbytes <= max_bytes


class _SectorProduct(Function):
    # Activations are stored as (N, B, F). The features of a neighbour are then contiguous over all
    # samples, so that copying is fast, and the linear map of a sector is one product for many
    # taxels and samples. Computes in full precision even under autocast, which would cast only some
    # of the products.
    @staticmethod
    @custom_fwd(device_type="cpu", cast_inputs=torch.float32)
    def forward(ctx: Any, h: Tensor, weight: Tensor, bias: Tensor, table: _SectorTable) -> Tensor:
        num_nodes, num_samples, width = h.shape
        rows = h.view(num_nodes, -1)
        out = h.new_empty(num_nodes, num_samples * weight.size(-1))
        for start, stop, sector_blocks in table.blocks(_block_size(h, weight)):
            block = out[start:stop]
            inputs = rows[start:stop].view(-1, width)
            torch.addmm(bias, inputs, weight[0], out=block.view(len(inputs), -1))
            for sector, source, target in sector_blocks:
                neighbors = rows.index_select(0, source).view(-1, width)
                block.index_add_(0, target, (neighbors @ weight[1 + sector]).view(len(source), -1))
        ctx.save_for_backward(h, weight)
        ctx.table = table
        return out.view(num_nodes, num_samples, -1)

    @staticmethod
    @once_differentiable
    @custom_bwd(device_type="cpu")
    def backward(ctx: Any, grad: Tensor) -> tuple[OptTensor, ...]:  # type: ignore[override]
        h, weight = ctx.saved_tensors
        num_nodes, _, width = h.shape
        flat_grads = grad.contiguous().view(-1, weight.size(-1))
        rows, grads = h.view(num_nodes, -1), flat_grads.view(num_nodes, -1)
        grad_weight = torch.zeros_like(weight)
        torch.mm(h.view(-1, width).t(), flat_grads, out=grad_weight[0])
        grad_h = (flat_grads @ weight[0].t()).view_as(rows) if ctx.needs_input_grad[0] else None
        for start, stop, sector_blocks in ctx.table.blocks(_block_size(h, weight)):
            block = grads[start:stop]
            for sector, source, target in sector_blocks:
                neighbors = rows.index_select(0, source).view(-1, width)
                output_grads = block.index_select(0, target).view(len(neighbors), -1)
                grad_weight[1 + sector].addmm_(neighbors.t(), output_grads)
                if grad_h is not None:
                    input_grads = output_grads @ weight[1 + sector].t()
                    grad_h.index_add_(0, source, input_grads.view(len(source), -1))
        grad_h = None if grad_h is None else grad_h.view_as(h)
        return grad_h, grad_weight, flat_grads.sum(dim=0), None


def _block_size(h: Tensor, weight: Tensor) -> int:
    # Returns the number of taxels in a block.
    width = max(weight.shape[1:])
    return max(1, _BLOCK_BYTES // max(1, h.size(1) * width * h.element_size()))
