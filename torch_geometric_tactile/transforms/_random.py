r"""What random transforms draw."""

import math

import torch
from torch import Tensor


def uniform(count: int, x: Tensor, generator: torch.Generator | None) -> Tensor:
    r"""Returns random numbers from 0 to 1, on the device of the readings: the same for one seed
    however samples are arranged.

    Shapes:
        - **output:** :math:`(count,)`
    """
    device = x.device if generator is None else generator.device
    return torch.rand(count, generator=generator, device=device).to(x.device)


def normal(count: int, x: Tensor, generator: torch.Generator | None) -> Tensor:
    r"""Returns normal random numbers of deviation one, as of :func:`uniform`.

    Shapes:
        - **output:** :math:`(count,)`, none beyond 5.5 deviations
    """
    # PyTorch draws many normal numbers at once in another order than one by one.
    drawn = uniform(count, x, generator).double()
    return torch.special.ndtri(drawn + 2.0**-25).float()  # the middles of the steps of `rand`


def check_deviation(std: float, name: str = "std") -> float:
    r"""Returns a standard deviation."""
    if not 0 <= std < math.inf:
        raise ValueError(f"'{name}' must be at least 0 and finite (got {std})")
    return float(std)


def check_probability(p: float) -> float:
    r"""Returns a probability."""
    if not 0 <= p <= 1:
        raise ValueError(f"'p' must be a probability, 0 to 1 (got {p})")
    return float(p)


def check_whole(name: str, number: int, least: int, most: int) -> int:
    r"""Returns a whole number."""
    if isinstance(number, bool) or not isinstance(number, int) or not least <= number <= most:
        raise ValueError(f"'{name}' must be a whole number, {least} to {most} (got {number})")
    return number
