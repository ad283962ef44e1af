r"""Checks of edges and segments, for layouts and for arguments of functions."""

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor


def check_edges(edge_index: Any, num_taxels: int, what: str = "'edge_index'") -> Tensor:
    r"""Returns edges as a contiguous tensor of integers.

    Args:
        edge_index (torch.Tensor or list): The edges.
        num_taxels (int): Number of taxels :math:`N`.
        what (str): Name of the edges in error messages.

    Shapes:
        - **output:** directed edges :math:`(2, |\mathcal{E}|)`

    Raises:
        ValueError: If the edges have the wrong shape, are not integers, or join taxels that do not
            exist.

    Examples:
        >>> check_edges([[0, 1], [1, 2]], num_taxels=3)
        tensor([[0, 1],
                [1, 2]])
    """
    # Under the meta device, torch.as_tensor would move the tensor to it.
    edges = edge_index if isinstance(edge_index, Tensor) else torch.as_tensor(edge_index)
    if edges.dim() != 2 or edges.size(0) != 2:
        raise ValueError(f"{what} must have shape (2, num_edges) (got {tuple(edges.shape)})")
    if edges.numel() and not is_integer_tensor(edges):
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
        segment (sequence of int or torch.Tensor): Index of each taxel's segment.
        num_taxels (int, optional): Number of taxels :math:`N`, if it is known.
        what (str): Name of the segments in error messages.
        gaps (bool): Whether to allow any integers. By default they must count from zero without
            gaps.

    Shapes:
        - **output:** segments :math:`(N,)`

    Raises:
        ValueError: If the segments are not one integer for each taxel, or have gaps.

    Examples:
        >>> check_segment([0, 0, 1], num_taxels=3)
        tensor([0, 0, 1])
    """
    indices = segment if isinstance(segment, Tensor) else torch.as_tensor(segment)
    if indices.dim() != 1 or len(indices) == 0 or not is_integer_tensor(indices):
        raise ValueError(
            f"{what} must be a whole number for each taxel "
            f"(got shape {tuple(indices.shape)}, {indices.dtype})"
        )
    if num_taxels not in (None, len(indices)):
        raise ValueError(f"{what} must have shape ({num_taxels},) (got {tuple(indices.shape)})")
    if not gaps:
        unique = indices.unique().tolist()
        if unique != list(range(len(unique))):
            raise ValueError(f"{what} must be numbered from 0 without gaps (got {unique})")
    return indices.long()


def is_integer_tensor(tensor: Tensor) -> bool:
    r"""Returns whether a tensor holds integers and not booleans."""
    is_discrete = not (tensor.is_floating_point() or tensor.is_complex())
    return is_discrete and tensor.dtype != torch.bool
