r"""Polynomials of the channels of taxels, with linear extrapolation beyond their range."""

from itertools import combinations_with_replacement
from math import comb

import torch
from torch import Tensor


def num_terms(num_inputs: int, degree: int) -> int:
    r"""Returns the number of products of up to :obj:`degree` readings, including the constant.

    Examples:
        >>> num_terms(3, 1), num_terms(3, 2)
        (4, 10)
    """
    return comb(num_inputs + degree, degree)


def scaled_readings(x: Tensor, low: Tensor | None, high: Tensor | None) -> tuple[Tensor, Tensor]:
    r"""Scales readings so that their range becomes -1 to 1. Returns the scaled readings, clamped to
    this interval, and their distance beyond it.

    Without :obj:`low` and :obj:`high`, the readings are returned unchanged, with distances of zero.

    Shapes:
        - **x:** :math:`(\ldots, C)`
        - **low, high:** the range :math:`(C,)`, or with leading dimensions
        - **output:** scaled readings and distances, each with the shape of :obj:`x`
    """
    if low is None or high is None:
        return x, torch.zeros_like(x)
    half_range = (high - low) / 2
    x = (x - ((low + high) / 2).to(x)) / torch.where(half_range > 0, half_range, 1.0).to(x)
    inside = x.clamp(-1, 1)
    return inside, x - inside


def polynomial_terms(x: Tensor, low: Tensor | None, high: Tensor | None, degree: int = 1) -> Tensor:
    r"""Returns the constant 1 and all products of up to :obj:`degree` scaled readings: first the
    readings, then the products of two readings, and so on.

    Beyond the range of the readings, products are extrapolated linearly, along their slope at the
    end of the range.

    Shapes:
        - **x:** :math:`(\ldots, C)`
        - **output:** :math:`(\ldots, M)`
    """
    inside, beyond = scaled_readings(x, low, high)
    num_inputs = x.size(-1)
    ones = torch.ones_like(inside[..., :1])
    inside, beyond = torch.cat([inside, ones], -1), torch.cat([beyond, torch.zeros_like(ones)], -1)
    # Each product has `degree` factors; shorter products are padded with the constant.
    products = torch.tensor(
        [
            [*factors, *[num_inputs] * (degree - size)]
            for size in range(degree + 1)
            for factors in combinations_with_replacement(range(num_inputs), size)
        ],
        device=x.device,
    )
    # By the product rule, `change` is the derivative of the product along the distance beyond the
    # range.
    value, change = inside[..., products[:, 0]], beyond[..., products[:, 0]]
    for factor in products.T[1:]:
        change = change * inside[..., factor] + value * beyond[..., factor]
        value = value * inside[..., factor]
    return value + change


def polynomial(
    x: Tensor, coefficients: Tensor, low: Tensor | None, high: Tensor | None, degree: int = 1
) -> Tensor:
    r"""Evaluates polynomials of the channels of each taxel.

    Shapes:
        - **x:** :math:`(\ldots, N, T, C)`
        - **coefficients:** :math:`(M, D)`, or for each taxel :math:`(N, M, D)`
        - **low, high:** the range :math:`(C,)`, or of each taxel :math:`(N, C)`
        - **output:** :math:`(\ldots, N, T, D)`
    """
    if low is not None and high is not None:
        low, high = low.unsqueeze(-2), high.unsqueeze(-2)
    return polynomial_terms(x, low, high, degree) @ coefficients.to(x)
