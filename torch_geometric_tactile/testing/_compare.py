r"""How all laws compare."""

import torch
from torch import Tensor


def assert_equal_numbers(law: str, found: Tensor, expected: Tensor, atol: float) -> None:
    r"""Raises an :class:`AssertionError` that names the law and the largest difference.

    Args:
        law (str): What should have been equal, as a sentence.
        found (torch.Tensor): The numbers found.
        expected (torch.Tensor): The numbers expected. NaN equals NaN.
        atol (float): The difference that is allowed.
    """
    if found.shape != expected.shape:
        raise AssertionError(
            f"{law}: the shapes differ, {tuple(found.shape)} and {tuple(expected.shape)}"
        )
    found, expected = found.detach().double(), expected.detach().double()
    if torch.equal(found.isnan(), expected.isnan()):
        same = (found == expected) | found.isnan()  # infinity minus infinity is no number
        difference = (found - expected).abs().masked_fill(same, 0.0)
        largest = float(difference.max()) if difference.numel() else 0.0
    else:
        largest = float("nan")
    if not largest <= atol:
        raise AssertionError(
            f"{law}: the largest difference is {largest:.3g} (allowed are {atol:.3g})"
        )
