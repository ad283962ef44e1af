r"""Presses of a stamp with a letter on a flexible pressure array."""

import math
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.sensors import TaxelLayout, letter_array
from torch_geometric_tactile.sim._pressure_field import CELL, FieldSampling, field_sampling
from torch_geometric_tactile.sim.letter_outlines import LETTERS, letter_strokes

# Arguments of LetterPress, grouped by the check that they must pass.
_RANGES = ("size", "pressure", "repeatability")
_POSITIVE = ("stroke", "sensel", "full_scale")
_NOT_NEGATIVE = ("margin", "blur_length", "spread_length")
_FRACTIONS = ("tilt", "spread", "crosstalk")


class LetterPresses(NamedTuple):
    r"""Simulated presses of a letter: the readings, and the random size, angle, position and
    pressure of each press.

    Shapes:
        - **readings:** readings in kPa :math:`(P, N)`
        - **size:** height of the letter in metres :math:`(P,)`
        - **angle:** rotation of the letter in radians, from :math:`x` to :math:`y` :math:`(P,)`
        - **place:** centre of the letter in the plane of the layout, in metres :math:`(P, 2)`
        - **pressure:** pressure below the centre of the letter in kPa :math:`(P,)`
        - **slope:** relative change of the pressure per metre along :math:`x` and :math:`y`
          :math:`(P, 2)`

    Examples:
        >>> presses = LetterPress().press("A", 2, np.random.default_rng(0))
        >>> presses.readings.shape, presses.place.shape
        ((2, 1024), (2, 2))
    """

    readings: np.ndarray
    size: np.ndarray
    angle: np.ndarray
    place: np.ndarray
    pressure: np.ndarray
    slope: np.ndarray


class _PressParameters(NamedTuple):
    size: float
    angle: float
    place: np.ndarray
    pressure: float
    slope: np.ndarray
    pieces: np.ndarray  # of the strokes, in the plane of the layout


@dataclass(frozen=True)
class LetterPress:
    r"""A model of a stiff stamp with a raised capital letter that is pressed on an array of
    pressure pixels in an elastic layer. It follows the data set of the "A Novel Bilinear Feature
    and Multi-Layer Fused Convolutional Neural Network for Tactile Shape Recognition" paper (Sensors
    2020, 20, 5822). The paper measured pressure, repeatability, pixel size and pitch; all other
    constants of the model are plausible, not measured.

    The model has these steps:

    1. The size, angle, position and pressure of the letter are drawn at random, and a tilt by which
       the pressure varies over the letter.
    2. The layer spreads the pressure by two Gaussians (:obj:`blur_length` and the wider
       :obj:`spread_length`).
    3. Each pixel averages the pressure over the square of a sensel, with a relative error within
       :obj:`repeatability` that differs between presses.
    4. Dead rows read zero.
    5. Each pixel also reads a part of the mean of the other pixels in its row and in its column
       (:obj:`crosstalk`).
    6. Readings are rounded to :obj:`bits` between 0 and :obj:`full_scale`.

    Rows and columns are defined by the layout's image map. A layout without an image map has no
    crosstalk.

    Args:
        size (tuple of float): Smallest and largest height of a letter in metres.
        stroke (float): Width of the strokes in metres.
        angle (float): Largest rotation to either side in radians. The default is 20 degrees. From
            45 degrees on, a rotated N can equal a rotated Z; with all rotations, M and W are hardly
            distinguishable.
        margin (float): Smallest distance in metres between a letter and the edge of the array,
            which is the box around the centres of the pixels.
        pressure (tuple of float): Smallest and largest pressure in kPa.
        tilt (float): Largest relative change of the pressure from the centre of the letter to half
            its height in any direction.
        blur_length (float): Standard deviation in metres of the narrow Gaussian.
        spread (float): Part of the pressure that the wide Gaussian spreads.
        spread_length (float): Standard deviation in metres of the wide Gaussian.
        sensel (float): Side of a pixel's sensitive square in metres.
        repeatability (tuple of float): Smallest and largest relative error of a reading.
        crosstalk (float): Part of the mean of the other pixels in its row, and of the mean of the
            other pixels in its column, that a pixel reads.
        full_scale (float): Largest reading in kPa.
        bits (int, optional): Number of bits per reading, up to 16. With :obj:`None`, readings are
            not rounded.
        dead_rows (int): Number of broken rows.
        device_seed (int): Seed of the choice of broken rows.

    Raises:
        ValueError: If a number is negative, if a range is decreasing, if a fraction is not below
            one, or if an angle is above half a turn.

    Examples:
        >>> presses = LetterPress().press("T", 2, np.random.default_rng(0))
        >>> presses.readings.shape
        (2, 1024)
        >>> bool(presses.readings.max() < 100)
        True
    """

    size: tuple[float, float] = (0.014, 0.020)
    stroke: float = 0.0025
    angle: float = math.pi / 9
    margin: float = 0.00125
    pressure: tuple[float, float] = (30.0, 75.0)
    tilt: float = 0.3
    blur_length: float = 0.001
    spread: float = 0.3
    spread_length: float = 0.003
    sensel: float = 0.0007
    repeatability: tuple[float, float] = (-0.02, 0.06)
    crosstalk: float = 0.05
    full_scale: float = 100.0
    bits: int | None = 8
    dead_rows: int = 0
    device_seed: int = 0

    def __post_init__(self) -> None:
        for name in _RANGES:
            pair = getattr(self, name)
            if np.shape(pair) != (2,) or not -1 < pair[0] <= pair[1] < math.inf:
                raise ValueError(
                    f"'{name}' must be two numbers above -1, the smaller first (got {pair})"
                )
            object.__setattr__(self, name, tuple(map(float, pair)))
        for name in (*_POSITIVE, *_NOT_NEGATIVE):
            value = getattr(self, name)
            if not 0 <= value < math.inf or (value == 0 and name in _POSITIVE):
                requirement = "positive" if name in _POSITIVE else "not negative"
                raise ValueError(f"'{name}' must be {requirement} and finite (got {value})")
        for name in _FRACTIONS:
            if not 0 <= getattr(self, name) < 1:
                raise ValueError(
                    f"'{name}' must be at least 0 and below 1 (got {getattr(self, name)})"
                )
        need(0 <= self.angle <= math.pi, "'angle' must be between 0 and pi, in radians", self.angle)
        if self.size[0] <= self.stroke:
            raise ValueError(f"'size' must be above 'stroke', {self.stroke} m (got {self.size[0]})")
        if self.pressure[0] < 0:
            raise ValueError(f"'pressure' must not be negative (got {self.pressure[0]})")
        if self.bits is not None and not 1 <= self.bits <= 16:
            raise ValueError(f"'bits' must be from 1 to 16, or None (got {self.bits})")
        for name in ("dead_rows", "device_seed"):
            if getattr(self, name) < 0:
                raise ValueError(f"'{name}' must not be negative (got {getattr(self, name)})")

    def press(
        self,
        letter: str,
        count: int,
        rng: np.random.Generator,
        layout: TaxelLayout | None = None,
    ) -> LetterPresses:
        r"""Returns the readings of several presses of a letter.

        Args:
            letter (str): One of the letters A to Z.
            count (int): Number of presses.
            rng (numpy.random.Generator): The random number generator for the presses and the errors
                of the pixels.
            layout (TaxelLayout, optional): The pixels, in a plane of constant :math:`z` whose
                :math:`y` points downwards in an image (default: :func:`letter_array`). With
                generators in the same state, layouts of the same outer size get the same presses.

        Raises:
            ValueError: If :obj:`letter` is not one of A to Z, if :obj:`count` is negative, or if
                the layout is not flat, is too small for the letters, or has fewer rows than
                :obj:`dead_rows`.
        """
        need(count >= 0, "'count' must not be negative", count)
        strokes = letter_strokes(letter)
        layout = _default_layout() if layout is None else layout
        self.check_layout(layout)
        sampling = field_sampling(
            layout,
            self.sensel,
            (self.blur_length, self.spread_length),
            (1 - self.spread, self.spread),
        )
        # All presses are drawn before any reading, so that they do not depend on the number of
        # pixels.
        presses = [self._draw_press(strokes, sampling, rng) for _ in range(count)]
        readings = np.empty((count, layout.num_taxels), dtype=np.float32)
        for i, press in enumerate(presses):
            readings[i] = self._to_readings(self._pixel_pressure(press, sampling), layout, rng)
        return LetterPresses(
            readings,
            np.array([press.size for press in presses]),
            np.array([press.angle for press in presses]),
            np.array([press.place for press in presses]).reshape(count, 2),
            np.array([press.pressure for press in presses]),
            np.array([press.slope for press in presses]).reshape(count, 2),
        )

    def check_layout(self, layout: TaxelLayout) -> None:
        r"""Raises a :obj:`ValueError` if letters cannot be pressed on a layout.

        Args:
            layout (TaxelLayout): The pixels.
        """
        pos = layout.pos.double().numpy()
        if len(pos) == 0 or np.ptp(pos[:, 2]) > 1e-6:
            raise ValueError(f"'layout' must be flat, with one z for all taxels (got {layout!r})")
        available = float(np.ptp(pos[:, :2], axis=0).min()) - 2 * self.margin
        needed = (self.size[1] - self.stroke) * _longest_diagonal() + self.stroke
        if needed > available:
            raise ValueError(
                f"'layout' must have room for letters of {1000 * self.size[1]:.3g} mm, which need "
                f"{1000 * needed:.3g} mm at any angle (got {1000 * available:.3g} mm within the "
                "margin)"
            )
        num_rows = 0 if layout.image_map is None else len(layout.image_map[:, 0].unique())
        if self.dead_rows > num_rows:
            raise ValueError(
                f"'dead_rows' must be at most the number of rows of the image map of 'layout', "
                f"{num_rows} (got {self.dead_rows})"
            )

    def _draw_press(
        self, strokes: np.ndarray, sampling: FieldSampling, rng: np.random.Generator
    ) -> _PressParameters:
        fractions = rng.random(7)
        size = _interpolate(self.size, fractions[0])
        angle = self.angle * (2 * fractions[1] - 1)
        cos, sin = math.cos(angle), math.sin(angle)
        rotated = (size - self.stroke) * (strokes @ np.array([[cos, sin], [-sin, cos]]))
        edge = self.stroke / 2 + self.margin
        low = sampling.low + edge - rotated.min(axis=(0, 1))
        high = sampling.high - edge - rotated.max(axis=(0, 1))
        place = low + fractions[2:4] * (high - low)
        pressure = _interpolate(self.pressure, fractions[4])
        direction = 2 * math.pi * fractions[5]
        steepness = self.tilt * fractions[6] / (size / 2)
        slope = steepness * np.array([math.cos(direction), math.sin(direction)])
        return _PressParameters(size, angle, place, pressure, slope, rotated + place)

    def _pixel_pressure(self, press: _PressParameters, sampling: FieldSampling) -> np.ndarray:
        # Only cells that the letter touches are evaluated.
        edge = self.stroke / 2 + CELL
        x, y, cells = sampling.cells_in_box(
            press.pieces.min(axis=(0, 1)) - edge, press.pieces.max(axis=(0, 1)) + edge
        )
        distance = _distance_to_pieces(x, y, press.pieces)
        coverage = np.clip(0.5 - (distance - self.stroke / 2) / CELL, 0.0, 1.0)
        tilt = (
            1
            + press.slope[0] * (x - press.place[0])[None, :]
            + press.slope[1] * (y - press.place[1])[:, None]
        )
        return press.pressure * sampling.at_pixels(coverage * np.maximum(tilt, 0.0), cells)

    def _to_readings(
        self, pressure: np.ndarray, layout: TaxelLayout, rng: np.random.Generator
    ) -> np.ndarray:
        low, high = self.repeatability
        readings = pressure * (1 + rng.uniform(low, high, len(pressure)))
        if layout.image_map is not None:
            rows, columns = layout.image_map.numpy().T
            is_dead = self._is_dead(rows)
            readings[is_dead] = 0.0
            if self.crosstalk:
                neighbors = _mean_without_self(readings, rows)
                neighbors = neighbors + _mean_without_self(readings, columns)
                readings = readings + self.crosstalk * neighbors
                readings[is_dead] = 0.0
        readings = np.clip(readings, 0.0, self.full_scale)
        if self.bits is not None:
            steps = 2**self.bits - 1
            readings = np.rint(readings * (steps / self.full_scale)) * (self.full_scale / steps)
        return readings

    def _is_dead(self, rows: np.ndarray) -> np.ndarray:
        device_rng = np.random.default_rng(self.device_seed)
        return np.isin(rows, device_rng.permutation(np.unique(rows))[: self.dead_rows])


@cache
def _default_layout() -> TaxelLayout:
    return letter_array()


@cache
def _longest_diagonal() -> float:
    # The longest diagonal of the bounding boxes of all letters with height one.
    return max(float(np.hypot(*np.ptp(letter_strokes(name), axis=(0, 1)))) for name in LETTERS)


def _interpolate(limits: tuple[float, float], fraction: float) -> float:
    return limits[0] + fraction * (limits[1] - limits[0])


def _distance_to_pieces(x: np.ndarray, y: np.ndarray, pieces: np.ndarray) -> np.ndarray:
    # The distance from each point of a grid to the nearest piece.
    square_distance = np.full((len(y), len(x)), np.inf)
    for start, end in pieces:
        along = end - start
        dx, dy = (x - start[0])[None, :], (y - start[1])[:, None]
        fraction = np.clip((dx * along[0] + dy * along[1]) / (along @ along), 0.0, 1.0)
        square = (dx - fraction * along[0]) ** 2 + (dy - fraction * along[1]) ** 2
        np.minimum(square_distance, square, out=square_distance)
    return np.sqrt(square_distance)


def _mean_without_self(readings: np.ndarray, line: np.ndarray) -> np.ndarray:
    # For each pixel, the mean of the other pixels in its line (row or column).
    total = np.bincount(line, weights=readings)
    num_neighbors = np.bincount(line) - 1
    mean: np.ndarray = (total[line] - readings) / np.maximum(num_neighbors, 1)[line]
    return mean
