r"""A graph convolution on one topology with many samples, made for training on processors.

Activations lie as :math:`(N, F, B)`, taxel by taxel and the samples innermost. One sparse product
with the :math:`(N, F \cdot B)` matrix then serves the whole batch, the linear map is a batched
product over the taxels, and the maximum over channels runs along contiguous memory.
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

# The widest activation of a block of this size stays in a processor's second-level cache.
_BLOCK_BYTES = 2**20
# Below the difference of any two numbers that are not equal, and above zero.
_TINY = 1e-37
# From this number of samples on, the layout of this module pays.
_MIN_SAMPLES = 8


def may_run_fast(x: Tensor) -> bool:
    r"""Tells whether :func:`pooled_gcn` pays for features: those of many samples on a processor."""
    return is_static_batch(x) and x.size(0) >= _MIN_SAMPLES


def may_merge(layers: Iterable[tuple[Any, ChannelMaxPool]]) -> bool:
    r"""Tells whether layers may be computed in one step, without calling them one by one.

    They may if each is exactly the layer of this package with its default arguments, and nothing is
    attached to it or to its linear map: no hook, no explainer, no wrapped, pruned or
    reparametrised weight.
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
    r"""Returns the features :math:`(B, N, O)` behind all layers, each by :func:`pooled_gcn`."""
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
    r"""A graph convolution, the maximum over neighbouring channels, and ReLU, in one step.

    .. math::
        \mathbf{H}' = \max \left( 0, \mathrm{pool}_k \left( \hat{\mathbf{A}} \mathbf{H} \mathbf{W}
        + \mathbf{b} \right) \right)

    It works block by block of taxels, so that the wide activation before the maximum is never
    written to memory. The backward pass computes it again from the sums over the neighbours, which
    costs less than reading it. The gradient goes to the channel that was the maximum (to all of
    them where several are equal to the last bit). There is no second derivative.

    Shapes:
        - **input:** features :math:`(N, F, B)`, weights :math:`(O, F)` or :math:`(S, O, F)`, biases
          :math:`(O,)` or :math:`(S, O)`, segments :math:`(N,)`
        - **output:** :math:`(N, O / k, B)`
    """
    if bias is None:
        bias = weight.new_zeros(weight.shape[:-1])
    out: Tensor = _PooledGCN.apply(h, weight, bias, pool, adjacency, segment)
    return out


class _PooledGCN(Function):
    # In full precision under autocast as well, which would cast some of the products.
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
        block = _Block(h, weight, bias, segment)
        out = h.new_empty(h.size(0), weight.size(-2) // pool, h.size(2))
        is_kept = any(ctx.needs_input_grad)
        sums = block.empty_sums(len(h) if is_kept else len(block.z))
        for start, stop in block.ranges:
            u = sums[start:stop] if is_kept else sums[: stop - start]
            u[:, :-1] = sparse_product(adjacency.rows(start, stop), h.flatten(1)).view_as(u[:, :-1])
            z = torch.bmm(block.weights(start, stop), u, out=block.z[: stop - start])
            if pool == 1:
                torch.clamp(z, min=0, out=out[start:stop])
            else:
                torch.amax(_groups(z, pool), dim=2, out=out[start:stop]).clamp_(min=0)
        ctx.save_for_backward(weight, bias, out, sums if is_kept else None)
        ctx.pool, ctx.adjacency, ctx.segment = pool, adjacency, segment
        return out

    @staticmethod
    @once_differentiable
    @custom_bwd(device_type="cpu")
    def backward(ctx: Any, grad: Tensor) -> tuple[OptTensor, ...]:  # type: ignore[override]
        weight, bias, out, sums = ctx.saved_tensors
        h, pool = sums[:, :-1], ctx.pool
        grad = grad.contiguous()
        block = _Block(h, weight, bias, ctx.segment)
        narrow = h.new_empty(len(block.z), *out.shape[1:])
        grad_weight = torch.zeros_like(block.weight.mT, memory_format=torch.contiguous_format)
        grad_u = h.new_empty(h.shape) if ctx.needs_input_grad[0] else None
        for start, stop in block.ranges:
            size, u = stop - start, sums[start:stop]
            part = torch.ops.aten.threshold_backward.grad_input(
                grad[start:stop], out[start:stop], 0, grad_input=narrow[:size]
            )
            if pool > 1:
                z = torch.bmm(block.weights(start, stop), u, out=block.z[:size])
                below = _groups(z, pool)
                # Compared with its own maximum, not with `out`: a product may differ in the last
                # bit from one run to the next.
                below.sub_(below.amax(dim=2, keepdim=True))
                torch.ops.aten.threshold_backward.grad_input(
                    part.unsqueeze(2).expand_as(below), below, -_TINY, grad_input=below
                )
                part = z
            outer = torch.bmm(u, part.transpose(1, 2))  # faster than its transpose
            if ctx.segment is None:
                grad_weight += outer.sum(dim=0)
            else:
                grad_weight.index_add_(0, ctx.segment[start:stop], outer)
            if grad_u is not None:
                back = block.weights(start, stop)[..., :-1].transpose(1, 2)
                torch.bmm(back, part, out=grad_u[start:stop])
        grad_h = None
        if grad_u is not None:
            transposed = ctx.adjacency.csr(transposed=True)
            grad_h = sparse_product(transposed, grad_u.flatten(1)).view_as(h)
        grad_weight = grad_weight.mT
        return grad_h, grad_weight[..., :-1], grad_weight[..., -1], None, None, None


class _Block:
    r"""Maps a block of taxels at a time, in a buffer that stays in the cache."""

    def __init__(self, h: Tensor, weight: Tensor, bias: Tensor, segment: OptTensor) -> None:
        num_nodes, self.width, num_samples = h.shape
        wide = weight.size(-2)
        size = _BLOCK_BYTES // max(1, wide * num_samples * h.element_size())
        size = max(1, min(num_nodes, size))
        self.segment = segment
        self.weight = torch.cat([weight, bias.unsqueeze(-1)], dim=-1)
        self.z = h.new_empty(size, wide, num_samples)
        self.ranges = [(start, min(start + size, num_nodes)) for start in range(0, num_nodes, size)]

    def empty_sums(self, num_nodes: int) -> Tensor:
        r"""Returns memory for the sums over neighbours, behind which ones multiply the bias."""
        sums = self.z.new_empty(num_nodes, self.width + 1, self.z.size(2))
        sums[:, -1] = 1
        return sums

    def weights(self, start: int, stop: int) -> Tensor:
        r"""Returns weights and biases of each taxel."""
        if self.segment is None:
            return self.weight.expand(stop - start, -1, -1)
        return self.weight[self.segment[start:stop]]


def _groups(z: Tensor, pool: int) -> Tensor:
    # The channels by what shares one maximum.
    return z.unflatten(1, (z.size(1) // pool, pool))
