r"""Asserts that a layer is permutation equivariant."""

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
    r"""Asserts that renumbering the nodes renumbers the output of a layer in the same way, and that
    the order of the edges has no effect.

    .. math::
        f(\mathbf{P} \mathbf{X}, \mathbf{P} \mathbf{A} \mathbf{P}^{\top}) =
        \mathbf{P} f(\mathbf{X}, \mathbf{A})

    Args:
        layer (callable): The layer, with one output row for each node.
        x (torch.Tensor): Node features :math:`(N, F)` or :math:`(B, N, F)`.
        edge_index (torch.Tensor): Edges :math:`(2, |\mathcal{E}|)`.
        seed (int): Seed for the random permutations.
        edge_attr (torch.Tensor, optional): Edge features or weights, shared by all samples
            :math:`(|\mathcal{E}|, D)` or :math:`(|\mathcal{E}|,)`.
        atol (float): The largest allowed difference.

    Raises:
        AssertionError: If the numbers differ.

    Examples:
        >>> from torch_geometric_tactile.nn.conv import StaticGCNConv
        >>> edge_index = torch.tensor([[0, 1], [1, 2]])
        >>> assert_permutation_equivariant(StaticGCNConv(3, 8), torch.randn(5, 4, 3), edge_index)
    """
    generator = torch.Generator().manual_seed(seed)
    order = _random_cycle(x.size(-2), generator).to(x.device)
    edge_order = _random_cycle(edge_index.size(1), generator).to(edge_index.device)
    new_number = order.argsort()  # for each node
    renumbered = new_number[edge_index[:, edge_order]]
    with torch.no_grad():
        if edge_attr is None:
            expected, actual = layer(x, edge_index), layer(x[..., order, :], renumbered)
        else:
            expected = layer(x, edge_index, edge_attr)
            actual = layer(x[..., order, :], renumbered, edge_attr[edge_order])
    law = f"{type(layer).__name__} must be permutation equivariant"
    assert_equal_numbers(law, actual, expected[..., order, :], atol)


def _random_cycle(size: int, generator: torch.Generator) -> Tensor:
    order = torch.randperm(size, generator=generator)
    # A single cycle moves every element, whereas a random permutation often leaves some in place.
    return torch.empty_like(order).scatter(0, order, order.roll(1))
