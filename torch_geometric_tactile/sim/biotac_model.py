r"""From forces on a fluid-filled fingertip to what its electrodes and pressure sensor report."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.sensors import TaxelLayout

_COUNTS = 4095
_REST = 3000.0  # counts of an electrode with nothing touched
_PRESSURE_REST = 1800.0
_SKIN_RADIUS = 0.007  # m
_FLUID = 0.002  # m, from an electrode to the skin above it
_STRONGEST_DRAG = 0.003  # m


class SessionOffsets(NamedTuple):
    r"""What differs from one recording session to the next: rest readings in counts and gains of
    the electrodes, both :math:`(N, 3)` for three fingers, and of the pressure sensors :math:`(3,)`.
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
    r"""Computes the readings of three fluid-filled fingertips such as the BioTac from contact
    forces. A model: its constants are plausible, not measured.

    The parts, in their order: the middle of a contact is dragged along by shear (:obj:`drag`); the
    contact is as wide as one of elastic bodies (Hertz, :obj:`stiffness`), widened by the fluid
    (:obj:`blur`), and thins the fluid above electrodes by their distance from it; the fluid that it
    displaces lifts the skin elsewhere (:obj:`bulge`); a part follows late (:obj:`lag`); the
    response saturates (:obj:`saturation`). Every session has offsets and gains of its own
    (:obj:`offset_spread`, :obj:`gain_spread`); each grasp drifts with temperature (:obj:`drift`);
    noise is added (:obj:`noise`); the result is rounded to 12 bits. Pressure lowers the count of an
    electrode near the contact.

    Args:
        gain (float): Counts per newton below a narrow contact.
        saturation (float): Counts by which a reading can fall.
        blur (float): Width in metres of the smallest contact.
        stiffness (float): Elastic modulus of the skin in pascal.
        drag (float): Way of the contact in metres per newton of shear, for small shear.
        bulge (float): Part of the response that all electrodes lose, per newton.
        lag (float): Part of the response that follows with :obj:`lag_time`.
        lag_time (float): Time constant in seconds.
        pressure_gain (float): Counts of the pressure sensor per newton.
        offset_spread (float): Standard deviation of offsets of a session in counts.
        gain_spread (float): The same of the logarithm of its gains.
        drift (float): Standard deviation of the drift in ten seconds in counts.
        noise (float): Standard deviation of the noise of an electrode in counts.
        pressure_noise (float): The same of the pressure sensor.

    Raises:
        ValueError: If a number is negative, or one that has to be positive is zero, or :obj:`lag`
            is not below one.

    Examples:
        >>> from torch_geometric_tactile.sensors import biotac
        >>> model = BioTacModel(offset_spread=0.0)
        >>> session = model.session(biotac(), np.random.default_rng(0))
        >>> response, force = np.zeros((10, 19, 3)), np.zeros((10, 3))  # nothing touches them
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
                least = "positive" if name in positive else "not negative"
                raise ValueError(f"'{name}' must be {least} and finite (got {value})")
        need(self.lag < 1, "'lag' must be at least 0 and below 1", self.lag)

    def session(self, layout: TaxelLayout, rng: np.random.Generator) -> SessionOffsets:
        r"""Draws offsets and gains of a session.

        Args:
            layout (TaxelLayout): The fingertip.
            rng (numpy.random.Generator): Draws them.
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
        r"""Returns by how many counts each reading falls, without lag, sessions, drift and noise
        :math:`(T, N, 3)`.

        Args:
            force (numpy.ndarray): Forces on three fingertips, in their frames, in newtons
                :math:`(T, 3, 3)`.
            normal (numpy.ndarray): Their parts along the normal of the contact :math:`(T, 3)`.
            place (numpy.ndarray): The middles of the contacts in metres :math:`(T, 3, 3)`.
            layout (TaxelLayout): The fingertip; it has normals.
            curvature (float): Of the object, in 1/metre; 0 is flat.

        Raises:
            ValueError: If shapes differ from these, or the layout has no normals.
        """
        if layout.normal is None:
            raise ValueError(f"layout '{layout.name}' must have normals (got none)")
        shape = (len(normal), 3, 3)
        if normal.shape != shape[:2] or force.shape != shape or place.shape != shape:
            raise ValueError(
                "'force', 'normal' and 'place' must have shapes (T, 3, 3), (T, 3) and (T, 3, 3) "
                f"(got {force.shape}, {normal.shape} and {place.shape})"
            )
        skin = (layout.pos + _FLUID * layout.normal).double().numpy()
        middle = place.copy()
        shear = force[..., :2]
        middle[..., :2] += _STRONGEST_DRAG * np.tanh(self.drag * shear / _STRONGEST_DRAG)
        radius = 1 / (1 / _SKIN_RADIUS + curvature)
        hertz = np.cbrt(0.75 * normal * radius / self.stiffness)
        square = ((middle[:, None] - skin[:, None]) ** 2).sum(axis=-1)  # (T, N, 3)
        width = self.blur**2 + (0.6 * hertz) ** 2
        press = normal[:, None] * (np.exp(-square / (2 * width[:, None])) - self.bulge)
        out: np.ndarray = self.saturation * np.tanh(self.gain * press / self.saturation)
        return out

    def readings(
        self,
        response: np.ndarray,
        normal: np.ndarray,
        time: np.ndarray,
        session: SessionOffsets,
        rng: np.random.Generator,
    ) -> _FingertipReadings:
        r"""Returns what is read.

        Args:
            response (numpy.ndarray): As :meth:`response` returns it.
            normal (numpy.ndarray): Normal forces in newtons :math:`(T, 3)`.
            time (numpy.ndarray): Times in seconds :math:`(T,)`.
            session (SessionOffsets): Offsets and gains.
            rng (numpy.random.Generator): Draws drift and noise.
        """
        late = np.zeros_like(response)
        keep = np.exp(-np.diff(time) / self.lag_time)
        for i, part in enumerate(keep, start=1):
            late[i] = part * late[i - 1] + (1 - part) * response[i]
        fall = (1 - self.lag) * response + self.lag * late
        # Temperature acts on a whole fingertip, on some electrodes more than on others.
        warmth = rng.normal(size=3) * (1 + 0.3 * rng.normal(size=response.shape[1:]))
        drift = self.drift * ((time - time[:1]) / 10.0)[:, None, None] * warmth
        tactile = session.offset - session.gain * fall + drift
        tactile += self.noise * rng.normal(size=tactile.shape)
        pressure = session.pressure_offset + session.pressure_gain * self.pressure_gain * normal
        pressure += drift.mean(axis=1) + self.pressure_noise * rng.normal(size=pressure.shape)
        return _FingertipReadings(_counts(tactile), _counts(pressure))


def _counts(values: np.ndarray) -> np.ndarray:
    return values.round().clip(0, _COUNTS).astype(np.float32)
