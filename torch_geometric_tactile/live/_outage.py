r"""Outages: periods without frames."""

from typing import NamedTuple


class Outage(NamedTuple):
    r"""A period in which a stream had no frame.

    Args:
        start (float): Time of the last frame before the outage in seconds (see
            :attr:`LiveFrame.time <torch_geometric_tactile.data.LiveFrame>`).
        end (float): Time of the first frame after the outage, or the present while it lasts.
        lost (int): Number of missing frames, from the numbers of these two frames.

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
        r"""Duration in seconds."""
        return self.end - self.start
