r"""A graph convolution with pooling for many samples on one topology, for training on CPUs.

Activations are stored as :math:`(N, F, B)`. With this layout, one sparse product with the
:math:`(N, F \cdot B)` matrix propagates the whole batch, the linear map is a batched product over
the taxels, and the maximum over channels reads contiguous memory.
"""

from collections.abc import Iterable
from typing import Any

import torch
from torch import Tensor
from torch.amp import custom_bwd, custom_fwd
from torch.autograd import Function
from torch.autograd.function import once_differentiable
from torch_geometric.typing import OptTensor

from torch_geometric_tactile.nn.conv._plain import is_hooked, is_static_batch
from torch_geometric_tactile.nn.conv._static_adjacency import StaticAdjacency, sparse_product
from torch_geometric_tactile.nn.pool import ChannelMaxPool

# The widest activation of a block has this size, so that it fits in a CPU's second-level cache.
_BLOCK_BYTES = 2**20
# Positive, but smaller than the difference between any two distinct activations.
_TINY = 1e-37
# Smallest batch for which the memory layout of this module is faster.
_MIN_SAMPLES = 8


def is_pooled_gcn_faster(x: Tensor) -> bool:
    r"""Returns whether :func:`pooled_gcn` supports these features and is faster than separate
    layers. This is the case for many samples on a CPU.
    """
    return is_static_batch(x) and x.size(0) >= _MIN_SAMPLES


def may_merge(layers: Iterable[tuple[Any, ChannelMaxPool]]) -> bool:
    r"""Returns whether :func:`pooled_thread` may compute the layers without calling them.

    Each layer must be the unmodified class from this package with its default arguments. It must
    have no hooks, no explainer, and no wrapped, pruned or reparametrised weights.
    """
    return all(
        conv.is_plain() and type(pool) is ChannelMaxPool and not is_hooked(pool)
        for conv, pool in layers
    )


def pooled_thread(
    x: Tensor,
    layers: Iterable[tuple[Any, ChannelMaxPool]],
    adjacency: StaticAdjacency,
    segment: OptTensor = None,
) -> Tensor:
    r"""Returns the output :math:`(B, N, O)` of a sequence of layers, each computed by
    :func:`pooled_gcn`.
    """
    h = x.permute(1, 2, 0).contiguous()
    for conv, pool in layers:
        weight = conv.lin.weight if segment is None else conv.weight
        h = pooled_gcn(h, adjacency, weight, conv.bias, pool.kernel_size, segment)
    return h.permute(2, 0, 1)


def pooled_gcn(
    h: Tensor,
    adjacency: StaticAdjacency,
    weight: Tensor,
    bias: OptTensor = None,
    pool: int = 1,
    segment: OptTensor = None,
) -> Tensor:
    r"""Computes a graph convolution, the maximum over neighbouring channels, and ReLU in one step.

    .. math::
        \mathbf{H}' = \max \left( 0, \mathrm{pool}_k \left( \hat{\mathbf{A}} \mathbf{H} \mathbf{W}
        + \mathbf{b} \right) \right)

    Taxels are processed in blocks, so that the wide activation before the maximum stays in the
    cache. The backward pass recomputes this activation from the sums over the neighbours, which is
    faster than reading it from memory. The gradient is passed to the channel with the maximum, or
    to all channels that are exactly equal to the maximum. Second derivatives are not supported.

    Shapes:
        - **input:** features :math:`(N, F, B)`, weights :math:`(O, F)` or :math:`(S, O, F)`, biases
          :math:`(O,)` or :math:`(S, O)`, segments :math:`(N,)`
        - **output:** features :math:`(N, O / k, B)`
    """
    if bias is None:
        bias = weight.new_zeros(weight.shape[:-1])
    out: Tensor = _PooledGCN.apply(h, weight, bias, pool, adjacency, segment)
    return out


class _PooledGCN(Function):
    # Computes in full precision even under autocast, which would cast only some of the products.
    @staticmethod
    @custom_fwd(device_type="cpu", cast_inputs=torch.float32)
    def forward(
        ctx: Any,
        h: Tensor,
        weight: Tensor,
        bias: Tensor,
        pool: int,
        adjacency: StaticAdjacency,
        segment: OptTensor,
    ) -> Tensor:
        blocks = _BlockedMap(h, weight, bias, segment)
        out = h.new_empty(h.size(0), weight.size(-2) // pool, h.size(2))
        needs_backward = any(ctx.needs_input_grad)
        sums = blocks.empty_sums(len(h) if needs_backward else len(blocks.z))
        for start, stop in blocks.ranges:
            u = sums[start:stop] if needs_backward else sums[: stop - start]
            u[:, :-1] = sparse_product(adjacency.rows(start, stop), h.flatten(1)).view_as(u[:, :-1])
            z = torch.bmm(blocks.weights(start, stop), u, out=blocks.z[: stop - start])
            if pool == 1:
                torch.clamp(z, min=0, out=out[start:stop])
            else:
                torch.amax(_pool_windows(z, pool), dim=2, out=out[start:stop]).clamp_(min=0)
        ctx.save_for_backward(weight, bias, out, sums if needs_backward else None)
        ctx.pool, ctx.adjacency, ctx.segment = pool, adjacency, segment
        return out

    @staticmethod
    @once_differentiable
    @custom_bwd(device_type="cpu")
    def backward(ctx: Any, grad: Tensor) -> tuple[OptTensor, ...]:  # type: ignore[override]
        weight, bias, out, sums = ctx.saved_tensors
        h, pool = sums[:, :-1], ctx.pool
        grad = grad.contiguous()
        blocks = _BlockedMap(h, weight, bias, ctx.segment)
        grad_buffer = h.new_empty(len(blocks.z), *out.shape[1:])
        grad_weight = torch.zeros_like(blocks.weight.mT, memory_format=torch.contiguous_format)
        grad_u = h.new_empty(h.shape) if ctx.needs_input_grad[0] else None
        for start, stop in blocks.ranges:
            size, u = stop - start, sums[start:stop]
            # The derivative of ReLU.
            grad_z = torch.ops.aten.threshold_backward.grad_input(
                grad[start:stop], out[start:stop], 0, grad_input=grad_buffer[:size]
            )
            if pool > 1:
                z = torch.bmm(blocks.weights(start, stop), u, out=blocks.z[:size])
                distance = _pool_windows(z, pool)
                # The maximum is recomputed instead of taken from `out`, since a repeated product
                # may differ in the last bit.
                distance.sub_(distance.amax(dim=2, keepdim=True))
                # Passes the gradient where the distance is zero. Overwrites `z`, which shares its
                # memory with `distance`.
                torch.ops.aten.threshold_backward.grad_input(
                    grad_z.unsqueeze(2).expand_as(distance), distance, -_TINY, grad_input=distance
                )
                grad_z = z
            outer = torch.bmm(u, grad_z.transpose(1, 2))  # faster than its transpose
            if ctx.segment is None:
                grad_weight += outer.sum(dim=0)
            else:
                grad_weight.index_add_(0, ctx.segment[start:stop], outer)
            if grad_u is not None:
                transposed_weights = blocks.weights(start, stop)[..., :-1].transpose(1, 2)
                torch.bmm(transposed_weights, grad_z, out=grad_u[start:stop])
        grad_h = None
        if grad_u is not None:
            transposed_matrix = ctx.adjacency.csr(transposed=True)
            grad_h = sparse_product(transposed_matrix, grad_u.flatten(1)).view_as(h)
        grad_weight = grad_weight.mT
        return grad_h, grad_weight[..., :-1], grad_weight[..., -1], None, None, None


class _BlockedMap:
    r"""The linear map with its bias, split into blocks of taxels. All blocks share one buffer,
    which stays in the cache.
    """

    def __init__(self, h: Tensor, weight: Tensor, bias: Tensor, segment: OptTensor) -> None:
        num_nodes, self.width, num_samples = h.shape
        out_width = weight.size(-2)
        size = _BLOCK_BYTES // max(1, out_width * num_samples * h.element_size())
        size = max(1, min(num_nodes, size))
        self.segment = segment
        # The bias is the last column of the weights, so that one product adds it.
        self.weight = torch.cat([weight, bias.unsqueeze(-1)], dim=-1)
        self.z = h.new_empty(size, out_width, num_samples)
        self.ranges = [(start, min(start + size, num_nodes)) for start in range(0, num_nodes, size)]

    def empty_sums(self, num_nodes: int) -> Tensor:
        r"""Returns uninitialised memory for the sums over neighbours :math:`(N, F + 1, B)`, with
        ones in the last row for the bias.
        """
        sums = self.z.new_empty(num_nodes, self.width + 1, self.z.size(2))
        sums[:, -1] = 1
        return sums

    def weights(self, start: int, stop: int) -> Tensor:
        r"""Returns the weights and biases of the taxels from :obj:`start` to :obj:`stop - 1`."""
        if self.segment is None:
            return self.weight.expand(stop - start, -1, -1)
        return self.weight[self.segment[start:stop]]


def _pool_windows(z: Tensor, pool: int) -> Tensor:
    # Returns a view (N, O / k, k, B), whose maximum is over the third dimension.
    return z.unflatten(1, (z.size(1) // pool, pool))
