r"""Computes the readings of the electrodes and the pressure sensor of a fluid-filled fingertip."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.sensors import TaxelLayout

_MAX_COUNT = 4095  # largest 12-bit count
_REST = 3000.0  # counts of an electrode without contact
_PRESSURE_REST = 1800.0  # counts of the pressure sensor without contact
_SKIN_RADIUS = 0.007  # m
_FLUID_DEPTH = 0.002  # m from an electrode to the skin above it
_MAX_DRAG = 0.003  # m


class SessionOffsets(NamedTuple):
    r"""The offsets and gains of one recording session: readings at rest in counts and gains of the
    electrodes on three fingers, both :math:`(N, 3)`, and of the pressure sensors :math:`(3,)`.
    """

    offset: np.ndarray
    gain: np.ndarray
    pressure_offset: np.ndarray
    pressure_gain: np.ndarray


class _FingertipReadings(NamedTuple):
    r"""Readings in counts: electrodes :math:`(T, N, 3)` and fluid pressure :math:`(T, 3)`."""

    tactile: np.ndarray
    pressure: np.ndarray


@dataclass(frozen=True)
class BioTacModel:
    r"""A model that computes the readings of three fluid-filled fingertips, such as the BioTac,
    from contact forces. The constants of the model are plausible, not measured.

    The model has these steps:

    1. Shear moves the centre of a contact (:obj:`drag`).
    2. The contact is as wide as for elastic bodies (Hertz, :obj:`stiffness`), plus a width due to
       the fluid (:obj:`blur`). It makes the fluid above nearby electrodes thinner.
    3. The displaced fluid lifts the skin elsewhere (:obj:`bulge`).
    4. A part of the response is delayed (:obj:`lag`).
    5. The response saturates (:obj:`saturation`).
    6. Offsets and gains differ between sessions (:obj:`offset_spread`, :obj:`gain_spread`).
    7. Each grasp drifts with temperature (:obj:`drift`).
    8. Noise is added (:obj:`noise`), and the sum is rounded to 12 bits.

    Pressure lowers the count of an electrode near the contact.

    Args:
        gain (float): Counts per newton below a narrow contact.
        saturation (float): Largest decrease of a reading in counts.
        blur (float): Width in metres of the smallest contact.
        stiffness (float): Elastic modulus of the skin in pascal.
        drag (float): Motion of the contact in metres per newton of shear, for small shear.
        bulge (float): Part of the response that all electrodes lose, per newton.
        lag (float): Part of the response that follows with the time constant :obj:`lag_time`.
        lag_time (float): Time constant in seconds.
        pressure_gain (float): Counts of the pressure sensor per newton.
        offset_spread (float): Standard deviation of the offsets of sessions in counts.
        gain_spread (float): Standard deviation of the logarithm of the gains of sessions.
        drift (float): Standard deviation of the drift in ten seconds in counts.
        noise (float): Standard deviation of the noise of an electrode in counts.
        pressure_noise (float): Standard deviation of the noise of the pressure sensor in counts.

    Raises:
        ValueError: If a number is negative, if :obj:`lag` is not below one, or if
            :obj:`saturation`, :obj:`blur`, :obj:`stiffness` or :obj:`lag_time` is zero.

    Examples:
        >>> from torch_geometric_tactile.sensors import biotac
        >>> model = BioTacModel(offset_spread=0.0)
        >>> session = model.session(biotac(), np.random.default_rng(0))
        >>> response, force = np.zeros((10, 19, 3)), np.zeros((10, 3))  # without contact
        >>> time = np.arange(10) / 100
        >>> readings = model.readings(response, force, time, session, np.random.default_rng(0))
        >>> readings.tactile.shape, readings.pressure.shape
        ((10, 19, 3), (10, 3))
    """

    gain: float = 220.0
    saturation: float = 2200.0
    blur: float = 0.0032
    stiffness: float = 2.5e5
    drag: float = 0.0012
    bulge: float = 0.08
    lag: float = 0.25
    lag_time: float = 0.15
    pressure_gain: float = 28.0
    offset_spread: float = 150.0
    gain_spread: float = 0.10
    drift: float = 20.0
    noise: float = 8.0
    pressure_noise: float = 1.5

    def __post_init__(self) -> None:
        positive = ("saturation", "blur", "stiffness", "lag_time")
        for name in self.__dataclass_fields__:
            value = getattr(self, name)
            if not 0 <= value < float("inf") or (value == 0 and name in positive):
                requirement = "positive" if name in positive else "not negative"
                raise ValueError(f"'{name}' must be {requirement} and finite (got {value})")
        need(self.lag < 1, "'lag' must be at least 0 and below 1", self.lag)

    def session(self, layout: TaxelLayout, rng: np.random.Generator) -> SessionOffsets:
        r"""Returns random offsets and gains of a session.

        Args:
            layout (TaxelLayout): The fingertip.
            rng (numpy.random.Generator): The random number generator.
        """
        shape = (layout.num_taxels, 3)
        return SessionOffsets(
            offset=_REST + self.offset_spread * rng.normal(size=shape),
            gain=np.exp(self.gain_spread * rng.normal(size=shape)),
            pressure_offset=_PRESSURE_REST + self.offset_spread * rng.normal(size=3),
            pressure_gain=np.exp(self.gain_spread * rng.normal(size=3)),
        )

    def response(
        self,
        force: np.ndarray,
        normal: np.ndarray,
        place: np.ndarray,
        layout: TaxelLayout,
        curvature: float = 0.0,
    ) -> np.ndarray:
        r"""Returns the decrease of each reading in counts, without lag, sessions, drift and noise
        :math:`(T, N, 3)`.

        Args:
            force (numpy.ndarray): Forces on three fingertips in the frames of the fingertips, in
                newtons :math:`(T, 3, 3)`.
            normal (numpy.ndarray): Normal forces in newtons :math:`(T, 3)`.
            place (numpy.ndarray): Centres of the contacts in metres :math:`(T, 3, 3)`.
            layout (TaxelLayout): The fingertip, with normals.
            curvature (float): Curvature of the object in 1/metre. A flat object has 0.

        Raises:
            ValueError: If an array has another shape, or the layout has no normals.
        """
        if layout.normal is None:
            raise ValueError(f"layout '{layout.name}' must have normals (got none)")
        shape = (len(normal), 3, 3)
        if normal.shape != shape[:2] or force.shape != shape or place.shape != shape:
            raise ValueError(
                "'force', 'normal' and 'place' must have shapes (T, 3, 3), (T, 3) and (T, 3, 3) "
                f"(got {force.shape}, {normal.shape} and {place.shape})"
            )
        skin = (layout.pos + _FLUID_DEPTH * layout.normal).double().numpy()
        centre = place.copy()
        shear = force[..., :2]
        centre[..., :2] += _MAX_DRAG * np.tanh(self.drag * shear / _MAX_DRAG)
        radius = 1 / (1 / _SKIN_RADIUS + curvature)
        hertz_radius = np.cbrt(0.75 * normal * radius / self.stiffness)
        square_distance = ((centre[:, None] - skin[:, None]) ** 2).sum(axis=-1)  # (T, N, 3)
        square_width = self.blur**2 + (0.6 * hertz_radius) ** 2
        proximity = np.exp(-square_distance / (2 * square_width[:, None]))
        press = normal[:, None] * (proximity - self.bulge)
        fall: np.ndarray = self.saturation * np.tanh(self.gain * press / self.saturation)
        return fall

    def readings(
        self,
        response: np.ndarray,
        normal: np.ndarray,
        time: np.ndarray,
        session: SessionOffsets,
        rng: np.random.Generator,
    ) -> _FingertipReadings:
        r"""Returns the readings of electrodes and pressure sensors in counts, with lag, the offsets
        and gains of the session, drift and noise.

        Args:
            response (numpy.ndarray): Output of :meth:`response` :math:`(T, N, 3)`.
            normal (numpy.ndarray): Normal forces in newtons :math:`(T, 3)`.
            time (numpy.ndarray): Times in seconds :math:`(T,)`.
            session (SessionOffsets): Offsets and gains of the session.
            rng (numpy.random.Generator): The random number generator for drift and noise.
        """
        delayed = np.zeros_like(response)
        decay = np.exp(-np.diff(time) / self.lag_time)
        for i, factor in enumerate(decay, start=1):
            delayed[i] = factor * delayed[i - 1] + (1 - factor) * response[i]
        fall = (1 - self.lag) * response + self.lag * delayed
        # The temperature affects the entire fingertip, but electrodes differ in sensitivity.
        sensitivity = rng.normal(size=3) * (1 + 0.3 * rng.normal(size=response.shape[1:]))
        drift = self.drift * ((time - time[:1]) / 10.0)[:, None, None] * sensitivity
        tactile = session.offset - session.gain * fall + drift
        tactile += self.noise * rng.normal(size=tactile.shape)
        pressure = session.pressure_offset + session.pressure_gain * self.pressure_gain * normal
        pressure += drift.mean(axis=1) + self.pressure_noise * rng.normal(size=pressure.shape)
        return _FingertipReadings(_to_counts(tactile), _to_counts(pressure))


def _to_counts(values: np.ndarray) -> np.ndarray:
    return values.round().clip(0, _MAX_COUNT).astype(np.float32)
