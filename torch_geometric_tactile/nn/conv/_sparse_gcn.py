r"""A graph convolution for many samples on one topology, for training on CPUs."""

from typing import Any

import torch
from torch import Tensor
from torch.autograd import Function
from torch.nn.functional import linear, pad
from torch_geometric.typing import OptTensor

from torch_geometric_tactile.nn.conv._static_adjacency import StaticAdjacency, sparse_product

# An activation of this size fits in a CPU's second-level cache.
_BLOCK_BYTES = 2**20
# Matrix products are fastest if their last dimension is a multiple of this number.
_LANES = 16
# Up to this number of rows, padding or reordering costs more time than it saves.
_MAX_DIRECT_ROWS = 1024


def sparse_gcn(
    x: Tensor,
    adjacency: StaticAdjacency,
    weight: Tensor,
    bias: OptTensor = None,
    root: OptTensor = None,
) -> Tensor:
    r"""Computes a graph convolution with its linear map, and optionally with another linear map for
    the taxel itself.

    .. math::
        \mathbf{X}' = \hat{\mathbf{A}} \mathbf{X} \mathbf{W}^{\top} + \mathbf{X}
        \mathbf{W}_{\mathrm{root}}^{\top} + \mathbf{b}

    Large inputs are processed in blocks of samples, so that the propagated features stay in the
    cache. Only the input is then saved for the backward pass. Small inputs, narrow inputs and
    inputs that need no gradient are propagated at once, and the propagated features are saved.

    Shapes:
        - **x:** Features :math:`(\ldots, N, F)` that
          :func:`~torch_geometric_tactile.nn.conv._static_adjacency.may_multiply` accepts.
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
        out_width, width = weight.shape
        num_rows = x.numel() // width
        is_small = num_rows * max(width, out_width) * x.element_size() <= _BLOCK_BYTES
        is_unblocked = width <= out_width and (
            is_small or 2 * width < out_width or not ctx.needs_input_grad[0]
        )
        sums = None
        # Not a view, since autograd restricts in-place writes to views returned by a custom
        # function.
        out = x.new_empty(*x.shape[:-1], out_width)
        rows = out.view(num_rows, out_width)
        if is_unblocked:
            sums = _propagate_unblocked(adjacency, x, transposed=False)
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
                mapped_grad = _narrow_product(rows, weight).view(x.shape)
                # The linear map comes before the propagation, since the input is not wider than the
                # output.
                grad_x = _propagate_unblocked(ctx.adjacency, mapped_grad, transposed=True).view(
                    x.shape
                )
        elif needs_x or needs_weight:
            grad_x = torch.empty_like(x, memory_format=torch.contiguous_format)
            grad_weight = torch.zeros_like(weight)
            matrix = ctx.adjacency.csr(transposed=True)
            for grad_block, x_block, grad_x_block in zip(*_blocks(grad, x, grad_x), strict=True):
                propagated_grad = _propagate(matrix, grad_block)
                if needs_weight:
                    grad_weight.addmm_(propagated_grad.t(), x_block.reshape(-1, x_block.size(-1)))
                if needs_x:
                    torch.mm(
                        propagated_grad, weight, out=grad_x_block.view(-1, grad_x_block.size(-1))
                    )
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
        ctx: Any,
        x_tangent: OptTensor,
        weight_tangent: OptTensor,
        bias_tangent: OptTensor,
        root_tangent: OptTensor,
        _: None,
    ) -> Tensor:
        x, weight, root = ctx.saved_tensors
        out = x.new_zeros(*x.shape[:-1], weight.size(0))
        if x_tangent is not None:
            out = out + linear(ctx.adjacency.product(x_tangent), weight)
            out = out if root is None else out + linear(x_tangent, root)
        if weight_tangent is not None:
            out = out + linear(ctx.adjacency.product(x), weight_tangent)
        if root_tangent is not None:
            out = out + linear(x, root_tangent)
        return out if bias_tangent is None else out + bias_tangent


def _differentiable_gradients(
    grad: Tensor, x: Tensor, weight: Tensor, root: OptTensor, adjacency: StaticAdjacency
) -> tuple[OptTensor, ...]:
    propagated_grad = adjacency.product(grad, transposed=True)
    grad_x, rows = propagated_grad @ weight, x.reshape(-1, x.size(-1))
    grad_rows = grad.reshape(-1, grad.size(-1))
    grad_root = None
    if root is not None:
        grad_x, grad_root = grad_x + grad @ root, grad_rows.t() @ rows
    grad_weight = propagated_grad.reshape(-1, propagated_grad.size(-1)).t() @ rows
    return grad_x, grad_weight, grad_rows.sum(dim=0), grad_root, None


def _sum_of_products(rows: Tensor, h: Tensor) -> Tensor:
    # A product takes several times as long if its last dimension is small and not a multiple of 16.
    is_narrow = h.size(1) < rows.size(1) and h.size(1) % _LANES != 0
    return (h.t() @ rows).t() if is_narrow else rows.t() @ h


def _narrow_product(rows: Tensor, weight: Tensor) -> Tensor:
    # Pads a narrow last dimension to a multiple of _LANES for many rows.
    width = weight.size(1)
    if width % _LANES == 0 or len(rows) <= _MAX_DIRECT_ROWS:
        return rows @ weight
    return (rows @ pad(weight, (0, -width % _LANES)))[:, :width]


def _map(x: Tensor, weight: Tensor, bias: OptTensor, out: Tensor) -> None:
    if bias is None:
        torch.mm(x, weight.t(), out=out)
    else:
        torch.addmm(bias, x, weight.t(), out=out)


def _map_in_blocks(x: Tensor, weight: Tensor, bias: OptTensor, matrix: Tensor, out: Tensor) -> None:
    out_width, width = weight.shape
    for h, out_block in zip(*_blocks(x, out), strict=True):
        rows = out_block.view(-1, out_width)
        if width > out_width:  # propagation is cheaper after the linear map
            h = _propagate(matrix, (h.flatten(0, 1) @ weight.t()).view(out_block.shape))
            rows.copy_(h) if bias is None else torch.add(h, bias, out=rows)
        else:
            _map(_propagate(matrix, h), weight, bias, rows)


def _propagate_unblocked(adjacency: StaticAdjacency, x: Tensor, transposed: bool) -> Tensor:
    # Returns the sums (B * N, F) of features (..., N, F).
    num_nodes, width = x.shape[-2:]
    num_rows = x.numel() // width
    num_bytes = num_rows * width * x.element_size()
    if num_rows <= _MAX_DIRECT_ROWS or (width >= _LANES and num_bytes <= _BLOCK_BYTES):
        # Everything is in the cache, so reordering the memory would take longer than the product.
        matrix = adjacency.batch_csr(num_rows // num_nodes, transposed)
        return sparse_product(matrix, x.reshape(num_rows, width))
    return _propagate(adjacency.csr(transposed), _as_samples(x))


def _propagate(matrix: Tensor, h: Tensor) -> Tensor:
    # Returns the sums (B * N, F) of features (B, N, F). With the taxels in the first dimension, one
    # entry of the matrix multiplies all samples.
    num_samples, num_nodes, width = h.shape
    if num_samples == 1:
        return sparse_product(matrix, h[0])
    out = sparse_product(matrix, h.transpose(0, 1).reshape(num_nodes, -1))
    return out.view(num_nodes, num_samples, width).transpose(0, 1).reshape(-1, width)


def _as_samples(x: Tensor) -> Tensor:
    # Reshapes features (..., N, F) to (B, N, F).
    return x if x.dim() == 3 else x.flatten(0, -3)


def _blocks(*tensors: Tensor) -> list[tuple[Tensor, ...]]:
    # Splits each tensor (..., N, F) into blocks of samples (b, N, F) that fit in the cache.
    batches = [_as_samples(tensor) for tensor in tensors]
    width = max([batch.size(2) for batch in batches])
    num_bytes = batches[0].size(1) * width * batches[0].element_size()
    size = max(1, _BLOCK_BYTES * torch.get_num_threads() // num_bytes)
    return [batch.split(size) for batch in batches]
