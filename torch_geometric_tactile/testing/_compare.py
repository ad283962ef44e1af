r"""Compares tensors for all assertions."""

import torch
from torch import Tensor


def assert_equal_numbers(law: str, actual: Tensor, expected: Tensor, atol: float) -> None:
    r"""Checks that numbers are equal. Otherwise, raises an :class:`AssertionError` that states the
    law and the largest difference.

    Args:
        law (str): Sentence that states the law.
        actual (torch.Tensor): The actual numbers.
        expected (torch.Tensor): The expected numbers. NaN equals NaN.
        atol (float): The largest allowed difference.
    """
    if actual.shape != expected.shape:
        raise AssertionError(
            f"{law}: the shapes differ, {tuple(actual.shape)} and {tuple(expected.shape)}"
        )
    actual, expected = actual.detach().double(), expected.detach().double()
    if torch.equal(actual.isnan(), expected.isnan()):
        same = (actual == expected) | actual.isnan()  # infinity minus infinity is NaN
        difference = (actual - expected).abs().masked_fill(same, 0.0)
        largest = float(difference.max()) if difference.numel() else 0.0
    else:
        largest = float("nan")
    if not largest <= atol:
        raise AssertionError(
            f"{law}: the largest difference is {largest:.3g} (allowed: {atol:.3g})"
        )
