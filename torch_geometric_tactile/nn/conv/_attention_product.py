r"""Attention over the neighbours in one topology, computed with sparse matrix products."""

from collections.abc import Callable, Sequence
from typing import Optional

import torch
import torch.nn.functional as F
from torch import Tensor
from torch_geometric.typing import OptTensor
from torch_geometric.utils import softmax

from torch_geometric_tactile.nn.conv._attention_edges import AttentionEdges, AttentionPattern


class Attention:
    r"""Attention coefficients of a batch, and their products with features.

    The softmax is taken over the first dimension, which is as fast as a sum. Over a short last
    dimension, it would take twenty times as long. Products use
    :func:`~torch.nn.functional.embedding_bag`, which is PyTorch's fastest weighted sum of rows on a
    CPU and writes no messages to memory.

    Args:
        logits (torch.Tensor): Logits of the slots :math:`(K, R)`. This tensor is overwritten.
        pattern (AttentionPattern): Indices of the coefficients.
        dropout (float): Probability of dropping a coefficient.
    """

    def __init__(self, logits: Tensor, pattern: AttentionPattern, dropout: float) -> None:
        self.pattern = pattern
        if pattern.padding is not None:
            logits.masked_fill_(pattern.padding, -torch.inf)
        self.slots = logits.softmax(dim=0)
        values = self.slots.view(-1).index_select(0, pattern.slots)
        self.factors: OptTensor = None
        if dropout > 0:
            self.factors = F.dropout(torch.ones_like(values), dropout)
            values = values * self.factors
        self.values = values

    def apply(self, rows: Tensor) -> Tensor:
        r"""Returns the weighted sum over the neighbours of each row :math:`(R, C)`.

        Args:
            rows (torch.Tensor): Features :math:`(R, C)`.
        """
        pattern = self.pattern
        return _sum_rows(rows, pattern.columns, pattern.row_starts, self.values)

    @staticmethod
    def apply_transposed(values: Tensor, rows: Tensor, pattern: AttentionPattern) -> Tensor:
        r"""Returns the product with the transposed matrix :math:`(R, C)`, which is the weighted sum
        over the targets of each source.

        Args:
            values (torch.Tensor): Attention coefficients, sorted by row.
            rows (torch.Tensor): Features :math:`(R, C)`.
            pattern (AttentionPattern): Indices of the coefficients.
        """
        values = values.index_select(0, pattern.by_column)
        return _sum_rows(rows, pattern.rows_by_column, pattern.column_starts, values)


def slot_gradient(
    slots: Tensor, factors: OptTensor, grad: Tensor, rows: Tensor, pattern: AttentionPattern
) -> Tensor:
    r"""Returns the gradient of the logits of the slots :math:`(K, R)`.

    Shapes:
        - **slots:** Coefficients of the slots :math:`(K, R)`.
        - **factors:** Dropout factors of the coefficients, sorted by row.
        - **grad:** Gradient of the weighted sums :math:`(R, C)`.
        - **rows:** Features :math:`(R, C)`.
    """
    grad_values = torch.sparse.sampled_addmm(pattern.matrix, grad, rows.t(), beta=0.0).values()
    if factors is not None:
        grad_values = grad_values * factors
    grad_slots = grad_values.index_select(0, pattern.slot_coefficients).view_as(slots)
    grad_logits: Tensor = torch.ops.aten._softmax_backward_data(grad_slots, slots, 0, slots.dtype)
    return grad_logits if pattern.empty is None else grad_logits.masked_fill_(pattern.empty, 0.0)


def sum_edges(edge_rows: Tensor, edges: Tensor, starts: Tensor) -> Tensor:
    r"""Returns the sum of the edge features at each node :math:`(N, F)`.

    Shapes:
        - **edge_rows:** Features of the edges :math:`(|\mathcal{E}|, F)`.
        - **edges:** Indices of the edges, sorted by node :math:`(|\mathcal{E}|,)`.
        - **starts:** Position of each node's first edge in :obj:`edges` :math:`(N + 1,)`.
    """
    return _sum_rows(edge_rows, edges, starts)


def _sum_rows(rows: Tensor, indices: Tensor, starts: Tensor, weights: OptTensor = None) -> Tensor:
    return F.embedding_bag(
        indices,
        rows,
        starts,
        mode="sum",
        per_sample_weights=weights,
        include_last_offset=True,
    )


def attend_by_messages(
    logits: Tensor, features: Tensor, edges: AttentionEdges, factors: OptTensor
) -> Tensor:
    r"""Returns the weighted sums :math:`(B, N, H, C)`, computed with messages along edges. The
    operations have derivatives of any order.

    Shapes:
        - **logits:** Logits of the edges :math:`(B, |\mathcal{E}|, H)`.
        - **features:** Features :math:`(B, N, H, C)`.
        - **factors:** Dropout factors :math:`(B \cdot |\mathcal{E}| \cdot H,)`.
    """
    alpha = softmax(logits, edges.target, num_nodes=edges.num_nodes, dim=1)
    alpha = alpha if factors is None else alpha * factors.view_as(alpha)
    messages = alpha.unsqueeze(-1) * features.index_select(1, edges.source)
    return torch.zeros_like(features).index_add(1, edges.target, messages)


def edge_factors(factors: OptTensor, pattern: AttentionPattern) -> OptTensor:
    r"""Returns the dropout factors in the order that :func:`attend_by_messages` expects.

    Shapes:
        - **factors:** Factors of the coefficients, sorted by row.
    """
    return None if factors is None else factors.index_select(0, pattern.edge_coefficients)


def differentiable_gradients(
    compute: Callable[..., Tensor],
    inputs: Sequence[Tensor],
    needs_grad: Sequence[bool],
    grad: Tensor,
) -> list[Optional[Tensor]]:
    r"""Returns gradients with respect to the inputs of a function. These gradients can be
    differentiated again.

    Args:
        compute (callable): The function. It must use only differentiable operations.
        inputs (list): Inputs of the function.
        needs_grad (list): Whether each input needs a gradient. The gradients of all other inputs
            are :obj:`None`.
        grad (torch.Tensor): Gradient of the output.
    """
    with torch.enable_grad():
        out = compute(*inputs)
        selected = [
            tensor for tensor, is_needed in zip(inputs, needs_grad, strict=True) if is_needed
        ]
        grads = iter(torch.autograd.grad(out, selected, grad, create_graph=True, allow_unused=True))
    return [next(grads) if is_needed else None for is_needed in needs_grad]
