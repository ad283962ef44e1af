r"""A graph convolution on one topology with many samples, made for training on processors."""

from typing import Any

import torch
from torch import Tensor
from torch.autograd import Function
from torch.nn.functional import linear, pad
from torch_geometric.typing import OptTensor

from torch_geometric_tactile.nn.conv._static_adjacency import StaticAdjacency, sparse_product

# An activation of this size stays in a processor's second-level cache.
_BLOCK_BYTES = 2**20
# Products of matrices are fastest where their last size is a multiple of it.
_LANES = 16
# So few narrow rows are multiplied as they lie: to prepare them takes longer.
_FEW_ROWS = 1024


def sparse_gcn(
    x: Tensor,
    adjacency: StaticAdjacency,
    weight: Tensor,
    bias: OptTensor = None,
    root: OptTensor = None,
) -> Tensor:
    r"""A graph convolution with its linear map, and optionally another map of the taxel itself.

    .. math::
        \mathbf{X}' = \hat{\mathbf{A}} \mathbf{X} \mathbf{W}^{\top} + \mathbf{X}
        \mathbf{W}_{\mathrm{root}}^{\top} + \mathbf{b}

    It takes a block of samples at a time, whose propagated features never leave the cache, and
    keeps the input alone for the backward pass. Narrow and small inputs, and those without a
    gradient, are propagated as a whole, and their sums are kept.

    Shapes:
        - **x:** Features :math:`(\ldots, N, F)`, for which
          :func:`~torch_geometric_tactile.nn.conv._static_adjacency.may_multiply`.
        - **weight, root:** :math:`(O, F)`
        - **bias:** :math:`(O,)`
        - **output:** :math:`(\ldots, N, O)`, contiguous
    """
    out: Tensor = _SparseGCN.apply(x, weight, bias, root, adjacency)
    return out


class _SparseGCN(Function):
    @staticmethod
    def forward(
        ctx: Any,
        x: Tensor,
        weight: Tensor,
        bias: OptTensor,
        root: OptTensor,
        adjacency: StaticAdjacency,
    ) -> Tensor:
        wide, width = weight.shape
        num_rows = x.numel() // width
        is_small = num_rows * max(width, wide) * x.element_size() <= _BLOCK_BYTES
        is_whole = width <= wide and (is_small or 2 * width < wide or not ctx.needs_input_grad[0])
        sums = None
        out = x.new_empty(*x.shape[:-1], wide)  # not a view, so that it may be written to in place
        rows = out.view(num_rows, wide)
        if is_whole:
            sums = _propagate_whole(adjacency, x, transposed=False)
            _map(sums, weight, bias, rows)
        else:
            _map_in_blocks(x, weight, bias, adjacency.csr(), out)
        if root is not None:
            rows.addmm_(x.reshape(num_rows, width), root.t())
        ctx.save_for_backward(x, weight, root, sums)
        ctx.save_for_forward(x, weight, root)
        ctx.adjacency = adjacency
        return out

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> tuple[OptTensor, ...]:
        x, weight, root, sums = ctx.saved_tensors
        if torch.is_grad_enabled():
            return _differentiable_gradients(grad, x, weight, root, ctx.adjacency)
        needs_x, needs_weight, needs_bias, needs_root, _ = ctx.needs_input_grad
        grad = grad.contiguous()
        rows = grad.view(-1, grad.size(-1))
        grad_x = grad_weight = None
        if sums is not None:
            if needs_weight:
                grad_weight = _sum_of_products(rows, sums)
            if needs_x:
                back = _narrow_product(rows, weight).view(x.shape)
                grad_x = _propagate_whole(ctx.adjacency, back, transposed=True).view(x.shape)
        elif needs_x or needs_weight:
            grad_x = torch.empty_like(x, memory_format=torch.contiguous_format)
            grad_weight = torch.zeros_like(weight)
            matrix = ctx.adjacency.csr(transposed=True)
            for g, h, part in zip(*_blocks(grad, x, grad_x), strict=True):
                back = _propagate(matrix, g)
                if needs_weight:
                    grad_weight.addmm_(back.t(), h.reshape(-1, h.size(-1)))
                if needs_x:
                    torch.mm(back, weight, out=part.view(-1, part.size(-1)))
        if root is not None and needs_x:
            assert grad_x is not None
            grad_x.view(-1, x.size(-1)).addmm_(rows, root)
        return (
            grad_x if needs_x else None,
            grad_weight if needs_weight else None,
            rows.sum(dim=0) if needs_bias else None,
            _sum_of_products(rows, x.reshape(-1, x.size(-1))) if needs_root else None,
            None,
        )

    @staticmethod
    def jvp(
        ctx: Any, x_t: OptTensor, weight_t: OptTensor, bias_t: OptTensor, root_t: OptTensor, _: None
    ) -> Tensor:
        x, weight, root = ctx.saved_tensors
        out = x.new_zeros(*x.shape[:-1], weight.size(0))
        if x_t is not None:
            out = out + linear(ctx.adjacency.product(x_t), weight)
            out = out if root is None else out + linear(x_t, root)
        if weight_t is not None:
            out = out + linear(ctx.adjacency.product(x), weight_t)
        if root_t is not None:
            out = out + linear(x, root_t)
        return out if bias_t is None else out + bias_t


def _differentiable_gradients(
    grad: Tensor, x: Tensor, weight: Tensor, root: OptTensor, adjacency: StaticAdjacency
) -> tuple[OptTensor, ...]:
    back = adjacency.product(grad, transposed=True)
    grad_x, rows = back @ weight, x.reshape(-1, x.size(-1))
    grad_rows = grad.reshape(-1, grad.size(-1))
    grad_root = None
    if root is not None:
        grad_x, grad_root = grad_x + grad @ root, grad_rows.t() @ rows
    grad_weight = back.reshape(-1, back.size(-1)).t() @ rows
    return grad_x, grad_weight, grad_rows.sum(dim=0), grad_root, None


def _sum_of_products(rows: Tensor, h: Tensor) -> Tensor:
    # A product takes several times as long where its last size is small and no multiple of 16.
    is_narrow = h.size(1) < rows.size(1) and h.size(1) % _LANES != 0
    return (h.t() @ rows).t() if is_narrow else rows.t() @ h


def _narrow_product(rows: Tensor, weight: Tensor) -> Tensor:
    width = weight.size(1)
    if width % _LANES == 0 or len(rows) <= _FEW_ROWS:
        return rows @ weight
    return (rows @ pad(weight, (0, -width % _LANES)))[:, :width]


def _map(x: Tensor, weight: Tensor, bias: OptTensor, out: Tensor) -> None:
    if bias is None:
        torch.mm(x, weight.t(), out=out)
    else:
        torch.addmm(bias, x, weight.t(), out=out)


def _map_in_blocks(x: Tensor, weight: Tensor, bias: OptTensor, matrix: Tensor, out: Tensor) -> None:
    wide, width = weight.shape
    for h, part in zip(*_blocks(x, out), strict=True):
        rows = part.view(-1, wide)
        if width > wide:  # the sums are cheaper behind the linear map
            h = _propagate(matrix, (h.flatten(0, 1) @ weight.t()).view(part.shape))
            rows.copy_(h) if bias is None else torch.add(h, bias, out=rows)
        else:
            _map(_propagate(matrix, h), weight, bias, rows)


def _propagate_whole(adjacency: StaticAdjacency, x: Tensor, transposed: bool) -> Tensor:
    # All features (..., N, F) to sums (B * N, F).
    num_nodes, width = x.shape[-2:]
    num_rows = x.numel() // width
    num_bytes = num_rows * width * x.element_size()
    if num_rows <= _FEW_ROWS or (width >= _LANES and num_bytes <= _BLOCK_BYTES):
        # All is in the cache, and to change the order of the memory takes longer than the product.
        matrix = adjacency.batch_csr(num_rows // num_nodes, transposed)
        return sparse_product(matrix, x.reshape(num_rows, width))
    return _propagate(adjacency.csr(transposed), _samples(x))


def _propagate(matrix: Tensor, h: Tensor) -> Tensor:
    # Features (B, N, F) to sums (B * N, F): with the taxels outermost, one entry of the matrix
    # serves all samples.
    num_samples, num_nodes, width = h.shape
    if num_samples == 1:
        return sparse_product(matrix, h[0])
    out = sparse_product(matrix, h.transpose(0, 1).reshape(num_nodes, -1))
    return out.view(num_nodes, num_samples, width).transpose(0, 1).reshape(-1, width)


def _samples(x: Tensor) -> Tensor:
    # Features (..., N, F) as (B, N, F).
    return x if x.dim() == 3 else x.flatten(0, -3)


def _blocks(*tensors: Tensor) -> list[tuple[Tensor, ...]]:
    # Parts of tensors (..., N, F), with so many samples (B, N, F) that they stay in the cache.
    parts = [_samples(t) for t in tensors]
    width = max([t.size(2) for t in parts])
    num_bytes = parts[0].size(1) * width * parts[0].element_size()
    size = max(1, _BLOCK_BYTES * torch.get_num_threads() // num_bytes)
    return [t.split(size) for t in parts]
