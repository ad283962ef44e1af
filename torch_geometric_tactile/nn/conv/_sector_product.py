r"""The sum over sectors on one topology with many samples, made for training on processors.

Activations lie as :math:`(N, B, F)`, taxel by taxel. The rows of all samples of a neighbour are
then contiguous: they are copied as they are, and the linear map of a sector is one product for many
taxels and samples.
"""

from typing import Any, NamedTuple, Optional

import torch
import torch.nn.functional as F
from torch import Tensor
from torch.amp import custom_bwd, custom_fwd
from torch.autograd import Function
from torch.autograd.function import once_differentiable
from torch_geometric.typing import OptTensor

from torch_geometric_tactile.nn.conv._edge_cache import EdgeCache, may_be_kept
from torch_geometric_tactile.nn.conv._edge_checks import TensorCheck, check_edge_index, is_traced
from torch_geometric_tactile.nn.conv._static_adjacency import all_finite

# What is copied of the neighbours at a time stays in a processor's second-level cache.
_BLOCK_BYTES = 2**19
# Up to this size, all neighbours are copied at once: fewer and larger products. Readings of a few
# channels make products so small that it pays far longer.
_COPY_BYTES = 2**22
_COPY_BYTES_OF_FEW = 2**25
_FEW_CHANNELS = 4
# From this number of samples on, the layout of this module pays.
_MIN_SAMPLES = 8
# Several batch sizes and widths.
_MAX_SIZES = 16


class SectorImage(NamedTuple):
    r"""Nodes that are the pixels of an image, row by row, and sectors that are its directions: a
    convolution over sectors is then one of images, which PyTorch has been made fast for.
    """

    rows: int
    cols: int
    sectors: tuple[int, ...]
    places: tuple[int, ...]

    @classmethod
    def of(
        cls, source: Tensor, target: Tensor, sector: Tensor, num_nodes: int
    ) -> Optional["SectorImage"]:
        r"""Returns the image that nodes are, or :obj:`None` if they are none: if an edge runs to no
        direct neighbour, one is missing, or a sector holds two directions.
        """
        steps, sectors = {}, sector.unique().tolist()
        for number in sectors:
            step = (source - target)[sector == number]
            steps[number] = int(step[0])
            if bool((step != step[0]).any()):
                return None
        if not steps:
            return None
        widths = {abs(step) + near for step in steps.values() for near in (-1, 0, 1)}
        for cols in sorted({*widths, num_nodes}):  # a single row tells nothing of its length
            if cols > 2 and num_nodes % cols == 0:
                found = cls._of_width(steps, target, sector, num_nodes // cols, cols)
                if found is not None:
                    return found
        return None

    @classmethod
    def _of_width(
        cls, steps: dict[int, int], target: Tensor, sector: Tensor, rows: int, cols: int
    ) -> Optional["SectorImage"]:
        places = []
        for number, step in steps.items():
            down = round(step / cols)
            right = step - down * cols
            if abs(down) > 1 or abs(right) > 1:
                return None
            at = target[sector == number]
            col = at % cols + right
            inside = (col >= 0) & (col < cols)  # and then so is the row
            whole = (rows - abs(down)) * (cols - abs(right))
            if not bool(inside.all()) or len(at) != whole or len(at.unique()) != whole:
                return None
            places.append(3 * (down + 1) + right + 1)
        return cls(rows, cols, tuple(steps), tuple(places))

    def product(self, x: Tensor, weight: Tensor, bias: OptTensor) -> Tensor:
        r"""Maps each node by the first matrix and each of its neighbours by that of its sector, and
        adds up.

        Shapes:
            - **x:** Node features :math:`(B, N, F)`.
            - **weight:** The matrices :math:`(1 + S, F, O)`, of the node itself first.
            - **bias:** The biases :math:`(O,)`.
        """
        kernel = weight.new_zeros(9, *weight.shape[1:])
        used = torch.tensor([0, *(1 + sector for sector in self.sectors)])
        kernel = kernel.index_add(0, torch.tensor([4, *self.places]), weight[used])
        kernel = kernel.view(3, 3, *weight.shape[1:]).permute(3, 2, 0, 1)
        # Channels last: pixel by pixel, as nodes lie, so that nothing is copied.
        image = x.contiguous().view(len(x), self.rows, self.cols, -1).permute(0, 3, 1, 2)
        out = F.conv2d(image, kernel, bias, padding=1)
        return out.permute(0, 2, 3, 1).reshape(len(x), self.rows * self.cols, -1)


class SectorBlock(NamedTuple):
    r"""The edges of some taxels that lie in one sector."""

    sector: int
    source: Tensor
    target: Tensor


class SectorTable:
    r"""The edges of one topology, some taxels at a time and sector by sector.

    Shapes:
        - **edge_index:** Edges :math:`(2, |\mathcal{E}|)`.
        - **edge_sector:** Their sectors :math:`(|\mathcal{E}|,)`.
        - **num_nodes:** Number of taxels :math:`N`.
    """

    def __init__(
        self, edge_index: Tensor, edge_sector: Tensor, num_nodes: int, num_sectors: int
    ) -> None:
        order = (edge_index[1].long() * num_sectors + edge_sector.long()).argsort(stable=True)
        self.source, self.target = edge_index.long()[:, order]
        self.sector = edge_sector.long()[order]
        self.num_nodes = num_nodes
        self.image = SectorImage.of(self.source, self.target, self.sector, num_nodes)
        self.near = self._near(num_sectors)
        self._blocks: dict[int, list[tuple[int, int, list[SectorBlock]]]] = {}

    def blocks(self, size: int) -> list[tuple[int, int, list[SectorBlock]]]:
        r"""Returns the first taxel of each block, the one behind its last, and its edges, computed
        once.
        """
        blocks = self._blocks.get(size)
        if blocks is None:
            if len(self._blocks) >= _MAX_SIZES:
                self._blocks = {}  # not cleared in place: another thread may be reading it
            with torch.inference_mode(False):
                starts = range(0, self.num_nodes, size)
                blocks = [self._block(start, min(start + size, self.num_nodes)) for start in starts]
            self._blocks[size] = blocks
        return blocks

    def _near(self, num_sectors: int) -> Optional[Tensor]:
        # Each taxel and its neighbours by sector, the number of taxels for none; None if there are
        # several in one.
        place = self.target * (1 + num_sectors) + 1 + self.sector
        if len(place.unique()) < len(place):
            return None
        near = torch.full((self.num_nodes, 1 + num_sectors), self.num_nodes)
        near[:, 0] = torch.arange(self.num_nodes)
        near.view(-1)[place] = self.source
        return near.view(-1)

    def _block(self, start: int, stop: int) -> tuple[int, int, list[SectorBlock]]:
        first, last = torch.searchsorted(self.target, torch.tensor([start, stop])).tolist()
        sector = self.sector[first:last]
        parts = []
        for number in sector.unique().tolist():
            edges = first + (sector == number).nonzero().view(-1)
            parts.append(SectorBlock(number, self.source[edges], self.target[edges] - start))
        return start, stop, parts


class SectorCache(EdgeCache[SectorTable]):
    r"""Keeps the table of the last topology."""

    def __init__(self) -> None:
        super().__init__()
        self.check = SectorCheck()

    def get(
        self, edge_index: Tensor, edge_sector: Tensor, num_nodes: int, num_sectors: int
    ) -> Optional[SectorTable]:
        r"""Returns the table of a topology, or :obj:`None` where it must not be kept.

        Shapes:
            - **edge_index:** Edges :math:`(2, |\mathcal{E}|)`.
            - **edge_sector:** Their sectors :math:`(|\mathcal{E}|,)`.
            - **num_nodes:** Number of taxels :math:`N`.
        """
        key, tensors = (num_nodes,), (edge_index, edge_sector)
        found = self._found(key, tensors)
        if found is not None:
            return found
        check_edge_index(edge_index, num_nodes)
        self.check(edge_index, edge_sector, num_sectors)
        if not may_be_kept(edge_index, edge_sector):
            return None

        def table() -> SectorTable:
            return SectorTable(edge_index, edge_sector, num_nodes, num_sectors)

        return self._keep(key, tensors, table)


class SectorCheck(TensorCheck):
    r"""Checks the sectors of edges: their number and type at each call, and their values, on a GPU
    once and again only if they change.
    """

    def __call__(self, edge_index: Tensor, edge_sector: Tensor, num_sectors: int) -> None:
        r"""Checks sectors.

        Shapes:
            - **edge_index:** Edges :math:`(2, |\mathcal{E}|)`.
            - **edge_sector:** Their sectors :math:`(|\mathcal{E}|,)`.
        """
        num_edges = edge_index.size(1)
        kind = edge_sector.dtype
        if edge_sector.dim() != 1 or edge_sector.size(0) != num_edges:
            raise ValueError(
                f"'edge_sector' must have shape ({num_edges},), a sector for each edge "
                f"(got {tuple(edge_sector.shape)})"
            )
        if kind.is_floating_point or kind.is_complex or kind == torch.bool:
            raise ValueError(f"'edge_sector' must hold integers (got {kind})")
        if edge_sector.is_cpu:  # at each call: a NumPy array may share the memory
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


def pays(x: Tensor, table: SectorTable) -> bool:
    r"""Tells whether :func:`sector_product` pays for features: those of many samples, and those of
    which all neighbours may be copied at once.

    Shapes:
        - **x:** Node features :math:`(B, N, F)`.
    """
    return x.size(0) >= _MIN_SAMPLES or table.image is not None or _is_small(x, table)


def sector_product(x: Tensor, table: SectorTable, weight: Tensor, bias: OptTensor) -> Tensor:
    r"""Maps each taxel by the first matrix and each of its neighbours by that of its sector, and
    adds up.

    Where the taxels are the pixels of an image, it is a convolution of images; where the copies of
    all neighbours are small, it is a single product. Elsewhere, it works block by block of edges,
    so that the copies are never written to memory; the backward pass makes them again, and there is
    no second derivative.

    Shapes:
        - **input:** features :math:`(B, N, F)`, weights :math:`(1 + S, F, O)`, biases :math:`(O,)`
        - **output:** :math:`(B, N, O)`, or a view of :math:`(N, B, O)`
    """
    with torch.autocast(x.device.type, enabled=False):  # in full precision
        # A kernel of an image has a weight for each of its nine places, and zero times infinity is
        # NaN; of the neighbours that there are, infinite readings go no further.
        if table.image is not None and all_finite(x):
            return table.image.product(x, weight, bias)
        if _is_small(x, table):
            assert table.near is not None
            rows = F.pad(x, (0, 0, 0, 1)).index_select(1, table.near)
            rows = rows.view(*x.shape[:2], weight.size(0) * x.size(2))
            return F.linear(rows, weight.flatten(0, 1).t(), bias)
    if bias is None:
        bias = weight.new_zeros(weight.size(-1))
    out: Tensor = _SectorProduct.apply(x.transpose(0, 1).contiguous(), weight, bias, table)
    return out.transpose(0, 1)


def _is_small(x: Tensor, table: SectorTable) -> bool:
    most = _COPY_BYTES_OF_FEW if x.size(2) <= _FEW_CHANNELS else _COPY_BYTES
    return table.near is not None and len(table.near) * x[:, 0].nbytes <= most


class _SectorProduct(Function):
    # In full precision under autocast as well, which would cast some of the products.
    @staticmethod
    @custom_fwd(device_type="cpu", cast_inputs=torch.float32)
    def forward(ctx: Any, h: Tensor, weight: Tensor, bias: Tensor, table: SectorTable) -> Tensor:
        num_nodes, num_samples, width = h.shape
        rows = h.view(num_nodes, -1)
        out = h.new_empty(num_nodes, num_samples * weight.size(-1))
        for start, stop, parts in table.blocks(_block_size(h, weight)):
            block = out[start:stop]
            flat = rows[start:stop].view(-1, width)
            torch.addmm(bias, flat, weight[0], out=block.view(len(flat), -1))
            for sector, source, target in parts:
                near = rows.index_select(0, source).view(-1, width)
                block.index_add_(0, target, (near @ weight[1 + sector]).view(len(source), -1))
        ctx.save_for_backward(h, weight)
        ctx.table = table
        return out.view(num_nodes, num_samples, -1)

    @staticmethod
    @once_differentiable
    @custom_bwd(device_type="cpu")
    def backward(ctx: Any, grad: Tensor) -> tuple[OptTensor, ...]:  # type: ignore[override]
        h, weight = ctx.saved_tensors
        num_nodes, _, width = h.shape
        flat = grad.contiguous().view(-1, weight.size(-1))
        rows, grads = h.view(num_nodes, -1), flat.view(num_nodes, -1)
        grad_weight = torch.zeros_like(weight)
        torch.mm(h.view(-1, width).t(), flat, out=grad_weight[0])
        grad_h = (flat @ weight[0].t()).view_as(rows) if ctx.needs_input_grad[0] else None
        for start, stop, parts in ctx.table.blocks(_block_size(h, weight)):
            block = grads[start:stop]
            for sector, source, target in parts:
                near = rows.index_select(0, source).view(-1, width)
                part = block.index_select(0, target).view(len(near), -1)
                grad_weight[1 + sector].addmm_(near.t(), part)
                if grad_h is not None:
                    back = part @ weight[1 + sector].t()
                    grad_h.index_add_(0, source, back.view(len(source), -1))
        grad_h = None if grad_h is None else grad_h.view_as(h)
        return grad_h, grad_weight, flat.sum(dim=0), None


def _block_size(h: Tensor, weight: Tensor) -> int:
    # How many taxels at a time.
    width = max(weight.shape[1:])
    return max(1, _BLOCK_BYTES // max(1, h.size(1) * width * h.element_size()))
