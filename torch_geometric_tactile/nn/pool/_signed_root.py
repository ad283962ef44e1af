r"""The signed root that bilinear features are scaled by."""

from torch import Tensor

# The root of a number near zero has a gradient without bound.
_FLOOR = 1e-8


def signed_root(phi: Tensor) -> Tensor:
    r"""Returns the root of each number's magnitude, raised by :math:`10^{-8}`, with its sign."""
    return phi.sign() * (phi.abs() + _FLOOR).sqrt()
