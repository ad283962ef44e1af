r"""From forces on the skin to what a magnetic skin reports."""

from dataclasses import dataclass

import numpy as np

from torch_geometric_tactile.sensors import TaxelLayout

_REST = np.array([33000.0, 33000.0, 37000.0])  # counts of x, y, z with nothing touched
_COUNTS = 65535


@dataclass(frozen=True)
class SkinModel:
    r"""Readings of a magnetic skin such as uSkin under given forces. A model: its constants are
    plausible, not measured. Each part is switched off by the value in brackets.

    The parts, in their order: force spreads to the other taxels of a patch
    (:obj:`spread`, conserving the sum); a part of it follows late (:obj:`lag`); the response
    saturates (:obj:`saturation`); axes mix (:obj:`mixing`); each device has gains and offsets of
    its own (:obj:`gain_spread`, :obj:`offset_spread`); each trial begins with another offset and
    drifts (:obj:`drift`); noise is added (:obj:`noise`); the result is rounded to 16-bit counts
    (:obj:`quantize`).

    Args:
        spread (float): Part of a taxel's force that its neighbours in the patch read (0).
        spread_length (float): Distance in metres over which it falls to 61 %.
        lag (float): Part of the force that follows with the time constant :obj:`lag_time`; a press
            and a release of one second each then differ by up to half of it, slower ones by less,
            :obj:`2 * lag * lag_time / seconds` of the range (0).
        lag_time (float): Time constant in seconds.
        saturation (tuple of float): Force in newtons at which shear :math:`x`, :math:`y` and
            pressure :math:`z` level off (infinity).
        gain (tuple of float): Counts per newton of :math:`x, y, z`.
        mixing (float): Part of each axis that shows in another (0).
        gain_spread (float): Standard deviation of the taxels' gains, relative (0).
        offset_spread (float): Standard deviation of the taxels' rest readings in counts (0).
        drift (float): Standard deviation of a trial's offset, and of its drift over ten seconds,
            in counts (0).
        noise (float): Standard deviation of the noise in counts (0).
        quantize (bool): Whether to round to whole counts within 16 bits.
        device_seed (int): Which device: decides gains, offsets and mixing.

    Raises:
        ValueError: If a number is negative, or a part is not below one.

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
        r"""Returns readings in counts.

        Args:
            force (numpy.ndarray): Shear along :math:`x` and :math:`y` and pressure :math:`z` on
                each taxel in newtons :math:`(T, N, 3)`.
            time (numpy.ndarray): Times in seconds :math:`(T,)`.
            layout (TaxelLayout): The taxels; their patches decide where force spreads.
            rng (numpy.random.Generator, optional): Draws drift and noise; none of both if left out.

        Raises:
            ValueError: If the forces have another shape than :math:`(T, N, 3)`.
        """
        num_taxels = layout.num_taxels
        if force.shape != (len(time), num_taxels, 3):
            raise ValueError(
                f"'force' must have shape {(len(time), num_taxels, 3)} (got {force.shape})"
            )
        out = self._lagged(self._spread(force.astype(np.float64), layout), time)
        limit = np.array(self.saturation)
        finite = np.isfinite(limit)
        out[..., finite] = limit[finite] * np.tanh(out[..., finite] / limit[finite])
        device = np.random.default_rng(self.device_seed)
        gain = np.array(self.gain) * (1 + self.gain_spread * device.normal(size=(num_taxels, 3)))
        mix = self.mixing * device.uniform(-1.0, 1.0, (num_taxels, 3, 3))
        mix[:, range(3), range(3)] = 1.0
        offset = _REST + self.offset_spread * device.normal(size=(num_taxels, 3))
        out = (mix * (out * gain)[..., None, :]).sum(axis=-1) + offset
        if rng is not None:
            start, slope = self.drift * rng.normal(size=(2, num_taxels, 3))
            out += start + slope * ((time - time[:1]) / 10.0)[:, None, None]
            out += self.noise * rng.normal(size=out.shape)
        if self.quantize:
            out = out.round().clip(0, _COUNTS)
        return out.astype(np.float32)

    def _spread(self, force: np.ndarray, layout: TaxelLayout) -> np.ndarray:
        if self.spread == 0:
            return force
        pos, patch = layout.pos.double().numpy(), layout.segments("patch").numpy()
        out = np.empty_like(force)
        for number in np.unique(patch):
            taxels = np.flatnonzero(patch == number)
            square = ((pos[taxels, None] - pos[taxels]) ** 2).sum(axis=-1)
            share = np.exp(-square / (2 * self.spread_length**2))
            np.fill_diagonal(share, 0.0)
            total = share.sum(axis=0)
            spread = np.where(total > 0, self.spread, 0.0)  # a single taxel keeps all
            share *= spread / np.where(total > 0, total, 1.0)
            np.fill_diagonal(share, 1 - spread)
            out[:, taxels] = np.einsum("ij,tjc->tic", share, force[:, taxels])
        return out

    def _lagged(self, force: np.ndarray, time: np.ndarray) -> np.ndarray:
        if self.lag == 0 or len(time) == 0:
            return force
        late = np.empty_like(force)
        late[0] = force[0]
        keep = np.exp(-np.diff(time) / self.lag_time)
        for i, part in enumerate(keep, start=1):
            late[i] = part * late[i - 1] + (1 - part) * force[i]
        out: np.ndarray = (1 - self.lag) * force + self.lag * late
        return out
