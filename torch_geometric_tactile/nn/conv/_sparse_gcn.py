r"""A graph convolution on one topology with many samples, made for training on processors."""

from typing import Any

import torch
from torch import Tensor
from torch.autograd import Function
from torch.nn.functional import linear
from torch_geometric.typing import OptTensor

from torch_geometric_tactile.nn.conv._static_adjacency import StaticAdjacency, sparse_product

# An activation of this size stays in a processor's second-level cache.
_BLOCK_BYTES = 2**20


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
    keeps the input alone for the backward pass. Narrow and small inputs are multiplied as a whole,
    which takes fewer operations.

    Shapes:
        - **x:** Features :math:`(\ldots, N, F)`, for which
          :func:`~torch_geometric_tactile.nn.conv._static_adjacency.may_multiply`.
        - **weight, root:** :math:`(O, F)`
        - **bias:** :math:`(O,)`
        - **output:** :math:`(\ldots, N, O)`, contiguous
    """
    wide, width = weight.shape
    num_bytes = x.numel() // width * max(width, wide) * x.element_size()
    is_constant = torch.is_grad_enabled() and not x.requires_grad and width <= wide
    if num_bytes <= _BLOCK_BYTES or 2 * width < wide or is_constant:
        # All is in the cache, or the gradient is cheaper on the narrow side, or the sums have none.
        near = adjacency.product(x)
        if root is None:
            return linear(near, weight, bias)
        return linear(torch.cat([x, near], dim=-1), torch.cat([root, weight], dim=1), bias)
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
        matrix, transposed, wide = adjacency.csr(), weight.t(), weight.size(0)
        out = x.new_empty(*x.shape[:-1], wide)
        is_narrow = x.size(-1) <= wide
        for h, part in zip(*_blocks(x, out), strict=True):
            rows = part.view(-1, wide)
            if not is_narrow:  # the sums are cheaper behind the linear map
                h = (h.flatten(0, 1) @ transposed).view(part.shape)
            h = _propagate(matrix, h)
            if not is_narrow:
                rows.copy_(h) if bias is None else torch.add(h, bias, out=rows)
            elif bias is None:
                torch.mm(h, transposed, out=rows)
            else:
                torch.addmm(bias, h, transposed, out=rows)
        if root is not None:
            out.view(-1, wide).addmm_(x.reshape(-1, x.size(-1)), root.t())
        ctx.save_for_backward(x, weight, root)
        ctx.save_for_forward(x, weight, root)
        ctx.adjacency = adjacency
        return out

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> tuple[OptTensor, ...]:
        x, weight, root = ctx.saved_tensors
        if torch.is_grad_enabled():
            return _differentiable_gradients(grad, x, weight, root, ctx.adjacency)
        needs_x, needs_weight, needs_bias, needs_root, _ = ctx.needs_input_grad
        matrix = ctx.adjacency.csr(transposed=True)
        grad = grad.contiguous()
        grad_x = torch.empty_like(x, memory_format=torch.contiguous_format)
        grad_weight = torch.zeros_like(weight)
        if needs_x or needs_weight:
            for g, h, part in zip(*_blocks(grad, x, grad_x), strict=True):
                back = _propagate(matrix, g)
                if needs_weight:
                    grad_weight.addmm_(back.t(), h.reshape(-1, h.size(-1)))
                if needs_x:
                    torch.mm(back, weight, out=part.view(-1, part.size(-1)))
        grad_rows, rows = grad.view(-1, grad.size(-1)), x.reshape(-1, x.size(-1))
        if root is not None and needs_x:
            grad_x.view(-1, x.size(-1)).addmm_(grad_rows, root)
        return (
            grad_x if needs_x else None,
            grad_weight if needs_weight else None,
            grad_rows.sum(dim=0) if needs_bias else None,
            grad_rows.t() @ rows if needs_root else None,
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


def _propagate(matrix: Tensor, h: Tensor) -> Tensor:
    # Features (B, N, F) to sums (B * N, F): with the taxels outermost, one entry of the matrix
    # serves all samples.
    num_samples, num_nodes, width = h.shape
    if num_samples == 1:
        return sparse_product(matrix, h[0])
    out = sparse_product(matrix, h.transpose(0, 1).reshape(num_nodes, -1))
    return out.view(num_nodes, num_samples, width).transpose(0, 1).reshape(-1, width)


def _blocks(*tensors: Tensor) -> list[tuple[Tensor, ...]]:
    # Parts of tensors (..., N, F), with so many samples (B, N, F) that they stay in the cache.
    parts = [t if t.dim() == 3 else t.flatten(0, -3) for t in tensors]
    width = max([t.size(2) for t in parts])
    num_bytes = parts[0].size(1) * width * parts[0].element_size()
    size = max(1, _BLOCK_BYTES * torch.get_num_threads() // num_bytes)
    return [t.split(size) for t in parts]
