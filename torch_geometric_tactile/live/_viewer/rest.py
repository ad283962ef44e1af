r"""What the viewer shows readings relative to."""

import numpy as np

_SECONDS = 1.0


class ViewerRest:
    r"""The mean of the first second that was shown, or what the caller gives.

    While that second is not over, the mean so far serves. Readings that are missing in all of its
    frames stay missing. One thread asks for readings; any may ask for another rest.

    Shapes:
        - **given:** What the caller gives :math:`(N, C)`; it goes first.
        - **mean:** What was measured :math:`(N, C)`.
    """

    def __init__(self) -> None:
        self.given: np.ndarray | None = None
        self.mean: np.ndarray | None = None
        self._total = self._count = np.zeros(0)
        self._start = 0.0
        self._over = False
        self._anew = True

    def again(self) -> None:
        r"""Measures the next second."""
        self._anew = True

    @property
    def kind(self) -> str:
        r"""Where the rest is from: :obj:`"given"`, :obj:`"measured"` or :obj:`"measuring"`."""
        if self.given is not None:
            return "given"
        return "measured" if self._over and not self._anew else "measuring"

    def relative(self, time: float, tactile: np.ndarray) -> np.ndarray:
        r"""Returns readings relative to the rest.

        Shapes:
            - **tactile:** Its readings :math:`(N, C)`.
        """
        given = self.given
        if given is not None and given.shape == tactile.shape:
            return tactile - given
        if self._anew or self._total.shape != tactile.shape:
            self._anew = self._over = False
            self._total, self._count = np.zeros(tactile.shape), np.zeros(tactile.shape)
            self._start = time
        if not self._over:
            self._add(time, tactile)
        assert self.mean is not None
        return tactile - self.mean

    def _add(self, time: float, tactile: np.ndarray) -> None:
        present = ~np.isnan(tactile)
        self._total[present] += tactile[present]
        self._count += present
        mean = self._total / np.maximum(self._count, 1)
        self.mean = np.where(self._count > 0, mean, np.nan)
        self._over = time >= self._start + _SECONDS
