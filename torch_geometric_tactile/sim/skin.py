r"""Computes the readings of a magnetic skin from the forces on it."""

from dataclasses import dataclass

import numpy as np

from torch_geometric_tactile.sensors import TaxelLayout

_REST = np.array([33000.0, 33000.0, 37000.0])  # counts of x, y, z without contact
_MAX_COUNT = 65535  # largest 16-bit count


@dataclass(frozen=True)
class SkinModel:
    r"""A model that computes the readings of a magnetic skin, such as uSkin, from forces. The
    constants of the model are plausible, not measured.

    The model has these steps:

    1. Force spreads to the neighbours in a patch (:obj:`spread`); the sum stays constant.
    2. A part of the force is delayed (:obj:`lag`).
    3. The response saturates (:obj:`saturation`).
    4. Axes mix (:obj:`mixing`).
    5. Gains and offsets differ between taxels and devices (:obj:`gain_spread`,
       :obj:`offset_spread`).
    6. Offset and drift differ between trials (:obj:`drift`).
    7. Noise is added (:obj:`noise`), and the sum is rounded to 16-bit counts (:obj:`quantize`).

    In the list of arguments, the value in brackets switches a step off.

    Args:
        spread (float): Part of a taxel's force that its neighbours in the patch read (0).
        spread_length (float): Distance in metres over which the spread falls to 61 %.
        lag (float): Part of the force that follows with the time constant :obj:`lag_time` (0).
            If a press and a release take one second each, their readings differ by up to half of
            this part. If they are slower, the readings differ by
            :obj:`2 * lag * lag_time / seconds` of the range.
        lag_time (float): Time constant in seconds.
        saturation (tuple of float): Force in newtons at which shear :math:`x`, :math:`y` and
            pressure :math:`z` level off (infinity).
        gain (tuple of float): Counts per newton of :math:`x, y, z`.
        mixing (float): Part of each axis that another axis reads (0).
        gain_spread (float): Relative standard deviation of the gains of the taxels (0).
        offset_spread (float): Standard deviation of the taxels' readings at rest in counts (0).
        drift (float): Standard deviation of the offset of a trial, and of its drift in ten seconds,
            in counts (0).
        noise (float): Standard deviation of the noise in counts (0).
        quantize (bool): If :obj:`True`, rounds to whole counts within 16 bits.
        device_seed (int): Seed of the gains, offsets and mixing of a device.

    Raises:
        ValueError: If a number is negative, or if :obj:`spread`, :obj:`lag` or :obj:`mixing` is not
            below one.

    Examples:
        >>> from torch_geometric_tactile.sensors import grid
        >>> skin = SkinModel(noise=0, drift=0, offset_spread=0)
        >>> skin.readings(np.zeros((1, 4, 3)), np.zeros(1), grid(2, 2, 0.005))[0, 0].tolist()
        [33000.0, 33000.0, 37000.0]
    """

    spread: float = 0.35
    spread_length: float = 0.005
    lag: float = 0.20
    lag_time: float = 0.6
    saturation: tuple[float, float, float] = (4.0, 4.0, 10.0)
    gain: tuple[float, float, float] = (1200.0, 1200.0, 1800.0)
    mixing: float = 0.06
    gain_spread: float = 0.10
    offset_spread: float = 250.0
    drift: float = 10.0
    noise: float = 10.0
    quantize: bool = True
    device_seed: int = 0

    def __post_init__(self) -> None:
        for key in ("spread", "lag", "mixing"):
            value = getattr(self, key)
            if not 0 <= value < 1:
                raise ValueError(f"'{key}' must be at least 0 and below 1 (got {value})")
        for key in ("gain_spread", "offset_spread", "drift", "noise"):
            value = getattr(self, key)
            if not value >= 0:
                raise ValueError(f"'{key}' must not be negative (got {value})")
        for key in ("spread_length", "lag_time"):
            value = getattr(self, key)
            if not value > 0:
                raise ValueError(f"'{key}' must be positive (got {value})")
        for key in ("saturation", "gain"):
            value = getattr(self, key)
            if len(value) != 3 or not min(value) > 0:
                raise ValueError(f"'{key}' must be three positive numbers (got {value})")

    def readings(
        self,
        force: np.ndarray,
        time: np.ndarray,
        layout: TaxelLayout,
        rng: np.random.Generator | None = None,
    ) -> np.ndarray:
        r"""Returns the readings of the skin in counts :math:`(T, N, 3)`.

        Args:
            force (numpy.ndarray): Shear along :math:`x` and :math:`y` and pressure :math:`z` on
                each taxel in newtons :math:`(T, N, 3)`.
            time (numpy.ndarray): Times in seconds :math:`(T,)`.
            layout (TaxelLayout): The taxels. Force spreads within their patches.
            rng (numpy.random.Generator, optional): The random number generator for drift and noise
                (default: no drift and no noise).

        Raises:
            ValueError: If the shape of the forces is not :math:`(T, N, 3)`.
        """
        num_taxels = layout.num_taxels
        if force.shape != (len(time), num_taxels, 3):
            raise ValueError(
                f"'force' must have shape {(len(time), num_taxels, 3)} (got {force.shape})"
            )
        response = self._apply_lag(self._spread_force(force.astype(np.float64), layout), time)
        limit = np.array(self.saturation)
        finite = np.isfinite(limit)
        response[..., finite] = limit[finite] * np.tanh(response[..., finite] / limit[finite])
        device_rng = np.random.default_rng(self.device_seed)
        relative_gain = 1 + self.gain_spread * device_rng.normal(size=(num_taxels, 3))
        gain = np.array(self.gain) * relative_gain
        mixing = self.mixing * device_rng.uniform(-1.0, 1.0, (num_taxels, 3, 3))
        mixing[:, range(3), range(3)] = 1.0
        offset = _REST + self.offset_spread * device_rng.normal(size=(num_taxels, 3))
        readings = (mixing * (response * gain)[..., None, :]).sum(axis=-1) + offset
        if rng is not None:
            start, slope = self.drift * rng.normal(size=(2, num_taxels, 3))
            readings += start + slope * ((time - time[:1]) / 10.0)[:, None, None]
            readings += self.noise * rng.normal(size=readings.shape)
        if self.quantize:
            readings = readings.round().clip(0, _MAX_COUNT)
        return readings.astype(np.float32)

    def _spread_force(self, force: np.ndarray, layout: TaxelLayout) -> np.ndarray:
        if self.spread == 0:
            return force
        pos, patch = layout.pos.double().numpy(), layout.segments("patch").numpy()
        spread_force = np.empty_like(force)
        for number in np.unique(patch):
            taxels = np.flatnonzero(patch == number)
            square_distance = ((pos[taxels, None] - pos[taxels]) ** 2).sum(axis=-1)
            weights = np.exp(-square_distance / (2 * self.spread_length**2))
            np.fill_diagonal(weights, 0.0)
            total = weights.sum(axis=0)
            spread = np.where(total > 0, self.spread, 0.0)  # 0 for a taxel without neighbours
            weights *= spread / np.where(total > 0, total, 1.0)
            np.fill_diagonal(weights, 1 - spread)
            spread_force[:, taxels] = np.einsum("ij,tjc->tic", weights, force[:, taxels])
        return spread_force

    def _apply_lag(self, force: np.ndarray, time: np.ndarray) -> np.ndarray:
        if self.lag == 0 or len(time) == 0:
            return force
        delayed = np.empty_like(force)
        delayed[0] = force[0]
        decay = np.exp(-np.diff(time) / self.lag_time)
        for i, factor in enumerate(decay, start=1):
            delayed[i] = factor * delayed[i - 1] + (1 - factor) * force[i]
        lagged_force: np.ndarray = (1 - self.lag) * force + self.lag * delayed
        return lagged_force
