r"""The readings of the taxels on the simulated gripper."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from torch_geometric_tactile._checks import need


@dataclass(frozen=True)
class PadSensor:
    r"""A tared sensor. Its gains, remaining offsets and dead taxels are drawn again for each
    episode. All spreads are standard deviations; they are plausible, not measured.

    Args:
        gain_spread (float): Relative spread of the gains of taxels and axes.
        offset (float): Spread of the offsets that remain after taring in newtons.
        noise (float): Noise of a reading in newtons.
        dead (float): Probability that a taxel is dead. Dead taxels read zero.

    Raises:
        ValueError: If a number is negative, or if :obj:`dead` is above one.

    Examples:
        >>> PadSensor()
        PadSensor(gain_spread=0.05, offset=0.002, noise=0.001, dead=0.0)
        >>> PadSensor.rough().offset
        0.02
    """

    gain_spread: float = 0.05
    offset: float = 0.002
    noise: float = 0.001
    dead: float = 0.0

    def __post_init__(self) -> None:
        for key in ("gain_spread", "offset", "noise", "dead"):
            value = getattr(self, key)
            need(0 <= value < float("inf"), f"'{key}' must be a number, not negative", value)
        need(self.dead <= 1, "'dead' must be a probability", self.dead)

    @classmethod
    def rough(cls) -> Self:
        r"""Returns a rough sensor with gains that differ by 15 % and offsets of 20 mN."""
        return cls(gain_spread=0.15, offset=0.02)

    def device(self, num_taxels: int, rng: np.random.Generator) -> "PadDevice":
        r"""Returns a random sensor for one episode.

        Args:
            num_taxels (int): Number of taxels :math:`N`.
            rng (numpy.random.Generator): The random number generator, which also draws the noise of
                later readings.

        Examples:
            >>> device = PadSensor(noise=0).device(32, np.random.default_rng(0))
            >>> device.readings(np.zeros((32, 3))).shape
            (32, 3)
        """
        shape = (num_taxels, 3)
        gain = 1 + self.gain_spread * rng.normal(size=shape)
        offset = self.offset * rng.normal(size=shape)
        is_alive = rng.uniform(size=(num_taxels, 1)) >= self.dead
        return PadDevice(gain * is_alive, offset * is_alive, self.noise * is_alive, rng)


@dataclass(frozen=True, eq=False)
class PadDevice:
    r"""The sensor of one episode, as returned by :meth:`PadSensor.device`.

    Shapes:
        - **gain:** :math:`(N, 3)`
        - **offset:** offset in newtons :math:`(N, 3)`
        - **noise:** standard deviation in newtons :math:`(N, 1)`

    Examples:
        >>> device = PadSensor().device(32, np.random.default_rng(0))
        >>> device.gain.shape
        (32, 3)
    """

    gain: np.ndarray
    offset: np.ndarray
    noise: np.ndarray
    rng: np.random.Generator

    def readings(self, force: np.ndarray) -> np.ndarray:
        r"""Returns the readings of one frame in newtons :math:`(N, 3)`.

        Args:
            force (numpy.ndarray): Forces on the taxels in newtons :math:`(N, 3)`.
        """
        noise = self.noise * self.rng.normal(size=force.shape)
        readings: np.ndarray = (self.gain * force + self.offset + noise).astype(np.float32)
        return readings
