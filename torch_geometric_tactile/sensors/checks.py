r"""Checks of edges and of segments, for layouts and for everything that takes some of its own."""

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor


def check_edges(edge_index: Any, num_taxels: int, what: str = "'edge_index'") -> Tensor:
    r"""Returns edges as a contiguous tensor of integers.

    Args:
        edge_index (torch.Tensor or list): The edges.
        num_taxels (int): Number of taxels :math:`N`.
        what (str): What the edges are, for messages.

    Shapes:
        - **output:** directed edges :math:`(2, |\mathcal{E}|)`

    Raises:
        ValueError: If they have another shape, are not whole numbers, or join taxels that are not
            there.

    Examples:
        >>> check_edges([[0, 1], [1, 2]], num_taxels=3)
        tensor([[0, 1],
                [1, 2]])
    """
    # On the meta device, torch.as_tensor would move a tensor there.
    edges = edge_index if isinstance(edge_index, Tensor) else torch.as_tensor(edge_index)
    if edges.dim() != 2 or edges.size(0) != 2:
        raise ValueError(f"{what} must have shape (2, num_edges) (got {tuple(edges.shape)})")
    if edges.numel() and not is_whole_tensor(edges):
        raise ValueError(f"{what} must hold whole numbers (got {edges.dtype})")
    edges = edges.long()
    if edges.numel() and not 0 <= int(edges.min()) <= int(edges.max()) < num_taxels:
        raise ValueError(
            f"{what} must join taxels 0 to {num_taxels - 1} "
            f"(got {int(edges.min())} to {int(edges.max())})"
        )
    return edges.contiguous()


def check_segment(
    segment: Sequence[int] | Tensor,
    num_taxels: int | None = None,
    what: str = "'segment'",
    gaps: bool = False,
) -> Tensor:
    r"""Returns the segment of each taxel as a tensor of integers.

    Args:
        segment (sequence of int or torch.Tensor): The number of each taxel's segment.
        num_taxels (int, optional): Number of taxels :math:`N`, if it is known.
        what (str): What the numbers are, for messages.
        gaps (bool): Whether any whole numbers will do; otherwise they count from zero without gaps.

    Shapes:
        - **output:** segments :math:`(N,)`

    Raises:
        ValueError: If they are not one whole number for each taxel, or have gaps.

    Examples:
        >>> check_segment([0, 0, 1], num_taxels=3)
        tensor([0, 0, 1])
    """
    numbers = segment if isinstance(segment, Tensor) else torch.as_tensor(segment)
    if numbers.dim() != 1 or len(numbers) == 0 or not is_whole_tensor(numbers):
        raise ValueError(
            f"{what} must be a whole number for each taxel "
            f"(got shape {tuple(numbers.shape)}, {numbers.dtype})"
        )
    if num_taxels not in (None, len(numbers)):
        raise ValueError(f"{what} must have shape ({num_taxels},) (got {tuple(numbers.shape)})")
    if not gaps:
        found = numbers.unique().tolist()
        if found != list(range(len(found))):
            raise ValueError(f"{what} must be numbered from 0 without gaps (got {found})")
    return numbers.long()


def is_whole_tensor(numbers: Tensor) -> bool:
    r"""Tells whether a tensor holds whole numbers, and no truth values."""
    is_number = not (numbers.is_floating_point() or numbers.is_complex())
    return is_number and numbers.dtype != torch.bool
