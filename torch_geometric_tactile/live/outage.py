r"""Times without frames."""

from typing import NamedTuple


class Outage(NamedTuple):
    r"""A time in which a stream had no frame.

    Args:
        start (float): Time of the last frame before it in seconds, as of
            :attr:`LiveFrame.time <torch_geometric_tactile.data.LiveFrame>`.
        end (float): Time of the first frame after it, or the present while it lasts.
        lost (int): Frames that the numbers of the two say are missing.

    Examples:
        >>> outage = Outage(2.0, 5.5)
        >>> outage.seconds
        3.5
    """

    start: float
    end: float
    lost: int = 0

    @property
    def seconds(self) -> float:
        r"""How long it lasted."""
        return self.end - self.start
