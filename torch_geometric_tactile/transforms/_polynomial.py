r"""Polynomials of the channels of taxels, which beyond their range go on along their tangent."""

from itertools import combinations_with_replacement
from math import comb

import torch
from torch import Tensor


def num_terms(num_inputs: int, degree: int) -> int:
    r"""Returns how many products of up to :obj:`degree` readings there are, the constant one
    included.

    Examples:
        >>> num_terms(3, 1), num_terms(3, 2)
        (4, 10)
    """
    return comb(num_inputs + degree, degree)


def scaled_readings(x: Tensor, low: Tensor | None, high: Tensor | None) -> tuple[Tensor, Tensor]:
    r"""Returns readings as -1 to 1 within their range, and how far they are beyond it.

    Shapes:
        - **x:** :math:`(\ldots, C)`
        - **low, high:** the range :math:`(C,)` or with leading dimensions; without, readings stay
          as they are, and none is beyond
        - **output:** that of :obj:`x` each; the first is cut off at -1 and 1
    """
    if low is None or high is None:
        return x, torch.zeros_like(x)
    half = (high - low) / 2
    x = (x - ((low + high) / 2).to(x)) / torch.where(half > 0, half, 1.0).to(x)
    inside = x.clamp(-1, 1)
    return inside, x - inside


def polynomial_terms(x: Tensor, low: Tensor | None, high: Tensor | None, degree: int = 1) -> Tensor:
    r"""Returns one and all products of up to :obj:`degree` scaled readings, first those of one,
    then those of two, and so on.

    Beyond the range they are what they are at its end, and their slope there times the distance.

    Shapes:
        - **x:** :math:`(\ldots, C)`
        - **output:** :math:`(\ldots, M)`
    """
    inside, beyond = scaled_readings(x, low, high)
    num_inputs = x.size(-1)
    one = torch.ones_like(inside[..., :1])
    inside, beyond = torch.cat([inside, one], -1), torch.cat([beyond, torch.zeros_like(one)], -1)
    products = torch.tensor(
        [
            [*chosen, *[num_inputs] * (degree - size)]  # filled up with the constant
            for size in range(degree + 1)
            for chosen in combinations_with_replacement(range(num_inputs), size)
        ],
        device=x.device,
    )
    value, slope = inside[..., products[:, 0]], beyond[..., products[:, 0]]
    for factor in products.T[1:]:
        slope = slope * inside[..., factor] + value * beyond[..., factor]
        value = value * inside[..., factor]
    return value + slope


def polynomial(
    x: Tensor, coefficients: Tensor, low: Tensor | None, high: Tensor | None, degree: int = 1
) -> Tensor:
    r"""Returns the polynomials of the channels of each taxel.

    Shapes:
        - **x:** :math:`(\ldots, N, T, C)`
        - **coefficients:** :math:`(M, D)`, or of each taxel its own :math:`(N, M, D)`
        - **low, high:** likewise :math:`(C,)` or :math:`(N, C)`
        - **output:** :math:`(\ldots, N, T, D)`
    """
    if low is not None and high is not None:
        low, high = low.unsqueeze(-2), high.unsqueeze(-2)
    return polynomial_terms(x, low, high, degree) @ coefficients.to(x)
