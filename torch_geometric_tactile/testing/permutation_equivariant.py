r"""The numbering of the taxels does not matter."""

from collections.abc import Callable

import torch
from torch import Tensor

from torch_geometric_tactile.testing._compare import assert_equal_numbers


def assert_permutation_equivariant(
    layer: Callable[..., Tensor],
    x: Tensor,
    edge_index: Tensor,
    seed: int = 0,
    edge_attr: Tensor | None = None,
    atol: float = 1e-5,
) -> None:
    r"""Asserts that a layer on renumbered nodes gives the renumbered output, whatever the order in
    which the edges are listed.

    .. math::
        f(\mathbf{P} \mathbf{X}, \mathbf{P} \mathbf{A} \mathbf{P}^{\top}) =
        \mathbf{P} f(\mathbf{X}, \mathbf{A})

    Args:
        layer (callable): The layer, with one output row for each node.
        x (torch.Tensor): Node features :math:`(N, F)` or :math:`(B, N, F)`.
        edge_index (torch.Tensor): Edges :math:`(2, |\mathcal{E}|)`.
        seed (int): Which of the permutations.
        edge_attr (torch.Tensor, optional): Edge features or weights, shared by all samples
            :math:`(|\mathcal{E}|, D)` or :math:`(|\mathcal{E}|,)`.
        atol (float): The difference that is allowed.

    Raises:
        AssertionError: If the numbers differ.

    Examples:
        >>> from torch_geometric_tactile.nn.conv import StaticGCNConv
        >>> edge_index = torch.tensor([[0, 1], [1, 2]])
        >>> assert_permutation_equivariant(StaticGCNConv(3, 8), torch.randn(5, 4, 3), edge_index)
    """
    generator = torch.Generator().manual_seed(seed)
    order = _cycle(x.size(-2), generator).to(x.device)
    listed = _cycle(edge_index.size(1), generator).to(edge_index.device)
    number = order.argsort()  # the new number of each node
    renumbered = number[edge_index[:, listed]]
    with torch.no_grad():
        if edge_attr is None:
            expected, found = layer(x, edge_index), layer(x[..., order, :], renumbered)
        else:
            expected = layer(x, edge_index, edge_attr)
            found = layer(x[..., order, :], renumbered, edge_attr[listed])
    law = f"{type(layer).__name__} must be permutation equivariant"
    assert_equal_numbers(law, found, expected[..., order, :], atol)


def _cycle(size: int, generator: torch.Generator) -> Tensor:
    order = torch.randperm(size, generator=generator)
    # A single cycle leaves nothing in its place, which a random permutation often does.
    return torch.empty_like(order).scatter(0, order, order.roll(1))
