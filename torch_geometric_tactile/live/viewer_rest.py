r"""What the viewer shows readings relative to."""

import numpy as np

_SECONDS = 1.0


class ViewerRest:
    r"""The mean of the first second that was shown, or what the caller gives.

    While that second is not over, the mean so far serves. Readings that are missing in all of its
    frames stay missing.
    """

    def __init__(self) -> None:
        self.given: np.ndarray | None = None
        self.again()

    def again(self) -> None:
        r"""Measures the next second anew."""
        self._total: np.ndarray | None = None
        self._count = np.zeros(0)
        self._start = 0.0
        self._mean: np.ndarray | None = None
        self._over = False

    @property
    def kind(self) -> str:
        r"""Where the rest is from: :obj:`"given"`, :obj:`"measured"` or :obj:`"measuring"`."""
        if self.given is not None:
            return "given"
        return "measured" if self._over else "measuring"

    def relative(self, time: float, tactile: np.ndarray) -> np.ndarray:
        r"""Returns readings relative to the rest.

        Args:
            time (float): Time of the frame in seconds.
            tactile (numpy.ndarray): Its readings :math:`(N, C)`.
        """
        given = self.given
        if given is not None and given.shape == tactile.shape:
            return tactile - given
        if self._total is None or self._total.shape != tactile.shape:
            self.again()
            self._total = np.zeros(tactile.shape)
            self._count = np.zeros(tactile.shape)
            self._start = time
        if not self._over:
            self._add(time, tactile)
        assert self._mean is not None
        return tactile - self._mean

    def _add(self, time: float, tactile: np.ndarray) -> None:
        assert self._total is not None
        present = ~np.isnan(tactile)
        self._total[present] += tactile[present]
        self._count += present
        counted = np.maximum(self._count, 1)
        self._mean = np.where(self._count > 0, self._total / counted, np.nan)
        # A stream that starts over, as a replay in a loop does, has earlier times.
        self._over = not self._start <= time < self._start + _SECONDS
